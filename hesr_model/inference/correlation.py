"""Autocorrelation of residuals."""

import numpy as np

from hesr_model.support.arrays import Array


def standard_errors(jacobian: Array, residual: Array) -> Array:
    """Return the (P,) standard errors of a least-squares solution, in the unknowns' units."""
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-150)
    _, s, vt = np.linalg.svd(np.linalg.qr(jacobian / scale, mode="r"))
    spread = np.sqrt(np.sum((vt.T / np.maximum(s, 1e-13 * s[0])) ** 2, axis=1)) / scale
    rows, parameters = jacobian.shape
    variance = float(residual @ residual) / max(rows - parameters, 1)
    return np.asarray(spread * np.sqrt(variance * correlation_length(residual)))


def correlation_length(residual: Array) -> float:
    """Return the integrated autocorrelation [rows] of a residual (N,) up to its first zero."""
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
