"""Binaries and archives: small, reproducible, exporting only FMI, and buildable elsewhere."""

import hashlib
import shutil
import struct
import subprocess
import sys
import tempfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from c_hosts import LINUX
from fmpy.validation import _validate_variable_names

from fmu_src import export_fmu
from fmu_src.export.description import RELEASE_DATE, to_xml
from fmu_src.export.interface import NAME
from fmu_src.export.toolchain import CFLAGS, TARGETS, build, get_ready, join_universal_binary
from fmu_src.friction.reference import reference_motion
from fmu_src.friction.replay import replay
from fmu_src.pages.datasheet import ModelAudit, ranges
from hesr_model.audit.certificate import Certificate
from hesr_model.errors import ExportError
from hesr_model.support.cache import USED, count_hits
from hesr_model.support.compiler import compile_c

FUNCTIONS = 44  # of FMI 2.0
PLATFORMS = [pytest.param(f, marks=pytest.mark.ci) if f != "linux64" else f for f in TARGETS]

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


@pytest.fixture
def sources(table1_fmu, tmp_path):
    with zipfile.ZipFile(table1_fmu) as archive:
        members = [name for name in archive.namelist() if name.startswith("sources/")]
        archive.extractall(tmp_path, members)
    return tmp_path / "sources"


def text_at(data, offset):
    return data[offset : data.index(b"\0", offset)].decode()


def elf_exports(data):
    """Defined global symbols of .dynsym of a 64-bit ELF file."""
    (table,) = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, table + i * size) for i in range(count)]
    dynamic = next(s for s in sections if s[1] == 11)
    strings = sections[dynamic[6]][4]
    for offset in range(dynamic[4], dynamic[4] + dynamic[5], 24):
        name, info, _, section, _, _ = struct.unpack_from("<IBBHQQ", data, offset)
        if section and info >> 4:
            yield text_at(data, strings + name)


def pe_exports(data):
    """Names in the export directory of a 64-bit PE file."""
    (header,) = struct.unpack_from("<I", data, 60)
    count, optional = struct.unpack_from("<xxxxxxHxxxxxxxxxxxxH", data, header)
    (directory,) = struct.unpack_from("<I", data, header + 24 + 112)
    sections = [
        struct.unpack_from("<IIII", data, header + 24 + optional + 40 * i + 8) for i in range(count)
    ]

    def place(address):
        start, raw = next((a, p) for n, a, _, p in sections if a <= address < a + n)
        return address - start + raw

    (names,) = struct.unpack_from("<I", data, place(directory) + 32)
    (number,) = struct.unpack_from("<I", data, place(directory) + 24)
    for i in range(number):
        (address,) = struct.unpack_from("<I", data, place(names) + 4 * i)
        yield text_at(data, place(address))


def mach_o_exports(data):
    """Defined external symbols of a 64-bit Mach-O file, and whether it is signed."""
    commands, offset = struct.unpack_from("<I", data, 16)[0], 32
    names, signed = set(), False
    for _ in range(commands):
        kind, size = struct.unpack_from("<II", data, offset)
        if kind == 2:  # LC_SYMTAB
            symbols, number, strings, _ = struct.unpack_from("<IIII", data, offset + 8)
            for i in range(number):
                name, flags, section = struct.unpack_from("<IBB", data, symbols + 16 * i)
                if flags & 1 and section:
                    names.add(text_at(data, strings + name).removeprefix("_"))
        signed = signed or kind == 0x1D  # LC_CODE_SIGNATURE
        offset += size
    return names, signed


def exports(folder, data):
    if folder == "darwin64":
        (count,) = struct.unpack_from(">I", data, 4)
        slices = [struct.unpack_from(">IIIII", data, 8 + 20 * i) for i in range(count)]
        parts = [data[offset : offset + size] for _, _, offset, size, _ in slices]
        found = [mach_o_exports(part) for part in parts]
        assert [s[0] for s in slices] == [0x01000007, 0x0100000C]  # Intel, ARM
        assert found[1][1]  # ARM Macs run only signed code
        assert found[0][0] == found[1][0]
        assert b"@rpath/friction_parfam_h.dylib\0" in parts[0]
        return found[0][0] - {
            "_mh_dylib_header",
            "__dso_handle",
            "_dso_handle",
        }  # a symbol of the linker
    return set(pe_exports(data) if folder == "win64" else elf_exports(data))


