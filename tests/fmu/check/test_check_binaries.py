"""Shared libraries: right for their folder, complete and self-contained."""

from types import SimpleNamespace

import pytest
from c_hosts import LINUX
from containing import Containing
from fmu_files import BINARY, changed, check, members, said, texts

from fmu_src.check import binaries, readers
from fmu_src.check.binaries import KNOWN_FUNCTIONS
from fmu_src.export.toolchain import TARGETS
from hesr_model.support import child
from hesr_model.support.compiler import compile_c

ALL = tuple(sorted(KNOWN_FUNCTIONS))
ELF = (*LINUX, "-shared", "-fPIC")


@pytest.fixture
def library(tmp_path):
    """Build a shared library from C source, by default with all FMI functions."""

    def build(extra="", names=ALL, flags=ELF, last=()):
        folder = tmp_path / f"c{len(list(tmp_path.iterdir()))}"
        folder.mkdir()
        source = folder / "x.c"
        lines = (f"EXPORT void {name}(void) {{}}" for name in names)
        source.write_text("#ifndef EXPORT\n#define EXPORT\n#endif\n" + "\n".join([extra, *lines]))
        compile_c(source, flags, folder / "x.out", last)
        return (folder / "x.out").read_bytes()

    return build


@pytest.fixture
def of(table1_fmu, tmp_path):
    """Findings for Table I with another binary."""

    def check_binary(data, name=BINARY, change=lambda _: None, **files):
        more = {path.replace("__", "/"): content for path, content in files.items()}
        path = changed(table1_fmu, tmp_path / "F.fmu", change, {name: data} | more)
        return said(path, "binary")

    return check_binary


def only_co_simulation(xml):
    for element in xml.root.findall("ModelExchange"):
        xml.drop(element)
    for capability in ("providesDirectionalDerivative", "canInterpolateInputs"):
        xml.find("CoSimulation").set(capability, "false")


@pytest.mark.ci
def test_our_binaries_pass(table1, tmp_path):
    from fmu_src import export_fmu

    fmu = export_fmu(table1, tmp_path / "F.fmu", platforms=["all"])
    found = check(fmu)
    assert texts(found) == []
    assert {name.split("/")[1] for name in members(fmu) if name.startswith("binaries/")} == set(
        TARGETS
    )


def test_a_wrong_name_is_reported(table1_fmu, tmp_path):
    path = changed(
        table1_fmu,
        tmp_path / "F.fmu",
        only_co_simulation,
        {BINARY: None, "binaries/linux64/other.so": members(table1_fmu)[BINARY]},
    )
    assert said(path) == [Containing("binaries/linux64: it lacks 'friction_parfam_h.so', the name")]


@pytest.mark.parametrize(
    ("target", "folder", "found", "needed"),
    [
        (
            "aarch64-linux-gnu.2.17",
            "linux64",
            "ELF for AARCH64",
            "ELF for X86_64",
        ),
        (
            "x86-linux-gnu.2.17",
            "linux64",
            "ELF for I386",
            "ELF for X86_64",
        ),
        (
            "x86_64-windows-gnu",
            "linux64",
            "PE for AMD64",
            "ELF for X86_64",
        ),
        (
            "x86_64-linux-gnu.2.17",
            "win64",
            "ELF for X86_64",
            "PE for AMD64",
        ),
        (
            "x86_64-linux-gnu.2.17",
            "darwin64",
            "ELF for X86_64",
            "Mach-O for X86_64 or ARM64",
        ),
        ("x86_64-linux-gnu.2.17", "x86_64-linux", None, None),
    ],
)
def test_a_wrong_machine_type_is_reported(target, folder, found, needed, library, of):
    suffix = binaries.PLATFORMS[2][folder].suffix
    name = f"binaries/{folder}/friction_parfam_h{suffix}"
    export = ("-DEXPORT=__declspec(dllexport)", "-Wl,--no-entry")
    more = export if "windows" in target else ("-fPIC",)
    flags = ("-target", target, "-shared", "-nostdlib", *more)
    expected = [Containing(name, found, needed)] if found else []
    assert of(library(flags=flags), name) == expected


@pytest.mark.parametrize("data", [b"", b"no library", b"MZ" + bytes(99)])
def test_other_files_than_libraries_are_reported(data, of):
    (text,) = of(data)
    assert f"{BINARY}: it is not a readable library" in text


def test_a_broken_library_is_reported(of):
    (text,) = of(b"\x7fELF" + bytes(100))
    assert f"{BINARY}: it is ELF for NONE" in text


def test_a_program_is_reported(library, of):
    program = library(
        "int main(void) { return 0; }",
        flags=(*LINUX, "-no-pie"),
        last=("-rdynamic",),
    )
    found = of(program)
    assert Containing(f"{BINARY}: it is a program") in found


def test_missing_functions_are_reported(library, of):
    names = sorted(KNOWN_FUNCTIONS - {"fmi2GetReal", "fmi2DoStep", "fmi2SetFMUstate"})

    def change(xml):
        only_co_simulation(xml)
        xml.find("CoSimulation").set("canGetAndSetFMUstate", "true")

    assert of(library(names=names), change=change) == [
        Containing(f"{BINARY}: it does not export 'fmi2SetFMUstate'", "canGetAndSetFMUstate"),
        Containing("export 'fmi2GetReal', 'fmi2DoStep'; FMI 2.0", "co-simulation"),
    ]


