"""What is in a drive FMU: a valid description, a page, the model; on every platform the same."""

import os
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from c_hosts import build_host
from drive_runs import model_of
from fmpy import read_model_description

from fmu_src.check import check
from fmu_src.drive.export import export_drive
from fmu_src.friction.embedded import embedded_model
from hesr_model.friction.model import FrictionModel

VDMCHECK2 = Path(__file__).parents[3] / ".tools" / "vdmcheck2"
WINE = shutil.which("wine") or shutil.which("wine64")
QEMU = shutil.which("qemu-aarch64")
ARM_LIBRARIES = Path("/usr/aarch64-linux-gnu")  # of Debian's libc6-arm64-cross
AGREEMENT = 1e-12  # of the peak; the C libraries differ in the last digits
INERTIA = [3.0, 3.0, 0.6]
STEPS = 1000


@pytest.fixture(scope="module")
def fmu(table1: FrictionModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "Drive.fmu"
    return export_drive(table1, path, inertia=INERTIA, platforms=["all"])


def page(fmu: Path) -> str:
    with zipfile.ZipFile(fmu) as archive:
        return archive.read("documentation/index.html").decode()


def test_no_validator_finds_anything(fmu: Path) -> None:
    has_vdmcheck = VDMCHECK2.is_dir() and shutil.which("java") is not None
    assert check(fmu, vdmcheck=VDMCHECK2 if has_vdmcheck else None).problems == ()


def test_laws_of_every_kind_are_valid(make_law, tmp_path: Path) -> None:
    names = ("viscous", "lugre", "elements", "gaussians", "bare")
    model = model_of({name: make_law(name) for name in names})
    path = export_drive(
        model, tmp_path / "D.fmu", inertia=[1.0] * 5, stiffness=[10.0] * 5, ratio=[50.0] * 5
    )
    assert check(path).problems == ()
    about = {v.name: v for v in read_model_description(str(path)).modelVariables}
    assert (about["stiffness[2]"].start, about["ratio[5]"].start) == ("10.0", "50.0")
    assert {"joint[2].sigma_0", "scale[4]", "z[2]", "der(z[2])"} <= set(about)


def test_no_output_depends_on_the_motor_torque_at_once(fmu: Path) -> None:
    """So that a controller and a drive make no algebraic loop."""
    about = read_model_description(str(fmu))
    outputs = {u.variable.name: {v.name for v in u.dependencies} for u in about.outputs}
    assert {f"{n}[{i}]" for n in ("q", "dq", "ddq", "tau_f", "tau_link") for i in (1, 2, 3)} == set(
        outputs
    )
    assert outputs["q[1]"] == outputs["dq[1]"] == set()
    assert not any(name.startswith("tau_motor") for found in outputs.values() for name in found)


def test_it_carries_its_model(fmu: Path, table1: FrictionModel) -> None:
    assert embedded_model(fmu) == table1


def test_the_same_model_gives_the_same_bytes(table1: FrictionModel, tmp_path: Path) -> None:
    one, two = (export_drive(table1, tmp_path / n, inertia=INERTIA) for n in ("1.fmu", "2.fmu"))
    assert one.read_bytes() == two.read_bytes()
    other = export_drive(table1, tmp_path / "3.fmu", inertia=[3.0, 3.0, 0.7])
    assert one.read_bytes() != other.read_bytes()


def test_the_page_explains_the_drive_and_needs_nothing(fmu: Path) -> None:
    text = page(fmu)
    words = " ".join(re.sub(r"<[^>]*>", " ", text).split())
    for said in (
        "Why torque in, speed out",
        "R(v) = J (v - dq) / h - tau_motor + (tau_f(v / N, x(v)) + tau_link(v)) / N",
        "At rest this law holds nothing",
        "Steady sliding drives at speeds of 0 to 0.75 rad/s",
        "0.001 s, parameter substep",
        "Your tool has the link's inertia and integrates it",
    ):
        assert said in words
    assert "<math" in text
    assert not re.search(r"<script|https?://(?!www\.w3\.org)|@import|url\(", text)


def test_the_page_says_what_a_law_holds(make_law, tmp_path: Path) -> None:
    model = model_of({"a": make_law("lugre"), "b": make_law("viscous")})
    text = page(export_drive(model, tmp_path / "D.fmu", inertia=[1.0, 1.0]))
    # 12 N.m break away, 9 N.m and what the bristle's damping does not add at speed remain.
    assert "At rest this law holds up to 12 N.m without load; a torque below 9 N.m lets" in text
    assert "At rest this law holds up to 4.5 N.m without load; a torque below 4.5 N.m lets" in text
    assert "friction depends in b." in text


def speeds(
    fmu: Path, folder: Path, library: str, *command: object, **environment: str
) -> np.ndarray:
    with zipfile.ZipFile(fmu) as archive:
        path = archive.extract(f"binaries/{library}", folder)
    about = read_model_description(str(fmu))
    first = next(v.valueReference for v in about.modelVariables if v.name == "dq[1]")
    whole = [*command, path, about.guid, 3, first, STEPS, 0.005, 20.0]
    result = subprocess.run(
        [str(part) for part in whole], capture_output=True, text=True, check=False,
        timeout=300, env=os.environ | environment,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return np.array([line.split() for line in result.stdout.splitlines()], dtype=float)


@pytest.fixture(scope="module")
def native(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    folder = tmp_path_factory.mktemp("native")
    program = build_host("drive_host.c", folder)
    return speeds(fmu, folder, "linux64/drive_parfam_h.so", program)


def assert_agrees(rows: np.ndarray, reference: np.ndarray) -> None:
    assert np.all(np.ptp(reference, axis=0) > 0.5)  # the joints have moved
    worst = np.abs(rows - reference).max(axis=0) / np.abs(reference).max(axis=0)
    assert np.all(worst <= AGREEMENT), worst


@pytest.mark.skipif(WINE is None, reason="wine, which runs Windows programs, is not installed")
def test_windows(fmu: Path, native: np.ndarray, tmp_path: Path) -> None:
    program = build_host("drive_host.c", tmp_path, "x86_64-windows-gnu")
    program = program.rename(tmp_path / "host.exe")
    rows = speeds(
        fmu, tmp_path, "win64/drive_parfam_h.dll", WINE, program,
        WINEPREFIX=str(tmp_path / "wine"), WINEDEBUG="-all", DISPLAY="",
    )  # fmt: skip
    assert_agrees(rows, native)


@pytest.mark.skipif(
    QEMU is None or not ARM_LIBRARIES.is_dir(),
    reason="qemu-user and the C library of 64-bit ARM are not installed",
)
def test_linux_on_arm(fmu: Path, native: np.ndarray, tmp_path: Path) -> None:
    program = build_host("drive_host.c", tmp_path, "aarch64-linux-gnu.2.17")
    rows = speeds(
        fmu, tmp_path, "aarch64-linux/drive_parfam_h.so", QEMU, "-L", ARM_LIBRARIES, program
    )
    assert_agrees(rows, native)
