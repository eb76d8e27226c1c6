"""Covariance of least-squares estimates from logs, for rigid bodies and friction.

The error of an estimate is the sum of the influences of its rows, psi_t = H^-1 g_t, with the
gradient g_t of row t and the Hessian H of half the sum of squares:

    cov = factor^2 sum over logs S_log + carried,    S = long-run covariance of the influences.

S is prewhitened by a first-order autoregression and weighted by Bartlett's kernel (Andrews and
Monahan 1992). The factor is the additional spread of estimates with each log left out. With
`MIN_SCATTER_LOGS` logs the influences of whole logs are summed instead (cluster-robust, Liang and
Zeger 1986). `carried` is the covariance of earlier estimates.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from hesr_model.errors import ArtifactError
from hesr_model.support.arrays import Array, Integers
from hesr_model.support.typed_files import Numbers, to_json


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
    stop = len(correlation)
    if len(negative):
        stop = int(negative[0])
    return float(max(1.0, 1.0 + 2.0 * correlation[1:stop].sum()))


MIN_SCATTER_LOGS = 20  # minimum number of logs for a covariance from their scatter
BLOCKS = 4  # blocks of time that replace the logs of a single log
_MAX_AUTOREGRESSION = 0.995  # largest autoregression coefficient; above is a drift
_MAX_LEVERAGE = 0.9  # largest leverage: a row that determines an unknown alone has no residual
_UPPER_QUANTILE = 0.975  # upper end of a 95 % interval
_CHANCE_LEVEL = 0.05  # significance level of the difference between logs
_RANK_TOLERANCE = 1e-13  # relative rank tolerance of a scaled Hessian


@dataclass(frozen=True, kw_only=True, eq=False)
class Covariance:
    """Covariance of P unknowns of one least-squares problem.

    Attributes
    ----------
    names : of the unknowns.
    within : (P, P) from the rows of each log, in the unknowns' units.
    between : mean square difference between logs, relative to what `within` predicts.
    degrees : independent comparisons of logs; 0 without any.
    carried : (P, P) from earlier estimates.
    logs : number of logs, or of blocks of time of a single log.
    """

    names: tuple[str, ...]
    within: Numbers
    between: float
    degrees: float
    carried: Numbers
    logs: int = 1

    def __post_init__(self) -> None:
        shape = (len(self.names),) * 2
        for matrix in (self.within, self.carried):
            if matrix.shape != shape:
                raise ArtifactError(
                    f"a covariance has the shape {matrix.shape}; expected {shape}, that of its "
                    "names.",
                    code="body.covariance",
                    key="covariance",
                )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Covariance) and to_json(self) == to_json(other)

    __hash__ = None  # type: ignore[assignment]

    @property
    def factor(self) -> float:
        """Ratio of the scatter between logs to that of their rows; 1 if not significant."""
        if not self.degrees:
            return 1.0
        by_chance = scipy.special.chdtri(self.degrees, _CHANCE_LEVEL) / self.degrees
        if self.between > by_chance:
            return float(np.sqrt(self.between))
        return 1.0

    @property
    def matrix(self) -> Array:
        """(P, P) covariance, in the unknowns' units."""
        return np.asarray(self.factor**2 * self.within + self.carried)

    @property
    def of_another_log(self) -> Array:
        """(P, P) covariance of the unknowns of one more log, with the scatter between logs."""
        return np.asarray(self.matrix + self.logs * (self.factor**2 - 1.0) * self.within)

    @property
    def standard_errors(self) -> Array:
        """(P,) in the unknowns' units."""
        # Round-off of an exact fit may be negative.
        return np.sqrt(np.maximum(np.diag(self.matrix), 0.0))

    def transform(self, names: Sequence[str], slopes: Array) -> "Covariance":
        """Return the covariance of (Q,) functions with derivatives `slopes` (Q, P)."""
        return replace(
            self,
            names=tuple(names),
            within=slopes @ self.within @ slopes.T,
            carried=slopes @ self.carried @ slopes.T,
        )


