"""Logs of two joints, without a model, to be made faulty."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from hesr_model.health.evidence import SmoothPart, TorqueFit
from hesr_model.health.referee import Estimate
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import RobotDescription

TWO = RobotDescription(name="two", model=Path("two.urdf"), joints=("a", "b"))
"""Description of two joints, for tests that need no model."""

SOUND_TORQUE = TorqueFit(
    gravity=Estimate(value=1.0, error=0.01),
    inertia=Estimate(value=1.2, error=0.02),
    friction=Estimate(value=0.5, error=0.01),
    gravity_size=5.0,
    friction_size=0.6,
    residual=0.3,
    deviation=5.0,
)
"""What explains a torque without any finding."""


def two_joints(rows: int = 1000, period: float = 0.01) -> Log:
    """Return a log of two joints on sines with distinct torques."""
    t = period * np.arange(rows)
    q = np.column_stack([np.sin(t), 0.5 * np.cos(0.7 * t)])
    dq = np.column_stack([np.cos(t), -0.35 * np.sin(0.7 * t)])
    tau = np.random.default_rng(0).normal(size=q.shape)
    return Log(name="run", t=t, q=q, dq=dq, tau=tau, is_checked=True)  # or faulty


def at(values: np.ndarray | None, rows: object, joint: object, value: object) -> np.ndarray:
    """Return a copy with other values in some rows of one joint."""
    assert values is not None
    changed = values.copy()
    changed[rows, joint] = value
    return changed


def as_part(log: Log, **more: np.ndarray | None) -> SmoothPart:
    """Return a log as a part ready for the checks, without low-pass filtering."""
    assert log.dq is not None
    part = SmoothPart(log=log, t=log.t, q=log.q, v=log.dq, a=0.0 * log.q, dq=log.dq, tau=log.tau)
    return replace(part, **more)


def cut(*, breaks: tuple[int, ...], by: float = 0.5, rows: int = 1000) -> Log:
    """Return a log with gaps before some rows."""
    log = two_joints(rows)
    later = sum((np.arange(rows) >= row for row in breaks), np.zeros(rows))
    return replace(log, t=log.t + by * later)


def lossy(long_steps: int, *, by: float = 2.0) -> Log:
    """Return a log with some of its 1000 steps longer."""
    log = two_joints(1001)
    steps = np.full(1000, 0.01)
    steps[np.arange(long_steps) * 1000 // max(long_steps, 1)] *= by
    return replace(log, t=np.concatenate([[0.0], np.cumsum(steps)]))


def still(rows: int, *, period: float = 0.01, quantity: str = "q") -> Log:
    """Return a log whose first joint repeats one value of a signal some times."""
    log = two_joints(1000, period)
    values = at(getattr(log, quantity), slice(300, 301 + rows), 0, 0.123456)
    return replace(log, **{quantity: values})


def wave(
    rate: float = 3.0, late: float = 0.0, rows: int = 1200, period: float = 0.01
) -> np.ndarray:
    """Return velocities of two joints with several harmonics each."""
    t = period * np.arange(rows) - late
    a = np.sin(rate * t) + 0.5 * np.sin(2.3 * rate * t + 1.0)
    b = np.cos(1.3 * rate * t) - 0.4 * np.sin(2.9 * rate * t + 2.0)
    return np.column_stack([a, b])


def with_units(robot: RobotDescription, **log: object) -> RobotDescription:
    """Return a description with other units, gear ratios or torque constants of its log."""
    data = robot.model_dump()
    data["gear_ratio"] = log.pop("gear_ratio", data["gear_ratio"])
    data["log"]["torque_per_ampere"] = log.pop("torque_per_ampere", None)
    data["log"]["units"] |= log
    return RobotDescription.model_validate(data)
