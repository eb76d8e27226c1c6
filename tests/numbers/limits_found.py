"""Thresholds of checks, found by bisection, and the full text of findings."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from hesr_model.findings import Finding
from hesr_model.health.evidence import Motionwise
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import RobotDescription

TWO = RobotDescription(name="two", model=Path("two.urdf"), joints=("a", "b"))
"""Description of two joints, for tests that need no model."""


def edge(
    speaks: Callable[[float], object], low: float, high: float, steps: int = 24
) -> list[float]:
    """Return the threshold of a check, and 1 if it reports above it, 0 if below."""
    at_low = bool(speaks(low))
    assert at_low != bool(speaks(high)), "it says the same at both ends"
    for _ in range(steps):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if bool(speaks(middle)) == at_low else (low, middle)
    return [0.5 * (low + high), 0.0 if at_low else 1.0]


def said(findings: Iterable[Finding], check: str = "") -> list[str]:
    """Return the full content of each finding in one line."""
    return [
        f"{f.check}, {f.severity}, {list(f.joints)}, {list(f.logs)}: {f.found} | {f.remedy} | "
        + ", ".join(f"{key} = {_short(value)}" for key, value in f.changes.items())
        for f in findings
        if check in ("", f.check)
    ]


def _short(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_short, value))}]"
    return f"{value:.4g}" if isinstance(value, float) else repr(value)


def two_joints(rows: int = 1000, period: float = 0.01) -> Log:
    """Return a log of two joints on sines with distinct torques."""
    t = period * np.arange(rows)
    q = np.column_stack([np.sin(t), 0.5 * np.cos(0.7 * t)])
    dq = np.column_stack([np.cos(t), -0.35 * np.sin(0.7 * t)])
    tau = np.random.default_rng(0).normal(size=q.shape)
    return Log(name="run", t=t, q=q, dq=dq, tau=tau)


def at(values: np.ndarray | None, rows: object, joint: int, value: object) -> np.ndarray:
    """Return a copy with other values in some rows of one joint."""
    assert values is not None
    changed = values.copy()
    changed[rows, joint] = value
    return changed


def as_part(log: Log, **more: np.ndarray | None) -> Motionwise:
    """Return a log as a part ready for the checks, without low-pass filtering."""
    assert log.dq is not None
    own = Motionwise(log=log, t=log.t, q=log.q, v=log.dq, a=0.0 * log.q, dq=log.dq, tau=log.tau)
    return replace(own, **more)
