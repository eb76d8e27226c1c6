"""Tables of errors on left-out rows, as `judge_laws` returns them."""

from collections.abc import Mapping, Sequence

import numpy as np

from hesr_model.inference.left_out import LeftOutErrors
from hesr_model.support.arrays import Array, Mask

RATE = 100.0  # [Hz]
FOLDS = 5


def make_errors(
    errors: Mapping[str, Sequence[Array]],
    *,
    tau: Sequence[Array] | None = None,
    log_names: Sequence[str] | None = None,
    counts: Mask | None = None,
    failed: Mapping[str, str] | None = None,
) -> LeftOutErrors:
    """Return the table of errors by law and log, (N,) of one joint or (N, n).

    Blocks of time are the folds, over all logs. Friction is 10 N.m either way if not given.
    """
    columns = {
        law_name: tuple(np.reshape(log_errors, (len(log_errors), -1)) for log_errors in law_errors)
        for law_name, law_errors in errors.items()
    }
    first_errors = next(iter(columns.values()))
    joint_count = first_errors[0].shape[1]
    row_counts = [len(log_errors) for log_errors in first_errors]
    fold_of_all = np.arange(sum(row_counts)) * FOLDS // sum(row_counts)
    measured = [np.tile([10.0, -10.0], rows)[:rows] for rows in row_counts] if tau is None else tau
    return LeftOutErrors(
        joints=tuple(f"j{j + 1}" for j in range(joint_count)),
        t=tuple(np.arange(rows) / RATE for rows in row_counts),
        log_names=tuple(log_names or [f"log{k}" for k in range(len(row_counts))]),
        fold_of_row=tuple(np.split(fold_of_all, np.cumsum(row_counts)[:-1])),
        errors=columns,
        joint_errors=columns,
        tau=tuple(np.tile(column[:, None], joint_count) for column in measured),
        dq=tuple(np.tile(np.sign(column[:, None]), joint_count) for column in measured),
        tau_load=tuple(np.zeros((rows, joint_count)) for rows in row_counts),
        counts=np.ones((FOLDS, joint_count), dtype=bool) if counts is None else counts,
        failed=failed or {},
    )
