"""Share of small faults in the sources that the tests detect: run by `make mutate`.

Random faults are inserted one by one into a clean copy of the tree. Each runs against the nearest
tests first, then against more distant ones (`nearest.toml`). Faults without observable effect are
listed in `equivalent.toml` with the reason. C that does not compile is not a fault.
"""

import argparse
import importlib
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest
from mutants import Mutant, mutant, variants

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PATIENCE = 5.0  # multiple of the tests' time without a fault
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
    os._exit(int(code))


class Tree:
    """A copy of the tree for faults."""

    def __init__(self, folder: Path, *, limit: float | None, marked: str) -> None:
        self.root = copied(folder)
        self._given = limit
        self._marked = marked
        self._seconds: dict[tuple[str, ...], float] = {}

    def sources(self, *patterns: str) -> list[str]:
        found = {path for pattern in patterns for path in self.root.glob(pattern)}
        return sorted(str(path.relative_to(self.root)) for path in found)

    def nearest(self, source: str) -> tuple[str, ...]:
        """Tests of the first matching entry, those named like the source first."""
        entry = next((e for e in table("nearest.toml") if fnmatch(source, str(e["sources"]))), None)
        named = self.sources(f"tests/**/test_{Path(source).stem}.py")
        others = [t for e in (entry["tests"] if entry else ()) for t in self.sources(f"tests/{e}")]
        return tuple(dict.fromkeys([*(() if entry else named), *others]))

    def beyond(self, source: str) -> list[tuple[str, ...]]:
        """More distant tests: those of each matching entry, entry by entry."""
        entries = [e for e in table("nearest.toml", "beyond") if fnmatch(source, str(e["sources"]))]
        return [
            tuple(t for name in entry["tests"] for t in self.sources(f"tests/{name}"))
            for entry in entries
        ]

    def _pytest(self, tests: Sequence[str], limit: float | None = None) -> tuple[int | None, str]:
        """Exit code of the tests, None if they do not end, and their output."""
        with tempfile.TemporaryFile("w+") as heard:
            running = FORK.Process(
                target=_run_tests, args=(self.root, tests, self._marked, heard.fileno())
            )
            running.start()
            running.join(limit)
            if running.exitcode is None:
                os.killpg(running.pid, signal.SIGKILL)
                running.join()
                return None, "no end"
            heard.seek(0)
            return running.exitcode, heard.read()

    def _limit(self, tests: tuple[str, ...]) -> float:
        """Check that tests pass without a fault, and return their time limit [s]."""
        if self._given:
            return self._given
        if tests not in self._seconds:
            begin = time.monotonic()
            code, said = self._pytest(tests)
            if code:
                sys.exit(f"{' '.join(tests)} fail without any fault:\n{said}")
            self._seconds[tests] = time.monotonic() - begin
        return 20.0 + PATIENCE * self._seconds[tests]

    def _write(self, source: str, text: str) -> None:
        path = self.root / source
        path.write_text(text, encoding="utf-8")
        # With equal date and size, its bytecode could be reused for this text.
        for stale in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            stale.unlink()

    def verdict(self, source: str, fault: Mutant) -> tuple[str, str]:
        """Return the outcome of a fault and the test that detected it."""
        listed = table("equivalent.toml")
        if any(fnmatch(source, str(e["source"])) and e["before"] == fault.before
               and e["after"] == fault.after for e in listed):  # fmt: skip
            return "equivalent", ""
        if not self.nearest(source):
            return "survived", "no test is near; see nearest.toml"
        original = (self.root / source).read_text(encoding="utf-8")
        for tests in (self.nearest(source), *self.beyond(source)):
            limit = self._limit(tests)
            self._write(source, fault.text)
            code, said = self._pytest(tests, limit)
            self._write(source, original)
            if "the C compiler failed" in said:
                return "stillborn", ""
            if code != 0:
                failed = [x for x in said.splitlines() if x.startswith(("FAILED", "ERROR"))]
                return "killed", failed[0][:150] if failed else said.strip().splitlines()[-1][:150]
        return "survived", " ".join(self.nearest(source))


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
        marked = "not soak and not ci" if options.quick else "not soak"
        tree = Tree(Path(folder, "tree"), limit=options.limit, marked=marked)
        for area in options.areas:
            counts: Counter[str] = Counter()
            for source, fault in faults(tree, AREAS[area], options.seed):
                if counts["killed"] + counts["survived"] == options.number:
                    break
                if not fnmatch(source, options.only):
                    continue
                verdict, why = tree.verdict(source, fault)
                counts[verdict] += 1
                print(f"{verdict:10} {source}:{fault.place[0]}  {why}\n"
                      f"    - {fault.before}\n    + {fault.after}", flush=True)  # fmt: skip
            print(f"{area}: {said(counts)} (seed {options.seed})", flush=True)
            total += counts
    print(f"all: {said(total)}")


def said(counts: Counter[str]) -> str:
    judged = counts["killed"] + counts["survived"]
    return (
        f"{counts['killed']} of {judged} faults killed, {counts['killed'] / max(judged, 1):.0%}; "
        f"{counts['equivalent']} equivalent"
    )


if __name__ == "__main__":
    main()
