"""The whole closed loop as one FMU for Windows, run by a plain C host under wine."""

import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from c_hosts import Wine, build_host
from closed_loop import build
from fmpy.model_description import read_model_description

from cosim.loop.closed_loop import Scheme
from fmu_src import model_file
from fmu_src.export.toolchain import TARGETS
from hesr.extras.ssp.container import write_container
from hesr.extras.ssp.contents import read_contents
from hesr_model.errors import ExportError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.compiler import compile_c

pytestmark = pytest.mark.ci

STEPS = 400  # 2 s


def rows(folder: Path, library: str, host: Path, *before: str, **environment: str) -> np.ndarray:
    about = read_model_description(str(folder))
    observed = [v.valueReference for v in about.modelVariables if v.causality == "output"]
    place = ("file:///Z:" if before else "file://") + str(folder / "resources")
    command = [*before, host, folder / "binaries" / library, about.guid, place, STEPS, *observed]
    ended = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
        env=os.environ | environment,
    )
    assert ended.returncode == 0, ended.stderr
    found = np.array([line.split() for line in ended.stdout.splitlines()], dtype=float)
    assert found.shape == (STEPS, len(observed))
    return found


def test_the_closed_loop_matches_linux(wine: Wine, tmp_path: Path) -> None:
    platforms = ("linux64", "win64")
    try:
        bench = build(tmp_path, FrictionModel.read(model_file("uf850-table1")), platforms)
    except ExportError as error:
        if "pip could not download MuJoCo's wheel" in str(error):
            pytest.skip(f"MuJoCo for Windows cannot be had here: {error}")
        raise
    spec = bench.system(bench.loop(Scheme(compensation="servo_inversion", Kx=5.0)))
    fmu = write_container(read_contents(spec, tmp_path / "loop.toml"), tmp_path / "Loop.fmu")
    folder = tmp_path / "unpacked"
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    name = read_model_description(str(folder)).coSimulation.modelIdentifier
    expected = rows(folder, f"linux64/{name}.so", build_host("container_host.c", tmp_path))
    host = build_host("container_host.c", tmp_path, "x86_64-windows-gnu").rename(tmp_path / "h.exe")
    missing = shutil.copy(Path(__file__).with_name("bcryptprimitives.c"), tmp_path)
    flags = ("-target", "x86_64-windows-gnu", "-O2", "-shared")
    dll = folder / "binaries/win64/bcryptprimitives.dll"
    compile_c(Path(missing), flags, dll, (*TARGETS["win64"].flags, "-ladvapi32"))
    found = rows(
        folder,
        f"win64/{name}.dll",
        host,
        wine.program,
        **wine.environment,
    )
    assert np.ptp(expected, axis=0).max() > 0.1  # the arm has moved
    worst = np.abs(found - expected).max(axis=0) / np.ptp(expected, axis=0)
    assert np.all(worst <= 1e-9), worst
