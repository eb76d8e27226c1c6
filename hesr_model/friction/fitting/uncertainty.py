"""How well data determine the coefficients of a law: linearised least squares (LM covariance).

Neighbouring rows of a log do not err independently, so the variance of the coefficients is that of
independent rows times the integrated autocorrelation of the residual.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hesr_model.equations.over_log import Array
from hesr_model.friction.evaluate import predict
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.records import record_start
from hesr_model.rigid_body.residual import FrictionRecord

MOST_COEFFICIENTS = 64
"""Laws with more coefficients are networks, whose single coefficients mean nothing."""
_STEP = 1e-6
_NONE = 1e-12  # a derivative below this is rounding


def with_standard_errors(law: FrictionLaw, records: Sequence[FrictionRecord]) -> FrictionLaw:
    """Return the law with the standard error of every coefficient that the records determine.

    Derivatives are central differences of the law's own prediction. Coefficients on which the
    torque does not depend at all have no standard error.

    Parameters
    ----------
    law : the law of one joint.
    records : those that it was fitted to.
    """
    if len(law.values) > MOST_COEFFICIENTS:
        return law
    names, columns = [], []
    # Where a log starts is held: it is measured, and no coefficient.
    starts = [record_start(law, r) for r in records]
    for name, value in law.values.items():
        step = _STEP * max(abs(value), 1e-3)
        if value:  # laws divide by some of their coefficients, so none may become zero
            step = min(step, 0.5 * abs(value))
        sides = [_predicted(_moved(law, name, value + d), records, starts) for d in (step, -step)]
        column = (sides[0] - sides[1]) / (2.0 * step)
        if np.abs(column).max() > _NONE:
            names.append(name)
            columns.append(column)
    predicted = _predicted(law, records, starts)
    residual = predicted - np.concatenate([r.tau for r in records])
    errors = standard_errors(np.stack(columns, axis=1), residual)
    return replace(law, standard_errors=dict(zip(names, map(float, errors), strict=True)))


def standard_errors(jacobian: Array, residual: Array) -> Array:
    """Return the (P,) standard errors of a least-squares solution, in the unknowns' units.

    Parameters
    ----------
    jacobian : (N, P) derivatives of the residual.
    residual : (N,) at the solution.
    """
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-150)
    _, s, vt = np.linalg.svd(np.linalg.qr(jacobian / scale, mode="r"))
    spread = np.sqrt(np.sum((vt.T / np.maximum(s, 1e-13 * s[0])) ** 2, axis=1)) / scale
    rows, parameters = jacobian.shape
    variance = float(residual @ residual) / max(rows - parameters, 1)
    return np.asarray(spread * np.sqrt(variance * correlation_length(residual)))


def correlation_length(residual: Array) -> float:
    """Integrated autocorrelation of a residual (N,), in rows whatever the residual's unit.

    At least 1; cut at the first crossing.
    """
    centred = residual - residual.mean()
    size = 2 ** int(np.ceil(np.log2(2 * len(centred))))
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum)[: len(centred) // 4]
    if correlation[0] <= 0.0:
        return 1.0
    correlation = correlation / correlation[0]
    negative = np.flatnonzero(correlation <= 0.0)
    stop = int(negative[0]) if len(negative) else len(correlation)
    return float(max(1.0, 1.0 + 2.0 * correlation[1:stop].sum()))


def _predicted(
    law: FrictionLaw, records: Sequence[FrictionRecord], starts: Sequence[tuple[float, ...]]
) -> Array:
    parts = [
        predict(law, t=r.t, dq=r.dq, q=r.q, tau_load=r.tau_load, start=start)
        for r, start in zip(records, starts, strict=True)
    ]
    return np.concatenate(parts)


def _moved(law: FrictionLaw, name: str, value: float) -> FrictionLaw:
    return replace(law, values={**law.values, name: value})
