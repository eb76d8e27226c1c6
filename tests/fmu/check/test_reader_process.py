"""The process that reads the untrusted files of one FMU."""

import subprocess
import sys

import pytest

from fmu_src.check import reader_process
from fmu_src.check.reader_process import ReaderProcess
from fmu_src.check.run import check
from hesr_model.support.child import Child
from hesr_model.support.process import DiedError

COMPARE = "fmu_src.check.readers:compare"


@pytest.fixture
def children(monkeypatch):
    """The processes that are started."""
    started = []

    def start(*arguments):
        started.append(Child(*arguments))
        return started[-1]

    monkeypatch.setattr(reader_process, "Child", start)
    return started


def test_an_fmu_has_one_process_and_shares_it_with_none(table1_fmu, children):
    for count in (1, 2):
        assert check(table1_fmu).rule_count
        assert len(children) == count
    assert all(child._ended for child in children)


def test_a_process_that_has_died_is_replaced(tmp_path, children):
    file = tmp_path / "m.xml"
    file.write_text('<fmiModelDescription fmiVersion="2.0"/>', encoding="utf-8")
    with ReaderProcess(tmp_path, tmp_path) as reader:
        with pytest.raises(DiedError, match="OSError"):
            reader.run(COMPARE, tmp_path / "none.xml", 60.0)
        assert reader.run(COMPARE, file, 60.0)
        assert reader.run(COMPARE, file, 60.0)
    assert len(children) == 2


def test_it_reads_nothing_but_its_folders(tmp_path):
    """Other reasons for a failure are excluded by the same file in a readable folder."""
    folder, other = tmp_path / "files", tmp_path / "other"
    for place in (folder, other):
        place.mkdir()
        (place / "m.xml").write_text('<fmiModelDescription fmiVersion="2.0"/>', encoding="utf-8")
    with ReaderProcess(tmp_path, folder) as reader:
        assert reader.run(COMPARE, folder / "m.xml", 60.0)
        with pytest.raises(DiedError):
            reader.run(COMPARE, other / "m.xml", 60.0)


PRINT_MODULES = """
import sys
from cosim.workflow.check import check
check(sys.argv[1])
print(*sys.modules)
"""


def test_a_check_loads_no_science_before_its_first_finding(source_fmu):
    """SymPy takes two seconds of CPU time, NumPy and FMPy a quarter each."""
    command = [sys.executable, "-c", PRINT_MODULES, str(source_fmu)]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert "fmu_src.check.run" in loaded
    assert not {"sympy", "numpy", "fmpy", "hesr_model.friction"} & set(loaded)
