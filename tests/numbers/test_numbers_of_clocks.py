"""Timing checks: torque lag and time-stamp rate."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from limits_found import said
from pytest_regressions.data_regression import DataRegressionFixture
from unchanged import Unchanged

from hesr_model.health.evidence import (
    SmoothPart,
    smooth_parts,
)
from hesr_model.health.examine import add_log_name
from hesr_model.health.referee import state
from hesr_model.health.timing import (
    LagRows,
    _compute_friction_shapes,
    _doubt_rate,
    _project_out,
    check_clocks,
    estimate_delays,
    estimate_stamp_rate,
)
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.transmission import Transmission

MakeMotion = Callable[..., Motion]
COUPLED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.5, 1.0))


def late(values: np.ndarray, rows: int) -> np.ndarray:
    """Values delayed by the given number of rows, or advanced."""
    return values[np.clip(np.arange(len(values)) - rows, 0, len(values) - 1)]


def part_of(log: Log) -> SmoothPart:
    (part,) = smooth_parts(log, 15.0)
    return part


def test_clocks(
    log: Log,
    arm: RobotDescription,
    arm_model: Robot,
    unchanged: Unchanged,
    data_regression: DataRegressionFixture,
) -> None:
    base = base_columns(arm_model)
    part = part_of(log)
    rows = LagRows.from_log(log, arm_model, base)
    coupled = Robot(
        RobotDescription(
            **{**dict(arm), "transmission": Transmission(matrix=COUPLED, logs="motor")}
        )
    )
    every = [0, 1, 2]

    def moved(*shifts: int) -> SmoothPart:
        tau = np.column_stack([late(log.tau[:, j], k) for j, k in enumerate(shifts)])
        return part_of(replace(log, tau=tau))

    def told(own: SmoothPart, joints: list[int] = every) -> list[str]:
        return said(state(add_log_name(own.log, check_clocks(own, joints, arm_model)[0])))

    def slowed(rate: float) -> SmoothPart:
        own = replace(log, t=rate * log.t, dq=None)
        return part_of(own)

    short = part_of(log.rows(slice(0, 300)))
    noisy = replace(log, tau=log.tau + 5.0 * np.random.default_rng(1).normal(size=log.tau.shape))
    unchanged(
        {
            "rows": rows,
            "coupled": LagRows.from_log(log, coupled, base),
            "delays": [
                [estimate_delays(LagRows.from_log(moved(k, k, k).log, arm_model, base), j)[kind]
                 for k in (-12, 0, 9, 20)]
                for j in every for kind in range(2)
            ],
            "rates": [estimate_stamp_rate(LagRows.from_log(x, arm_model, base), every)
                      for x in (log, slowed(1.5).log, slowed(0.6).log, noisy)],
            "rate of one": estimate_stamp_rate(rows, [1]),
            "short": estimate_stamp_rate(LagRows.from_log(short.log, arm_model, base), every),
            "rubs": _compute_friction_shapes(part.q[:, 0], part.v[:, 0]),
            "rubs backwards": _compute_friction_shapes(-part.q[:, 0], -part.v[:, 0])[:3],
            "beside": _project_out(
                np.column_stack([part.q, part.q[:, :1], 1e-12 * part.v]), part.tau
            ),
            "beside nothing": _project_out(0.0 * part.q, part.tau)[:5],
        },
        rtol=1e-3,
    )  # fmt: skip
    data_regression.check(
        {
            "sound": told(part),
            **{
                f"late by {', '.join(map(str, x))}": told(moved(*x))
                for x in ((18, 18, 18), (6, 6, 6), (-18, -18, -18), (0, 18, 0),
                          (0, 30, 0), (0, 49, 0), (30, 30, 0), (0, 60, 0))
            },
            "one joint alone": told(moved(0, 30, 0), [1]),
            "one joint alone, a little": told(moved(0, 10, 0), [1]),
            "not that joint": told(moved(0, 30, 0), [0]),
            "no joint": told(moved(0, 30, 0), []),
            "too short": told(part_of(log.rows(slice(0, 400)))),
            "long enough": told(part_of(moved(30, 30, 30).log.rows(slice(0, 402)))),
            "slowed": told(slowed(1.5)),
            "hurried": told(slowed(0.6)),
            "hardly slowed": told(slowed(1.2)),
            "rates": said(state(add_log_name(log, [_doubt_rate(x, 36.0) for x in (0.5, 1.7)]))),
        }
    )  # fmt: skip


def test_few_rows_determine_no_delay() -> None:
    bodies = np.ones((5, 1, 2))
    rows = LagRows(
        torques=np.zeros((5, 3, 1)),
        static=bodies,
        inertial=bodies,
        friction_shapes=(np.zeros((5, 40)),),
        is_known=np.ones((5, 1), dtype=bool),
    )
    assert [(one.value, one.error) for one in estimate_delays(rows, 0)] == [(0.0, np.inf)] * 2
