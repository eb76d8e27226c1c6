"""CPU time of tests: what is recorded, and what is listed in CI."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import cpu_time
import pytest

TESTS = """
import hashlib

def test_quick():
    pass

def test_slow():
    hashlib.pbkdf2_hmac("sha256", b"", b"", 400_000)
"""

RUN = """
import sys, cpu_time, pytest
plugin = cpu_time.CpuTime()
options = ["-q", "-p", "no:cacheprovider", "-W", "ignore", "--confcutdir=.", "test_it.py"]
sys.exit(pytest.main(options, plugins=[plugin]))
"""


def test_slow_tests_are_listed_and_do_not_fail(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(TESTS, encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "-c", RUN],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(cpu_time.__file__).parent)},
        check=False,
    )
    assert ended.returncode == pytest.ExitCode.OK, ended.stdout
    _, _, listed = ended.stdout.partition("CPU seconds of the slowest tests")
    first, second = [line.split() for line in listed.splitlines() if "test_it.py" in line]
    assert first[1:] == ["-", "test_it.py::test_slow"]
    assert second[2] == "test_it.py::test_quick"
    assert float(first[0]) > float(second[0])


def test_the_record_can_be_read_with_any_name_of_a_test() -> None:
    name = "test_it.py::test_refused[unknown key 'log.rates' in \"robot.toml\" \\n]"
    record = tomllib.loads(cpu_time.as_toml({"default": {name: 2.5}}))
    assert record["default"]["tests"] == {name: 2.5}


def test_slow_tests_of_a_record_are_left_to_the_complete_run(tmp_path: Path) -> None:
    record = tmp_path / "durations.toml"
    assert not cpu_time.slow_tests(record)
    seconds = {"default": {"a.py::quick": 0.2}, "ci": {"a.py::slow": 2.5, "a.py::marked": 0.1}}
    record.write_text(cpu_time.as_toml(seconds), encoding="utf-8")
    assert cpu_time.slow_tests(record) == {"a.py::slow"}
