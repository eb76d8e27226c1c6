"""Files as cases: an FMU and a system in FMPy, which is installed with HESR."""

from pathlib import Path

import pytest
from interop.case import opened_case
from interop.drive import driven
from interop.engine import Tools
from interop.matrix import compare
from interop.table import notes, table
from small_fmus import lag

from cosim.systems.system import ComponentSpec, SystemSpec, write_system
from hesr_model.errors import HesrError


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return lag(tmp_path_factory.mktemp("lag"))


def test_an_fmu_file_is_run(fmu: Path, tmp_path: Path) -> None:
    """Engines in a folder that does not exist are omitted."""
    matrix = compare([driven(fmu)], Tools(folder=tmp_path / "none"))
    assert not matrix.failing
    assert table(matrix).caption.startswith("largest deviation, relative to the")
    assert any(
        line.startswith(f"Maestro: not run: there is no {tmp_path}/none/maestro: make interop")
        for line in notes(matrix)
    )
    rows = {row.engine.name: row for row in matrix.rows}
    cell = rows["FMPy"].cells["Lag"]
    assert cell.deviation <= cell.tolerance == 1e-12
    assert rows["FMPy"].version
    assert not rows["Maestro"].version
    assert rows["OMSimulator"].missing.startswith("there is no library")


def test_a_system_file_is_run(fmu: Path, tmp_path: Path) -> None:
    parts = (ComponentSpec(name="a", fmu=fmu, start={"u": 2.0}), ComponentSpec(name="b", fmu=fmu))
    spec = SystemSpec(
        name="lags",
        step=0.01,
        stop=0.5,
        components=parts,
        connections={"b.u": "a.y"},
        observe=("b.y",),
    )
    with opened_case(write_system(spec, tmp_path / "SYSTEM.toml"), tmp_path) as case:
        matrix = compare([case], Tools(folder=tmp_path / "none"))
    assert not matrix.failing
    assert "FMPy: systems are coupled by Jacobi, first inputs zero." in list(notes(matrix))
    [cell] = next(row for row in matrix.rows if row.engine.name == "FMPy").cells.values()
    assert cell.deviation <= cell.tolerance == 1e-9
    assert cell.seconds > 0.0


def test_unreadable_files_are_refused(tmp_path: Path) -> None:
    for name, text in (("x.ssp", "not a readable SSP"), ("x.toml", "x.toml")):
        (tmp_path / name).write_text("nothing")
        with pytest.raises(HesrError, match=text), opened_case(tmp_path / name, tmp_path):
            pass
    (tmp_path / "x.fmu").write_text("nothing")
    with pytest.raises(HesrError, match=r"x\.fmu: not a readable FMU"):
        driven(tmp_path / "x.fmu")
