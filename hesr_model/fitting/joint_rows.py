"""Rows of all records of one joint, and linear least squares on them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hesr_model.equations.functions import lowered
from hesr_model.equations.recurrence import recurrence
from hesr_model.errors import FitError
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import SETTLING
from hesr_model.inference.covariance import blocks_of_time
from hesr_model.rigid_body.residual import FrictionRecord, require_reversals
from hesr_model.support.arrays import Array, Integers, Mask


@dataclass(frozen=True, kw_only=True)
class JointRows:
    """Rows of several records of one joint in sequence."""

    dt: Array  # (N,) [s] since the previous row, 0 at the first of a record
    begins: Mask  # (N,) at the first row of a record
    record: Integers  # (N,) index of the log; of the record for a single log
    dq: Array
    q: Array
    tau_load: Array
    tau: Array
    gear_ratio: float | None = None  # turns of the motor per turn of the joint
    sliding: bool = False  # in m and N

    @property
    def folds(self) -> "list[Mask]":
        """(N,) masks of the rows left out in turn: logs, or blocks of time of a single log."""
        group = blocks_of_time(self.record)
        return [np.asarray(group == k) for k in range(int(group.max()) + 1)]

    @classmethod
    def of(cls, records: Sequence[FrictionRecord], *, coefficients: int) -> "JointRows":
        """Join the records of one joint; raises FitError or LogError if they do not suffice."""
        rows = sum(len(r.t) for r in records)
        joint = records[0].joint if records else "?"
        if rows < coefficients:
            raise FitError(
                f"joint '{joint}': {rows} rows for {coefficients} coefficients; more data needed."
            )
        require_reversals(records)
        begins = np.concatenate([np.arange(len(r.t)) == 0 for r in records])
        logs = log_of_rows(records)
        names = ("dq", "q", "tau_load", "tau")
        return cls(
            dt=np.concatenate([np.diff(r.t, prepend=r.t[0]) for r in records]),
            begins=begins,
            record=logs if logs.any() else np.cumsum(begins) - 1,
            gear_ratio=records[0].gear_ratio,
            sliding=records[0].sliding,
            **{n: np.concatenate([getattr(r, n) for r in records]) for n in names},
        )

    @cached_property
    def settling(self) -> Array:
        """(N,) share of the steady state in the initial state; used at first rows only."""
        return np.asarray(_settling(self.dq)[0])

    def recurrence(self, a: Array, c: Array, steady: Array) -> Array:
        """Solve x[k] = a[k] x[k-1] + c[k] (N,) along records that start from `steady` (N,)."""
        c = np.where(self.begins, self.settling * steady, c)
        return recurrence(np.where(self.begins, 0.0, a), c, float(c[0]))


_settling = lowered((DQ,), (SETTLING,))


def log_of_rows(records: Sequence[FrictionRecord]) -> Integers:
    """Return the (N,) index of each row's log."""
    logs = list(dict.fromkeys(r.log for r in records))
    return np.repeat([logs.index(r.log) for r in records], [len(r.t) for r in records])


def in_one_piece(rows: Mask) -> Mask | slice:
    """Return a mask (N,) as a slice if its rows are consecutive; slices do not copy."""
    at = np.flatnonzero(rows)
    whole = len(at) and at[-1] - at[0] + 1 == len(at)
    return slice(int(at[0]), int(at[-1]) + 1) if whole else rows


def least_squares(columns: Array, target: Array) -> Array:
    """Return the (K,) coefficients of least norm for (N, K) columns and a target."""
    return np.asarray(np.linalg.lstsq(columns, target)[0], dtype=np.float64)


def non_negative_least_squares(
    columns: Array, target: Array, *, non_negative: int
) -> tuple[Array, float]:
    """Return (K,) coefficients, the leading ones non-negative, and the sum of squared residuals.

    Negative ones are set to zero one by one, the worst first: exact for nearly orthogonal columns.
    """
    gram, moment = columns.T @ columns, columns.T @ target
    scale = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    active = np.arange(columns.shape[1])
    while True:
        part = gram[np.ix_(active, active)] / np.outer(scale[active], scale[active])
        solution = np.zeros(columns.shape[1])
        solution[active] = np.linalg.lstsq(part, moment[active] / scale[active])[0] / scale[active]
        bounded = solution[:non_negative] * scale[:non_negative]
        if bounded.min(initial=0.0) >= 0.0:
            return solution, float(target @ target - moment @ solution)
        active = active[active != int(np.argmin(bounded))]
