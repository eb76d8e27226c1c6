"""Observer of external torques: valid FMUs, the same numbers in every form, exact on a plant."""

import ctypes
import shutil
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent / "plant"))

from adaptive_models import lugre, stops
from fmpy.validation import validate_fmu
from plant_robots import UF850, coupled, ur_like
from plant_runs import Run, at, plant
from pure_c import compiled, function

import hesr
from fmu_src.check.run import check
from fmu_src.export.package import write_fmu
from fmu_src.friction.friction_fmu import export_fmu
from fmu_src.friction.replay import replay
from fmu_src.plant.plant_fmu import PlantBody
from fmu_src.run.fmu import FmuInstance
from hesr.extras.observer.observation import build_header, export_observer, observe_logs
from hesr.extras.observer.observer_fmu import ObserverLimits, content, has_wrench, law_limits
from hesr_model.errors import ArgumentError, ExportError, HesrError, LogError
from hesr_model.friction.band import Band
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.thermal import Thermal
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription

VDMCHECK2 = Path(__file__).parents[2] / ".tools" / "vdmcheck2"
ACCEPTED = ["velocity-match", "no-friction", "torque-small", "coarse", "stuck", "torque-signal"]
OUTPUTS = ("tau_ext", "tau_ext_lower", "tau_ext_upper", "contact_threshold", "tau_friction")


def limits(joints: int) -> ObserverLimits:
    rows = ((1.0, 0.5, 0.02, 3.0, 0.2, 0.05)[k] for k in range(6))
    return ObserverLimits(numbers=tuple((x,) * joints for x in rows), factor=2.5)


def motion(count: int = 2400) -> Log:
    """A motion with reversals and rests under gravity and noisy torques."""
    rng, t = np.random.default_rng(3), 0.004 * np.arange(count)
    dq = np.sin(np.outer(t, rng.uniform(1.0, 3.0, 3))) * (np.sin(0.7 * t) > -0.5)[:, None]
    q = np.cumsum(dq, axis=0) * 0.004
    own = Robot(UF850)
    tau = own.torque(own.nominal_parameters, q, 0.0 * q, 0.0 * q) + rng.normal(0.0, 8.0, q.shape)
    return Log(name="made", t=t, q=q, dq=dq, tau=tau)


def viscous(robot: Robot, value: float = 2.0) -> FrictionModel:
    c = Coefficient(name="d", unit="N.m.s/rad", description="damping")
    law = FrictionLaw(
        name="viscous", form=LawForm(coefficients=(c,), output=c.symbol * DQ), values={"d": value}
    )
    return FrictionModel(
        law="viscous",
        robot=robot.name,
        joints=robot.joints,
        laws=(law,) * robot.n,
        sample_time=0.004,
        coupling=robot.description.coupling,
    )


