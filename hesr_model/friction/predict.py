"""Run a law: over a whole log at once, or one step at a time.

The convention is that of the FMU: sample k is set, the states go from t[k-1] to t[k] with the
inputs of sample k held, and the torque of sample k is read. At the first sample the states are
where they begin: in the steady state of its inputs where these are motion, at the law's start at
rest.
"""

from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any

import numpy as np
import sympy
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

from hesr_model.equations.functions import lowered
from hesr_model.equations.kernel import Kernel, Rows, kernel_of
from hesr_model.equations.memory import DT, Element, Stop
from hesr_model.equations.over_log import StatesOverLog
from hesr_model.equations.rows import RUNS, OutsideError
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.support.arrays import Array

_PIECE = 2048
"""Rows that are run for all joints before the next ones."""


@lru_cache(maxsize=256)
def _kernel(form: LawForm) -> Kernel | None:
    """Return the torque in C, where that can be had."""
    symbols = tuple(c.symbol for c in form.coefficients)
    settling = form.component.settling
    return kernel_of(form.memory, symbols, INPUTS, (form.output,), settling, once=True)


@lru_cache(maxsize=256)
def _functions(form: LawForm) -> tuple[StatesOverLog, Any]:
    arguments = (*(c.symbol for c in form.coefficients), *INPUTS)
    return over_log(form.memory, arguments, (form.output,), form.component.settling)


def over_log(
    memory: Sequence[Element], arguments: Sequence[sympy.Symbol], outputs: Sequence[sympy.Expr],
    settling: sympy.Expr,
) -> tuple[StatesOverLog, Any]:  # fmt: skip
    """Return what runs memory over logs, and outputs of arguments, states, derivatives and DT."""
    states = tuple(s for m in memory for s in (m.state, m.derivative))
    read = set().union(*(e.free_symbols for e in outputs))
    found = StatesOverLog(memory, arguments, read, settling)
    return found, lowered((*arguments, *states, DT), outputs)


def numbers(law: FrictionLaw) -> tuple[np.float64, ...]:
    """Return the values of a law's coefficients, in their order and units, for lowered functions.

    As NumPy's numbers: a division by one that is 0 gives inf or nan, as it does in C and among
    arrays, where Python's own would end the program.
    """
    return tuple(np.float64(value) for value in law.values.values())


def first_states(
    law: FrictionLaw, dq: float, q: float = 0.0, tau_load: float = 0.0
) -> tuple[float, ...]:
    """Return where the states begin for the first inputs [rad/s, rad, N.m].

    In the steady state from `law.MOVING` on, faded in from the law's start at rest.
    """
    if not law.form.memory:
        return ()
    memory, _ = _functions(law.form)
    return tuple(map(float, memory.beginning((*numbers(law), dq, q, tau_load), law.start)))


def predict(
    law: FrictionLaw,
    *,
    t: ArrayLike,
    dq: ArrayLike,
    q: ArrayLike | None = None,
    tau_load: ArrayLike | None = None,
    start: tuple[float, ...] | None = None,
    shown: Sequence[Array] | None = None,
) -> Array:
    """Return the friction torque of a law over a log.

    Parameters
    ----------
    law : the law of one joint.
    t : (N,) time [s], increasing.
    dq : (N,) joint velocity [rad/s].
    q : (N,) joint position [rad]; zero where not given.
    tau_load : (N,) load torque [N.m]; zero where not given.
    start : values of the states at t[0]; `first_states` of the first row where not given.
    shown : (N,) of `dq`, `q` and `tau_load` at which the torque is read, the states being where the
        others have taken them; those themselves where not given.

    Returns
    -------
    (N,) friction torque [N.m].

    Raises
    ------
    SimulationError
        If the discretisation is not stable at the log's steps.
    """
    dt, inputs = _arrays(t, (dq, q, tau_load))
    if shown is None:
        found = np.empty_like(dt)
        with suppress(OutsideError):
            rows = _begun(law, dt, inputs, start, found)
            if rows is not None:
                rows.on(np.array(numbers(law)), 0, len(dt))
                return found
        return _in_numpy(law, dt, inputs, start)
    output, values, states = _states(law, dt, inputs, start)
    values = (*numbers(law), *shown)
    every = np.ones(dt.shape, dtype=bool)  # so that states stay and derivatives follow
    states = _functions(law.form)[0](values, dt, every, states[::2], law.discretisation)
    return np.array(np.broadcast_to(output(*values, *states, dt)[0], dt.shape))


