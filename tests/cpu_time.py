"""CPU time of every test with its processes: recorded by `make durations`, listed in CI."""

import json
import os
import tomllib
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path

import psutil
import pytest

SLOW = 0.8
"""Minimum CPU seconds, as recorded, for a test to run in `make test-all` only."""

_HEAD = """\
# CPU seconds of each test file and of its slow tests, their processes included.
# Written by `make durations`; only `make test-all` runs the tests of "ci": those of [ci.tests], and
# those marked in their files.
"""

_PROPERTY = "cpu"

SHARED = "shared fixtures"
"""Name under which fixtures of more than one test are recorded."""

LISTED = 20
"""Tests in the list of the slowest ones."""


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


def slow_tests(record: Path) -> frozenset[str]:
    """Return the tests that a record calls slow."""
    if not record.is_file():
        return frozenset()
    return frozenset(tomllib.loads(record.read_text(encoding="utf-8"))["ci"]["tests"])


def recorded_seconds(record: Path) -> dict[str, float]:
    """Return the CPU seconds of the slow tests of a record."""
    seconds: dict[str, float] = {}
    if record.is_file():
        tables = tomllib.loads(record.read_text(encoding="utf-8"))
        for kind in tables.values():
            seconds |= kind.get("tests", {})
    return seconds


class CpuTime:
    """Measure tests, list the slowest, and write a record if given a file."""

    def __init__(self, *, record: Path | None = None) -> None:
        self.record = record
        self.start = self.shared = 0.0
        self.sharing = False
        self.seconds: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))

    @classmethod
    def measure(cls, config: pytest.Config) -> None:
        """Measure in CI or if a record is requested."""
        record = config.getoption("--record-cpu")
        if os.environ.get("CI") == "true" or record:
            config.pluginmanager.register(cls(record=record))

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

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            for kind, own, shared in (v for k, v in report.user_properties if k == _PROPERTY):
                kind = "ci" if own >= SLOW else kind
                self.seconds[kind][report.nodeid] = own
                self.seconds[kind][SHARED] += shared

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self.record and not hasattr(session.config, "workerinput"):
            self.record.write_text(as_toml(self.seconds), encoding="utf-8")

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """List the slowest tests, which fail nothing: machines differ."""
        tests = {
            test: value
            for kind in self.seconds.values()
            for test, value in kind.items()
            if test != SHARED
        }
        slowest = sorted(tests, key=lambda test: tests[test], reverse=True)[:LISTED]
        recorded = recorded_seconds(Path(__file__).with_name("durations.toml"))
        terminalreporter.section("CPU seconds of the slowest tests, and their record")
        for test in slowest:
            expected = recorded.get(test)
            record = "-" if expected is None else f"{expected:.1f}"
            terminalreporter.write_line(f"{tests[test]:7.1f} {record:>7}  {test}")


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
