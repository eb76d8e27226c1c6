"""Descriptions of one log tried against each other: which one lets motion explain the torque."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.health.evidence import ModelTorques, SmoothPart, find_rests, smooth_parts
from hesr_model.health.joints import apply_changes
from hesr_model.health.referee import LeftOutRows, Race, TrialOutcome
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array

ReadLogs = Callable[[RobotDescription], Sequence[Log]]
_MAX_ROWS = 2000  # per part


@dataclass(frozen=True, kw_only=True)
class TorqueTrial:
    """A description, and the squared errors of its torques on left-out rows.

    Attributes
    ----------
    changes : values by key of the robot file that distinguish the description.
    squares : (N,) summed over joints, each over the square of its torque's deviation.
    needs_friction : whether friction explains anything; torques of a controller have none.
    """

    changes: Mapping[str, Any]
    squares: Array
    needs_friction: bool

    def race(self, rival: "TorqueTrial") -> TrialOutcome:
        """Return whether the motion explains these torques better than those of a rival."""
        if not self.needs_friction:
            return "lost"
        row_count = min(len(self.squares), len(rival.squares))
        if not rival.needs_friction:
            return "won"
        return Race(
            rival="the other columns",
            rival_squares=rival.squares[:row_count],
            squares=self.squares[:row_count],
        ).outcome


def try_descriptions(
    description: RobotDescription,
    alternatives: Iterable[Mapping[str, Any]],
    read_logs: ReadLogs,
    *,
    has_model: bool,
) -> list[TorqueTrial]:
    """Return the trials of those alternatives, changes of a description, that can be read."""
    trials = []
    for changes in alternatives:
        changed = apply_changes(description, changes)
        parts: list[SmoothPart] = []
        try:
            for log in read_logs(changed):
                parts += smooth_parts(log, changed.log.filter_cutoff)
        except LogError:
            continue
        robot = None
        if has_model and changed.known is None:
            robot = Robot(changed)
        trials.append(_try_parts(find_rests(parts), robot, changes))
    return trials


def _try_parts(
    parts: Sequence[SmoothPart], robot: Robot | None, changes: Mapping[str, Any]
) -> TorqueTrial:
    thinned_parts = [part.thin(_MAX_ROWS) for part in parts]
    split = LeftOutRows.split(
        [part.log.name for part in thinned_parts], [part.t for part in thinned_parts]
    )
    squares = np.zeros(sum(len(part.t) for part in thinned_parts))
    squares_without_friction = np.zeros_like(squares)
    is_moving = np.any([part.is_moving for part in parts], axis=0)
    torques = [_compute_rigid_columns(part, robot) for part in thinned_parts]
    for j in np.flatnonzero(is_moving):
        tau = np.concatenate([part.tau[:, j] for part in thinned_parts])
        v = np.concatenate([part.v[:, j] for part in thinned_parts])
        rigid = np.concatenate([columns[:, :, j] for columns in torques])
        deviation = float(np.std(tau))
        if deviation == 0.0:
            squares += 1.0
            squares_without_friction += 1.0
            continue
        friction = _build_friction_columns(v)
        squares += (split.predict(np.hstack([rigid, friction]), tau) / deviation) ** 2
        squares_without_friction += (split.predict(rigid, tau) / deviation) ** 2
    friction_gain = Race(
        rival="no friction", rival_squares=squares_without_friction, squares=squares, min_gain=0.0
    )
    return TorqueTrial(
        changes=changes, squares=squares, needs_friction=friction_gain.outcome == "won"
    )


_KNEE_SHARE = 0.05  # speed, over the peak, up to which friction rises


def _build_friction_columns(v: Array) -> Array:
    """Return Coulomb and viscous friction (N, 2) over a velocity (N,)."""
    peak = float(np.max(np.abs(v))) or 1.0
    return np.column_stack([np.tanh(v / (_KNEE_SHARE * peak)), v / peak])


def _compute_rigid_columns(part: SmoothPart, robot: Robot | None) -> Array:
    """Return columns (N, K, n) of rigid-body torques: of the model, or of any body on each axis."""
    ones = np.ones_like(part.q)
    if robot is None:
        return np.stack([part.a, np.sin(part.q), np.cos(part.q), ones], axis=1)
    torques = ModelTorques.from_motion(robot, part.q, part.v, part.a)
    return np.stack([torques.gravity, torques.inertial, ones], axis=1)
