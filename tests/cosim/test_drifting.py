"""The twin over a day: drifting friction and the closed loop that tracks it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from closed_loop import GAINS, MOTION, UF850
from oracles.arm import encoder_error
from oracles.drifting_arm import DriftingArm
from oracles.drifting_loop import (
    Drift,
    Drifted,
    DriftingLoop,
    heated,
    run_drifting,
    score,
    warm_up,
    wear,
)
from small_study import Run, uf850

from cosim.workflow.fit import fit as fit_to
from fmu_src.arm.plant import Plant
from fmu_src.arm.truth import true_friction
from hesr.extras.thermal.thermal_fit import fit_thermal
from hesr_model.errors import ConfigError
from hesr_model.fitting.fit import fit
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.thermal import Thermal
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.lugre import LuGre
from hesr_model.logs.robot_log import Log
from hesr_model.motions.trajectories import Fourier, random_fourier
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.typed_files import to_json

PLANT = Plant.read(UF850 / "plant.toml")


def truth() -> FrictionModel:
    """The twin's own friction, as if fitted."""
    seen = TrainedRange(
        sample_time=0.005, dq=(-1.2, 1.2), q=(-3, 3), tau_load=(-60, 60), tau=(-60, 60)
    )
    known = true_friction(PLANT.model, PLANT.joints, sample_time=0.005)
    return replace(known, trained=(seen,) * 3, training_rmse=PLANT.noise.torque)


def loop_of(
    folder: Path, model: FrictionModel, parameters: np.ndarray | None = None
) -> DriftingLoop:
    robot = Robot(RobotDescription.read(UF850 / "robot.toml"))
    made = DriftingLoop(
        plant=PLANT,
        robot=robot,
        model=model,
        motion=MOTION,
        gains=GAINS,
        folder=folder,
        parameters=robot.nominal_parameters if parameters is None else parameters,
    )
    made.build()
    return made


def by_hand() -> FrictionModel:
    """LuGre laws with the sums of the twin's bristles."""
    numbers = ((9.6, 13.0, 16.6), (12.1, 15.7, 12.5), (5.5, 7.4, 4.0))
    laws = tuple(
        FrictionLaw(name="lugre", form=LuGre.form({}), values={
            "sigma_0": 4e4, "sigma_1": 0.0, "sigma_2": viscous, "F_c": coulomb, "F_s": static,
            "v_s": 0.1, "tau_0": 0.0,
        })
        for coulomb, static, viscous in numbers
    )  # fmt: skip
    return replace(truth(), law="lugre", laws=laws)


@pytest.fixture(scope="module")
def simple(tmp_path_factory: pytest.TempPathFactory) -> DriftingLoop:
    return loop_of(tmp_path_factory.mktemp("simple"), by_hand())


def test_friction_of_the_arm_is_scaled() -> None:
    arm = DriftingArm(PLANT, "payload")
    found = []
    for coulomb, viscous in ((1.0, 1.0), (0.9, 0.7)):
        arm.reset(np.array([0.0, 0.3, -1.9]))
        arm.scale([coulomb] * 3, [viscous] * 3)
        for _ in range(300):
            out = arm.step([0.4, 0.4, 0.4], 0.005)
        found.append(out.tau_f_true)
    sliding = np.array([0.4 * 16.6, 0.4 * 12.5, 0.4 * 4.0])
    # The rest of the difference is ripple.
    change = 0.1 * (found[0] - sliding) + 0.3 * sliding
    np.testing.assert_allclose(found[0] - found[1], change, atol=0.35)


def test_a_load_and_a_push_are_measured() -> None:
    arm = DriftingArm(PLANT, "payload")
    found = []
    for mass in (0.0, 2.0):
        arm.reset(np.array([0.0, 0.3, -1.9]))
        arm.load(mass)
        for _ in range(200):
            loaded = arm.step(np.array([0.0, 0.3, 0.3]), 0.005).tau_meas
        found.append(loaded)
    assert found[0][2] - found[1][2] > 5.0
    arm.push([0.0, 0.0, 30.0])
    for _ in range(100):
        pushed = arm.step(np.zeros(3), 0.005).tau_meas
    assert pushed[2] - loaded[2] < -5.0
    with pytest.raises(ConfigError, match="has no body 'hand'"):
        DriftingArm(PLANT, "hand")


def test_the_loop_tracks_a_drift(simple: DriftingLoop) -> None:
    drift = Drift(coulomb=lambda _, n: np.full(n, 0.8), viscous=lambda _, n: np.full(n, 0.6))
    followed, fixed = (run_drifting(simple, drift, 10.0, adapt=adapt) for adapt in (True, False))
    undrifted = replace(fixed, tau_true=fixed.fixed(simple.model))
    found = score(simple.model, followed, fixed, undrifted, 6.0)
    assert min(found.cut) > 0.3
    assert np.all(np.array(found.tracking) < 0.8 * np.array(found.tracking_fixed))
    assert np.all(np.array(found.level) < 0.97)
    assert to_json(found).keys() >= {"cut", "tracking"}


# --- long runs ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted(study_run: Run, tmp_path_factory: pytest.TempPathFactory) -> DriftingLoop:
    """A law fitted to one log of the twin, whose friction has another form."""
    model = fit_to(
        study_run.log("sweep"),
        law="parfam_s_load",
        robot=uf850("robot.toml"),
        rigid_body=study_run.rigid_body,
    )
    body = np.array(RigidBody.read(study_run.rigid_body).parameters)
    return loop_of(tmp_path_factory.mktemp("fitted"), model, body)