def test_functions_of_the_other_interface_are_optional(library, of):
    names = sorted(n for n in KNOWN_FUNCTIONS if n not in ("fmi2SetTime", "fmi2GetDerivatives"))
    assert of(library(names=names), change=only_co_simulation) == []


def test_functions_of_model_exchange_are_required_for_it(library, of):
    def change(xml):
        only_co_simulation(xml)
        xml.find("CoSimulation").tag = "ModelExchange"

    assert of(library(names=sorted(KNOWN_FUNCTIONS - {"fmi2SetTime"})), change=change) == [
        Containing("'fmi2SetTime'", "functions of model exchange")
    ]


def test_names_with_the_source_code_prefix_are_reported(library, of):
    names = [f"friction_parfam_h_{name}" for name in sorted(KNOWN_FUNCTIONS)]
    assert of(library(names=names), change=only_co_simulation) == [
        Containing("exports 'friction_parfam_h_fmi2GetTypesPlatform' and the like")
    ]


def test_unknown_functions_are_reported(library, of):
    more = {"fmi2Foo", "fmi3DoStep", "fmiDoStep", "fmin_of_mine", "helper"}
    assert of(library(names=sorted(KNOWN_FUNCTIONS | more))) == [
        Containing("exports 'fmi2Foo', which FMI 2.0")
    ]


def test_dependency_on_python_is_reported(library, of):
    extra = "void PyRun_SimpleString(void); void helper(void) { PyRun_SimpleString(); }"
    assert of(library(extra)) == [Containing(f"{BINARY}: it needs a Python interpreter")]


@pytest.fixture
def needy(library, tmp_path):
    """A library that depends on another one."""

    def build(name, *flags):
        other = tmp_path / name
        other.write_bytes(library("", ["other"], (*ELF, f"-Wl,-soname,{name}")))
        return library("void other(void); void f(void) { other(); }", last=(str(other), *flags))

    return build


def test_a_missing_library_is_reported(needy, of):
    assert of(needy("libother.so.3")) == [
        Containing(f"{BINARY}: it needs 'libother.so.3', neither part")
    ]


def test_a_library_outside_the_search_path_is_reported(needy, of):
    other = {"binaries__linux64__libother.so.3": b"x"}
    assert of(needy("libother.so.3"), **other) == [
        Containing("'libother.so.3' in its folder", "$ORIGIN")
    ]
    assert of(needy("libother.so.3", "-Wl,-rpath,$ORIGIN"), **other) == []


def test_the_python_library_is_reported(needy, of):
    assert of(needy("libpython3.11.so.1.0")) == [
        Containing(f"{BINARY}: it needs a Python interpreter")
    ]


def test_an_unknown_platform_folder_is_reported(table1_fmu, tmp_path):
    path = changed(table1_fmu, tmp_path / "F.fmu", files={"binaries/amiga/x.library": b"x"})
    found = check(path)
    assert texts(found) == []
    assert found.skipped[0] == ("binaries/amiga: not checked; the platform is unknown.")


def test_static_libraries_and_their_folders_are_ignored(table1_fmu, tmp_path):
    files = {"binaries/win64/VisualStudio8/friction_parfam_h.lib": b"x"}
    assert said(changed(table1_fmu, tmp_path / "F.fmu", files=files)) == []


def test_a_library_that_hangs_is_reported(of, monkeypatch, table1_fmu):
    monkeypatch.setattr(binaries, "READER_TIMEOUT", 0.0)
    assert of(members(table1_fmu)[BINARY]) == [Containing("gave no answer within 0 s")]


@pytest.mark.parametrize(
    ("module", "deed", "how"),
    [
        ("killed_reader", "os.kill(os.getpid(), 11)", "crashed with signal 11 (SIGSEGV)"),
        ("failing_reader", "raise MemoryError('too much')", "failed with 'MemoryError: too much'"),
        ("ended_reader", "os._exit(7)", "ended its process with exit code 7"),
    ],
)
def test_a_reader_crash_is_reported(of, monkeypatch, table1_fmu, tmp_path, module, deed, how):
    text = f"import os\ndef read(_file): {deed}\n"
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / f"{module}.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path / "modules")  # not the current folder
    monkeypatch.setattr(binaries, "_READER", f"{module}:read")
    assert of(members(table1_fmu)[BINARY]) == [
        Containing(f"{BINARY}: its content", f"its reader {how}")
    ]


def test_a_missing_reader_is_reported(of, monkeypatch, table1_fmu, tmp_path):
    monkeypatch.setattr("hesr_model.support.child._nursery", child._Nursery())
    monkeypatch.setattr("sys.executable", str(tmp_path / "none"))
    assert of(members(table1_fmu)[BINARY]) == [Containing("reader has no process", "No such file")]


def test_functions_of_mach_o_are_in_the_trie_or_in_the_symbol_table():
    def symbol(name, category):
        return SimpleNamespace(name=name, category=f"CATEGORY.{category}")

    defined = symbol("_fmi2GetReal", "EXTERNAL")
    others = [symbol("_fmi2Reset", "UNDEFINED"), symbol("_fmi2Hidden", "LOCAL")]
    exported = symbol("_fmi2DoStep", "NONE")
    part = SimpleNamespace(exported_symbols=[exported], symbols=[*others, defined])
    assert list(readers.list_exports(part)) == [exported, defined]
