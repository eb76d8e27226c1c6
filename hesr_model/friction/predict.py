"""Predictions of laws over logs: inputs of sample k act from t[k-1] to t[k], then tau is read."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import scipy
import sympy
from numpy.typing import ArrayLike

from hesr_model.equations.functions import positive
from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import Stop, find_read_symbols
from hesr_model.errors import ArtifactError
from hesr_model.friction.band import COVERAGE, LEVEL, LOWER, NUMBERS, UPPER, band_equations
from hesr_model.friction.inputs import INPUTS, TORQUE
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array

_PIECE_ROWS = 2048  # rows run for all joints before the next ones, to stay in the processor's cache


@lru_cache(maxsize=256)
def _motion_kernel(form: LawForm, *, reads_states: bool = False) -> Kernel:
    expressions = [form.output]
    if reads_states:
        expressions = [element.state for element in form.memory]
    settling = form.component.settling
    return Kernel(form.memory, _symbols(form), INPUTS, expressions, settling, once=True)


@lru_cache(maxsize=64)
def _reading_kernel(form: LawForm) -> Kernel:
    """Return the torque and each element's guarded parts, for inputs and states of each row."""
    states = tuple(element.state for element in form.memory)
    torque = form.output.xreplace(
        {element.derivative: element.express_derivative() for element in form.memory}
    )
    parts = []
    for element in form.memory:
        first, second = element.parts
        parts += [first, positive(second)]
    return Kernel((), _symbols(form), (*INPUTS, *states), (torque, *parts), once=True)


@lru_cache(maxsize=64)
def _band_kernel(form: LawForm) -> Kernel:
    names = {
        equation.symbol: equation.expression
        for equation in band_equations(form.memory, form.output, steady_speed=form.steady_speed)
    }
    numbers = (*_symbols(form), *(quantity.symbol for quantity in (*NUMBERS, COVERAGE)))
    ends = [sympy.Symbol(name, real=True) for name in (LOWER, UPPER)]
    inputs = (*INPUTS, sympy.Symbol(TORQUE, real=True))
    return Kernel((), numbers, inputs, ends, names=names, once=True)


def _symbols(form: LawForm) -> tuple[sympy.Symbol, ...]:
    return tuple(quantity.symbol for quantity in form.coefficients)


def coefficient_array(law: FrictionLaw) -> Array:
    """Return the (C,) coefficients of a law in their units."""
    return np.array(list(law.values.values()))


def first_states(
    law: FrictionLaw, dq: float, q: float = 0.0, tau_load: float = 0.0
) -> tuple[float, ...]:
    """Return the initial states for the first inputs [rad/s, rad, N.m]."""
    inputs = [np.array([u]) for u in (dq, q, tau_load)]
    run = KernelRun(_motion_kernel(law.form), inputs, np.zeros(1), start=law.start)
    return tuple(run.begin(coefficient_array(law))[:, 0].tolist())


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
    dt, inputs = _to_arrays(t, (dq, q, tau_load))
    if shown is None:
        return _run(_motion_kernel(law.form), law, dt, inputs, start)[:, 0]
    states = _run(_motion_kernel(law.form, reads_states=True), law, dt, inputs, start)
    reading = KernelRun(_reading_kernel(law.form), [*shown, *states.T], dt)
    return reading.evaluate(coefficient_array(law))[:, 0]


def predict_joints(
    laws: Sequence[FrictionLaw], *, t: Array, dq: Array, q: Array, tau_load: Array
) -> Array:
    """Return the torques (N, n) of n joints over a log; see `predict`."""
    dt, inputs = _to_arrays(t, (dq, q, tau_load))
    tau_predicted = np.empty(dq.shape)
    runs = []
    for j, law in enumerate(laws):
        run = KernelRun(
            _motion_kernel(law.form),
            [u[:, j] for u in inputs],
            dt,
            euler=law.discretisation == "euler",
            start=law.start,
            output=tau_predicted[:, j : j + 1],
        )
        run.begin(coefficient_array(law))
        runs.append((run, coefficient_array(law)))
    for first_row in range(0, len(dt), _PIECE_ROWS):
        for run, values in runs:
            run.run_rows(values, first_row, min(first_row + _PIECE_ROWS, len(dt)))
    return tau_predicted


