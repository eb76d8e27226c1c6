"""CPU time of every test with its processes: listed in CI, recorded by `make durations`.

    python tests/cpu_time.py REPORT ...

reads reports of pytest and writes `tests/durations.toml`, of which tests in CI are chosen.
"""

import json
import os
import sys
import tomllib
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Generator, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import psutil
import pytest

RECORD = Path(__file__).with_name("durations.toml")

SLOW = 0.3
"""CPU seconds, with the share of its fixtures, from which a test is left to `make rest`.

With 0.4, `make test` would cost a quarter more.
"""

COSTLY = 1.0
"""CPU seconds above which a fixture with few users leaves these to `make rest`."""

WORTH_USERS = 20
"""Users for each of these seconds that make a costly fixture worth its time in `make test`."""

LISTED_FIXTURE = 0.4
"""CPU seconds from which a fixture is recorded."""

_HEAD = """\
# CPU seconds of each test file, of its slow tests and of the fixtures that tests share, all with
# their processes. Written by `make durations` from the reports of a gate.
#
# `make test` leaves the tests of [ci.tests] to `make rest`, as those that are marked in their
# files, and the users of costly fixtures.
"""

_PROPERTY = "cpu"

SHARED = "shared fixtures"
"""Name under which the fixtures of more than one test are counted."""

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


class Fixture(NamedTuple):
    """A recorded fixture of more than one test."""

    seconds: float
    users: int

    @property
    def is_costly(self) -> bool:
        """Whether its few users are left to `make rest`."""
        return self.seconds > COSTLY and self.users < WORTH_USERS * self.seconds / COSTLY

    @property
    def share(self) -> float:
        """CPU seconds of each user."""
        return self.seconds / max(self.users, 1)


class Record:
    """What `tests/durations.toml` says."""

    def __init__(self, path: Path = RECORD) -> None:
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        tables = tomllib.loads(text)
        fixtures: dict[str, dict[str, Any]] = tables.pop("fixtures", {})
        self.kinds: dict[str, dict[str, Any]] = tables
        self.fixtures = {name: Fixture(**table) for name, table in fixtures.items()}
        self.slow_tests = frozenset(tables.get("ci", {}).get("tests", {}))
        self.seconds: dict[str, float] = {}
        for table in tables.values():
            self.seconds |= table.get("tests", {})

    def is_slow(self, item: pytest.Item) -> bool:
        """Return whether a test or one of its fixtures takes too long for `make test`."""
        if item.nodeid in self.slow_tests:
            return True
        recorded = (self.fixtures.get(name) for name in required_fixtures(item))
        return any(fixture is not None and fixture.is_costly for fixture in recorded)


def fixture_name(fixturedef: pytest.FixtureDef[Any]) -> str:
    """Return the name of a fixture with its file or folder."""
    return f"{fixturedef.baseid}::{fixturedef.argname}"


def is_shared(fixturedef: pytest.FixtureDef[Any]) -> bool:
    """Return whether more than one test may use a fixture of ours."""
    return fixturedef.scope != "function" and bool(fixturedef.baseid)


def required_fixtures(item: pytest.Item) -> set[str]:
    """Return the fixtures of more than one test that a test is known to need."""
    if not isinstance(item, pytest.Function):
        return set()
    required = item._fixtureinfo.name2fixturedefs.values()  # pytest has no public way
    return {fixture_name(defs[-1]) for defs in required if is_shared(defs[-1])}


def used_fixtures(item: pytest.Item) -> set[str]:
    """Return the fixtures of more than one test that a test used, also those asked for by name."""
    if not isinstance(item, pytest.Function):
        return set()
    active = item._request._fixture_defs.values()  # pytest has no public way
    return {fixture_name(fixturedef) for fixturedef in active if is_shared(fixturedef)}


class Measured(NamedTuple):
    """CPU seconds of a test."""

    test: str
    kind: str
    seconds: float
    set_up: dict[str, float]
    """CPU seconds of the fixtures of more than one test that were set up before it."""
    used: list[str]
    """All fixtures of more than one test that it used."""


def kind_of(item: pytest.Item) -> str:
    """Return which run a test belongs to by its marks, without those of the record."""
    if item.get_closest_marker("nightly"):
        return "nightly"
    is_marked = any(not mark.kwargs.get("recorded") for mark in item.iter_markers("ci"))
    return "ci" if is_marked else "default"


