"""Predictions of laws over logs: inputs of sample k act from t[k-1] to t[k], then tau is read."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import scipy
import sympy
from numpy.typing import ArrayLike

from hesr_model.equations.functions import positive
from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import Stop
from hesr_model.errors import ArtifactError
from hesr_model.friction.band import COVERAGE, LEVEL, LOWER, NUMBERS, UPPER, band_equations
from hesr_model.friction.inputs import INPUTS, TORQUE
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array

_PIECE = 2048  # rows run for all joints before the next ones, to stay in the processor's cache


@lru_cache(maxsize=256)
def _moving(form: LawForm, *, states: bool = False) -> Kernel:
    wanted = tuple(element.state for element in form.memory) if states else (form.output,)
    return Kernel(form.memory, _symbols(form), INPUTS, wanted, form.component.settling, once=True)


@lru_cache(maxsize=64)
def _reading(form: LawForm) -> Kernel:
    """Return the torque and each element's guarded parts, for inputs and states of each row."""
    states = tuple(element.state for element in form.memory)
    torque = form.output.xreplace(
        {element.derivative: element.continuous() for element in form.memory}
    )
    parts = [
        part for element in form.memory for part in (element.parts[0], positive(element.parts[1]))
    ]
    return Kernel((), _symbols(form), (*INPUTS, *states), (torque, *parts), once=True)


@lru_cache(maxsize=64)
def _band(form: LawForm) -> Kernel:
    names = {
        equation.symbol: equation.expression
        for equation in band_equations(form.memory, form.output)
    }
    numbers = (*_symbols(form), *(quantity.symbol for quantity in (*NUMBERS, COVERAGE)))
    ends = [sympy.Symbol(name, real=True) for name in (LOWER, UPPER)]
    inputs = (*INPUTS, sympy.Symbol(TORQUE, real=True))
    return Kernel((), numbers, inputs, ends, names=names, once=True)


def _symbols(form: LawForm) -> tuple[sympy.Symbol, ...]:
    return tuple(quantity.symbol for quantity in form.coefficients)


def numbers(law: FrictionLaw) -> Array:
    """Return the (C,) coefficients of a law in their units."""
    return np.array(list(law.values.values()))


def first_states(
    law: FrictionLaw, dq: float, q: float = 0.0, tau_load: float = 0.0
) -> tuple[float, ...]:
    """Return the initial states for the first inputs [rad/s, rad, N.m]."""
    inputs = [np.array([u]) for u in (dq, q, tau_load)]
    run = KernelRun(_moving(law.form), inputs, np.zeros(1), start=law.start)
    return tuple(run.begin(numbers(law))[:, 0].tolist())


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
    """Return the friction torque (N,) [N.m] of a law over a log of (N,) [s, rad/s, rad, N.m].

    `start` has the states at t[0], by default `first_states`. `shown` has `dq`, `q` and `tau_load`
    for reading the torque, if other than those that move the states. Raises SimulationError if the
    discretisation is unstable.
    """
    dt, inputs = _arrays(t, (dq, q, tau_load))
    if shown is None:
        return _run(_moving(law.form), law, dt, inputs, start)[:, 0]
    states = _run(_moving(law.form, states=True), law, dt, inputs, start)
    return KernelRun(_reading(law.form), [*shown, *states.T], dt).at(numbers(law))[:, 0]


def predict_joints(
    laws: Sequence[FrictionLaw], *, t: Array, dq: Array, q: Array, tau_load: Array
) -> Array:
    """Return the torques (N, n) of n joints over a log; see `predict`."""
    dt, inputs = _arrays(t, (dq, q, tau_load))
    found = np.empty(dq.shape)
    runs = []
    for k, law in enumerate(laws):
        run = KernelRun(
            _moving(law.form),
            [u[:, k] for u in inputs],
            dt,
            euler=law.discretisation == "euler",
            start=law.start,
            found=found[:, k : k + 1],
        )
        run.begin(numbers(law))
        runs.append((run, numbers(law)))
    for first in range(0, len(dt), _PIECE):
        for run, values in runs:
            run.on(values, first, min(first + _PIECE, len(dt)))
    return found


def states_over(law: FrictionLaw, *, t: Array, dq: Array, q: Array, tau_load: Array) -> Array:
    """Return the (m, N) states of a law over a log; see `predict`."""
    dt, inputs = _arrays(t, (dq, q, tau_load))
    return _run(_moving(law.form, states=True), law, dt, inputs).T


def predict_band(
    law: FrictionLaw,
    *,
    t: Array,
    dq: Array,
    q: Array,
    tau_load: Array,
    torque: Array,
    coverage: float = LEVEL,
) -> tuple[Array, Array]:
    """Return both ends (N,) [N.m] of the band around `torque` (N,); ArtifactError if none."""
    if law.band is None:
        raise ArtifactError(f"law '{law.name}' has no band; fit it again with this version.")
    dt, inputs = _arrays(t, (dq, q, tau_load))
    given = np.array([*law.values.values(), *law.band.values.values(), coverage])
    lower, upper = KernelRun(_band(law.form), [*inputs, torque], dt).at(given).T
    return lower, upper


