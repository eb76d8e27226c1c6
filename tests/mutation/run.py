"""Share of small faults in the sources that the tests detect: run by `make mutate`.

Random faults are inserted one by one into a clean copy of the tree. Each runs against the nearest
tests first, then against more distant ones (`nearest.toml`): those of `make test`, then of CI,
until one fails or the CPU time per fault is used up. Faults without observable effect are
listed in `equivalent.toml` with the reason. C that does not compile is not a fault.
"""

import argparse
import importlib
import math
import multiprocessing
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from fnmatch import fnmatch
from itertools import product
from pathlib import Path
from typing import Any

import psutil
import pytest
from mutants import Mutant, mutant, variants

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PATIENCE = 5.0  # multiple of the tests' time without a fault
CPU = 60.0  # CPU seconds of tests per fault
SELECTIONS = {"": "not soak and not ci", "in CI": "ci and not soak"}  # in this order
# Tests run in forks of a process that has the slow imports but none of our modules.
FORK = multiprocessing.get_context("fork")
SLOW_IMPORTS = (
    "numpy", "pinocchio", "pyarrow", "pydantic", "pytest", "scipy.interpolate",
    "scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.special", "scipy.stats", "sympy",
    "fmpy.fmi2", "fmpy.validation", "matplotlib.figure", "mujoco",
)  # fmt: skip


def table(name: str, kind: str = "of") -> Any:
    return tomllib.loads((HERE / name).read_text(encoding="utf-8"))[kind]


AREAS: dict[str, list[str]] = table("nearest.toml", "areas")


