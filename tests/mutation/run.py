"""Share of small faults in the sources that the tests detect: run by `make mutate`.

Random faults are inserted one by one into a clean copy of the tree. Each runs against the nearest
tests first, those of `make test`, then of CI; then against those that import it within two steps
and more distant ones (`nearest.toml`), until one fails or the CPU time per fault is used up. A test
that fails with a fault is run again without it. Faults without observable effect are listed in
`equivalent.toml` with the reason. C that does not compile is not a fault.
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
import sysconfig
import tempfile
import time
import tomllib
import venv
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from fnmatch import fnmatch
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import psutil
import pytest
from mutants import Mutant, mutant, variants

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
CPU = 90.0  # CPU seconds of tests per fault
# CPU seconds after which a test that needs a third of them has no end. A study that many tests
# share takes half of them.
TEST_CPU = 60.0
TEST_WALL = 300.0  # [s] after which a test waits for ever
_NO_END = "no end"  # of a test
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


class Outcome(NamedTuple):
    """What tests showed of a fault.

    Attributes
    ----------
    failed : name of the test that failed or did not end, "" if none did.
    output : what pytest wrote.
    used : CPU seconds.
    is_spent : whether the CPU time was used up before that.
    """

    failed: str
    output: str
    used: float
    is_spent: bool


class _Starts:
    """A plug-in of pytest that writes which test runs: the last one, when the process ends."""

    def __init__(self, file: int) -> None:
        self._file = file

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, nodeid.encode(), 0)


def make_environment(root: Path) -> None:
    """Make an environment that imports the product from `root` and the packages from here.

    Isolated processes import the product from their environment, whatever `PYTHONPATH` says.
    """
    folder = root / ".venv"
    venv.create(folder, with_pip=False)
    packages = sysconfig.get_path("purelib")
    lines = f"{root}\nimport site; site.addsitedir({packages!r})\n"
    inner = sysconfig.get_path("purelib", vars={"base": str(folder)})
    Path(inner, "a_tree.pth").write_text(lines, encoding="utf-8")


def new_cache(root: Path) -> Path:
    """Make a cache with compiled C only, whose keys are its sources.

    What a fault left in the cache would judge the next one, and results of readers without a fault
    would hide it.
    """
    usual = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hesr"
    cache = root / ".cache-of-faults"
    shutil.rmtree(cache, ignore_errors=True)
    (cache / "hesr").mkdir(parents=True, mode=0o700)
    for kind in ("zig", "binaries", "functions"):
        if (usual / kind).is_dir():
            shutil.copytree(usual / kind, cache / "hesr" / kind)
    return cache


def _run_tests(root: Path, options: Sequence[str], output: int, started: int) -> None:
    """Run in a process group, which can be ended as a whole."""
    os.setsid()
    sys.executable = str(root / ".venv/bin/python")
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.chdir(root)
    os.environ |= {
        "PYTHONPATH": str(root),
        "COLUMNS": "200",
        "XDG_CACHE_HOME": str(new_cache(root)),
    }
    sys.path[:1] = [str(root)]
    always = ["-xq", "-p", "no:cacheprovider", "--hypothesis-profile=ci"]
    code = pytest.main([*always, *options], plugins=[_Starts(started)])
    sys.stdout.flush()
    os._exit(0 if code == pytest.ExitCode.NO_TESTS_COLLECTED else int(code))


def cpu_of(process: psutil.Process) -> float:
    """Return the CPU seconds of a process and all processes it has started."""
    with suppress(psutil.NoSuchProcess):
        return sum(sum(p.cpu_times()[:4]) for p in (process, *process.children(recursive=True)))
    return 0.0


class Tree:
    """A copy of the tree for faults."""

    def __init__(self, folder: Path, *, selections: dict[str, str]) -> None:
        self.root = copied(folder)
        make_environment(self.root)
        self._selections = selections
        self._can: dict[tuple[str, bool], bool] = {}  # tests that failed, or had no end

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
        for tests in (self.nearest(source), *self._importing(source), *self._beyond(source)):
            new = dict.fromkeys(t for t in tests if not any(t in group for group in found))
            found += [tuple(new)] if new else []
        return found

    def nearest(self, source: str) -> list[str]:
        """Tests named like the source, those of the first matching entry, records of numbers."""
        entry = next((e for e in table("nearest.toml") if fnmatch(source, str(e["sources"]))), None)
        listed = [t for e in (entry["tests"] if entry else ()) for t in self.tests(e)]
        # Names of files are unique within the packages, but not across them.
        if source.startswith("hesr_model/"):
            named = self.sources(f"tests/unit/**/test_{Path(source).stem}.py")
            return [*named, *listed, *self.sources("tests/numbers/test_*.py")]
        return listed if entry else self.sources(f"tests/**/test_{Path(source).stem}.py")

    def _importing(self, source: str) -> list[list[str]]:
        """Tests that import a module, then those that import one that does, the quickest first."""
        recorded = tomllib.loads((self.root / "tests/durations.toml").read_text(encoding="utf-8"))
        seconds = recorded["default"]["files"]
        direct = self._importers(source)
        indirect = {test for module in direct for test in self._importers(module)}
        return [
            sorted(
                filter(_holds_tests, found),
                key=lambda test: seconds.get(test, math.inf),
            )
            for found in (direct, indirect - direct)
        ]

    def _importers(self, source: str) -> set[str]:
        folder, _, name = source.removesuffix(".py").replace("/", ".").rpartition(".")
        imported = re.compile(rf"\b{folder}(\.| import \(?[\w\s,]*\b){name}\b")
        return {path for path, text in self._texts.items() if imported.search(text)}

    @cached_property
    def _texts(self) -> dict[str, str]:
        return {
            path: (self.root / path).read_text(encoding="utf-8") for path in self.sources("**/*.py")
        }

    def _beyond(self, source: str) -> list[list[str]]:
        """More distant tests: those of each matching entry."""
        entries = [e for e in table("nearest.toml", "beyond") if fnmatch(source, str(e["sources"]))]
        return [[t for name in entry["tests"] for t in self.tests(name)] for entry in entries]

    def _pytest(self, options: Sequence[str], cpu: float = math.inf) -> Outcome:
        """Run tests until one fails, does not end, or `cpu` seconds are used."""
        with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as started:
            running = FORK.Process(
                target=_run_tests, args=(self.root, options, output.fileno(), started.fileno())
            )
            running.start()
            process = psutil.Process(running.pid)
            test, test_used, test_begin, used, stop = "", 0.0, time.monotonic(), 0.0, ""
            while not stop and running.is_alive():
                running.join(0.2)
                used = max(used, cpu_of(process))
                current = os.pread(started.fileno(), 4096, 0).decode()
                if current != test:
                    test, test_used, test_begin = current, used, time.monotonic()
                has_end = used - test_used < TEST_CPU and time.monotonic() - test_begin < TEST_WALL
                if used > cpu or not has_end:
                    stop = "out of CPU time" if has_end else _NO_END
                    os.killpg(running.pid, signal.SIGKILL)
            running.join()
            output.seek(0)
            text = output.read().decode(errors="replace")
        is_spent = stop == "out of CPU time"
        # After a failure pytest runs no other test; a module that cannot be imported runs none.
        broken = re.search(r"^ERROR (\S+)", text, re.MULTILINE)
        name = broken[1] if broken and not test else test or options[0]
        failed = "" if is_spent or running.exitcode == 0 else name
        return Outcome(failed, text + stop, used, is_spent)

    def _write(self, source: str, text: str) -> None:
        path = self.root / source
        path.write_text(text, encoding="utf-8")
        # With equal date and size, its bytecode could be reused for this text.
        for stale in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            stale.unlink()

    def _can_judge(self, test: str, options: Sequence[str], *, has_end: bool) -> bool:
        """Return whether a test passes, or ends much sooner, in the sources as they are."""
        if (test, has_end) not in self._can:
            # A module that cannot be imported may lack only what another folder hides from it.
            again = [test] if "::" in test else [*options, "--collect-only"]
            outcome = self._pytest(again)
            can = not outcome.failed and (has_end or outcome.used < TEST_CPU / 3)
            self._can[test, has_end] = can
            if not can:
                print(f"left out, fails or is too slow without any fault: {test}", flush=True)
        return self._can[test, has_end]

    def _judge(
        self, source: str, text: str, tests: Sequence[str], marked: str, cpu: float
    ) -> Outcome:
        """Run tests with a fault, but for those that fail without it."""
        original = (self.root / source).read_text(encoding="utf-8")
        used = 0.0
        while True:
            unfit = [test for (test, _), can in self._can.items() if not can]
            left_out = [f"--{'deselect' if '::' in test else 'ignore'}={test}" for test in unfit]
            options = [*(test for test in tests if test not in unfit), "-m", marked, *left_out]
            if options[0] == "-m":
                return Outcome("", "", used, False)
            self._write(source, text)
            outcome = self._pytest(options, cpu - used)
            self._write(source, original)
            used += outcome.used
            has_end = not outcome.output.endswith(_NO_END)
            if not outcome.failed or self._can_judge(outcome.failed, options, has_end=has_end):
                return outcome._replace(used=used)

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
        left = CPU
        # The nearest tests of CI are seconds, so that they precede those that only import a source.
        near, distant = groups[:1], groups[1:]
        rounds = [*product(self._selections.items(), near)]
        rounds += product(self._selections.items(), distant)
        for (where, marked), tests in rounds:
            outcome = self._judge(source, fault.text, tests, marked, left)
            left -= outcome.used
            if "the C compiler failed" in outcome.output:
                return "stillborn", ""
            if outcome.is_spent:
                return "survived", f"{CPU:.0f} CPU s of tests"
            if outcome.failed:
                return f"killed {where}".strip(), f"{CPU - left:.0f} s, {outcome.failed[:150]}"
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
        fault = mutant(tree.root / source, place, chance.choice(choices))
        if is_code(source, fault.text):
            yield source, fault


def _holds_tests(path: str) -> bool:
    """Return whether a module has tests of results, neither of speed nor of other tools."""
    is_other = path.startswith(("tests/benchmarks/", "tests/interop/", "tests/mutation/"))
    return Path(path).name.startswith("test_") and not is_other


def is_code(source: str, text: str) -> bool:
    """Return whether Python compiles a source; the compiler of C judges others."""
    try:
        return not source.endswith(".py") or bool(compile(text, source, "exec"))
    except SyntaxError:
        return False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("areas", nargs="*", default=list(AREAS), help=", ".join(AREAS))
    parser.add_argument("--number", type=int, default=20, help="of faults in each area")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="*", help="pattern of sources")
    parser.add_argument("--quick", action="store_true", help="only tests that `make test` runs")
    options = parser.parse_args()
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    for name in SLOW_IMPORTS:
        importlib.import_module(name)
    total: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="hesr-mutation-") as folder:
        selections = dict(list(SELECTIONS.items())[: 1 if options.quick else None])
        tree = Tree(Path(folder, "tree"), selections=selections)
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