def _arrays(t: ArrayLike, given: tuple[ArrayLike | None, ...]) -> tuple[Array, list[Array]]:
    time = np.asarray(t, dtype=float)
    zero = np.broadcast_to(0.0, time.shape)
    inputs = [zero if u is None else np.asarray(u, dtype=float) for u in given]
    return np.diff(time, prepend=time[0]), inputs


def _run(
    kernel: Kernel,
    law: FrictionLaw,
    dt: Array,
    inputs: Sequence[Array],
    start: tuple[float, ...] | None = None,
) -> Array:
    run = KernelRun(kernel, inputs, dt, euler=law.discretisation == "euler", start=law.start)
    settled = start is not None
    return run.at(numbers(law), np.array(start, dtype=float) if settled else None, settled=settled)


def record_start(law: FrictionLaw, record: FrictionRecord) -> tuple[float, ...]:
    """Return the start of the states that best explains the first `law.start_samples` torques.

    A relaxation is searched within its reachable limits in the record; stops share one number,
    their deflection as a share of their bounds. For other memories, or if the parts of a relaxation
    depend on its state, the law's own start is returned.
    """
    first = record.rows(slice(0, law.start_samples))

    def error(start: tuple[float, ...]) -> float:
        return float(np.sum((predict(law, **first.motion, start=start) - first.tau) ** 2))

    def best(
        start_of: Callable[[float], tuple[float, ...]], low: float, high: float
    ) -> tuple[float, ...]:
        found = scipy.optimize.minimize_scalar(
            lambda x: error(start_of(x)), bounds=(low, high), method="bounded"
        )
        return start_of(float(found.x))

    if law.start_samples and law.form.stops:
        rows = [np.array([u]) for u in (record.dq[0], record.q[0], record.tau_load[0], *law.start)]
        _, *parts = KernelRun(_reading(law.form), rows, np.zeros(1)).at(numbers(law))[0].tolist()

        def deflect_bristles(share: float) -> tuple[float, ...]:
            return tuple(
                share * bound if isinstance(element, Stop) else x
                for element, x, bound in zip(law.form.memory, law.start, parts[1::2], strict=True)
            )

        return best(deflect_bristles, -1.0, 1.0)
    if not law.start_samples or len(law.form.memory) != 1 or not law.form.relaxations:
        return law.start
    [element] = law.form.memory
    if element.state in sympy.Tuple(*element.parts).free_symbols:
        return law.start
    still = np.zeros_like(record.t)
    rows = [record.dq, record.q, record.tau_load, still]
    _, b, r = KernelRun(_reading(law.form), rows, still).at(numbers(law)).T
    moving = r > 1e-9 * max(float(r.max()), 1e-300)
    limit = float(np.max(np.abs(b[moving] / r[moving]), initial=0.0))
    grid = np.linspace(-limit, limit, 41)
    nearest = int(np.argmin([error((float(x),)) for x in grid]))
    low = grid[max(nearest - 1, 0)]
    high = grid[min(nearest + 1, len(grid) - 1)]
    return law.start if low == high else best(lambda x: (x,), low, high)


@lru_cache(maxsize=256)
def _kernel(form: LawForm, *, own: bool) -> Kernel:
    symbols = _symbols(form)
    given, columns = (symbols, INPUTS) if own else ((), (*symbols, *INPUTS))
    states = tuple(element.state for element in form.memory)
    return Kernel(form.memory, given, columns, (form.output, *states), once=True)


class LawStepper:
    """Step a law for W motions at once, with coefficients `values` (C, W) or those of the law."""

    def __init__(self, law: FrictionLaw, values: Array | None = None) -> None:
        self._kernel = _kernel(law.form, own=values is None)
        self._given = numbers(law) if values is None else np.zeros(0)
        self._values = np.zeros((0, 0)) if values is None else values
        self._euler = law.discretisation == "euler"
        self._table = np.zeros((0, 0))
        self._run: KernelRun | None = None

    def _bind(self, motions: int) -> KernelRun:
        coefficients = len(self._values)
        self._table = np.zeros((1 + coefficients + len(INPUTS), 2 * motions))
        if coefficients:
            self._table[1 : 1 + coefficients] = np.repeat(self._values, 2, axis=1)
        dt, *inputs = self._table
        return KernelRun(self._kernel, inputs, dt, range(0, 2 * motions, 2), euler=self._euler)

    def __call__(
        self, dt: Array, dq: Array, q: Array, tau_load: Array, x: Array
    ) -> tuple[Array, Array]:
        """Hold inputs (W,) in [s, rad/s, rad, N.m] and return torque (W,) [N.m] and states (m, W).

        `x` (m, W) are the states before; dt = 0 reads the torque there.
        """
        if self._run is None or self._table.shape[1] != 2 * len(dt):
            self._run = self._bind(len(dt))
        self._table[0, 1::2] = dt
        for row, given in zip(self._table[-len(INPUTS) :], (dq, q, tau_load), strict=True):
            row[1::2] = given
        found = self._run.at(self._given, x, settled=True)[1::2].T.copy()
        return found[0], found[1:]