@pytest.mark.parametrize("folder", PLATFORMS)
def test_only_fmi_functions_are_exported(folder, table1, tmp_path):
    fmu = export_fmu(table1, tmp_path / "F.fmu", platforms=[folder])
    with zipfile.ZipFile(fmu) as archive:
        (name,) = (n for n in archive.namelist() if n.startswith("binaries/"))
        data = archive.read(name)
    assert name == f"binaries/{folder}/friction_parfam_h{TARGETS[folder].suffix}"
    names = exports(folder, data)
    assert len(names) == FUNCTIONS
    assert all(n.startswith("fmi2") for n in names)
    assert str(Path.home()).encode() not in data
    assert tempfile.gettempdir().encode() not in data


@pytest.mark.ci
def test_windows_binaries_need_only_system_libraries_and_no_start_up(table1, tmp_path):
    """Libraries of every Windows since 10; no code runs when the library is loaded."""
    import lief  # slow

    fmu = export_fmu(table1, tmp_path / "F.fmu", platforms=["win64"])
    with zipfile.ZipFile(fmu) as archive:
        data = archive.read("binaries/win64/friction_parfam_h.dll")
    found = lief.PE.parse(list(data))
    assert found.optional_header.addressof_entrypoint == 0
    libraries = {imported.name: [e.name for e in imported.entries] for imported in found.imports}
    assert all(name.startswith("api-ms-win-crt-") for name in libraries)
    assert "calloc" in libraries["api-ms-win-crt-heap-l1-1-0.dll"]
    assert "api-ms-win-crt-math-l1-1-0.dll" not in libraries  # the FMU has its own exponential


def test_sizes_are_limited(table1_fmu):
    with zipfile.ZipFile(table1_fmu) as archive:
        # 40 KiB, the search for start states, and the factors of every law with their slopes.
        assert archive.getinfo("binaries/linux64/friction_parfam_h.so").file_size <= 42 * 1024
    assert table1_fmu.stat().st_size <= 120 * 1024


def test_the_build_is_reproducible(table1, table1_fmu, tmp_path, empty_cache):
    again = export_fmu(table1, tmp_path / "again" / "Other.fmu")
    assert again.read_bytes() == table1_fmu.read_bytes()


@pytest.fixture
def percent(tmp_path, monkeypatch):
    """A temporary folder whose name has a pattern that a linker would expand."""
    folder = tmp_path / "a%b"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_a_folder_with_a_percent_sign_gives_the_same_bytes(
    empty_cache, percent, table1, table1_fmu, tmp_path
):
    again = export_fmu(table1, tmp_path / "F.fmu")
    assert again.read_bytes() == table1_fmu.read_bytes()
    assert not list(percent.iterdir())


@pytest.mark.parametrize("folder", PLATFORMS)
def test_every_target_is_built_in_a_folder_with_a_percent_sign(
    folder, empty_cache, percent, tmp_path
):
    data = []
    for place in (tmp_path / "plain", percent / "50%"):
        place.mkdir()
        # Zig's linker for macOS crashes on a library without exports.
        shown = '__attribute__((visibility("default")))'
        (place / "all.c").write_text(f"{shown} int f(void);\nint f(void) {{ return 1; }}\n")
        data.append(build(place / "all.c", "some", TARGETS[folder]))
        shutil.rmtree(empty_cache / "binaries")  # forces the second build
        assert [file.name for file in place.iterdir()] == ["all.c"]
    assert data[0] == data[1]
    assert b"hesr-" not in data[0]


def test_another_model_has_another_guid(table1, binary, load, tmp_path):
    values = dict(table1.laws[0].values) | {"c_0": -2.129}
    laws = (replace(table1.laws[0], values=values), *table1.laws[1:])
    other = load(export_fmu(replace(table1, laws=laws), tmp_path / "F.fmu"))
    assert other.about.guid != binary.about.guid


