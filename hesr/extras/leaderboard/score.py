"""Torque errors over all joints of a robot, with confidence intervals.

One bootstrap draws the same times for all joints, since their errors are correlated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hesr.extras.leaderboard.board_file import Ground, Kind
from hesr_model.friction.metrics import rmse, rmse_ratio_interval
from hesr_model.logs.phases import moving, near_reversals
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array, Mask

_DRAWS = 20_000
_LEVEL = 0.95


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A dimensionless value with a bootstrap interval."""

    value: float
    low: float
    high: float


class Judge:
    """Scores torques on the logs of a robot; `tau_std` (n,) is that of measured friction [N.m]."""

    def __init__(self, ground: Ground, *, warm_up: float, block: float) -> None:
        parts = ground.records
        self._rows = [part[0].t - part[0].t[0] >= warm_up for part in parts]
        self._tau = [
            np.column_stack([r.tau for r in part])[rows]
            for part, rows in zip(parts, self._rows, strict=True)
        ]
        self.tau_std: Array = np.vstack(self._tau).std(axis=0)
        self._block = max(1, round(block / float(np.median(np.diff(parts[0][0].t)))))
        kinds = [_kinds(part, rows) for part, rows in zip(parts, self._rows, strict=True)]
        self._masks: Mapping[Kind, list[Mask]] = {
            kind: [of_part[kind] for of_part in kinds] for kind in kinds[0]
        }

    def errors(self, torques: Sequence[Array]) -> list[Array]:
        """Return torque errors (N, n) [N.m] per part, on scored rows."""
        pairs = zip(torques, self._rows, self._tau, strict=True)
        return [torque[rows] - tau for torque, rows, tau in pairs]

    def by_joint(self, errors: Sequence[Array], kind: Kind) -> tuple[float | None, ...]:
        """Return the RMSE by joint [N.m] on rows of a kind; None without rows."""
        error, mask = np.vstack(errors), np.vstack(self._masks[kind])
        return tuple(
            rmse(error[rows, j]) if np.any(rows) else None for j, rows in enumerate(mask.T)
        )

    def relative(self, errors: Sequence[Array], kind: Kind) -> Interval | None:
        """Return the error over the size of friction; None without scored rows."""
        counts = [np.sqrt(mask.sum(axis=1)) for mask in self._masks[kind]]
        if not any(map(np.any, counts)):
            return None
        return self._interval(self._sizes(errors, kind), counts, _LEVEL)

    def ratio(self, errors: Sequence[Array], below: Sequence[Array], compared: int) -> Interval:
        """Return the ratio of two errors, simultaneous for `compared` ones (Bonferroni)."""
        level = 1.0 - (1.0 - _LEVEL) / max(1, compared)
        return self._interval(self._sizes(errors, "all"), self._sizes(below, "all"), level)

    def _sizes(self, errors: Sequence[Array], kind: Kind) -> list[Array]:
        return [
            np.sqrt(np.sum(mask * np.square(error / self.tau_std), axis=1))
            for error, mask in zip(errors, self._masks[kind], strict=True)
        ]

    def _interval(self, above: list[Array], below: list[Array], level: float) -> Interval:
        low, high = rmse_ratio_interval(
            above,
            below,
            block=self._block,
            rng=np.random.default_rng(0),
            resamples=_DRAWS,
            level=level,
        )
        value = rmse(np.concatenate(above)) / rmse(np.concatenate(below))
        return Interval(value=value, low=low, high=high)


def _kinds(part: Sequence[FrictionRecord], rows: Mask) -> dict[Kind, Mask]:
    fast = np.column_stack([moving(r.dq) for r in part])[rows]
    near = np.column_stack([near_reversals(r.t, r.dq) for r in part])[rows]
    return {"all": np.ones_like(fast), "moving": fast, "reversals": near, "rests": ~fast}
