"""House rules beyond the linters: names, and private parts of other libraries."""

import ast
import re
import subprocess
from collections import defaultdict
from collections.abc import Iterator

import pytest
from documents import ROOT
from sources import MODULES, layer, tree

KNOWN_DUPLICATES: set[str] = set()
"""Public classes whose name is defined twice, as a class or an alias. Remove renamed entries."""

NOUNS = {
    "coupling",
    "fitting",
    "presliding",
    "sliding",
    "stepping",
    "timing",
    "tracking",
    "training",
}
NOUNS |= {"tuning", "wiring"}

KNOWN_PARTICIPLES: set[str] = set()
"""Modules still named by a participle. Remove renamed entries."""

TOP_LEVEL = {".ci", ".clang-format", ".dockerignore", ".github", ".gitignore"}
TOP_LEVEL |= {".pre-commit-config.yaml", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md"}
TOP_LEVEL |= {"Dockerfile", "LICENSE", "Makefile", "README.md", "SECURITY.md", "pyproject.toml"}
TOP_LEVEL |= {"hatch_build.py", "cosim", "docs", "fmu_src", "hesr", "hesr_model", "models", "tests"}
"""Files and folders of a checkout."""

KNOWN_PRIVATE = {"fmu_src.pages.mathml"}
"""Modules that still use private parts of other libraries. Remove fixed entries."""


def definitions(name: str) -> Iterator[tuple[str, bool]]:
    """Yield the public CamelCase names at the top level of a module, with True for classes."""
    for node in tree(MODULES[name]).body:
        if isinstance(node, ast.ClassDef):
            yield node.name, True
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            if isinstance(target, ast.Name) and re.fullmatch(r"[A-Z]\w*[a-z]\w*", target.id):
                yield target.id, False


def test_names_of_public_classes_are_unique() -> None:
    homes: dict[str, list[str]] = defaultdict(list)
    classes = {"Array"}
    for module in MODULES:
        for name, is_class in definitions(module):
            if not name.startswith("_"):
                homes[name].append(module)
                classes |= {name} if is_class else set()
    twice = {name: found for name, found in homes.items() if len(found) > 1 and name in classes}
    assert {name: found for name, found in twice.items() if name not in KNOWN_DUPLICATES} == {}
    assert KNOWN_DUPLICATES - twice.keys() == set(), "these are unique now: remove them"


def test_modules_are_named_by_nouns() -> None:
    participle = re.compile(
        r"(\w+(ed|ing)|beg[au]n|chosen|drawn|driven|found|given|held|hidden|kept|known|made|seen"
        r"|shown|swept|told|unseen|written)"
    )
    offenders = {
        name
        for name in MODULES
        if participle.fullmatch(last := name.split(".")[-1].split("_")[-1]) and last not in NOUNS
    }
    assert offenders - KNOWN_PARTICIPLES == set()
    assert KNOWN_PARTICIPLES - offenders == set(), "these are renamed: remove them"


def own_private_names() -> set[str]:
    """Return every private name that the product defines or looks up by string."""
    return {
        name
        for path in MODULES.values()
        for node in ast.walk(tree(path))
        for name in (
            getattr(node, "name", None),
            getattr(node, "id", None),
            getattr(node, "arg", None),
            node.attr if isinstance(node, ast.Attribute) and is_own(node) else None,
            node.value if isinstance(node, ast.Constant) else None,
        )
        if isinstance(name, str) and name.startswith("_")
    }


def is_own(node: ast.Attribute) -> bool:
    """Return whether an attribute is set on `self` or `cls`."""
    stored = isinstance(node.ctx, ast.Store) and isinstance(node.value, ast.Name)
    return stored and node.value.id in ("self", "cls")


def test_private_parts_of_other_libraries_are_not_used() -> None:
    # Documented: parts of Python, the SymPy printer's method for operands, and the type of lxml.
    public = {"_exit", "_thread", "_print", "_Element"}
    own = own_private_names()
    offenders = defaultdict(set)
    for name, path in MODULES.items():
        for node in ast.walk(tree(path)):
            parts: list[str] = []
            if isinstance(node, ast.Attribute) and node.attr not in own:
                parts = [node.attr]
            elif isinstance(node, ast.ImportFrom) and layer(node.module or "") == "":
                parts = [*(node.module or "").split("."), *(alias.name for alias in node.names)]
            elif isinstance(node, ast.Import):
                parts = [part for alias in node.names for part in alias.name.split(".")]
            offenders[name] |= {
                part
                for part in parts
                if re.match(r"_(?!_)|externals$", part) and part not in public
            }
    offenders = {name: found for name, found in offenders.items() if found}
    assert {name: found for name, found in offenders.items() if name not in KNOWN_PRIVATE} == {}
    assert KNOWN_PRIVATE - offenders.keys() == set(), "these are mended: remove them"


def test_the_top_level_has_known_names_and_no_links() -> None:
    """A test that leaves something in the checkout would commit it with the next change."""
    done = subprocess.run(
        ["git", "ls-files", "--stage"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode or not done.stdout:
        pytest.skip("needs a clone with git")
    entries = [line.split(maxsplit=3) for line in done.stdout.splitlines()]
    links = [name for mode, _, _, name in entries if mode == "120000"]
    assert not links
    top_level = {name.split("/")[0] for *_, name in entries}
    assert top_level <= TOP_LEVEL


def is_loose(call: ast.Call) -> bool:
    """Return whether the default of `pytest.approx`, 1e-12, exceeds a relative tolerance."""
    is_approx = isinstance(call.func, ast.Attribute) and call.func.attr == "approx"
    stated = {keyword.arg: keyword.value for keyword in call.keywords}
    relative = stated.get("rel")
    if not is_approx or "abs" in stated or not isinstance(relative, ast.Constant):
        return False
    return isinstance(relative.value, float) and relative.value <= 1e-12


def test_tight_relative_tolerances_hold_for_small_values() -> None:
    """Of a value of 1, rel=1e-15 accepts errors of 1e-12 unless abs=0.0 is stated."""
    loose = []
    for path in sorted((ROOT / "tests").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if not re.search(r"rel=[\d.]*e-", text):
            continue
        calls = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call))
        loose += [f"{path.relative_to(ROOT)}:{call.lineno}" for call in calls if is_loose(call)]
    assert loose == []
