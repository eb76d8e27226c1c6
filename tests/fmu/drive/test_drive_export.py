"""Contents of a drive FMU: a valid description, a page, the model; the same on every platform."""

import os
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from c_hosts import Wine, build_host
from containing import Containing
from drive_runs import model_of
from fmpy import read_model_description

from cosim.systems.simulation import System
from fmu_src.blocks.controller import controller
from fmu_src.check.run import check
from fmu_src.export.package import write_fmu
from fmu_src.friction.embedded_model import read_embedded_model
from fmu_src.run.fmu import FmuInstance
from hesr.extras.drive.drive_fmu import export_drive
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel

VDMCHECK2 = Path(__file__).parents[3] / ".tools" / "vdmcheck2"
QEMU = shutil.which("qemu-aarch64")
ARM_LIBRARIES = Path("/usr/aarch64-linux-gnu")  # from Debian's libc6-arm64-cross
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


def test_validators_find_no_problem(fmu: Path) -> None:
    has_vdmcheck = VDMCHECK2.is_dir() and shutil.which("java") is not None
    assert check(fmu, vdmcheck=VDMCHECK2 if has_vdmcheck else None).problems == ()


@pytest.mark.nightly("laws")
def test_laws_of_every_kind_are_valid(make_law, tmp_path: Path) -> None:
    names = ("viscous", "lugre", "elements", "gaussians", "bare")
    model = model_of({name: make_law(name) for name in names})
    path = export_drive(
        model, tmp_path / "D.fmu", inertia=[1.0] * 5, stiffness=[10.0] * 5, ratio=[50.0] * 5
    )
    assert check(path).problems == ()
    about = {v.name: v for v in read_model_description(str(path)).modelVariables}
    assert (about["stiffness[2]"].start, about["ratio[5]"].start) == ("10.0", "50.0")
    assert {"joint[2].sigma_0", "coulomb_scale[4]", "z[2]", "der(z[2])"} <= set(about)


def bristle_with_load() -> FrictionLaw:
    """A law with load-dependent state and torque."""
    rate = 20.0 * absolute(DQ) / (1.0 + 0.1 * absolute(TAU_LOAD))
    z = Relaxation(name="z", unit="rad", drive=DQ, rate=rate)
    output = 20.0 * z.state + 0.5 * z.derivative
    form = LawForm(coefficients=(), memory=(z,), output=output)
    return FrictionLaw(name="by_hand", form=form, values={})


def inputs_of(unknowns) -> dict[str, set[str]]:
    return {
        u.variable.name: {v.name for v in u.dependencies if v.causality == "input"}
        for u in unknowns
    }


def test_no_output_has_direct_feedthrough(make_law, tmp_path: Path) -> None:
    """Hence neither a controller nor a link forms an algebraic loop with a drive."""
    laws = {"a": bristle_with_load(), "b": make_law("viscous"), "c": make_law("lugre")}
    fmu = export_drive(model_of(laws), tmp_path / "D.fmu", inertia=INERTIA, stiffness=INERTIA)
    about = read_model_description(str(fmu))
    outputs = {f"{n}[{i}]" for n in ("q", "dq", "ddq", "tau_f", "tau_link") for i in (1, 2, 3)}
    assert inputs_of(about.outputs) == {name: set() for name in outputs}
    assert not any(inputs_of(about.derivatives).values())
    initially = {name: found for name, found in inputs_of(about.initialUnknowns).items() if found}
    expected = {f"tau_link[{i}]": {f"q_link[{i}]", f"dq_link[{i}]"} for i in (1, 2, 3)}
    expected |= {name: {"tau_load[1]"} for name in ("tau_f[1]", "der(z[1])")}
    assert initially == expected | {"tau_f[2]": {"tau_load[2]"}}


def test_inputs_affect_outputs_during_initialisation(make_law, tmp_path: Path) -> None:
    laws = {"a": bristle_with_load(), "b": make_law("viscous")}
    one = [1.0, 1.0]
    fmu = export_drive(
        model_of(laws), tmp_path / "D.fmu", inertia=one, stiffness=[50.0, 50.0], damping=[4.0, 4.0]
    )
    names = ["tau_link[1]", "tau_f[2]", "der(z[1])", "tau_f[1]"]
    with FmuInstance(fmu) as drive:
        drive.enter_initialisation(start={"dq_start[1]": 0.5, "dq_start[2]": 0.5, "z_start[1]": 0.1,
                                          "start_mode": 2})  # fmt: skip
        first = drive.get(names)
        assert first[:2] == pytest.approx([2.0, 4.5 + 12.0 * 0.5**3 + 0.5])
        drive.set({"q_link[1]": 0.1, "dq_link[1]": 0.2, "tau_load[1]": 7.0, "tau_load[2]": -8.0})
        given = drive.get(names)
        assert given[:2] == pytest.approx([-5.0 + 4.0 * 0.3, first[1] + 0.8])
        assert np.all(given != first)
        drive.exit_initialisation()
        np.testing.assert_array_equal(drive.get(names), given)
        drive.set({f"{n}[{i}]": 3.0 for n in ("q_link", "dq_link", "tau_load", "tau_motor")
                   for i in (1, 2)})  # fmt: skip
        np.testing.assert_array_equal(drive.get(names), given)
        drive.step(0.0, 0.001)
        assert np.all(drive.get(names) != given)


