"""The C compiler reads and writes its own files only, and ends."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from fmu_src.export.toolchain import TARGETS, build
from hesr_model.errors import ExportError
from hesr_model.support import compiler, rights

Compile = Callable[[str], bytes]

linux = pytest.mark.skipif(rights.get_landlock_version() < 1, reason="needs Landlock")


@pytest.fixture
def compile_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Compile:
    """Return a function that compiles a text, with all caches in this folder."""

    def compile_text(text: str) -> bytes:
        source = tmp_path / "code" / "source.c"
        source.parent.mkdir(exist_ok=True)
        source.write_text(text, encoding="utf-8")
        return build(source, "source", TARGETS["linux64"])

    return compile_text


KEPT = (
    "extern char kept[];\n"
    '__attribute__((visibility("default"))) char *find(void);\n'
    "char *find(void) {{ return kept; }}\n"
)
INCLUSIONS = {
    "include": '#include "{}"\n',
    "incbin": '__asm__(".data\\n kept: .incbin \\"{}\\"\\n .text");\n' + KEPT,
    "incbin of a part": '__asm__(".data\\n kept: .incbin \\"{}\\", 1, 4\\n .text");\n' + KEPT,
    "assembly": '__asm__(".include \\"{}\\"");\n',
    "embed": 'char kept[] = {{\n#embed "{}"\n}};\n' + KEPT,
}


@pytest.mark.ci
@linux
@pytest.mark.parametrize("inclusion", INCLUSIONS)
def test_files_of_the_user_are_not_compiled_into_a_library(
    inclusion: str, compile_text: Compile, tmp_path: Path
) -> None:
    secret = tmp_path / "id_rsa"
    secret.write_text("PRIVATE KEY", encoding="utf-8")
    with pytest.raises(ExportError, match="the C compiler failed") as caught:
        compile_text(INCLUSIONS[inclusion].format(secret))
    assert "PRIVATE" not in str(caught.value)  # compilers quote lines


@linux
def test_a_file_of_the_source_is_compiled_into_it(compile_text: Compile, tmp_path: Path) -> None:
    """A control: the same inclusion works for files next to the source."""
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "table").write_text("PUBLIC TABLE", encoding="utf-8")
    assert b"PUBLIC TABLE" in compile_text(INCLUSIONS["incbin"].format("table"))


@pytest.mark.parametrize(
    "text", ['#include "source.c"\n', "#include __FILE__\n#include __FILE__\n"]
)
def test_a_source_that_includes_itself_ends(text: str, compile_text: Compile) -> None:
    with pytest.raises(ExportError, match="the C compiler"):
        compile_text(text)


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is that of Linux")
def test_a_compilation_without_end_ends(
    compile_text: Compile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "_SECONDS", 1.0)
    doubled = "".join(f"#define M{k} M{k - 1} M{k - 1}\n" for k in range(1, 60))
    with pytest.raises(ExportError, match="the C compiler"):
        compile_text(f"#define M0 int;\n{doubled}M59\n")


def test_variables_of_the_user_change_nothing(
    compile_text: Compile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "math.h").write_text("#error of the user\n", encoding="utf-8")
    for name in ("CPATH", "C_INCLUDE_PATH"):
        monkeypatch.setenv(name, str(tmp_path))
    assert compile_text("#include <math.h>\nint two(void);\nint two(void) { return 2; }\n")