def test_new_coefficients_need_no_compiler(table1, table1_fmu, monkeypatch, tmp_path, empty_cache):
    export_fmu(table1, tmp_path / "first.fmu", no_documentation=True)
    values = dict(table1.laws[0].values) | {"c_0": 7.5}
    other = replace(table1, laws=(replace(table1.laws[0], values=values), *table1.laws[1:]))
    with monkeypatch.context() as without:
        without.setattr("hesr_model.support.compiler._run_compiler", None)
        fmu = export_fmu(other, tmp_path / "second.fmu", no_documentation=True)
    t, dq = 0.005 * np.arange(20), np.linspace(-1.0, 1.0, 60).reshape(20, 3)
    difference = replay(fmu, t, dq) - replay(table1_fmu, t, dq)
    np.testing.assert_allclose(difference, np.array([[7.5 + 2.128, 0.0, 0.0]] * 20), atol=1e-12)


def test_overwritten_numbers_give_the_bytes_of_the_compiler(sources):
    direct = sources / "direct.so"
    target = TARGETS["linux64"]
    flags = ("-target", *target.triples, *CFLAGS, "-shared", "-g0", "-s")
    compile_c(sources / "all.c", flags, direct, target.flags)
    assert build(sources / "all.c", "direct", target) == direct.read_bytes()


def test_the_signature_of_overwritten_libraries_for_macos_is_valid(sources, tmp_path):
    import lief  # slow

    binary = build(sources / "all.c", "friction", TARGETS["darwin64"])
    file = tmp_path / "friction.dylib"
    file.write_bytes(binary)
    checked = 0
    parts = lief.MachO.parse(str(file))
    for part in parts:
        if not part.has_code_signature:
            continue
        code = binary[part.fat_offset :]
        signature = bytes(part.code_signature.content)
        (begin,) = struct.unpack_from(">I", signature, 16)
        hashes, _, _, pages, end = struct.unpack_from(">5I", signature, begin + 16)
        size = 1 << signature[begin + 39]
        for page in range(pages):
            wanted = hashlib.sha256(code[size * page : min(size * (page + 1), end)]).digest()
            at = begin + hashes + 32 * page
            assert signature[at : at + 32] == wanted
            checked += 1
    assert checked > 3


@pytest.mark.parametrize(
    ("epoch", "created", "expected"),
    [
        (None, None, RELEASE_DATE),
        (None, "2024-05-06T07:08:09+02:00", "2024-05-06T05:08:09Z"),
        ("1700000000", "2024-05-06", "2023-11-14T22:13:20Z"),
        ("0", None, "1980-01-01T00:00:00Z"),
        ("99999999999", None, "2107-12-31T00:00:00Z"),
    ],
)
def test_the_date_is_that_given(epoch, created, expected, table1, load, tmp_path, monkeypatch):
    if epoch is None:
        monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    else:
        monkeypatch.setenv("SOURCE_DATE_EPOCH", epoch)
    model = replace(table1, provenance={"created": created} if created else {})
    fmu = export_fmu(model, tmp_path / "F.fmu")
    assert load(fmu).about.generationDateAndTime == expected


def test_an_invalid_date_is_refused(table1, tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "today")
    with pytest.raises(ExportError, match=r"SOURCE_DATE_EPOCH is 'today'; it must be a date\."):
        export_fmu(table1, tmp_path / "F.fmu")


