"""CPU time of every test with its processes: recorded by `make durations`, limited in CI."""

import os
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path

import psutil
import pytest

LIMIT = 10.0
"""CPU seconds allowed per test of `make test`, without shared fixtures."""

_NAMED = 2.0
"""Minimum CPU seconds for a test to have its own line in the record."""

_HEAD = """\
# CPU seconds of each test file and of its slow tests, their processes included.
# Written by `make durations`; "ci" are the tests that only `make test-all` runs.
"""

_PROPERTY = "cpu"


def used() -> float:
    """Return the CPU seconds of this process and all processes it has started."""
    me = psutil.Process()
    total = 0.0
    for process in (me, *me.children(recursive=True)):
        try:
            total += sum(process.cpu_times()[:4])
        except psutil.NoSuchProcess:  # has ended: its time is included in the parent's
            continue
    return total


class CpuTime:
    """Measure tests, fail slow ones if `limited`, and write a record if given a file."""

    def __init__(self, *, limited: bool, record: Path | None) -> None:
        self.limited = limited
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
            config.pluginmanager.register(cls(limited=limited, record=record))

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
        if self.limited and kind == "default" and seconds > LIMIT:
            pytest.fail(
                f"took {seconds:.1f} CPU s; the limit for `make test` is {LIMIT:.0f} s: "
                "share a fixture or mark it ci"
            )

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            for kind, own, shared in (v for k, v in report.user_properties if k == _PROPERTY):
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
        slow = {test: value for test, value in tests.items() if value >= _NAMED}
        lines += [f"[{kind}]", f"total = {round(sum(tests.values()))}", ""]
        for name, table in (("files", files), ("tests", slow)):
            lines += [f"[{kind}.{name}]"]
            lines += [f"'{key}' = {value:.1f}" for key, value in sorted(table.items())]
            lines += [""]
    return "\n".join(lines)