def compute_states(law: FrictionLaw, *, t: Array, dq: Array, q: Array, tau_load: Array) -> Array:
    """Return the (m, N) states of a law over a log; see `predict`."""
    dt, inputs = _to_arrays(t, (dq, q, tau_load))
    return _run(_motion_kernel(law.form, reads_states=True), law, dt, inputs).T


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
    dt, inputs = _to_arrays(t, (dq, q, tau_load))
    kernel_numbers = np.array([*law.values.values(), *law.band.values.values(), coverage])
    run = KernelRun(_band_kernel(law.form), [*inputs, torque], dt)
    lower, upper = run.evaluate(kernel_numbers).T
    return lower, upper


def _to_arrays(t: ArrayLike, signals: tuple[ArrayLike | None, ...]) -> tuple[Array, list[Array]]:
    time = np.asarray(t, dtype=float)
    zero = np.broadcast_to(0.0, time.shape)
    inputs = [zero if u is None else np.asarray(u, dtype=float) for u in signals]
    return np.diff(time, prepend=time[0]), inputs


def _run(
    kernel: Kernel,
    law: FrictionLaw,
    dt: Array,
    inputs: Sequence[Array],
    start: tuple[float, ...] | None = None,
) -> Array:
    run = KernelRun(kernel, inputs, dt, euler=law.discretisation == "euler", start=law.start)
    values = coefficient_array(law)
    if start is None:
        return run.evaluate(values)
    return run.evaluate(values, np.array(start, dtype=float), settled=True)


def record_start(law: FrictionLaw, record: FrictionRecord) -> tuple[float, ...]:
    """Return the start of the states that best explains the first `law.start_samples` torques.

    A relaxation is searched within its reachable limits in the record; stops share one number,
    their deflection as a share of their bounds. For other memories, or if the parts of a relaxation
    depend on its state, the law's own start is returned.
    """
    if law.start_samples and law.form.stops:
        return _find_deflected_start(law, record)
    if not law.start_samples or len(law.form.memory) != 1 or not law.form.relaxations:
        return law.start
    [element] = law.form.memory
    if element.state in find_read_symbols([element]):
        return law.start
    return _find_relaxed_start(law, record)


def _find_deflected_start(law: FrictionLaw, record: FrictionRecord) -> tuple[float, ...]:
    """Return the best start whose stops are deflected by the same share of their bounds."""
    first_inputs = (record.dq[0], record.q[0], record.tau_load[0], *law.start)
    inputs = [np.array([first_input]) for first_input in first_inputs]
    reading = KernelRun(_reading_kernel(law.form), inputs, np.zeros(1))
    _, *parts = reading.evaluate(coefficient_array(law))[0].tolist()
    bounds = parts[1::2]

    def deflect_stops(share: float) -> tuple[float, ...]:
        start = []
        for element, x, bound in zip(law.form.memory, law.start, bounds, strict=True):
            start.append(share * bound if isinstance(element, Stop) else x)
        return tuple(start)

    start_record = record.rows(slice(0, law.start_samples))
    return _find_best_start(law, start_record, deflect_stops, -1.0, 1.0)


