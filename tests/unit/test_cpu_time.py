"""CPU time of tests: what reports hold, what is recorded, and what is listed."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import cpu_time
from cpu_time import Fixture, Measured, Record

TESTS = """
import hashlib
import pytest

def work(rounds):
    hashlib.pbkdf2_hmac("sha256", b"", b"", rounds)

@pytest.fixture(scope="module")
def shared():
    work(400_000)

@pytest.fixture
def by_name(request):
    return request.getfixturevalue("shared")

def test_quick():
    pass

def test_slow(by_name):
    work(800_000)

def test_user(shared):
    pass
"""

RUN = """
import sys, cpu_time, pytest
plugin = cpu_time.CpuTime()
options = ["-q", "-p", "no:cacheprovider", "-W", "ignore", "--confcutdir=.", "test_it.py"]
options += ["--junitxml", "report.xml"]
sys.exit(pytest.main(options, plugins=[plugin]))
"""


def test_slow_tests_are_listed_and_fixtures_are_counted_once(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(TESTS, encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "-c", RUN],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(cpu_time.__file__).parent)},
        check=False,
    )
    assert ended.returncode == 0, ended.stdout
    _, _, table = ended.stdout.partition("CPU seconds of the slowest tests")
    rows = [line.split() for line in table.splitlines() if "test_it.py" in line]
    assert rows[0][1:] == ["-", "test_it.py::test_slow"]
    assert float(rows[0][0]) > float(rows[1][0])

    measured = {one.test: one for one in cpu_time.read_report(tmp_path / "report.xml")}
    slow, user = (measured[f"test_it.py::test_{name}"] for name in ("slow", "user"))
    assert 0 < slow.set_up["test_it.py::shared"] < slow.seconds
    assert slow.used == user.used == ["test_it.py::shared"]
    assert user.set_up == measured["test_it.py::test_quick"].set_up == {}


def test_the_record_can_be_read_with_any_name_of_a_test() -> None:
    name = "test_it.py::test_refused[unknown key 'log.rates' in \"robot.toml\" \\n]"
    record = tomllib.loads(cpu_time.as_toml([Measured(name, "ci", 2.5, {}, [])]))
    assert record["ci"]["tests"] == {name: 2.5}


def test_slow_tests_and_few_users_of_costly_fixtures_are_left_to_ci(tmp_path: Path) -> None:
    few = [Measured(f"a.py::few[{k}]", "default", 0.0, {}, ["a.py::costly"]) for k in range(3)]
    few[0].set_up["a.py::costly"] = 1.1
    many = [Measured(f"b.py::many[{k}]", "default", 0.0, {}, ["b.py::common"]) for k in range(40)]
    many[0].set_up["b.py::common"] = 1.1
    own = [
        Measured("c.py::quick", "default", cpu_time.SLOW - 0.01, {}, []),
        Measured("c.py::slow", "default", cpu_time.SLOW, {}, []),
        Measured("c.py::marked", "ci", 0.1, {}, []),
        Measured("c.py::long", "nightly", 9.0, {}, []),
    ]
    path = tmp_path / "durations.toml"
    path.write_text(cpu_time.as_toml([*few, *many, *own]), encoding="utf-8")
    record = Record(path)
    assert record.slow_tests == {"a.py::few[0]", "a.py::few[1]", "a.py::few[2]", "c.py::slow"}
    assert record.fixtures["a.py::costly"] == Fixture(1.1, 3)
    assert record.fixtures["a.py::costly"].is_costly
    assert not record.fixtures["b.py::common"].is_costly
    assert record.kinds["default"]["files"]["c.py"] == round(cpu_time.SLOW - 0.01, 1)
    assert record.kinds["nightly"]["files"] == {"c.py": 9.0, cpu_time.SHARED: 0.0}


def test_runs_without_a_report_keep_their_record(tmp_path: Path) -> None:
    path = tmp_path / "durations.toml"
    long = Measured("c.py::long", "nightly", 9.0, {}, [])
    path.write_text(cpu_time.as_toml([long]), encoding="utf-8")
    quick = Measured("c.py::quick", "default", 0.1, {}, [])
    kinds = tomllib.loads(cpu_time.as_toml([quick], Record(path)))
    assert kinds["nightly"]["tests"] == {"c.py::long": 9.0}
    assert kinds["default"]["files"] == {"c.py": 0.1, cpu_time.SHARED: 0.0}


def test_reports_of_a_part_of_the_gate_are_refused(tmp_path: Path) -> None:
    here = Path(__file__).relative_to(cpu_time.RECORD.parents[1]).as_posix()
    path = tmp_path / "durations.toml"
    removed = Measured("tests/test_removed.py::it", "ci", 0.1, {}, [])
    path.write_text(cpu_time.as_toml([Measured(f"{here}::it", "ci", 0.1, {}, []), removed]))
    assert not cpu_time.is_of_a_whole_gate(["tests/test_new.py::it"], Record(path))
    assert cpu_time.is_of_a_whole_gate([f"{here}::other"], Record(path))
    assert not cpu_time.is_of_a_whole_gate([], Record(tmp_path / "no.toml"))


def test_there_may_be_no_record(tmp_path: Path) -> None:
    record = Record(tmp_path / "durations.toml")
    assert not record.slow_tests
    assert not record.fixtures
