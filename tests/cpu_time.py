"""CPU time of every test with its processes: recorded by `make durations`, limited in CI."""

import json
import os
import statistics
import tomllib
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from time import process_time

import psutil
import pytest

LIMIT = 10.0
"""CPU seconds per test of `make test` on the reference machine, without shared fixtures."""

PROBE_ON_REFERENCE = 0.2
"""CPU seconds of `probe` on the reference machine, an idle core of a Xeon at 2.5 GHz."""

ROUNDS = 500_000
"""Rounds of `probe`."""

SLOW = 0.8
"""Minimum CPU seconds, as recorded, for a test to run in `make test-all` only."""

_HEAD = """\
# CPU seconds of each test file and of its slow tests, their processes included.
# Written by `make durations`; only `make test-all` runs the tests of "ci": those of [ci.tests], and
# those marked in their files.
"""

_PROPERTY = "cpu"


def used() -> float:
    """Return the CPU seconds of this process and all processes it has started."""
    me = psutil.Process()
    total = 0.0
    for process in (me, *(() if childless() else me.children(recursive=True))):
        try:
            total += sum(process.cpu_times()[:4])
        except psutil.NoSuchProcess:  # has ended: its time is included in the parent's
            continue
    return total


def childless() -> bool:
    """Return whether there is surely no child: looking at all processes takes longer."""
    if not hasattr(os, "waitid"):
        return False
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return True
    return False


def probe() -> float:
    """Return the CPU seconds of a fixed piece of work."""
    start, table = process_time(), dict.fromkeys(range(4096), 0)
    for k in range(ROUNDS):
        table[k % 4096] += table[7 * k % 4096] % 1000 + len(str(k))
    return process_time() - start


def slowness() -> float:
    """Return the CPU time of work here and now, relative to the reference machine.

    Another machine, or a core shared with others, needs a multiple of the reference's CPU time.
    """
    return statistics.median(probe() for _ in range(3)) / PROBE_ON_REFERENCE


def slow_tests(record: Path) -> frozenset[str]:
    """Return the tests that a record calls slow."""
    if not record.is_file():
        return frozenset()
    return frozenset(tomllib.loads(record.read_text(encoding="utf-8"))["ci"]["tests"])


class CpuTime:
    """Measure tests, fail those beyond a limit [s], and write a record if given a file."""

    def __init__(self, *, limit: float | None, record: Path | None = None) -> None:
        self.limit = limit
        self.record = record
        self.start = self.shared = 0.0
        self.sharing = False
        self.seconds: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))

    @classmethod
    def measure(cls, config: pytest.Config) -> None:
        """Measure in CI or if a record is requested."""
        record = config.getoption("--record-cpu")
        limited = os.environ.get("CI") == "true"
        if limited or record:
            config.pluginmanager.register(cls(limit=LIMIT if limited else None, record=record))

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
    ) -> Generator[None, object, object]:
        """Do not charge shared fixtures to the first test that uses them."""
        if fixturedef.scope == "function" or self.sharing:
            return (yield)
        self.sharing, start = True, used()
        try:
            return (yield)
        finally:
            self.sharing = False
            self.shared += used() - start

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Generator[None]:
        self.start, self.shared = used(), 0.0
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None]:
        yield
        seconds = used() - self.start - self.shared
        kind = "ci" if item.get_closest_marker("ci") else "default"
        item.user_properties.append((_PROPERTY, (kind, seconds, self.shared)))
        # The probe runs only after slow tests.
        if self.limit and kind == "default" and seconds > self.limit:
            reference = seconds / slowness()
            if reference > self.limit:
                pytest.fail(
                    f"took {seconds:.1f} CPU s, {reference:.1f} s on the reference machine; the "
                    f"limit for `make test` is {self.limit:g} s: share a fixture or mark it ci"
                )

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            for kind, own, shared in (v for k, v in report.user_properties if k == _PROPERTY):
                kind = "ci" if own >= SLOW else kind
                self.seconds[kind][report.nodeid] = own
                self.seconds[kind]["shared fixtures"] += shared

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self.record and not hasattr(session.config, "workerinput"):
            self.record.write_text(as_toml(self.seconds), encoding="utf-8")


def as_toml(seconds: dict[str, dict[str, float]]) -> str:
    lines = [_HEAD]
    for kind, tests in sorted(seconds.items(), reverse=True):
        files: dict[str, float] = defaultdict(float)
        for test, value in tests.items():
            files[test.partition("::")[0]] += value
        slow = {test: value for test, value in tests.items() if value >= SLOW}
        lines += [f"[{kind}]", f"total = {round(sum(tests.values()))}", ""]
        for name, table in (("files", files), ("tests", slow)):
            lines += [f"[{kind}.{name}]"]
            # Strings of JSON are strings of TOML.
            lines += [f"{json.dumps(key)} = {value:.1f}" for key, value in sorted(table.items())]
            lines += [""]
    return "\n".join(lines)
