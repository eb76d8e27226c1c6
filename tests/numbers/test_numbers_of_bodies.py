"""Rigid bodies, payloads and torque constants from noisy motions of the arm."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from joint_data import law as made
from unchanged import Unchanged

from hesr_model.fitting.fit import fit_models
from hesr_model.friction.predict import predict
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.motions.excitation import ExcitationSettings, design
from hesr_model.motions.limits import MotionLimits
from hesr_model.rigid_body.accumulation import StreamedProblem
from hesr_model.rigid_body.identification import Method, Weighting, identify, identify_motions
from hesr_model.rigid_body.observations import match_motions
from hesr_model.rigid_body.payload import add_payload, identify_payload_motions
from hesr_model.rigid_body.refinement import identify_again
from hesr_model.rigid_body.residual import friction_records, transform_all_records
from hesr_model.rigid_body.torque_constants import point_payload, torque_constants
from hesr_model.robots.robot import Robot

MakeMotion = Callable[..., Motion]

LUGRE = made(
    "lugre", {}, sigma_0=600.0, sigma_1=0.5, sigma_2=4.0, F_c=6.0, F_s=9.0, v_s=0.15, tau_0=0.5
)


def noisy(motion: Motion, seed: int, size: float = 0.2) -> Motion:
    noise = np.random.default_rng(seed).standard_normal(motion.tau.shape)
    return replace(motion, tau=motion.tau + size * noise * [1.0, 2.0, 0.5])


@pytest.fixture
def motions(make_motion: MakeMotion) -> list[Motion]:
    return [
        noisy(make_motion(name=f"log{k}", seconds=3.0 + 2 * k, friction=2.0), k) for k in range(3)
    ]


def as_log(motion: Motion) -> Log:
    friction = [
        predict(LUGRE, t=motion.t, dq=motion.dq[:, k], tau_load=motion.tau[:, k]) for k in range(3)
    ]
    tau = motion.tau + np.column_stack(friction)
    return Log(name=motion.name, t=motion.t, q=motion.q, dq=motion.dq, tau=tau)


@pytest.mark.parametrize("weighting", ["wls", "ols"])
@pytest.mark.parametrize("physical", [False, True])
def test_stacked(
    motions: list[Motion],
    arm_model: Robot,
    weighting: Weighting,
    physical: bool,
    unchanged: Unchanged,
) -> None:
    unchanged(
        identify_motions(motions, arm_model, weighting=weighting, physical=physical),
        rtol=1e-4 if physical else 1e-6,
    )


@pytest.mark.parametrize("method", ["stacked", "paper"])
def test_with_reversed_logs(
    make_motion: MakeMotion, arm_model: Robot, method: Method, unchanged: Unchanged
) -> None:
    forward = noisy(make_motion(name="run", seconds=5.0, friction=2.0), 1)
    backward = noisy(make_motion(name="back", seconds=5.0, friction=2.0, reverse=True), 2)
    body = identify_motions([forward], arm_model, method=method, reversed_motions=[backward])
    there, back = match_motions(forward, backward)
    unchanged({"body": body, "pair": {"forward": there, "backward": back}})


def test_streamed(motions: list[Motion], arm_model: Robot, unchanged: Unchanged) -> None:
    stream = StreamedProblem(arm_model)
    for motion in motions:
        stream.add(motion)
    unchanged({"slow": stream.min_speeds, "body": stream.body(motions, "the logs")})


def test_refined_by_a_law(make_motion: MakeMotion, arm_model: Robot, unchanged: Unchanged) -> None:
    logs = [as_log(noisy(make_motion(name=f"log{k}", seconds=6.0), k)) for k in range(2)]
    body = identify(logs, arm_model)
    records = [friction_records(log, arm_model, body) for log in logs]
    by_joint = [list(of_joint) for of_joint in zip(*records, strict=True)]
    model = fit_models(["lugre"], by_joint, robot="arm", seed=0, workers=1)["lugre"]
    again = identify_again(logs, arm_model, body, model)
    unchanged(
        {
            "body": body,
            "records": transform_all_records(by_joint),
            "laws": model.laws,
            "again": again,
        },
        rtol=1e-2,
    )


def test_a_payload(motions: list[Motion], arm_model: Robot, unchanged: Unchanged) -> None:
    unloaded = identify_motions(motions, arm_model)
    columns = [arm_model.regressor(m.q, m.dq, m.ddq)[:, :, 20:30] for m in motions]
    carried = point_payload(4.0, (0.08, -0.04, 0.06))
    under = [replace(m, tau=m.tau + own @ carried) for m, own in zip(motions, columns, strict=True)]
    payload = identify_payload_motions(under, arm_model, unloaded)
    unchanged({"payload": payload, "loaded": add_payload(unloaded, payload, arm_model)}, rtol=1e-5)


def test_torque_constants(motions: list[Motion], arm_model: Robot, unchanged: Unchanged) -> None:
    assumed = [10.0, 20.0, 5.0]
    alone = torque_constants(motions, arm_model, assumed, mass_error=0.05)
    payload = point_payload(2.0, (0.05, 0.0, 0.1))
    under = [
        replace(m, tau=m.tau + arm_model.regressor(m.q, m.dq, m.ddq)[:, :, 20:30] @ payload)
        for m in motions
    ]
    known = torque_constants(
        motions, arm_model, assumed, mass_error=0.3, loaded=under, payload=payload
    )
    unchanged({"alone": alone, "known": known}, rtol=1e-5)


def test_an_exciting_motion(arm_model: Robot, unchanged: Unchanged) -> None:
    settings = ExcitationSettings(
        starts=2, harmonics=3, limits=MotionLimits(velocity=(2.0, 2.0, 2.0))
    )
    found = design(arm_model, settings)
    unchanged(
        {"condition": found.condition, "peak": found.peak_torque, "limits": found.limits},
        rtol=1e-2,
    )