def predict_joints(
    laws: Sequence[FrictionLaw], *, t: Array, dq: Array, q: Array, tau_load: Array
) -> Array:
    """Return the (N, n) torques of the laws of n joints over a log; arguments (N, n), as above."""
    dt, inputs = _arrays(t, (dq, q, tau_load))
    found = np.empty(dq.shape)
    in_c: dict[int, tuple[Rows, Array]] = {}
    for k, law in enumerate(laws):
        with suppress(OutsideError):
            rows = _begun(law, dt, [u[:, k] for u in inputs], None, found[:, k])
            if rows is not None:
                in_c[k] = rows, np.array(numbers(law))
    # All joints together, a piece of the log after the other, as long as it stays in a cache.
    for first in range(0, len(dt), _PIECE):
        for k, (rows, values) in list(in_c.items()):
            try:
                rows.on(values, first, min(first + _PIECE, len(dt)))
            except OutsideError:
                del in_c[k]
    for k in set(range(len(laws))) - in_c.keys():
        found[:, k] = _in_numpy(laws[k], dt, [u[:, k] for u in inputs], None)
    return found


def states_over(law: FrictionLaw, *, t: Array, dq: Array, q: Array, tau_load: Array) -> Array:
    """Return the states of a law over a log, (m, N) in their units; arguments as of `predict`."""
    dt, inputs = _arrays(t, (dq, q, tau_load))
    _, _, states = _states(law, dt, inputs, None)
    return np.array(states[::2]).reshape(len(law.form.memory), len(dt))


def _arrays(t: ArrayLike, given: tuple[ArrayLike | None, ...]) -> tuple[Array, list[Array]]:
    """Return steps and inputs."""
    time = np.asarray(t, dtype=float)
    zero = np.broadcast_to(0.0, time.shape)
    inputs = [zero if u is None else np.asarray(u, dtype=float) for u in given]
    return np.diff(time, prepend=time[0]), inputs


def _begun(
    law: FrictionLaw,
    dt: Array,
    inputs: Sequence[Array],
    start: tuple[float, ...] | None,
    found: Array,
) -> Rows | None:
    """Return the law's rows in C where they begin, to be run into an array; None for NumPy."""
    kernel, euler = _kernel(law.form), law.discretisation == "euler"
    rows = kernel.over(inputs, dt, [0], euler=euler, found=found[:, None]) if kernel else None
    if rows is not None:
        at_rest = np.array(law.start if start is None else start, dtype=float)
        rows.begin(np.array(numbers(law)), at_rest, settled=start is not None)
    return rows


def _in_numpy(
    law: FrictionLaw, dt: Array, inputs: Sequence[Array], start: tuple[float, ...] | None
) -> Array:
    """Return the torque as `predict` does."""
    RUNS["NumPy"] += 1
    output, values, states = _states(law, dt, inputs, start)
    return np.array(np.broadcast_to(output(*values, *states, dt)[0], dt.shape))


def _states(
    law: FrictionLaw, dt: Array, inputs: Sequence[Array], start: tuple[float, ...] | None
) -> tuple[Any, tuple[Any, ...], list[Array]]:
    """Return the output's function, what it reads besides states, and states and derivatives."""
    memory, output = _functions(law.form)
    values = (*numbers(law), *inputs)
    states = memory(
        values,
        dt,
        np.arange(len(dt)) == 0,
        first_states(law, *(float(u[0]) for u in inputs)) if start is None else start,
        law.discretisation,
    )
    return output, values, states