class CpuTime:
    """Measure tests, put the figures into the report, and list the slowest."""

    def __init__(self) -> None:
        self.start = 0.0
        self.set_up: dict[str, float] = {}
        self.sharing = False
        self.seconds: dict[str, float] = {}

    @classmethod
    def measure(cls, config: pytest.Config) -> None:
        """Measure in CI, or if a report is written."""
        if os.environ.get("CI") == "true" or config.option.xmlpath:
            config.pluginmanager.register(cls())

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
            self.set_up[fixture_name(fixturedef)] = used() - start

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Generator[None]:
        self.start, self.set_up = used(), {}
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None]:
        yield
        seconds = used() - self.start - sum(self.set_up.values())
        measured = Measured(
            item.nodeid,
            kind_of(item),
            round(seconds, 3),
            {name: round(seconds, 3) for name, seconds in self.set_up.items()},
            sorted(used_fixtures(item)),
        )
        item.user_properties.append((_PROPERTY, json.dumps(measured)))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            for name, value in report.user_properties:
                if name == _PROPERTY:
                    measured = Measured(*json.loads(str(value)))
                    self.seconds[measured.test] = measured.seconds

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """List the slowest tests, which fail nothing: machines differ."""
        slowest = sorted(self.seconds, key=lambda test: self.seconds[test], reverse=True)[:LISTED]
        recorded = Record().seconds
        terminalreporter.section("CPU seconds of the slowest tests, and their record")
        for test in slowest:
            expected = recorded.get(test)
            record = "-" if expected is None else f"{expected:.1f}"
            terminalreporter.write_line(f"{self.seconds[test]:7.1f} {record:>7}  {test}")


def read_report(report: Path) -> list[Measured]:
    """Return the CPU seconds in a report of pytest."""
    properties = ET.parse(report).iter("property")
    values = [entry.get("value") or "" for entry in properties if entry.get("name") == _PROPERTY]
    return [Measured(*json.loads(value)) for value in values]


def summarise_fixtures(tests: Iterable[Measured]) -> dict[str, Fixture]:
    """Return fixtures with the CPU seconds of their longest set-up."""
    seconds: dict[str, float] = defaultdict(float)
    users: Counter[str] = Counter()
    for test in tests:
        users.update(test.used)
        for name, value in test.set_up.items():
            seconds[name] = max(seconds[name], value)
    return {name: Fixture(round(value, 1), users[name]) for name, value in seconds.items()}


def run_of(test: Measured, fixtures: Mapping[str, Fixture]) -> str:
    """Return the run that a test belongs to: `default`, `ci` or `nightly`."""
    needed = [fixtures[name] for name in test.used if name in fixtures]
    charge = test.seconds + sum(fixture.share for fixture in needed)
    is_slow = charge >= SLOW or any(fixture.is_costly for fixture in needed)
    return "ci" if test.kind == "default" and is_slow else test.kind


def as_toml(tests: Iterable[Measured], previous: Record | None = None) -> str:
    """Return the record of tests; runs without a test in them are those of a previous record."""
    tests = list(tests)
    fixtures = summarise_fixtures(tests)
    files: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    slow: dict[str, dict[str, float]] = defaultdict(dict)
    for test in tests:
        run = run_of(test, fixtures)
        files[run][test.test.partition("::")[0]] += test.seconds
        files[run][SHARED] += sum(test.set_up.values())
        if test.seconds >= SLOW or run != test.kind:
            slow[run][test.test] = test.seconds
    for run, table in (previous.kinds if previous else {}).items():
        if run not in files:
            files[run] |= table["files"]
            slow[run] |= table["tests"]
    lines = [_HEAD]
    for run in sorted(files, key=("default", "ci", "nightly").index):
        lines += [f"[{run}]", f"total = {round(sum(files[run].values()))}", ""]
        for name, table in (("files", files[run]), ("tests", slow[run])):
            lines += [f"[{run}.{name}]"]
            # Strings of JSON are strings of TOML.
            lines += [f"{json.dumps(key)} = {value:.1f}" for key, value in sorted(table.items())]
            lines += [""]
    lines += ["[fixtures]"]
    for name, fixture in sorted(fixtures.items()):
        if fixture.seconds >= LISTED_FIXTURE:
            entry = f"{{ seconds = {fixture.seconds}, users = {fixture.users} }}"
            lines += [f"{json.dumps(name)} = {entry}"]
    return "\n".join(lines) + "\n"


def is_of_a_whole_gate(node_ids: Iterable[str], record: Record) -> bool:
    """Return whether tests are from nearly all recorded files of the gate that are still there."""
    reported = {node_id.partition("::")[0] for node_id in node_ids}
    recorded = {f for run in ("default", "ci") for f in record.kinds.get(run, {}).get("files", {})}
    present = {file for file in recorded if (RECORD.parents[1] / file).is_file()}
    # Some files may have moved to nightly groups.
    return bool(reported) and len(present & reported) >= 0.9 * len(present)


def main(reports: list[str]) -> int:
    """Write the record from reports."""
    tests: dict[str, Measured] = {}
    for report in reports:
        for measured in read_report(Path(report)):
            # The first report has set up the fixtures; further ones repeat tests.
            tests.setdefault(measured.test, measured)
    if not is_of_a_whole_gate(tests, Record()):
        sys.stderr.write("The reports are not those of a whole gate: run `make gate` first.\n")
        return 1
    RECORD.write_text(as_toml(tests.values(), Record()), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
