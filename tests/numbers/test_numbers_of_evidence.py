"""Explanations of torques, and the cost of lost rows."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from faulty_logs import at, two_joints
from limits_found import edge, said
from pytest_regressions.data_regression import DataRegressionFixture
from unchanged import Unchanged

from hesr_model.health.evidence import (
    ModelTorques,
    SmoothPart,
    fit_joint_torque,
    friction_shape,
    smooth_parts,
    to_logged_side,
)
from hesr_model.health.examine import add_log_name
from hesr_model.health.positions import _estimate_sliding_torque, check_loss
from hesr_model.health.referee import Estimate, state
from hesr_model.health.torque import fit_joint_torques
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import Coupling

MakeMotion = Callable[..., Motion]
COUPLED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.5, 1.0))


def part_of(log: Log) -> SmoothPart:
    (part,) = smooth_parts(log, 15.0)
    return replace(part, resting_travel=5e-3, resting_speeds=0.02)


def test_explanations_of_a_torque(unchanged: Unchanged) -> None:
    t = np.linspace(0.0, 9.0, 800)
    v, gravity, inertial = np.cos(t) + 0.4 * np.sin(2.7 * t), np.sin(t), np.sin(3.1 * t + 0.4)
    noise = 0.2 * np.random.default_rng(1).normal(size=len(t))
    tau = 2.0 * gravity + 0.7 * inertial + 0.3 * friction_shape(v) + 1.5 + noise
    nothing = 0.0 * t
    unchanged(
        {
            "whole": (whole := fit_joint_torque(tau, gravity, inertial, v)),
            "r2": whole.r2,
            "bears": [
                edge(lambda x: replace(whole, residual=x).bears_gravity, 0.01, 9.0),
                edge(lambda x: replace(whole, gravity_size=x).bears_gravity, 0.0, 9.0),
                edge(
                    lambda x: (
                        replace(
                            whole, gravity=Estimate(value=0.5, error=0.01), residual=x
                        ).bears_gravity
                    ),
                    0.01,
                    9.0,
                ),
                edge(
                    lambda x: replace(whole, gravity_size=x, residual=1e-9).bears_gravity, 0, 1e-4
                ),
            ],
            "no gravity": fit_joint_torque(tau, nothing, inertial, v).friction,
            "no model": fit_joint_torque(tau, nothing, nothing, v).r2,
            "tiny gravity": [
                float(fit_joint_torque(tau, x * gravity, inertial, v).gravity.value)
                for x in (1e-13, 1e-12, 1e-11, 2e-9, 1e-8)
            ],
            "tiny all": [
                float(
                    fit_joint_torque(1e-5 * tau, x * gravity, x * inertial, 1e-9 * v).gravity.value
                )
                for x in (1e-13, 3e-12, 1e-9)
            ],
            "slow": friction_shape(0.01 * v),
            "at rest": friction_shape(nothing),
            "fast": friction_shape(5.0 * v),
            "knee": friction_shape(0.3 * v),
            "of one": Estimate(value=2.0, error=0.0).t / 1e300,
            "constant torque": fit_joint_torque(nothing, gravity, inertial, v).r2,
        },
        rtol=1e-5,
    )


def test_prepared_parts(log: Log, arm_model: Robot, unchanged: Unchanged) -> None:
    part = part_of(log)
    long = two_joints(9000)
    coupling = Coupling(COUPLED)
    torques = ModelTorques.from_motion(arm_model, part.q, part.v, part.a)
    resting = replace(part, q=part.q * [1.0, 1e-3, 1.0], v=part.v * [1.0, 1.0, 0.0])
    constant = replace(part, tau=at(part.tau, slice(None), 2, 1.0))
    flat = replace(part, tau=1e-3 * part.tau)
    gap = replace(log, t=log.t + 5.0 * (log.t > 2.0) + 5.0 * (log.t > 2.05))
    unchanged(
        {
            "part": part,
            "thinned": [len(part.thin(n).t) for n in (1, 999, 1000, 1001, 1999, 2000, 2001)],
            "long": [len(x.t) for x in smooth_parts(long, 15.0)],
            "parts": [len(x.t) for x in smooth_parts(gap, 5.0)],
            "moves": [part.is_moving, resting.is_moving, constant.is_moving],
            "least travel": edge(lambda x: replace(part, q=x * part.q).is_moving[0], 1e-4, 0.1),
            "least speed": edge(lambda x: replace(part, v=x * part.v).is_moving[0], 1e-4, 0.1),
            "torques": torques,
            "as logged": to_logged_side(part, torques, coupling),
            "explained": [
                list(fit_joint_torques(x, torques)) for x in (part, resting, constant, flat)
            ],
            "fits": fit_joint_torques(part, torques),
        },
        rtol=1e-5,
    )


def test_cost_of_lost_rows(
    log: Log,
    arm_model: Robot,
    unchanged: Unchanged,
    data_regression: DataRegressionFixture,
) -> None:
    def lost(share: float, noise: float = 0.0) -> Log:
        rng = np.random.default_rng(2)
        kept = log.rows(np.flatnonzero(rng.random(len(log.t)) >= share))
        return replace(kept, tau=kept.tau + noise * rng.normal(size=kept.tau.shape))

    def told(own: Log) -> list[str]:
        part = part_of(own)
        torques = ModelTorques.from_motion(arm_model, part.q, part.v, part.a)
        return said(state(add_log_name(part.log, check_loss(part, torques, arm_model))))

    part = part_of(lost(0.3, 1.0))
    torques = ModelTorques.from_motion(arm_model, part.q, part.v, part.a)
    unchanged(
        {
            "sliding": [_estimate_sliding_torque(part, torques, j) for j in range(3)],
            "noise": edge(lambda x: told(lost(0.3, x)), 0.0, 2.0, steps=12),
        },
        rtol=1e-4,
    )
    resting = replace(lost(0.3, 1.0), q=log.q[: len(lost(0.3).t)] * [1e-4, 1.0, 1e-4])
    nothing = replace(lost(0.3, 1.0), tau=at(lost(0.3, 1.0).tau, slice(None), 1, 2.0))
    data_regression.check(
        {
            "lost": told(lost(0.3, 1.0)),
            "much": told(lost(0.5, 30.0)),
            "none lost": told(replace(log, tau=log.tau + lost(0.0, 1.0).tau)),
            "two at rest": told(resting),
            "a constant torque": told(nothing),
        }
    )