ADMITTANCE = """
step = 0.01
stop = 0.5
observe = ["drive.tau_link", "link.dq_cmd"]

[[components]]
name = "drive"
fmu = "D.fmu"
start = { tau_motor = 20.0, tau_load = 0.0, q_link = 0.0 }

[[components]]
name = "link"
fmu = "Controller.fmu"
start = { compensation = "torque_error", Kp = 0.02, tau_rb = 5.0, tau_f = 0.0, tau_g = 0.0, \
q_d = 0.0, dq_d = 0.0, q = 0.0 }

[connections]
"link.tau_meas" = "drive.tau_link"
"drive.dq_link" = "link.dq_cmd"
"""


@pytest.mark.parametrize("order", ["gauss_seidel", "jacobi"])
def test_a_link_with_direct_feedthrough_forms_no_algebraic_loop(
    make_law, tmp_path: Path, order: str
) -> None:
    """Its speed follows the torque of the same instant; the drive uses it in its next step."""
    path = tmp_path / "system.toml"
    path.write_text(f'order = "{order}"\n' + ADMITTANCE.replace("\\\n", ""), encoding="utf-8")
    export_drive(
        model_of({"a": make_law("lugre")}),
        tmp_path / "D.fmu",
        inertia=[1.0],
        damping=[10.0],
        stiffness=[200.0],
    )
    write_fmu(controller(1, step=0.01), tmp_path / "Controller.fmu")
    result = System.read(path).run()
    torque, speed = (result.vector(n)[:, 0] for n in ("drive.tau_link", "link.dq_cmd"))
    assert len(result.t) == 51
    # Initially only the link moves: tau = -10 v and v = 0.02 (5 - tau).
    assert (torque[0], speed[0]) == pytest.approx((-1.25, 0.125), rel=1e-3)
    late = int(order == "jacobi")
    np.testing.assert_allclose(speed[1:], 0.02 * (5.0 - torque[1 - late : 51 - late]), rtol=1e-9)
    assert np.ptp(torque) > 1.0


def test_the_model_is_embedded(fmu: Path, table1: FrictionModel) -> None:
    assert read_embedded_model(fmu) == table1


def test_the_export_is_reproducible(table1: FrictionModel, tmp_path: Path) -> None:
    one, two = (export_drive(table1, tmp_path / n, inertia=INERTIA) for n in ("1.fmu", "2.fmu"))
    assert one.read_bytes() == two.read_bytes()
    other = export_drive(table1, tmp_path / "3.fmu", inertia=[3.0, 3.0, 0.7])
    assert one.read_bytes() != other.read_bytes()


def test_the_page_explains_the_drive_and_is_self_contained(fmu: Path) -> None:
    text = page(fmu)
    words = " ".join(re.sub(r"<[^>]*>", " ", text).split())
    for said in (
        "Causality: torque in, speed out",
        "R(v) = J (v - dq) / h - tau_motor + (tau_f(v / N, x(v)) + tau_link(v)) / N",
        "At rest this law holds nothing",
        "Steady sliding drives at speeds of 0 to 0.75 rad/s",
        "0.001 s, parameter substep",
        "torque on the link, for the importing tool",
    ):
        assert said in words
    assert "<math" in text
    assert not re.search(r"<script|https?://(?!www\.w3\.org)|@import|url\(", text)


def test_the_page_documents_the_holding_torque(make_law, tmp_path: Path) -> None:
    model = model_of({"a": make_law("lugre"), "b": make_law("viscous")})
    text = page(export_drive(model, tmp_path / "D.fmu", inertia=[1.0, 1.0]))
    # Break-away at 12 N.m; 9 N.m and the lost damping of the bristle remain at speed.
    assert text == Containing("holds up to 12 N.m", "below 9 N.m")
    assert text == Containing("holds up to 4.5 N.m", "below 4.5 N.m")
    assert "load on the joint, used by b" in text


def speeds(
    fmu: Path, folder: Path, library: str, *command: object, **environment: str
) -> np.ndarray:
    with zipfile.ZipFile(fmu) as archive:
        path = archive.extract(f"binaries/{library}", folder)
    about = read_model_description(str(fmu))
    first = next(v.valueReference for v in about.modelVariables if v.name == "dq[1]")
    whole = [*command, path, about.guid, 3, first, STEPS, 0.005, 20.0]
    result = subprocess.run(
        [str(part) for part in whole],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env=os.environ | environment,
    )
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


@pytest.mark.ci
def test_windows_matches(fmu: Path, native: np.ndarray, wine: Wine, tmp_path: Path) -> None:
    program = build_host("drive_host.c", tmp_path, "x86_64-windows-gnu")
    program = program.rename(tmp_path / "host.exe")
    rows = speeds(
        fmu,
        tmp_path,
        "win64/drive_parfam_h.dll",
        wine.program,
        program,
        **wine.environment,
    )
    assert_agrees(rows, native)


@pytest.mark.ci
@pytest.mark.skipif(
    QEMU is None or not ARM_LIBRARIES.is_dir(),
    reason="qemu-user and the C library of 64-bit ARM are not installed",
)
def test_linux_on_arm_matches(fmu: Path, native: np.ndarray, tmp_path: Path) -> None:
    program = build_host("drive_host.c", tmp_path, "aarch64-linux-gnu.2.17")
    rows = speeds(
        fmu, tmp_path, "aarch64-linux/drive_parfam_h.so", QEMU, "-L", ARM_LIBRARIES, program
    )
    assert_agrees(rows, native)
