"""hesr interop, through the real command line."""

import json
from pathlib import Path

import pytest
from small_fmus import lag

from cosim.systems.system import ComponentSpec, SystemSpec, write_system
from hesr.cli import app
from hesr_model.errors import HesrError


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return lag(tmp_path_factory.mktemp("lag"))


def hesr(*arguments: object) -> int:
    """Return the exit code."""
    try:
        app([str(a) for a in ("interop", *arguments)])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_one_fmu(fmu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In FMPy, which comes with HESR; engines in a folder that is not there are left out."""
    file = tmp_path / "matrix.json"
    assert hesr(fmu, "--tools", tmp_path / "none", "--json", file) == 0
    out = capsys.readouterr().out
    assert "largest deviation, relative to the" in " ".join(out.split())
    assert f"Maestro: not run: there is no {tmp_path}/none/maestro: make interop" in out
    found = json.loads(file.read_text())
    cell = found["FMPy"]["cases"]["Lag"]
    assert cell["deviation"] <= cell["tolerance"] == 1e-12
    assert found["FMPy"]["version"]
    assert found["Maestro"]["version"] is None
    assert found["OMSimulator"]["missing"].startswith("there is no library")


def test_a_system(fmu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts = (ComponentSpec(name="a", fmu=fmu, start={"u": 2.0}), ComponentSpec(name="b", fmu=fmu))
    spec = SystemSpec(name="lags", step=0.01, stop=0.5, components=parts,
                      connections={"b.u": "a.y"}, observe=("b.y",))  # fmt: skip
    path = write_system(spec, tmp_path / "SYSTEM.toml")
    file = tmp_path / "matrix.json"
    assert hesr(path, "--tools", tmp_path / "none", "--json", file) == 0
    assert "FMPy: systems are coupled by Jacobi, first inputs zero." in capsys.readouterr().out
    cell = json.loads(file.read_text())["FMPy"]["cases"]["lags"]
    assert cell["deviation"] <= cell["tolerance"] == 1e-9
    assert cell["seconds"] > 0.0


def test_what_cannot_be_read(tmp_path: Path) -> None:
    for name, text in (("x.ssp", "not a readable SSP"), ("x.toml", "x.toml")):
        (tmp_path / name).write_text("nothing")
        with pytest.raises(HesrError, match=text):
            hesr(tmp_path / name)
    (tmp_path / "x.fmu").write_text("nothing")
    with pytest.raises(HesrError, match=r"x\.fmu: not a readable FMU"):
        hesr(tmp_path / "x.fmu")