def pool_covariances(covariances: Sequence[Covariance]) -> list[Covariance]:
    """Return covariances with a common between-log factor."""
    degrees = sum(covariance.degrees for covariance in covariances)
    if not degrees:
        return list(covariances)
    between = sum(covariance.between * covariance.degrees for covariance in covariances) / degrees
    return [replace(covariance, between=between, degrees=degrees) for covariance in covariances]


def leave_out_rows(jacobian: Array, residual: Array, hessian: Array) -> Array:
    """Return the residual (N,) of each row by an estimate without it.

    A few rows around reversals determine some unknowns alone, which hides their errors (MacKinnon
    and White 1985, HC3). `hessian` (P, P) is that of half the sum of squares.
    """
    leverage = np.sum((jacobian @ _inverse(hessian, hessian)) * jacobian, axis=1)
    return np.asarray(residual / (1.0 - np.minimum(leverage, _MAX_LEVERAGE)))


def blocks_of_time(logs: Integers) -> Integers:
    """Return the labels of logs (N,), or of blocks of time for a single log."""
    if np.any(logs != logs[0]):
        return logs
    return np.arange(len(logs)) * BLOCKS // len(logs)


def covariance(
    names: Sequence[str],
    gradients: Array,
    hessians: Sequence[Array] | Array,
    labels: Integers,
    *,
    prior_hessian: Array | None = None,
    carried: Array | None = None,
) -> Covariance:
    """Return the covariance of a least-squares estimate of P unknowns.

    `gradients` (N, P) are those of half the squared leave-one-out residual (`leave_out_rows`) of
    each row in time order, `hessians` (P, P) the share of each label, `labels` (N,) each row's log
    or block. `prior_hessian` (P, P) is the Hessian of prior knowledge, `carried` (P, r) the summed
    gradients for one standard deviation of each of r independent errors of earlier estimates.
    """
    total_hessian = np.sum(hessians, axis=0)
    if prior_hessian is not None:
        total_hessian = total_hessian + prior_hessian
    parts = [(k, gradients[labels == k], hessian) for k, hessian in enumerate(hessians)]
    return covariance_of_parts(
        names, lambda: parts, total_hessian, prior_hessian=prior_hessian, carried=carried
    )


Gradients = tuple[int, Array, Array]  # log, gradients (N, P) of its next rows, their Hessian (P, P)


def covariance_of_parts(
    names: Sequence[str],
    parts: Callable[[], Iterable[Gradients]],
    total_hessian: Array,
    *,
    prior_hessian: Array | None = None,
    carried: Array | None = None,
) -> Covariance:
    """Return `covariance` with `total_hessian` (P, P); `parts` is called once or twice."""
    inverse = _inverse(total_hessian, total_hessian)
    moments_by_log: dict[int, Moments] = defaultdict(lambda: Moments(len(total_hessian)))
    hessians: dict[int, Array] = defaultdict(lambda: np.zeros_like(total_hessian))
    for label, rows, hessian in parts():
        moments_by_log[label].add(rows @ inverse)
        hessians[label] += hessian
    labels = sorted(moments_by_log)
    moments = [moments_by_log[label] for label in labels]
    carried_covariance = np.zeros_like(inverse)
    if prior_hessian is not None:
        carried_covariance = inverse @ prior_hessian @ inverse
    if carried is not None:
        carried_influences = inverse @ carried
        carried_covariance = carried_covariance + carried_influences @ carried_influences.T
    carried_only = Covariance(
        names=tuple(names),
        within=np.zeros_like(inverse),
        between=1.0,
        degrees=0.0,
        carried=carried_covariance,
    )
    if len(labels) >= MIN_SCATTER_LOGS:
        sums = np.array([log_moments.total for log_moments in moments])
        return replace(carried_only, within=sums.T @ sums * (len(sums) / (len(sums) - 1)))
    influences = ((labels.index(label), rows @ inverse) for label, rows, _ in parts())
    variances = compute_long_run(moments, influences)
    between, degrees = _compare_logs(
        moments, variances, [hessians[label] for label in labels], total_hessian, prior_hessian
    )
    within = np.sum(variances, axis=0) * _correct_few_rows(moments)
    return replace(carried_only, within=within, between=between, degrees=degrees, logs=len(labels))


