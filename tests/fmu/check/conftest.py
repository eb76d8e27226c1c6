"""FMUs to check."""

from pathlib import Path

import pytest
from fmu_files import Xml, read_xml, without_binaries


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def source_fmu(table1_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Table I without binaries."""
    return without_binaries(table1_fmu, tmp_path_factory.mktemp("source") / "Source.fmu")


@pytest.fixture
def xml(table1_fmu: Path) -> Xml:
    """Model description of Table I, to be modified."""
    return read_xml(table1_fmu)
