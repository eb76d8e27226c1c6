"""Speed of the drive FMU in a C host."""

import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from c_hosts import build_host
from fmpy import read_model_description
from pytest_benchmark.fixture import BenchmarkFixture

from fmu_src import model_file
from hesr.extras.drive.drive_fmu import export_drive
from hesr_model.friction.model import FrictionModel

INERTIA = [3.0, 3.0, 0.6]
TORQUE = 25.0  # [N.m], above the holding torque of any joint


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_host("drive_host.c", tmp_path_factory.mktemp("host"))


@pytest.mark.parametrize("step", ["1e-3", "1e-4"])
@pytest.mark.parametrize("discretisation", ["euler", "exact"])
def test_step_in_a_c_host(
    discretisation: str,
    step: str,
    host: Path,
    benchmark: BenchmarkFixture,
    tmp_path: Path,
    tell: Callable[[str], None],
) -> None:
    """Target: 1 us for three joints of ParFam-H, one inner step per step, through 80 reversals."""
    model = FrictionModel.read(model_file("uf850-table1"))
    laws = tuple(replace(law, discretisation=discretisation) for law in model.laws)
    path = export_drive(replace(model, laws=laws), tmp_path / "Drive.fmu", inertia=INERTIA)
    about = read_model_description(str(path))
    with zipfile.ZipFile(path) as archive:
        name = next(n for n in archive.namelist() if n.startswith("binaries/linux64/"))
        library = archive.extract(name, tmp_path)
    first = next(v.valueReference for v in about.modelVariables if v.name == "dq[1]")
    command = [host, library, about.guid, 3, first, 4000, step, TORQUE, "time"]

    def run() -> float:
        result = subprocess.run(
            [str(part) for part in command], capture_output=True, text=True, check=True
        )
        return float(result.stdout)

    found = benchmark.pedantic(run, rounds=5)
    benchmark.extra_info |= {"aim": "1000 ns", "ns": found}
    tell(f"doStep of a drive of three joints, {discretisation}, {step} s: {found:.0f} ns")
