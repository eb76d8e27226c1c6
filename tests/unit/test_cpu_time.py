"""Limit of the CPU time of a test, in units of a probe on the same machine."""

import subprocess
import sys
import tomllib
from pathlib import Path

import cpu_time
import pytest

TESTS = """
import pytest
from cpu_time import probe

def test_of_one_probe():
    probe()

def test_of_twelve_probes():
    [probe() for _ in range(12)]

@pytest.mark.ci
def test_of_twelve_probes_in_ci():
    [probe() for _ in range(12)]
"""

PROBE = cpu_time.PROBE_ON_REFERENCE / 5

RUN = f"""
import sys, cpu_time, pytest
cpu_time.ROUNDS //= 5
cpu_time.PROBE_ON_REFERENCE = float(sys.argv[1])
plugin = cpu_time.CpuTime(limit=3 * {PROBE})
options = ["-q", "-p", "no:cacheprovider", "-W", "ignore", "-rf", "--confcutdir=.", "test_it.py"]
sys.exit(pytest.main(options, plugins=[plugin]))
"""


def failures(folder: Path, on_reference: float) -> tuple[str, int]:
    """Run the tests with a stated cost of the probe on the reference machine."""
    (folder / "test_it.py").write_text(TESTS, encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "-c", RUN, str(on_reference)],
        capture_output=True,
        text=True,
        cwd=folder,
        env={"PYTHONPATH": str(Path(cpu_time.__file__).parent), "PATH": ""},
        check=False,
    )
    return ended.stdout, ended.returncode


def test_a_slow_test_fails_by_the_cost_of_the_probe(tmp_path: Path) -> None:
    said, code = failures(tmp_path, PROBE)
    assert code == pytest.ExitCode.TESTS_FAILED, said
    assert "1 failed, 2 passed" in said
    assert "FAILED test_it.py::test_of_twelve_probes - Failed: took" in said
    assert "share a fixture or mark it ci" in said


def test_a_slow_machine_does_not_fail(tmp_path: Path) -> None:
    """Compared with a reference machine that is ten times as fast."""
    said, code = failures(tmp_path, PROBE / 10)
    assert (code, "3 passed" in said) == (0, True), said


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
