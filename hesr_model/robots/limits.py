"""Limits of joints in a model file, and of leaders by the joints that follow them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hesr_model.robots.urdf import UNLIMITED
from hesr_model.support.arrays import Array, Mask


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