@pytest.fixture(scope="module")
def fmus(table1: FrictionModel, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder, body = tmp_path_factory.mktemp("observer"), PlantBody.from_robot(Robot(UF850))
    return {
        fmi: write_fmu(content(table1, body, limits(3)), folder / f"Observer{fmi}.fmu", fmi=fmi)
        for fmi in (2, 3)
    }


@pytest.mark.parametrize("fmi", [2, 3])
def test_validators_find_no_problem(fmi: int, fmus: dict[int, Path]) -> None:
    has_vdmcheck = fmi == 2 and VDMCHECK2.is_dir() and shutil.which("java") is not None
    assert check(fmus[fmi], vdmcheck=VDMCHECK2 if has_vdmcheck else None).problems == ()
    assert validate_fmu(str(fmus[fmi])) == []


def run(fmu: Path, log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Return the outputs (N, 5 n) and contacts (N,) of an FMU over a log."""
    joints, rows, contact = range(1, log.q.shape[1] + 1), [], []
    with FmuInstance(fmu) as instance:
        inputs = instance.buffer([f"{n}[{i}]" for n in ("q", "dq", "tau_motor") for i in joints])
        outputs = instance.buffer([f"{n}[{i}]" for n in OUTPUTS for i in joints])
        reference = instance.variables.references(["contact"], "Boolean")
        for k, sample in enumerate(np.hstack([log.q, log.dq, log.tau])):
            inputs.values[:] = sample
            if k == 0:
                instance.initialise(inputs=inputs)
            else:
                inputs.write()
                instance.step(log.t[k - 1], log.t[k] - log.t[k - 1])
            rows.append(outputs.read().copy())
            contact += instance._instance.get("Boolean", reference)
    return np.array(rows), np.array(contact, dtype=bool)


def test_every_form_has_the_same_numbers(
    table1: FrictionModel, fmus: dict[int, Path], tmp_path: Path
) -> None:
    body, log = PlantBody.from_robot(Robot(UF850)), motion()
    known, contact = run(fmus[2], log)
    assert 0.05 < contact.mean() < 0.95
    rows, other = run(fmus[3], log)
    np.testing.assert_array_equal(rows, known)
    np.testing.assert_array_equal(other, contact)
    [found] = observe_logs(table1, body, limits(3), [log])
    np.testing.assert_array_equal(np.hstack([found.outputs[n] for n in OUTPUTS]), known)
    np.testing.assert_array_equal(found.contact, contact)
    header = build_header(content(table1, body, limits(3), bare=True), "own")
    text = """
#include <string.h>
#include "own.h"
EXPORT int sample(const double *u, double step, double *y) {
    static own observer;
    own_outputs found;
    if (step == 0.0) {
        own_begin(&observer, u, u + 3, u + 6, &found);
    } else {
        own_step(&observer, u, u + 3, u + 6, step, &found);
    }
    memcpy(y, found.tau_ext, 3 * sizeof *y);
    memcpy(y + 3, found.tau_ext_lower, 3 * sizeof *y);
    memcpy(y + 6, found.tau_ext_upper, 3 * sizeof *y);
    memcpy(y + 9, found.contact_threshold, 3 * sizeof *y);
    memcpy(y + 12, found.tau_friction, 3 * sizeof *y);
    return found.contact;
}
"""
    library = compiled(tmp_path, text, others={"own.h": header})
    pointer = np.ctypeslib.ndpointer(dtype=float, flags="C")
    sample = function(library, "sample", ctypes.c_int, pointer, ctypes.c_double, pointer)
    steps, y = np.diff(log.t, prepend=log.t[0]), np.zeros(15)
    for k, u in enumerate(np.hstack([log.q, log.dq, log.tau])):
        assert sample(np.ascontiguousarray(u), steps[k], y) == contact[k]
        np.testing.assert_array_equal(y, known[k])


@pytest.mark.parametrize(("step", "kind"), [(0.001, ur_like), (0.01, ur_like), (0.001, coupled)])
def test_the_observer_finds_what_pushes_a_plant(
    step: float, kind: Callable[[Path], Path | RobotDescription], tmp_path: Path
) -> None:
    robot = Robot(kind(tmp_path))
    model, count = viscous(robot, 30.0), round(2.0 / step)
    t, every = step * np.arange(count), round(step / 0.001)
    push = np.zeros((count, 6))
    push[t > 1.0] = (15.0, -30.0, 10.0, 2.0, -3.0, 1.0)
    gravity = robot.torque(robot.nominal_parameters, np.zeros((1, 6)), *np.zeros((2, 1, 6)))
    motor = gravity + 8.0 * np.sin(2.0 * t)[:, None] * np.array([1.0, 1.0, 0.5, 0.1, 0.1, 0.05])
    fine = Run(
        plant(robot, model.laws, tmp_path),
        np.repeat(motor + push, every, axis=0),
        step=step / every,
    )
    q, dq = fine.q[::every], fine.dq[::every]
    assert np.abs(dq).max() > 0.5
    assert np.abs(q).max() < 8.0
    # The torque of row k is held over the step that ends there.
    tau = np.vstack([motor[:1], motor])
    log = Log(name="pushed", t=step * np.arange(count + 1), q=q, dq=dq, tau=tau)
    [found] = observe_logs(model, PlantBody.from_robot(robot), limits(6), [log], bandwidth=10.0)
    settled = log.t > 1.3
    error = (found.outputs["tau_ext"] - np.vstack([push[:1], push]))[settled]
    assert np.abs(error).max() < 0.02 * np.abs(push).max() * step / 0.001
    before = found.outputs["tau_ext"][(log.t > 0.3) & (log.t < 1.0)]
    assert np.abs(before).max() < 0.02 * np.abs(push).max() * step / 0.001


def test_force_and_moment_at_the_flange(tmp_path: Path) -> None:
    robot, rng = Robot(ur_like(tmp_path)), np.random.default_rng(4)
    body, zero = PlantBody.from_robot(robot), np.zeros((400, 6))
    assert has_wrench(robot)
    assert not has_wrench(Robot(UF850))
    for _ in range(5):
        q, wrench = rng.uniform(-2.0, 2.0, 6), rng.normal(0.0, 20.0, 6)
        q[[2, 4]] = np.copysign(1.0, q[[2, 4]])  # away from singular elbows and wrists
        poses = robot.places(q)
        axes = [r @ j.axis for (r, _), j in zip(poses, robot.tree, strict=True)]
        jacobian = np.array(
            [
                np.concatenate([np.cross(a, poses[-1][1] - p), a])
                for a, (_, p) in zip(axes, poses, strict=True)
            ]
        ).T
        rows = zero + q
        tau = robot.torque(robot.nominal_parameters, rows, zero, zero) - jacobian.T @ wrench
        log = Log(name="held", t=0.004 * np.arange(400), q=rows, dq=zero, tau=tau)
        [found] = observe_logs(viscous(robot), body, limits(6), [log])
        last = {name: values[-1] for name, values in found.outputs.items()}
        np.testing.assert_allclose([*last["force"], *last["moment"]], wrench, rtol=1e-3, atol=1e-3)
        half = 0.5 * (last["tau_ext_upper"] - last["tau_ext_lower"]) / 1.96
        inverse = np.linalg.inv(jacobian @ np.diag(half**-2.0) @ jacobian.T)
        force, moment, both = (
            last[f"{name}_covariance"] for name in ("force", "moment", "force_moment")
        )
        covariance = np.block([[force, both], [both.T, moment]])
        np.testing.assert_allclose(covariance, inverse, rtol=1e-3, atol=1e-3)


def thermal(*, measured: bool = True) -> FrictionModel:
    robot = Robot(UF850)
    warm = Thermal(
        coulomb=0.004,
        viscous=0.02,
        coulomb_scale=1.1,
        viscous_scale=0.9,
        reference=25.0,
        measured=measured,
    )
    return FrictionModel(
        law="warm",
        robot=robot.name,
        joints=robot.joints,
        laws=(lugre(), stops(), lugre()),
        sample_time=0.004,
        thermal=(warm, replace(warm, coulomb=0.008), warm),
    )


def test_friction_follows_the_temperature(tmp_path: Path) -> None:
    model, log = thermal(), motion()
    temperature = np.stack([20.0 + k * log.t + 5.0 * np.sin(log.t) for k in (1, 2, 3)], axis=1)
    warm = replace(log, temperature=temperature)
    [found] = observe_logs(model, PlantBody.from_robot(Robot(UF850)), limits(3), [warm])
    torque, load = found.outputs["tau_friction"], found.outputs["tau_load"]
    alone = export_fmu(model, tmp_path / "Warm.fmu")
    known = replay(alone, log.t, log.dq, log.q, load, temperature=temperature)
    np.testing.assert_allclose(torque, known, rtol=0.0, atol=1e-9 * np.abs(known).max())
    cold = replace(log, temperature=np.full_like(temperature, 25.0))
    [other] = observe_logs(model, PlantBody.from_robot(Robot(UF850)), limits(3), [cold])
    assert np.abs(other.outputs["tau_friction"] - torque).max(axis=0).min() > 0.5
    path = write_fmu(
        content(model, PlantBody.from_robot(Robot(UF850)), limits(3)), tmp_path / "O.fmu"
    )
    assert check(path).problems == ()
    assert validate_fmu(str(path)) == []


def test_currents_replace_torques(table1: FrictionModel, tmp_path: Path) -> None:
    body, log, constants = PlantBody.from_robot(Robot(UF850)), motion(300), (10.0, 12.0, 8.0)
    whole = content(table1, body, limits(3), constants=constants, bare=True)
    by_current = Log(name="i", t=log.t, q=log.q, dq=log.dq, tau=log.tau / constants)
    rows, _ = run(write_fmu(whole, tmp_path / "Current.fmu"), by_current)
    [known] = observe_logs(table1, body, limits(3), [log])
    np.testing.assert_allclose(rows[:, :3], known.outputs["tau_ext"], rtol=1e-9, atol=1e-9)


def test_limits_without_calibration_are_those_of_the_law(tmp_path: Path) -> None:
    robot = Robot(UF850)
    model = viscous(robot)
    with pytest.raises(ArgumentError, match="has no band; give 'calibration'"):
        law_limits(model)
    band = Band(
        floor=1.0, slow=2.0, slow_speed=0.02, rest=3.0, fast=0.1, load=0.0, tail=0.65, envelope=0.0
    )
    laws = tuple(
        FrictionLaw(name="viscous", form=one.form, values=one.values, band=band)
        for one in model.laws
    )
    banded = FrictionModel(
        law="viscous", robot=robot.name, joints=robot.joints, laws=laws, sample_time=0.004
    )
    own = law_limits(banded)
    assert own.numbers[:2] == ((1.0,) * 3, (2.0,) * 3)
    # ln(1 / (900000 * 3)) / ln(0.05) = 4.94
    assert own.factor == pytest.approx(4.943**0.65, rel=1e-3)
    path = export_observer(banded, tmp_path / "Own.fmu", plant_body=PlantBody.from_robot(robot))
    with zipfile.ZipFile(path) as archive:
        page = archive.read("documentation/index.html").decode()
    assert "rate of false alarms is unknown" in page
    header = export_observer(banded, tmp_path / "own.h", plant_body=PlantBody.from_robot(robot))
    assert "own_step(" in header.read_text(encoding="utf-8")


def test_bad_requests_are_refused(table1: FrictionModel, tmp_path: Path) -> None:
    body = PlantBody.from_robot(Robot(UF850))
    with pytest.raises(ExportError, match="'bandwidth' is 0 Hz"):
        content(table1, body, limits(3), bandwidth=0.0)
    with pytest.raises(ExportError, match="'2b' is not a valid C name"):
        export_observer(table1, tmp_path / "2b.h", plant_body=body)
    turned = Robot(coupled(tmp_path))
    with pytest.raises(ArgumentError, match="bands are those of coupled motors"):
        export_observer(
            viscous(turned), tmp_path / "O.fmu", plant_body=PlantBody.from_robot(turned)
        )
    heated = thermal(measured=False)
    with pytest.raises(ExportError, match="takes the temperature from the heat"):
        content(heated, body, limits(3))
    with pytest.raises(
        ExportError, match="temperature, which the C header of an observer does not"
    ):
        export_observer(thermal(), tmp_path / "own.h", plant_body=body)
    with pytest.raises(LogError, match="log 'made': has no temperatures"):
        observe_logs(thermal(), body, limits(3), [motion()])
    short = motion(500)
    with pytest.raises(HesrError, match="last 2 s; at least 60 s"):
        hesr.observe(short, law=table1, robot=UF850, calibration=short, accept=ACCEPTED)


def test_a_posture_is_the_start(tmp_path: Path) -> None:
    """At the first sample, and at rest in balance, nothing is external."""
    robot = Robot(ur_like(tmp_path))
    q = np.zeros((50, 6)) + 0.3
    tau = robot.torque(robot.nominal_parameters, q, 0.0 * q, 0.0 * q)
    log = Log(name="still", t=0.01 * np.arange(50), q=q, dq=0.0 * q, tau=tau)
    [found] = observe_logs(viscous(robot), PlantBody.from_robot(robot), limits(6), [log])
    assert np.abs(found.outputs["tau_ext"]).max() < 1e-9
    assert at(robot, q[0])["q_start[1]"] == 0.3
