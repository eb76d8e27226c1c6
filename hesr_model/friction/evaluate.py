"""Run a law: over a whole log at once, or one step at a time.

The convention is that of the FMU: sample k is set, the states go from t[k-1] to t[k] with the
inputs of sample k held, and the torque of sample k is read. At the first sample the states still
have their start values.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.lapack import dtbtrs
from scipy.optimize import minimize_scalar

from hesr_model.errors import SimulationError
from hesr_model.friction.functions import INPUTS, lowered
from hesr_model.friction.law import Discretisation, FrictionLaw, LawForm

Array = NDArray[np.float64]

# Below this the series of phi is exact to double precision and the quotient is not.
_SERIES_BELOW = 1e-3


def phi(z: Array) -> Array:
    """Return (1 - exp(-z)) / z, continued by phi(0) = 1; z has any shape and no unit."""
    small = np.abs(z) < _SERIES_BELOW
    safe = np.where(small, 1.0, z)
    series = 1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0)))
    return np.asarray(np.where(small, series, -np.expm1(-safe) / safe))


def recurrence(a: Array, c: Array, start: float) -> Array:
    """Solve x[0] = start, x[k] = a[k] x[k-1] + c[k] for a whole log without a Python loop.

    Parameters
    ----------
    a, c : (N,) factors and increments; those of k = 0 are not used.
    start : value at k = 0.

    Returns
    -------
    (N,) array: a unit lower bidiagonal system, solved by LAPACK's banded substitution.
    """
    bands = np.empty((2, len(a)), order="F")
    bands[0] = 1.0
    bands[1, :-1] = -a[1:]
    bands[1, -1] = 0.0
    right = np.array(c, dtype=float)
    right[0] = start
    solution, _ = dtbtrs(bands, right[:, None], uplo="L", diag="U")
    return np.asarray(solution[:, 0])


def step_coefficients(
    b: Array, r: Array, dt: Array, discretisation: Discretisation
) -> tuple[Array, Array]:
    """Return (a, c) of one step x+ = a x + c of x' = b - r x with b and r held over dt.

    Parameters
    ----------
    b, r, dt : (N,) drive [unit of x per s], rate [1/s] and step [s].
    discretisation : exact, or explicit Euler (eq. 10).

    Raises
    ------
    SimulationError
        If r is negative, or r dt >= 1 for Euler.
    """
    z = r * dt
    if discretisation == "exact":
        if np.any(z < 0.0):
            raise SimulationError("relaxation rate is negative, so the state would not decay.")
        return np.exp(-z), b * dt * phi(z)
    if np.any((z < 0.0) | (z >= 1.0)):
        worst = float(z.flat[np.argmax(np.abs(z))])
        raise SimulationError(
            f"Euler needs 0 <= rate * step < 1, found {worst:.3g}; take a smaller step or the "
            "'exact' discretisation."
        )
    return 1.0 - z, b * dt


@lru_cache(maxsize=256)
def _functions(form: LawForm) -> tuple[Any, Any]:
    coefficients = tuple(c.symbol for c in form.coefficients)
    drives = lowered(
        (*coefficients, *INPUTS), tuple(e for r in form.relaxations for e in (r.drive, r.rate))
    )
    states = tuple(s for r in form.relaxations for s in (r.state, r.derivative))
    return drives, lowered((*coefficients, *INPUTS, *states), (form.output,))


def numbers(law: FrictionLaw) -> tuple[np.float64, ...]:
    """Return the values of a law's coefficients, in their order and units, for lowered functions.

    As NumPy's numbers: a division by one that is 0 gives inf or nan, as it does in C and among
    arrays, where Python's own would end the program.
    """
    return tuple(np.float64(value) for value in law.values.values())


def predict(
    law: FrictionLaw,
    *,
    t: ArrayLike,
    dq: ArrayLike,
    q: ArrayLike | None = None,
    tau_load: ArrayLike | None = None,
    start: tuple[float, ...] | None = None,
) -> Array:
    """Return the friction torque of a law over a log.

    Parameters
    ----------
    law : the law of one joint.
    t : (N,) time [s], increasing.
    dq : (N,) joint velocity [rad/s].
    q : (N,) joint position [rad]; zero where not given.
    tau_load : (N,) load torque [N.m]; zero where not given.
    start : values of the states at t[0]; those of the law where not given.

    Returns
    -------
    (N,) friction torque [N.m].

    Raises
    ------
    SimulationError
        If the discretisation is not stable at the log's steps.
    """
    time = np.asarray(t, dtype=float)
    zero = np.zeros_like(time)
    inputs = [zero if u is None else np.asarray(u, dtype=float) for u in (dq, q, tau_load)]
    drives, output = _functions(law.form)
    values = numbers(law)
    dt = np.diff(time, prepend=time[0])
    lowered_drives = [np.broadcast_to(e, time.shape) for e in drives(*values, *inputs)]
    states: list[Array] = []
    for i, x0 in enumerate(law.start if start is None else start):
        b, r = lowered_drives[2 * i], lowered_drives[2 * i + 1]
        x = recurrence(*step_coefficients(b, r, dt, law.discretisation), x0)
        states += [x, b - r * x]
    return np.array(np.broadcast_to(output(*values, *inputs, *states)[0], time.shape))


def estimated_start(
    law: FrictionLaw, *, t: Array, dq: Array, q: Array, tau_load: Array, tau: Array
) -> tuple[float, ...]:
    """Return the start of the state that explains the first torques of a log best.

    Of `law.start_samples` rows; the state is searched between the limits that it can reach in the
    log. A law without such samples, without a state or with several keeps its own start.

    Parameters
    ----------
    law : the law of one joint.
    t, dq, q, tau_load, tau : (N,) rows of the log [s, rad/s, rad, N.m, N.m]; tau is friction.
    """
    if not law.start_samples or len(law.start) != 1:
        return law.start
    b, r = (
        np.broadcast_to(e, t.shape) for e in _functions(law.form)[0](*numbers(law), dq, q, tau_load)
    )
    moving = r > 1e-9 * max(float(r.max()), 1e-300)
    limit = float(np.max(np.abs(b[moving] / r[moving]), initial=0.0))
    first = slice(0, law.start_samples)

    def error(x: float) -> float:
        predicted = predict(
            law, t=t[first], dq=dq[first], q=q[first], tau_load=tau_load[first], start=(x,)
        )
        return float(np.sum((predicted - tau[first]) ** 2))

    grid = np.linspace(-limit, limit, 41)
    best = int(np.argmin([error(float(x)) for x in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    if low == high:
        return law.start
    return (float(minimize_scalar(error, bounds=(low, high), method="bounded").x),)


class Stepper:
    """A law run one step at a time, as a controller or a co-simulation master would.

    Parameters
    ----------
    law : the law of one joint.
    """

    def __init__(self, law: FrictionLaw) -> None:
        self._law = law
        self._drives, self._output = _functions(law.form)
        self._values = numbers(law)
        self.x: list[float] = list(law.start)

    def step(self, dt: float, dq: float, q: float = 0.0, tau_load: float = 0.0) -> float:
        """Hold the inputs over dt [s], advance the states and return the torque at the end [N.m].

        dt = 0 reads the torque without moving the states, as after initialisation.
        """
        inputs = (dq, q, tau_load)
        drives = self._drives(*self._values, *inputs)
        states: list[float] = []
        for i, x in enumerate(self.x):
            # Scalars stand for the arrays of a log here: one row, the same arithmetic.
            b, r = np.float64(drives[2 * i]), np.float64(drives[2 * i + 1])
            a, c = step_coefficients(b, r, np.float64(dt), self._law.discretisation)  # type: ignore[arg-type]
            self.x[i] = float(a * x + c)
            states += [self.x[i], float(b - r * self.x[i])]
        return float(self._output(*self._values, *inputs, *states)[0])