def covariance_of_fit(
    names: Sequence[str],
    jacobian: Array,
    residual: Array,
    labels: Integers,
    *,
    carried: Array | None = None,
) -> Covariance:
    """Return the covariance of an unweighted fit from its Jacobian (N, P); see `covariance`."""
    parts = [jacobian[labels == k] for k in range(int(labels[-1]) + 1)]
    gradients = jacobian * leave_out_rows(jacobian, residual, jacobian.T @ jacobian)[:, None]
    hessians = [part.T @ part for part in parts]
    return covariance(names, gradients, hessians, labels, carried=carried)


class Moments:
    """Sums over the influences (N, P) of a log, which come in parts."""

    def __init__(self, size: int) -> None:
        self.rows = 0
        self.total, self.squares, self.fourths, self.lag1, self.lag2 = np.zeros((5, size))
        self.last = np.zeros((2, size))  # last two rows

    def add(self, psi: Array) -> None:
        """Add the next rows."""
        longer = np.concatenate([self.last, psi])
        self.rows += len(psi)
        self.total += psi.sum(axis=0)
        self.squares += np.sum(psi**2, axis=0)
        self.fourths += np.sum(psi**4, axis=0)
        self.lag1 += np.sum(psi * longer[1:-1], axis=0)
        self.lag2 += np.sum(psi * longer[:-2], axis=0)
        self.last = longer[-2:]

    def whitened_products(self, autoregression: Array) -> tuple[Array, Array]:
        """Return the squares and lag-1 products of psi[k] - `autoregression` psi[k - 1]."""
        earlier_squares = self.squares - self.last[1] ** 2
        squares = (
            self.squares - 2.0 * autoregression * self.lag1 + autoregression**2 * earlier_squares
        )
        product = self.lag1 - self.last[0] * self.last[1]
        return squares, self.lag1 - autoregression * (
            earlier_squares + self.lag2
        ) + autoregression**2 * product


def compute_long_run(
    moments: Sequence[Moments], influences: Iterable[tuple[int, Array]]
) -> list[Array]:
    """Return each log's covariance (P, P) of the sum of its rows.

    The `influences` are numbers of logs with their next rows (N, P). Bartlett's kernel with weights
    1 - lag / width is the mean product of sums over windows of that width.
    """
    autoregression = _estimate_autoregression(
        [(log_moments.squares, log_moments.lag1) for log_moments in moments]
    )
    width = 1 + _choose_bandwidth(
        [log_moments.whitened_products(autoregression) for log_moments in moments], moments
    )
    size = len(autoregression)
    last_rows = np.zeros((len(moments), 1, size))
    last_white_rows = np.zeros((len(moments), width, size))
    totals = np.zeros((len(moments), size, size))

    def add(k: int, white_rows: Array) -> None:
        extended_rows = np.concatenate([last_white_rows[k], white_rows])
        sums = np.cumsum(extended_rows, axis=0)
        windows = sums[width:] - sums[:-width]
        totals[k] += windows.T @ windows
        last_white_rows[k] = extended_rows[-width:]

    for k, psi in influences:
        extended_rows = np.concatenate([last_rows[k], psi])
        add(k, psi - autoregression * extended_rows[:-1])
        last_rows[k] = extended_rows[-1]
    for k in range(len(moments)):
        add(k, np.zeros((width - 1, size)))
    return list(totals / width / np.outer(1.0 - autoregression, 1.0 - autoregression))