def test_a_failed_export_keeps_the_old_file(table1, tmp_path, monkeypatch, empty_cache):
    path = tmp_path / "F.fmu"
    path.write_bytes(b"old")

    def wrong(*about):
        return to_xml(*about).replace(b'causality="output"', b'causality="input"', 1)

    monkeypatch.setattr("fmu_src.export.package.to_xml", wrong)
    with pytest.raises(ExportError, match=r"not a valid FMU: .*has no start value"):
        export_fmu(table1, path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


PLAIN = ("q", "q[1]", "joint[12].sigma_0", "a[1,2].b.c[3]", "der(x)", "der(joint[1].h)", "_x9")
LEFT_TO_FMPY = ("der(x,2)", "'a b'")
NO_NAMES = ("", "1q", "q[]", "q[1", "q[1,]", "q.", ".q", "q..r", "der()", "der(x", "a b", "q[-1]",
            "ä", "q\n")  # fmt: skip


@pytest.mark.parametrize("name", [*PLAIN, *LEFT_TO_FMPY, *NO_NAMES])
def test_plain_names_follow_the_grammar_of_fmpy(name):
    variable = SimpleNamespace(name=name, sourceline=1)
    of = SimpleNamespace(variableNamingConvention="structured", modelVariables=[variable])
    assert bool(_validate_variable_names(of)) == (name in NO_NAMES)
    assert bool(NAME.fullmatch(name)) == (name in PLAIN)


def test_other_names_are_checked_by_fmpy(table1, tmp_path, monkeypatch, empty_cache):
    def wrong(*about):
        return to_xml(*about).replace(b'name="tau_load[1]"', b'name="tau load"', 1)

    monkeypatch.setattr("fmu_src.export.package.to_xml", wrong)
    with pytest.raises(ExportError, match=r'"tau load".* is not a legal variable name'):
        export_fmu(table1, tmp_path / "F.fmu")


def test_dependencies_of_the_first_page_are_built_in_advance(empty_cache):
    get_ready()
    assert list((empty_cache / "zig").glob("o/*/libcompiler_rt.a"))
    before = USED.copy()
    get_ready()
    assert count_hits(before) == {"binaries": (1, 1)}


def test_a_given_audit_is_used_in_the_page(table1, tmp_path):
    motion = reference_motion(table1)
    audit = ModelAudit.from_model(table1, ranges(table1, motion))
    given, own = (
        export_fmu(table1, tmp_path / f"{name}.fmu", audit=found).read_bytes()
        for name, found in (("given", audit), ("own", None))
    )
    assert given == own
    another = tuple(Certificate(verdict="proven", storage="S = another") for _ in table1.laws)
    fmu = export_fmu(table1, tmp_path / "F.fmu", audit=replace(audit, certificates=another))
    page = zipfile.ZipFile(fmu).read("documentation/index.html")
    assert b"S = another" in page


def test_unknown_platform_is_refused(table1, tmp_path):
    with pytest.raises(ExportError, match="platform 'amiga' is unknown; known are linux64"):
        export_fmu(table1, tmp_path / "F.fmu", platforms=["amiga"])


def test_the_suffix_must_be_fmu(table1, tmp_path):
    with pytest.raises(ExportError, match=r"ends in \.fmu"):
        export_fmu(table1, tmp_path / "F.zip")


def test_compiler_errors_are_reported(tmp_path):
    (tmp_path / "bad.c").write_text("int f(void) { return x; }\n")
    said = r"^bad\.o: the C compiler failed: .*undeclared identifier 'x'\.$"
    with pytest.raises(ExportError, match=said):
        compile_c(tmp_path / "bad.c", ("-c",), tmp_path / "bad.o")


def test_a_missing_compiler_is_reported(tmp_path, monkeypatch, empty_cache):
    monkeypatch.setattr("hesr_model.support.compiler.files", lambda _: tmp_path)
    (tmp_path / "good.c").write_text("int x;\n")
    said = r"^the C compiler cannot be run \(No such file or directory\)\.$"
    with pytest.raises(ExportError, match=said):
        compile_c(tmp_path / "good.c", ("-c",), tmp_path / "good.o")


def test_an_empty_list_of_platforms_is_refused(table1, tmp_path):
    with pytest.raises(ExportError) as caught:
        export_fmu(table1, tmp_path / "F.fmu", platforms=[])
    known = "linux64, win64, darwin64, aarch64-linux"
    assert f"known are {known} and 'all'" in str(caught.value)


def test_parts_of_universal_files_are_page_aligned():
    parts = [struct.pack("<III", 0xFEEDFACF, cpu, 3) + b"x" * n for cpu, n in ((7, 5), (12, 20000))]
    data = join_universal_binary(parts)
    for i, part in enumerate(parts):
        cpu, _, offset, size, _ = struct.unpack_from(">IIIII", data, 8 + 20 * i)
        assert offset % 0x4000 == 0
        assert data[offset : offset + size] == part
        assert cpu == (7, 12)[i]


@pytest.mark.ci
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_sources_compile_without_a_warning_by_another_compiler(compiler, sources):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    flags = [f for f in CFLAGS if f != "-fvisibility=hidden"]
    command = [compiler, *flags, "-shared", "-fPIC", "-o", "own.so", "all.c", "-lm"]
    subprocess.run(command, cwd=sources, check=True)
    assert len(set(elf_exports((sources / "own.so").read_bytes()))) == FUNCTIONS


@pytest.mark.ci
def test_two_fmus_can_be_linked_into_one_program(sources):
    for prefix in ("first_", "second_"):
        flags = ("-c", *CFLAGS, f"-DFMI2_FUNCTION_PREFIX={prefix}")
        compile_c(sources / "all.c", flags, sources / f"{prefix}.o")
    main = (
        "const char *first_fmi2GetVersion(void), *second_fmi2GetVersion(void);\n"
        "int main(void) { return first_fmi2GetVersion()[0] - second_fmi2GetVersion()[0]; }\n"
    )
    (sources / "main.c").write_text(main)
    compile_c(sources / "main.c", LINUX, sources / "main", ("first_.o", "second_.o", "-lm"))
    subprocess.run([str(sources / "main")], check=True)


@pytest.mark.ci
@needs_gcc
@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not installed")
def test_the_fmu_compiled_by_fmpy_gives_the_same_results(table1_fmu, make_motion, tmp_path):
    fmu = Path(shutil.copy(table1_fmu, tmp_path / "F.fmu"))
    subprocess.run([sys.executable, "-m", "fmpy", "compile", str(fmu)], check=True, cwd=tmp_path)
    assert fmu.read_bytes() != table1_fmu.read_bytes()
    t, dq, q, load = make_motion(3)
    np.testing.assert_array_equal(replay(fmu, t, dq, q, load), replay(table1_fmu, t, dq, q, load))


def test_concurrent_compilations_are_independent(tmp_path, empty_cache):
    common = tmp_path / "main.c"
    common.write_text('#include "number.h"\nint main(void) { return NUMBER; }\n')

    def compiled(number):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "number.h").write_text(f"#define NUMBER {number}\n")
        (folder / "other.c").write_text("int other;\n")
        compile_c(folder / "other.c", (*LINUX, "-I."), folder / "program", (str(common),))
        return subprocess.run([folder / "program"], check=False).returncode

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(compiled, range(10, 22))) == list(range(10, 22))


