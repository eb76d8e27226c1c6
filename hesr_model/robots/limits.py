"""Limits of joints in a model file, of leaders by their followers, and doubts about a model."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.findings import Finding, Severity
from hesr_model.robots.urdf import UNLIMITED
from hesr_model.support.arrays import Array, Mask


def doubts_of_model(path: Path, model: Any) -> Iterator[Finding]:
    """Yield doubts about single joints of a model file."""
    urdf = path.suffix.lower() != ".xml"
    for name, joint, link in list(zip(model.names, model.joints, model.inertias, strict=True))[1:]:
        if joint.nv != 1:
            found = "has several degrees of freedom and is held at its reference position"
            yield _doubt("held-joint", path, name, found, "leave it out if it moves", "advice")
            continue
        low, high = position_limits(model, joint, valid=False)
        if urdf and not link.mass > 0.0:
            needs = "give the link an <inertial> if it is a real part"
            yield _doubt("massless-link", path, name, "its link has no mass", needs)
        if urdf and link.mass > 0.0 and not np.any(link.inertia):
            found = f"its link of {link.mass:.3g} kg has no inertia, as if it was rounded"
            yield _doubt("rounded-inertia", path, name, found, "write more digits of its <inertia>")
        if joint.nq != 1 or not np.isfinite(low + high):
            if joint.nq == 1 and urdf:
                needs = "state them in its <limit>; hesr excite needs them"
                yield _doubt("no-limits", path, name, "has no limits", needs, "advice")
        elif low >= high:
            way = "equal" if low == high else "reversed"
            found = f"its position limits are {way}, {low:g} and {high:g}, and count as none"
            yield _doubt("odd-limits", path, name, found, "correct its limits")
        elif 4 * np.pi < max(-low, high) <= 720.0 and "JointModelP" not in joint.shortname():
            found = f"its limits {low:g} and {high:g} rad look like degrees"
            yield _doubt("odd-limits", path, name, found, "write radians")


def doubts_of_chain(
    path: Path, joints: Sequence[str], masses: Array, bare: Mask, sprung: Iterable[str]
) -> Iterator[Finding]:
    """Yield doubts about mass matrices (N, n, n) [kg.m2; kg] and joints without a range (n,).

    Joints in `sprung` have a spring in the model file that the robot lacks.
    """
    for name in sprung:
        found = "has a spring, which its torque leaves out"
        yield _doubt("no-spring", path, name, found, "list it in 'springs' of the robot file")
    least = np.diagonal(masses, axis1=1, axis2=2).min(axis=0)
    for j in np.flatnonzero(least <= 1e-12 * np.abs(masses).max()).tolist():
        found = (
            f"moves an inertia of {least[j]:.3g} kg.m2 (kg if it slides), which makes its torques "
            "meaningless"
        )
        remedy = "correct the <inertial> of the links after it"
        yield _doubt("no-inertia", path, joints[j], found, remedy, "error")
    for j in np.flatnonzero(bare).tolist():
        found = "joints that follow it leave it no range, and their limits count as none"
        remedy = "correct their limits or their <mimic> or equality"
        yield _doubt("odd-limits", path, joints[j], found, remedy)


def _doubt(
    check: str, path: Path, joint: str, found: str, remedy: str, severity: Severity = "warning"
) -> Finding:
    return Finding(
        check=check, severity=severity, where=str(path), joints=(joint,), found=found, remedy=remedy
    )


def position_limits(model: Any, joint: Any, *, valid: bool = True) -> tuple[float, float]:
    """Return the position limits, infinite if absent or, if `valid`, equal or reversed."""
    low = float(model.lowerPositionLimit[joint.idx_q]) if joint.nq == 1 else -np.inf
    high = float(model.upperPositionLimit[joint.idx_q]) if joint.nq == 1 else np.inf
    low, high = (low if low > -UNLIMITED else -np.inf), (high if high < UNLIMITED else np.inf)
    return (-np.inf, np.inf) if valid and not low < high else (low, high)


def chain_limits(
    model: Any, own: Sequence[int], follow: tuple[Array, Array] | None
) -> tuple[Array, Array, Array, Mask]:
    """Return lowest and highest position [rad or m] and highest speed (n,) of the joints `own`.

    `follow` is G and b of q_all = G q + b. Joints that follow a leader also limit it, unless they
    leave it no range: there the mask (n,) is true.
    """
    joints, n = list(model.joints)[1:], len(own)
    ranges = np.array([position_limits(model, joint) for joint in joints])
    speeds = np.array([float(model.velocityLimit[joint.idx_v]) for joint in joints])
    speeds = np.where((speeds > 0.0) & (speeds < UNLIMITED), speeds, np.inf)
    slopes, offsets = follow or (np.eye(n), np.zeros(n))
    moved = slopes != 0.0
    scale = np.where(moved, slopes, 1.0)
    ends = np.sort((ranges.T - offsets)[:, :, None] / scale, axis=0)
    lower = np.where(moved, ends[0], -np.inf).max(axis=0)
    upper = np.where(moved, ends[1], np.inf).min(axis=0)
    bare, alone = lower >= upper, ranges[np.array(own) - 1].T
    lower, upper = np.where(bare, alone, [lower, upper])
    speed = np.where(moved, speeds[:, None] / np.abs(scale), np.inf).min(axis=0)
    return lower, upper, speed, bare
