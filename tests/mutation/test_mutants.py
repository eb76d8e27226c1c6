"""The faults of `make mutate` are faults, and every source has nearby tests."""

import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
AREAS = tomllib.loads((HERE / "nearest.toml").read_text(encoding="utf-8"))["areas"]
SOURCES = sorted({p for area in AREAS.values() for pattern in area for p in ROOT.glob(pattern)})

PYTHON = """
if TYPE_CHECKING:
    import a
def f(a, *, b=True):
    '''Not 3 faults.'''
    return a * 0.5 if a < 2 else -a
"""
C = """
/* Not 3 faults. */
#include "x.h"
#ifdef _WIN32
#define NOT_HERE 2.5
#else
#endif
static double f(const double *a, int n) {
    double sum = 0.0;
    for (int i = 0; i < n; i++) {
        sum += fabs(a[i]) * 2.5; /* nor here: 1 + 1 */
    }
    return !n ? -sum : sum;
}
"""


def changes(name: str, text: str, folder: Path) -> set[tuple[str, str]]:
    mutants = pytest.importorskip("mutants", reason="needs hesr[mutation]")
    path = folder / name
    path.write_text(text, encoding="utf-8")
    found = [mutants.mutant(path, p, v) for p, vs in mutants.variants(path).items() for v in vs]
    assert all(sum(map(str.__ne__, m.text.split("\n"), text.split("\n"))) == 1 for m in found)
    return {(m.before, m.after) for m in found}


def test_python_faults_are_generated(tmp_path: Path) -> None:
    found = changes("a.py", PYTHON, tmp_path)
    line = "return a * 0.5 if a < 2 else -a"
    for after in (
        "return a / 0.5 if a < 2 else -a",
        "return a * 1.0 if a < 2 else -a",
        "return a * 5.0 if a < 2 else -a",
        "return a * 0.5 if a <= 2 else -a",
        "return a * 0.5 if a < 3 else -a",
        "return a * 0.5 if a < 2 else a",
    ):
        assert (line, after) in {(before, " ".join(after.split())) for before, after in found}
    assert {before for before, _ in found} == {line, "def f(a, *, b=True):"}


def test_a_loop_over_several_lines_has_a_fault(tmp_path: Path) -> None:
    mutants = pytest.importorskip("mutants", reason="needs hesr[mutation]")
    path = tmp_path / "a.py"
    path.write_text("for a in (\n    b,\n    c,\n):\n    a = b\n", encoding="utf-8")
    found = [mutants.mutant(path, p, v) for p, vs in mutants.variants(path).items() for v in vs]
    assert [(m.before, m.after) for m in found] == [("for a in ( b, c, ):", "for a in []:")]


def test_statements_arguments_and_slices_have_faults(tmp_path: Path) -> None:
    text = "def f(a, n):\n    g(a, n)\n    a += h(n, b=a)\n    raise E(a[n:])\n"
    assert {
        ("g(a, n)", "pass"),
        ("g(a, n)", "g(n, a)"),
        ("a += h(n, b=a)", "pass"),
        ("raise E(a[n:])", "pass"),
        ("raise E(a[n:])", "raise E(a[n + 1:])"),
    } <= changes("a.py", text, tmp_path)


def test_arguments_in_any_order_have_no_fault(tmp_path: Path) -> None:
    assert not changes("a.py", "a = max(b, c)\nd = np.minimum(a, b)\n", tmp_path)


def test_c_faults_are_generated(tmp_path: Path) -> None:
    found = changes("a.c", C, tmp_path)
    addition = "sum += fabs(a[i]) * 2.5; /* nor here: 1 + 1 */"
    assert found == {
        ("double sum = 0.0;", "double sum = 1.0;"),
        ("for (int i = 0; i < n; i++) {", "for (int i = 1; i < n; i++) {"),
        ("for (int i = 0; i < n; i++) {", "for (int i = 0; i <= n; i++) {"),
        ("for (int i = 0; i < n; i++) {", "for (int i = 0; i >= n; i++) {"),
        *((addition, addition.replace("+=", to, 1)) for to in ("-=", "=")),
        (addition, addition.replace("fabs", "")),
        (addition, addition.replace("*", "/", 1).replace("//", "/*")),
        *((addition, addition.replace("2.5", to)) for to in ("5.0", "1.25", "25.0")),
        ("return !n ? -sum : sum;", "return n ? -sum : sum;"),
        ("return !n ? -sum : sum;", "return !n ? sum : sum;"),
    }


@pytest.mark.parametrize(
    ("table", "kind"),
    [("nearest.toml", "of"), ("nearest.toml", "beyond"), ("equivalent.toml", "of")],
)
def test_tables_name_existing_files(table: str, kind: str) -> None:
    for entry in tomllib.loads((HERE / table).read_text(encoding="utf-8"))[kind]:
        pattern = str(entry.get("sources", entry.get("source")))
        named = [path for path in SOURCES if fnmatch(str(path.relative_to(ROOT)), pattern)]
        assert named, pattern
        for test in entry.get("tests", ()):
            assert list((ROOT / "tests").glob(test.partition("::")[0])), f"{pattern}: {test}"
        if "reason" in entry:
            texts = [" ".join(path.read_text(encoding="utf-8").split()) for path in named]
            assert any(" ".join(entry["before"].split()) in text for text in texts), entry


def test_every_source_has_nearby_tests() -> None:
    entries = tomllib.loads((HERE / "nearest.toml").read_text(encoding="utf-8"))["of"]
    bare = [
        str(path.relative_to(ROOT))
        for path in SOURCES
        if path.stem != "__init__"
        and not any(fnmatch(str(path.relative_to(ROOT)), e["sources"]) for e in entries)
        and not list((ROOT / "tests").rglob(f"test_{path.stem}.py"))
    ]
    assert bare == []