def _find_relaxed_start(law: FrictionLaw, record: FrictionRecord) -> tuple[float, ...]:
    """Return the best start of one relaxation within the steady values along a record."""
    zeros = np.zeros_like(record.t)
    inputs = [record.dq, record.q, record.tau_load, zeros]
    reading = KernelRun(_reading_kernel(law.form), inputs, zeros)
    _, drive, rate = reading.evaluate(coefficient_array(law)).T
    # Rates that are round-off, of a joint at rest, have no steady value.
    is_relaxing = rate > 1e-9 * max(float(rate.max()), 1e-300)
    limit = float(np.max(np.abs(drive[is_relaxing] / rate[is_relaxing]), initial=0.0))
    # The error may have several minima; the search begins around the best of a grid.
    start_record = record.rows(slice(0, law.start_samples))
    grid = np.linspace(-limit, limit, 41)
    errors = [_measure_error(law, start_record, (float(x),)) for x in grid]
    nearest = int(np.argmin(errors))
    lower = grid[max(nearest - 1, 0)]
    upper = grid[min(nearest + 1, len(grid) - 1)]
    if lower == upper:
        return law.start
    return _find_best_start(law, start_record, lambda x: (x,), lower, upper)


def _measure_error(law: FrictionLaw, record: FrictionRecord, start: tuple[float, ...]) -> float:
    """Return the sum of squared errors [N^2.m^2] of a law over a record from a start."""
    tau_predicted = predict(law, **record.motion, start=start)
    return float(np.sum((tau_predicted - record.tau) ** 2))


def _find_best_start(
    law: FrictionLaw,
    record: FrictionRecord,
    build_start: Callable[[float], tuple[float, ...]],
    lower: float,
    upper: float,
) -> tuple[float, ...]:
    """Return the start of a number within limits whose error over a record is lowest."""
    optimum = scipy.optimize.minimize_scalar(
        lambda x: _measure_error(law, record, build_start(x)),
        bounds=(lower, upper),
        method="bounded",
    )
    return build_start(float(optimum.x))


@lru_cache(maxsize=256)
def _step_kernel(form: LawForm, *, fixed_coefficients: bool) -> Kernel:
    numbers = _symbols(form)
    inputs = INPUTS
    if not fixed_coefficients:  # they differ by row
        inputs = (*numbers, *INPUTS)
        numbers = ()
    states = tuple(element.state for element in form.memory)
    return Kernel(form.memory, numbers, inputs, (form.output, *states), once=True)


class LawStepper:
    """Step a law for W motions at once, with coefficients `values` (C, W) or those of the law."""

    def __init__(self, law: FrictionLaw, values: Array | None = None) -> None:
        self._kernel = _step_kernel(law.form, fixed_coefficients=values is None)
        if values is None:
            self._numbers = coefficient_array(law)
            self._values = np.zeros((0, 0))
        else:
            self._numbers = np.zeros(0)
            self._values = values
        self._is_euler = law.discretisation == "euler"
        self._table = np.zeros((0, 0))
        self._run: KernelRun | None = None

    def _bind(self, motions: int) -> KernelRun:
        coefficients = len(self._values)
        self._table = np.zeros((1 + coefficients + len(INPUTS), 2 * motions))
        if coefficients:
            self._table[1 : 1 + coefficients] = np.repeat(self._values, 2, axis=1)
        dt, *inputs = self._table
        return KernelRun(self._kernel, inputs, dt, range(0, 2 * motions, 2), euler=self._is_euler)

    def __call__(
        self, dt: Array, dq: Array, q: Array, tau_load: Array, x: Array
    ) -> tuple[Array, Array]:
        """Hold inputs (W,) in [s, rad/s, rad, N.m] and return torque (W,) [N.m] and states (m, W).

        `x` (m, W) are the states before; dt = 0 reads the torque there.
        """
        if self._run is None or self._table.shape[1] != 2 * len(dt):
            self._run = self._bind(len(dt))
        self._table[0, 1::2] = dt
        for row, signal in zip(self._table[-len(INPUTS) :], (dq, q, tau_load), strict=True):
            row[1::2] = signal
        outputs = self._run.evaluate(self._numbers, x, settled=True)[1::2].T.copy()
        return outputs[0], outputs[1:]