def test_included_files_determine_the_binary(tmp_path, empty_cache):
    (tmp_path / "main.cpp").write_text('#include "near.h"\n')
    flags = ("-x", "c++", "-c")
    (tmp_path / "near.h").write_text("int x;\n")
    compile_c(tmp_path / "main.cpp", flags, tmp_path / "main.o")
    (tmp_path / "near.h").write_text("nonsense\n")
    with pytest.raises(ExportError, match="the C compiler failed"):
        compile_c(tmp_path / "main.cpp", flags, tmp_path / "main.o")


def test_changed_sources_are_recompiled(tmp_path, empty_cache):
    (tmp_path / "further").mkdir()
    files = {
        "main.c": '#include "near.h"\n'
        "int other(void);\nint main(void) { return NEAR + other(); }\n",
        "near.h": "#include <far.h>\n#define NEAR FAR\n",
        "further/far.h": "#define FAR 1\n",
        "other.c": "int other(void) { return ADDED; }\n",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)

    def result(added=0):
        flags = (*LINUX, "-Ifurther", f"-DADDED={added}")
        compile_c(tmp_path / "main.c", flags, tmp_path / "main", ("other.c",))
        return subprocess.run([tmp_path / "main"], check=False).returncode

    def binaries():
        return len([f for f in (empty_cache / "binaries").glob("*/*") if f.name != "lock"])

    assert [result(), result()] == [1, 1]
    assert binaries() == 1
    assert result(added=10) == 11
    (tmp_path / "further/far.h").write_text("#define FAR 2\n")
    assert result() == 2
    (tmp_path / "other.c").write_text("int other(void) { return ADDED + 5; }\n")
    assert result() == 7
    assert binaries() == 4
