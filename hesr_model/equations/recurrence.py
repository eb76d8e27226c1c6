"""First-order recurrences over whole logs."""

import numpy as np
import scipy

from hesr_model.support.arrays import Array


def recurrence(a: Array, c: Array, start: float) -> Array:
    """Solve x[0] = start, x[k] = a[k] x[k-1] + c[k], (N,), by LAPACK's banded substitution."""
    bands = np.empty((2, len(a)), order="F")
    bands[0] = 1.0
    bands[1, :-1] = -a[1:]
    bands[1, -1] = 0.0
    right_side = np.array(c, dtype=float)
    right_side[0] = start
    solution, _ = scipy.linalg.lapack.dtbtrs(bands, right_side[:, None], uplo="L", diag="U")
    return np.asarray(solution[:, 0])