def first(run: Drifted, alarm: str) -> list[float]:
    """Start of the alarm of each joint [s]; inf for none."""
    rows = [np.flatnonzero(column) for column in run.learned[alarm].T]
    return [float(run.t[own[0]]) if len(own) else np.inf for own in rows]


def long_motion(seed: int) -> Fourier:
    """A motion of two minutes that never repeats, so that every row is new."""
    return random_fourier(
        seed=seed,
        harmonics=60,
        period=120.0,
        peak_velocity=np.array([1.0, 0.9, 1.0]),
        offset=np.array([0.0, 0.3, -1.9]),
    )


def log_of(run: Drifted, rows: slice = slice(None), *, name: str = "loop") -> Log:
    """Readings of the twin's encoders and torque sensors."""
    q = run.q + encoder_error(PLANT.noise, np.arange(len(run.t)))
    return Log(name=name, t=run.t[rows], q=q[rows], dq=None, tau=run.tau_meas[rows])


@pytest.fixture(scope="module")
def cold(simple: DriftingLoop) -> Log:
    return log_of(run_drifting(replace(simple, motion=long_motion(3)), Drift(), 120.0))


@pytest.mark.soak
def test_the_drift_of_a_warm_up_is_cut_within_a_minute(fitted: DriftingLoop) -> None:
    # The last of the 20 minutes.
    fitted, drift, seconds = replace(fitted, motion=long_motion(11)), warm_up(1020.0), 120.0
    followed = run_drifting(fitted, drift, seconds)
    fixed = run_drifting(fitted, drift, seconds, adapt=False)
    undrifted = run_drifting(fitted, Drift(), seconds, adapt=False)
    found = score(fitted.model, followed, fixed, undrifted, 60.0)
    assert min(found.cut) >= 0.7


@pytest.mark.soak
@pytest.mark.parametrize("law", ["parfam_s_load", "lugre_load"])
def test_an_adaptive_law_tracks_like_one_refitted_every_minute(
    law: str, cold: Log, tmp_path: Path
) -> None:
    robot = Robot(RobotDescription.read(UF850 / "robot.toml"))
    body = identify([cold], robot)
    model = fit(law, friction_records(cold, robot, body))
    loop = replace(loop_of(tmp_path, model, np.array(body.parameters)), motion=long_motion(11))
    minute = round(60.0 / loop.step)

    def anew(so_far: Drifted, k: int) -> FrictionModel:
        if k == 0:
            return model
        last = log_of(so_far, slice(k - minute, k))
        return fit(law, friction_records(last, robot, body))

    def tracking(run: Drifted) -> np.ndarray:
        return np.sqrt(np.mean((run.q - run.q_d)[run.t >= 60.0] ** 2, axis=0))

    drift, seconds = warm_up(1020.0), 180.0
    followed = tracking(run_drifting(loop, drift, seconds))
    refitted = tracking(run_drifting(loop, drift, seconds, refitted=anew))
    assert np.all(followed <= 1.15 * refitted)
    assert np.all(followed < 0.5 * tracking(run_drifting(loop, drift, seconds, adapt=False)))


@pytest.mark.soak
def test_the_effect_of_temperature_on_the_twin_is_found(simple: DriftingLoop, cold: Log) -> None:
    known = Thermal(coulomb=0.006, viscous=0.02, reference=30.0)

    def course(t: Any) -> Any:
        return 20.0 + 25.0 * t / 1200.0

    run = run_drifting(replace(simple, motion=long_motion(11)), heated(known, course), 1200.0)
    warm = replace(
        log_of(run, name="warm"), temperature=np.repeat(course(run.t)[:, None], 3, axis=1)
    )
    body = identify([cold], simple.robot)
    _, found = fit_thermal(truth(), [friction_records(warm, simple.robot, body)])
    for joint in found:
        assert joint.thermal.coulomb == pytest.approx(known.coulomb, rel=0.05)
        assert joint.thermal.viscous == pytest.approx(known.viscous, rel=0.05)


@pytest.mark.soak
def test_wear_differs_from_load_collision_and_sensor_faults(fitted: DriftingLoop) -> None:
    worn = run_drifting(fitted, wear(60.0, 0), 120.0)
    assert 60.0 < first(worn, "drift")[0] < 120.0
    assert first(worn, "drift")[1:] == [np.inf, np.inf]
    assert worn.learned["level"][-1, 0] > 1.1
    shifted = run_drifting(
        fitted, Drift(torque_offset=lambda t, n: np.full(n, 5.0 * (t >= 60.0))), 120.0
    )
    assert min(first(shifted, "shift")) > 60.0
    assert max(first(shifted, "shift")) < 120.0
    calm = run_drifting(fitted, Drift(), 70.0)
    push = np.array([80.0, -80.0, 40.0])
    hit = run_drifting(fitted, Drift(push=lambda t, _: push * (60.0 <= t < 60.3)), 70.0)
    for factor in ("level", "viscosity"):
        assert np.abs(hit.learned[factor] - calm.learned[factor]).max() < 0.02
    assert first(hit, "drift") == [np.inf] * 3