def estimated_start(
    law: FrictionLaw, *, t: Array, dq: Array, q: Array, tau_load: Array, tau: Array
) -> tuple[float, ...]:
    """Return the start of the state that explains the first torques of a log best.

    Of `law.start_samples` rows; the state is searched between the limits that it can reach in the
    log; stops share one number, the share of their bounds at which they are. A law without such
    samples, whose memory is otherwise not one relaxation, or one whose parts see its state, keeps
    its own start.

    Parameters
    ----------
    law : the law of one joint.
    t, dq, q, tau_load, tau : (N,) rows of the log [s, rad/s, rad, N.m, N.m]; tau is friction.
    """
    first = slice(0, law.start_samples)

    def error(start: tuple[float, ...]) -> float:
        predicted = predict(
            law, t=t[first], dq=dq[first], q=q[first], tau_load=tau_load[first], start=start
        )
        return float(np.sum((predicted - tau[first]) ** 2))

    if law.start_samples and law.form.stops:
        bounds = _bounds(law, dq[0], q[0], tau_load[0])

        def deflected(share: float) -> tuple[float, ...]:
            return tuple(
                x if bound is None else share * bound
                for x, bound in zip(law.start, bounds, strict=True)
            )

        found = minimize_scalar(lambda u: error(deflected(u)), bounds=(-1.0, 1.0), method="bounded")
        return deflected(float(found.x))
    if not law.start_samples or len(law.form.memory) != 1 or not law.form.relaxations:
        return law.start
    parts = _functions(law.form)[0].parts((*numbers(law), dq, q, tau_load), t.shape)
    if not parts:
        return law.start
    b, r = parts[0]
    moving = r > 1e-9 * max(float(r.max()), 1e-300)
    limit = float(np.max(np.abs(b[moving] / r[moving]), initial=0.0))
    grid = np.linspace(-limit, limit, 41)
    best = int(np.argmin([error((float(x),)) for x in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    if low == high:
        return law.start
    best_of_all = minimize_scalar(lambda x: error((x,)), bounds=(low, high), method="bounded")
    return (float(best_of_all.x),)


def _bounds(law: FrictionLaw, *inputs: float) -> list[float | None]:
    """Return the bound of each stop where a log starts, None for what is no stop."""
    bounds = iter(_bounds_of(law.form)(*numbers(law), *inputs, *law.start))
    return [max(float(next(bounds)), 0.0) if isinstance(m, Stop) else None for m in law.form.memory]


@lru_cache(maxsize=256)
def _bounds_of(form: LawForm) -> Any:
    """Return the bounds of all stops as a function of coefficients, inputs and states."""
    arguments = (*(c.symbol for c in form.coefficients), *INPUTS, *(m.state for m in form.memory))
    return lowered(arguments, [m.bound for m in form.memory if isinstance(m, Stop)])


class Stepper:
    """A law run one step at a time, as a controller or a co-simulation master would.

    Parameters
    ----------
    law : the law of one joint.
    start : values of the states; `first_states` of the inputs of the first step where not given.

    Attributes
    ----------
    x : values of the states; empty before the first step where none were given.
    """

    def __init__(self, law: FrictionLaw, start: Sequence[float] | None = None) -> None:
        self._law = law
        self._memory, self._output = _functions(law.form)
        self._values = numbers(law)
        self.x = list(start or ())

    def step(self, dt: float, dq: float, q: float = 0.0, tau_load: float = 0.0) -> float:
        """Hold the inputs over dt [s], advance the states and return the torque at the end [N.m].

        dt = 0 reads the torque without moving the states, as after initialisation.
        """
        if not self.x:
            self.x = list(first_states(self._law, dq, q, tau_load))
        values = (*self._values, dq, q, tau_load)
        # A log of two rows: where the states are, and where a step takes them.
        rows = self._memory(
            values, np.array([0.0, dt]), np.array([True, False]), self.x, self._law.discretisation
        )
        states = [float(row[1]) for row in rows]
        self.x = states[::2]
        return float(self._output(*values, *states, dt)[0])
