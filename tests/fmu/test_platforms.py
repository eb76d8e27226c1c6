"""Binaries of other platforms give the torques of this one, each in its own host."""

import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from c_hosts import build_host
from fmpy import read_model_description

from fmu_src import export_fmu

pytestmark = pytest.mark.ci

STEPS = 1000
AGREEMENT = 1e-13  # of the peak; the C libraries differ in the last digits

QEMU = shutil.which("qemu-aarch64")
ARM_LIBRARIES = Path("/usr/aarch64-linux-gnu")  # from Debian's libc6-arm64-cross


def torques(fmu, folder, library, program, *before, **environment):
    with zipfile.ZipFile(fmu) as archive:
        path = archive.extract(f"binaries/{library}", folder)
    about = read_model_description(str(fmu))
    tau = [v.valueReference for v in about.modelVariables if v.name.startswith("tau[")]
    command = [*before, program, path, about.guid, str(len(tau)), str(tau[0]), str(STEPS)]
    result = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env=os.environ | environment,
    )
    assert result.returncode == 0, result.stderr
    rows = np.array([line.split() for line in result.stdout.splitlines()], dtype=float)
    assert rows.shape == (STEPS, len(tau))
    return rows


@pytest.fixture(scope="module")
def native(table1, tmp_path_factory):
    folder = tmp_path_factory.mktemp("native")
    fmu = export_fmu(table1, folder / "F.fmu", platforms=["all"])
    program = build_host("host.c", folder)
    return fmu, torques(fmu, folder, "linux64/friction_parfam_h.so", program)


def assert_agrees(rows, reference):
    assert np.all(np.ptp(reference, axis=0) > 1.0)  # the joints have moved
    worst = np.abs(rows - reference).max(axis=0) / np.abs(reference).max(axis=0)
    assert np.all(worst <= AGREEMENT), worst


def test_windows_matches(native, wine, tmp_path):
    fmu, reference = native
    program = build_host("host.c", tmp_path, "x86_64-windows-gnu").rename(tmp_path / "host.exe")
    rows = torques(
        fmu,
        tmp_path,
        "win64/friction_parfam_h.dll",
        program,
        wine.program,
        **wine.environment,
    )
    assert_agrees(rows, reference)


@pytest.mark.skipif(
    QEMU is None or not ARM_LIBRARIES.is_dir(),
    reason="qemu-user and the C library of 64-bit ARM are not installed",
)
def test_linux_on_arm_matches(native, tmp_path):
    fmu, reference = native
    program = build_host("host.c", tmp_path, "aarch64-linux-gnu.2.17")
    library = "aarch64-linux/friction_parfam_h.so"
    assert_agrees(torques(fmu, tmp_path, library, program, QEMU, "-L", ARM_LIBRARIES), reference)


def test_the_host_reports_errors(native, tmp_path):
    program = build_host("host.c", tmp_path)
    command = [program, tmp_path / "none.so", "{}", "3", "9", "1"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (1, "the library cannot be loaded\n")