def _correct_few_rows(moments: Sequence[Moments]) -> Array:
    """Return the ratios (P, P) of Student's to normal quantiles (Bell and McCaffrey 2002)."""
    squares = np.sum([log_moments.squares for log_moments in moments], axis=0)
    fourths = np.sum([log_moments.fourths for log_moments in moments], axis=0)
    degrees = np.maximum(3.0 * squares**2 / np.maximum(fourths, 1e-300), 2.0)
    ratio = scipy.special.stdtrit(degrees, _UPPER_QUANTILE) / scipy.special.ndtri(_UPPER_QUANTILE)
    return np.outer(ratio, ratio)


def _compare_logs(
    moments: Sequence[Moments],
    log_variances: Sequence[Array],
    hessians: Sequence[Array],
    total_hessian: Array,
    prior_hessian: Array | None,
) -> tuple[float, float]:
    """Compare each log's estimate with that of the others by one Gauss-Newton step each.

    Returns the mean square difference over its variance by `log_variances`, and the number of
    independent differences.
    """
    if len(moments) < 2:
        return 1.0, 0.0
    total_variance = np.sum(log_variances, axis=0)
    squares = []
    for k, log_moments in enumerate(moments):
        # A sum, as a difference from the total is round-off, even negative, where one log alone
        # determines an unknown.
        other_hessian = _sum_others(hessians, k)
        if prior_hessian is not None:
            other_hessian = other_hessian + prior_hessian
        log_step = _inverse(hessians[k], total_hessian) @ total_hessian
        other_step = _inverse(other_hessian, total_hessian) @ total_hessian
        difference = (log_step + other_step) @ log_moments.total
        variance = np.diag(
            log_step @ log_variances[k] @ log_step.T
            + other_step @ _sum_others(log_variances, k) @ other_step.T
        )
        squares.append(difference**2 / np.maximum(variance, 1e-300))
    size = np.sqrt(np.maximum(np.diag(total_variance), 1e-300))
    correlation = total_variance / np.outer(size, size)
    np.fill_diagonal(correlation, 1.0)
    independent = len(size) ** 2 / float(np.sum(correlation**2))
    return float(np.mean(squares)), (len(moments) - 1) * independent


def _sum_others(matrices: Sequence[Array], k: int) -> Array:
    """Return the sum of all matrices (P, P) but one."""
    return np.asarray(np.sum([*matrices[:k], *matrices[k + 1 :]], axis=0))


def _inverse(hessian: Array, total_hessian: Array) -> Array:
    size = np.sqrt(np.where(np.diag(total_hessian) > 0.0, np.diag(total_hessian), 1.0))
    scaled = np.linalg.pinv(hessian / np.outer(size, size), hermitian=True, rcond=_RANK_TOLERANCE)
    return np.asarray(scaled / np.outer(size, size))


def _estimate_autoregression(sums: Sequence[tuple[Array, Array]]) -> Array:
    """Return the first-order autoregression of each column (P,) from squares and products."""
    squares, products = np.sum(sums, axis=0)
    return np.asarray(
        np.clip(products / np.maximum(squares, 1e-300), -_MAX_AUTOREGRESSION, _MAX_AUTOREGRESSION)
    )


def _choose_bandwidth(white: Sequence[tuple[Array, Array]], moments: Sequence[Moments]) -> int:
    """Return the bandwidth of Bartlett's kernel [rows] (Andrews 1991, eq. 6.2 and 6.4)."""
    rho = _estimate_autoregression(white)
    numerator = np.sum(4.0 * rho**2 * (1.0 - rho**2) ** 2 / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2))
    denominator = np.sum((1.0 - rho**2) ** 2 / (1.0 - rho) ** 4)
    rows = np.mean([log_moments.rows for log_moments in moments])
    return int(np.ceil(1.1447 * (numerator / denominator * rows) ** (1.0 / 3.0)))
