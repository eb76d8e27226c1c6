"""Tests near a change: those that import a changed module within two steps.

    python tests/near.py [COMMIT] [-- OPTIONS OF PYTEST]

Runs the changed tests and those near changed files: since a commit, by default the uncommitted
changes, or those of the last commit where there are none. In CI, where the gate runs the others,
only nightly tests are run, up to a bound of CPU seconds.
"""

import ast
import os
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterable
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("hesr_model", "fmu_src", "cosim", "hesr")
STEPS = 2  # of imports between a test and a changed module
CI_SECONDS = 120.0  # recorded CPU seconds of nightly tests in CI


def module_name(path: Path) -> str:
    """Return the name under which a file of the tree is imported."""
    parts = path.with_suffix("").parts
    if parts[0] == "tests":
        return parts[-1]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_names(path: Path) -> set[str]:
    """Return all names that a file imports, those of modules and of what is in them."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


class ImportGraph:
    """Who imports whom, in the product and its tests."""

    def __init__(self, root: Path) -> None:
        self.importers: dict[str, set[Path]] = defaultdict(set)
        for package in (*PACKAGES, "tests"):
            for path in sorted((root / package).rglob("*.py")):
                for name in imported_names(path):
                    self.importers[name].add(path.relative_to(root))

    def tests_near(self, changed: Path, steps: int = STEPS) -> dict[Path, int]:
        """Return test files by their distance to a changed module, 0 for itself."""
        distances = {changed: 0}
        frontier = [changed]
        for step in range(1, steps + 1):
            following = []
            for path in frontier:
                for importer in self.importers[module_name(path)] - distances.keys():
                    distances[importer] = step
                    following.append(importer)
            frontier = following
        return {path: steps for path, steps in distances.items() if is_test(path)}


def is_test(path: Path) -> bool:
    """Return whether a file of the tree holds tests."""
    return path.parts[0] == "tests" and path.name.startswith("test_") and path.suffix == ".py"


def listed_tests(root: Path, source: Path) -> list[Path]:
    """Return the tests that `nearest.toml` lists for a source, which nothing may import."""
    tables = tomllib.loads((root / "tests/mutation/nearest.toml").read_text(encoding="utf-8"))
    for entry in (*tables["of"], *tables.get("beyond", ())):
        if fnmatch(source.as_posix(), entry["sources"]):
            patterns = (name.partition("::")[0] for name in entry["tests"])
            return [p.relative_to(root) for name in patterns for p in (root / "tests").glob(name)]
    return []


def near_tests(root: Path, changed: Iterable[Path]) -> list[Path]:
    """Return the tests near changed files, the nearest first."""
    graph = ImportGraph(root)
    distances: dict[Path, int] = {}
    for path in changed:
        near = graph.tests_near(path) if path.suffix == ".py" else {}
        near |= {test: 1 for test in listed_tests(root, path) if test not in near}
        for test, steps in near.items():
            distances[test] = min(steps, distances.get(test, steps))
    present = (test for test in distances if (root / test).is_file())
    return sorted(present, key=lambda test: (distances[test], test))


def git(*arguments: str) -> list[str]:
    """Return the lines that git prints."""
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def changed_files(commit: str | None) -> list[Path]:
    """Return the files that differ from a commit, or from the last one or its parent."""
    uncommitted = git("diff", "--name-only", "HEAD")
    uncommitted += git("ls-files", "--others", "--exclude-standard")
    if commit is None and uncommitted:
        return [Path(name) for name in uncommitted]
    return [Path(name) for name in git("diff", "--name-only", commit or "HEAD~1")]


def within_budget(tests: list[Path], seconds: float) -> list[Path]:
    """Return the nearest files whose recorded CPU time of nightly tests fits into a bound [s]."""
    record = tomllib.loads((ROOT / "tests/durations.toml").read_text(encoding="utf-8"))
    costs = record.get("nightly", {}).get("files", {})
    chosen = []
    for test in tests:
        if test.as_posix() not in costs:
            continue
        cost = costs[test.as_posix()]
        if cost <= seconds:
            seconds -= cost
            chosen.append(test)
    return chosen


def main(arguments: list[str]) -> int:
    """Run the tests near the change; return pytest's exit code."""
    own, options = arguments, []
    if "--" in arguments:
        split = arguments.index("--")
        own, options = arguments[:split], arguments[split + 1 :]
    tests = near_tests(ROOT, changed_files(own[0] if own else None))
    selection = "not soak"
    if os.environ.get("CI") == "true":
        tests = within_budget(tests, CI_SECONDS)
        selection = "nightly and not soak"
    skipped = ("tests/interop/", "tests/benchmarks/", "tests/mutation/")
    tests = [test for test in tests if not test.as_posix().startswith(skipped)]
    if not tests:
        sys.stdout.write("No test is near the change.\n")
        return 0
    sys.stdout.write(f"{len(tests)} files of tests are near the change.\n")
    sys.stdout.flush()
    command = [sys.executable, "-m", "pytest", *map(str, tests), *options, "-m", selection]
    code = subprocess.run(command, cwd=ROOT).returncode
    return 0 if code == 5 else code  # 5: none of them is selected


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