def copied(folder: Path) -> Path:
    """Copy all files of git's working tree, including uncommitted changes."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    files = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, files.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    return folder


def _run_tests(root: Path, tests: Sequence[str], marked: str, output: int) -> None:
    """Run in a process group, which can be ended as a whole."""
    os.setsid()
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.chdir(root)
    os.environ |= {"PYTHONPATH": str(root), "COLUMNS": "200"}
    sys.path[:1] = [str(root)]
    options = ["-xq", "-p", "no:cacheprovider", "--hypothesis-profile=ci", "-m", marked]
    code = pytest.main([*options, *tests])
    sys.stdout.flush()
    os._exit(0 if code == pytest.ExitCode.NO_TESTS_COLLECTED else int(code))


def cpu_of(process: psutil.Process) -> float:
    """Return the CPU seconds of a process and all processes it has started."""
    with suppress(psutil.NoSuchProcess):
        return sum(sum(p.cpu_times()[:4]) for p in (process, *process.children(recursive=True)))
    return 0.0


class Tree:
    """A copy of the tree for faults."""

    def __init__(self, folder: Path, *, limit: float | None, selections: dict[str, str]) -> None:
        self.root = copied(folder)
        self._given = limit
        self._selections = selections
        self._seconds: dict[tuple[str, tuple[str, ...]], float] = {}

    def sources(self, *patterns: str) -> list[str]:
        found = {path for pattern in patterns for path in self.root.glob(pattern)}
        return sorted(str(path.relative_to(self.root)) for path in found)

    def tests(self, name: str) -> list[str]:
        """Test files, or one test of a file, `file::test`."""
        pattern, of, test = name.partition("::")
        return [f"{path}{of}{test}" for path in self.sources(f"tests/{pattern}")]

    def groups(self, source: str) -> list[tuple[str, ...]]:
        """Tests for a source without repetition: the nearest, those that import it, the others."""
        found: list[tuple[str, ...]] = []
        for tests in (self.nearest(source), self._importing(source), *self._beyond(source)):
            new = dict.fromkeys(t for t in tests if not any(t in group for group in found))
            found += [tuple(new)] if new else []
        return found

    def nearest(self, source: str) -> list[str]:
        """Tests named like the source, then those of the first matching entry."""
        entry = next((e for e in table("nearest.toml") if fnmatch(source, str(e["sources"]))), None)
        listed = [t for e in (entry["tests"] if entry else ()) for t in self.tests(e)]
        # Names of files are unique within the packages, but not across them.
        if source.startswith("hesr_model/"):
            return self.sources(f"tests/unit/**/test_{Path(source).stem}.py") + listed
        return listed if entry else self.sources(f"tests/**/test_{Path(source).stem}.py")

    def _importing(self, source: str) -> list[str]:
        """Tests that import a module, the quickest first."""
        folder, _, name = source.removesuffix(".py").replace("/", ".").rpartition(".")
        imported = re.compile(rf"\b{folder}(\.| import \(?[\w\s,]*\b){name}\b")
        seconds = tomllib.loads((self.root / "tests/durations.toml").read_text(encoding="utf-8"))
        found = [
            test
            for test in self.sources("tests/**/test_*.py")
            if imported.search((self.root / test).read_text(encoding="utf-8"))
        ]
        return sorted(found, key=lambda test: seconds["default"]["files"].get(test, math.inf))

    def _beyond(self, source: str) -> list[list[str]]:
        """More distant tests: those of each matching entry."""
        entries = [e for e in table("nearest.toml", "beyond") if fnmatch(source, str(e["sources"]))]
        return [[t for name in entry["tests"] for t in self.tests(name)] for entry in entries]

    def _pytest(
        self, tests: Sequence[str], marked: str, *, limit: float = math.inf, cpu: float = math.inf
    ) -> tuple[int | None, str, float]:
        """Exit code of the tests, None if they do not end, their output and CPU seconds."""
        with tempfile.TemporaryFile("w+") as heard:
            running = FORK.Process(
                target=_run_tests, args=(self.root, tests, marked, heard.fileno())
            )
            begin, used = time.monotonic(), 0.0
            running.start()
            process = psutil.Process(running.pid)
            while running.is_alive():
                used = max(used, cpu_of(process))
                if used > cpu or time.monotonic() - begin > limit:
                    os.killpg(running.pid, signal.SIGKILL)
                    running.join()
                    return None, "out of CPU time" if used > cpu else "no end", used
                running.join(0.5)
            heard.seek(0)
            return running.exitcode, heard.read(), used

    def _limit(self, tests: tuple[str, ...], marked: str) -> float:
        """Check that tests pass without a fault, and return their time limit [s]."""
        if self._given:
            return self._given
        if (marked, tests) not in self._seconds:
            begin = time.monotonic()
            code, said, _ = self._pytest(tests, marked)
            if code:
                sys.exit(f"{' '.join(tests)} fail without any fault:\n{said}")
            self._seconds[marked, tests] = time.monotonic() - begin
        return 20.0 + PATIENCE * self._seconds[marked, tests]

    def _write(self, source: str, text: str) -> None:
        path = self.root / source
        path.write_text(text, encoding="utf-8")
        # With equal date and size, its bytecode could be reused for this text.
        for stale in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            stale.unlink()

    def verdict(self, source: str, fault: Mutant) -> tuple[str, str]:
        """Return the outcome of a fault and the test that detected it."""
        listed = table("equivalent.toml")
        if any(
            fnmatch(source, str(e["source"]))
            and e["before"] == fault.before
            and e["after"] == fault.after
            for e in listed
        ):
            return "equivalent", ""
        groups = self.groups(source)
        if not groups:
            return "survived", "no test is near; see nearest.toml"
        original = (self.root / source).read_text(encoding="utf-8")
        left = CPU
        for (where, marked), tests in product(self._selections.items(), groups):
            limit = self._limit(tests, marked)
            self._write(source, fault.text)
            code, said, used = self._pytest(tests, marked, limit=limit, cpu=left)
            self._write(source, original)
            left -= used
            if "the C compiler failed" in said:
                return "stillborn", ""
            if left <= 0.0:
                return "survived", f"{CPU:.0f} CPU s of tests"
            if code != 0:
                failed = [x for x in said.splitlines() if x.startswith(("FAILED", "ERROR"))]
                said = failed[0] if failed else said.strip().splitlines()[-1]
                return f"killed {where}".strip(), f"{CPU - left:.0f} s, {said[:150]}"
        return "survived", f"{CPU - left:.0f} s, {' '.join(groups[0])}"


def faults(tree: Tree, patterns: Sequence[str], seed: int) -> Iterator[tuple[str, Mutant]]:
    """All places in random order with one fault each."""
    found = [
        (source, place, choices)
        for source in tree.sources(*patterns)
        for place, choices in sorted(variants(tree.root / source).items())
    ]
    chance = random.Random(seed)
    for source, place, choices in chance.sample(found, len(found)):
        yield source, mutant(tree.root / source, place, chance.choice(choices))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("areas", nargs="*", default=list(AREAS), help=", ".join(AREAS))
    parser.add_argument("--number", type=int, default=20, help="of faults in each area")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="*", help="pattern of sources")
    parser.add_argument("--quick", action="store_true", help="only tests that `make test` runs")
    parser.add_argument("--limit", type=float, help="seconds for tests that are known to pass")
    options = parser.parse_args()
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    for name in SLOW_IMPORTS:
        importlib.import_module(name)
    total: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="hesr-mutation-") as folder:
        selections = dict(list(SELECTIONS.items())[: 1 if options.quick else None])
        tree = Tree(Path(folder, "tree"), limit=options.limit, selections=selections)
        for area in options.areas:
            counts: Counter[str] = Counter()
            for source, fault in faults(tree, AREAS[area], options.seed):
                if judged(counts) == options.number:
                    break
                if not fnmatch(source, options.only):
                    continue
                verdict, why = tree.verdict(source, fault)
                counts[verdict] += 1
                print(
                    f"{verdict:12} {source}:{fault.place[0]}  {why}\n"
                    f"    - {fault.before}\n    + {fault.after}",
                    flush=True,
                )
            print(f"{area}: {said(counts)} (seed {options.seed})", flush=True)
            total += counts
    print(f"all: {said(total)}")


def judged(counts: Counter[str]) -> int:
    return counts["killed"] + counts["killed in CI"] + counts["survived"]


def said(counts: Counter[str]) -> str:
    number = max(judged(counts), 1)
    killed = counts["killed"] + counts["killed in CI"]
    return (
        f"{killed} of {judged(counts)} faults killed, {killed / number:.0%}; "
        f"{counts['killed'] / number:.0%} by `make test`; {counts['equivalent']} equivalent"
    )


if __name__ == "__main__":
    main()
