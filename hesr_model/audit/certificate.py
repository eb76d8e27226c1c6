"""Passivity of a law: proven by a storage function, refuted by a cycle with energy, or tested.

A storage function S >= 0 with tau dq >= dS for every step dq = v dt proves passivity. S is a sum of
k x^2 over states, and tau is read after they have moved. Torques of position alone are left out.

    stop       F x, F >= 0                 S = F w x^2 / 2, any step and change of its bound: a clip
                                           is a projection on a set that contains 0
    bristle    c x, x' = b v - r x, r >= 0 S = c x^2 / (2 b), any step of an exact relaxation
                                           and change of its rate r with speed and load
    level      sgn(v) g, g(v, load) >= 0   dissipates g |v|
    with       + d x', r = |v| k(v)        f >= b d (max k / min k - 1) >= -d x' / v for all states
                                           |x| <= b / min k, which exact steps preserve; the
                                           condition of Barabanov and Ortega (2000)
    f(v) v     f >= 0
    ripple     see `laws.stops.form`: f at every speed above the energy of its lag

Functions of speed are bounded over all speeds up to 1e6 rad/s by interval arithmetic.
"""

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from math import inf
from typing import Literal, NamedTuple

import numpy as np
import sympy

from hesr_model.audit.attack import Attack, attack
from hesr_model.audit.audit import SLOWEST_SPEED
from hesr_model.equations.functions import absolute, cardinal_sine, larger, positive, sgn
from hesr_model.equations.intervals import (
    Enclosure,
    Minimum,
    bound_expression,
    find_minimum,
    is_never_negative,
)
from hesr_model.equations.memory import DT, Element, Relaxation, Stop
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw, format_expression
from hesr_model.friction.scales import COULOMB, MIN_SCALE, SCALES, add_scales
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.stops.form import distance
from hesr_model.support.arrays import Array

ProofVerdict = Literal["proven", "refuted", "tested"]
_RELATIVE_ROUND_OFF = 1e-9
_STEP_CANDIDATES = np.geomspace(1e-6, 10.0, 141)  # [s] candidates of the largest certified step
_REST_SPEED = 1e-12  # [rad/s]; below, only torques above round-off count
_SPEED_EDGES = np.concatenate([[1e-300], np.geomspace(_REST_SPEED, 1e6, 73)])  # [rad/s]
_DIRECTIONS = (1.0, -1.0)


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Result of the passivity analysis of a law."""

    verdict: ProofVerdict
    storage: str = ""  # empty without a proof
    rests_on: tuple[str, ...] = ()  # conditions of the proof, or the one that failed
    largest_step: float | None = None  # [s] inf for any; None in continuous time
    cycle: Attack | None = None  # with net energy
    sequences: int = 0  # tried without a proof

    @property
    def label(self) -> str:
        """The verdict in words; without a proof, what was tried."""
        if self.verdict == "tested":
            return f"tested on {self.sequences} sequences of one to three tones"
        return self.verdict


class _UnprovenError(Exception):
    """A condition of the proof fails, possibly at a pair of forward and backward speeds [rad/s]."""

    def __init__(self, reason: str, *speed_pairs: tuple[float, float]) -> None:
        super().__init__(reason)
        self.speed_pairs = speed_pairs


def _require(condition: object, reason: str, *speed_pairs: tuple[float, float]) -> None:
    if not condition:
        raise _UnprovenError(reason, *speed_pairs)


def certify(law: FrictionLaw, trained_range: TrainedRange) -> Certificate:
    """Prove the passivity of a law, refute it by a cycle, or return the condition that fails."""
    try:
        return _Proof(law).build_certificate()
    except _UnprovenError as error:
        slowest_speeds = (
            trained_range.speed * SLOWEST_SPEED,
            trained_range.speed * SLOWEST_SPEED**2,
            0.0,
        )
        speed_pairs = [
            (max(forward, slowest), max(backward, slowest))
            for (forward, backward), slowest in product(error.speed_pairs, slowest_speeds)
        ]
        cycle, sequences = attack(law, trained_range, speed_pairs)
        verdict: ProofVerdict = "tested"
        if cycle:
            verdict = "refuted"
        return Certificate(
            verdict=verdict, rests_on=(str(error),), cycle=cycle, sequences=sequences
        )


def has_proof(law: FrictionLaw) -> bool:
    """Return whether a proof of passivity exists, without a search for cycles."""
    try:
        _Proof(law).build_certificate()
    except _UnprovenError:
        return False
    return True


def find_min_viscous_scale(law: FrictionLaw) -> float:
    """Return the smallest factor on viscous friction that keeps the proof, else 0."""
    return find_scale_limits(law)[1][0]


def find_scale_limits(law: FrictionLaw) -> list[tuple[float, float | None]]:
    """Return limits of each factor of `SCALES` (None: any) that keep the proof of a proven law.

    Both remain 1 if either part alone could generate energy, or Coulomb friction covers ripple.
    """
    proof = _Proof(law)
    try:
        proof.build_certificate()
    except _UnprovenError:
        return [(0.0, None)] * len(SCALES)
    coulomb, viscous = proof.collect_scaled_parts()
    try:
        _require(coulomb == 0 or not proof.min_viscous_scale, "")
        for part in (coulomb, viscous):
            _SteadyTorque(part).find_viscous_bound()
    except _UnprovenError:
        return [(1.0, 1.0)] * len(SCALES)
    # Six digits, rounded up: the printed limit must keep the proof as well.
    rounded_scale = float(f"{proof.min_viscous_scale * (1.0 + 1e-5):.6g}")
    return [(0.0, None), (min(rounded_scale, 1.0), None)]


def find_storage_factors(law: FrictionLaw) -> Mapping[str, float]:
    """Return k of k x^2 [J per square of its unit] of each state in the storage of a proven law."""
    proof = _Proof(law)
    proof.build_certificate()
    return {
        element.name: proof.storage_factors.get(element.name, 0.0) for element in law.form.memory
    }


class _Proof:
    def __init__(self, law: FrictionLaw) -> None:
        self.law = law
        self.values = {
            quantity.symbol: sympy.Float(law.values[quantity.name])
            for quantity in law.form.coefficients
        }
        self.memory: tuple[Element, ...] = tuple(
            element.subs(self.values) for element in law.form.memory
        )
        self.zero_states: dict[sympy.Symbol, sympy.Expr] = {}
        for element in self.memory:
            self.zero_states[element.state] = sympy.S.Zero
            self.zero_states[element.derivative] = sympy.S.Zero
        self.output = law.form.output.xreplace(self.values)
        self.storage_factors: dict[str, float] = {}
        self.storage_terms: list[str] = []
        self.conditions: list[str] = []
        self.largest_step: float | None = inf
        self.min_viscous_scale = 0.0
        functions = self.output.atoms(sympy.Function)
        self._nonlinear_symbols = set[sympy.Symbol]().union(*(f.free_symbols for f in functions))

    def build_certificate(self) -> Certificate:
        damping = 0.0
        for element in self.memory:
            damping += self._prove_element(element)
        stateless_torque = self.output.xreplace(self.zero_states)
        state_torque = sum(self.output.diff(s) * s for s in self.zero_states if self.output.has(s))
        remainder = sympy.expand(self.output - stateless_torque - state_torque)
        _require(remainder == 0, "the torque is not linear in the states")
        terms = list(sympy.Add.make_args(sympy.expand_mul(stateless_torque)))
        load_terms = [term for term in terms if TAU_LOAD in term.free_symbols]
        self._prove_load_terms(load_terms)
        terms = [term for term in terms if TAU_LOAD not in term.free_symbols]
        wave_terms = [term for term in terms if Q in term.free_symbols]
        speed_terms = [term for term in terms if Q not in term.free_symbols]
        self._prove_viscous(sympy.Add(*speed_terms), wave_terms, damping)
        storage = "S = 0"
        if self.storage_terms:
            storage = f"S = {' + '.join(self.storage_terms)}"
        return Certificate(
            verdict="proven",
            storage=storage,
            rests_on=tuple(self.conditions),
            largest_step=self.largest_step,
        )

    def _prove_load_terms(self, terms: Sequence[sympy.Expr]) -> None:
        """Require that each term of the torque with the load brakes."""
        for term in terms:
            is_braking = is_never_negative(term / sgn(DQ))
            _require(is_braking, "the load is in the torque itself, not in a bound")
        if terms:
            self.conditions.append("factors of friction that rises with the load are >= 0")

    def _prove_element(self, element: Element) -> float:
        """Return the requirement on f [N.m.s/rad]."""
        state = element.state
        reason = f"the factor of {state} depends on inputs or states"
        # Before derivatives, which are slow of functions.
        _require(not self._nonlinear_symbols & {state, element.derivative}, reason)
        factor = self.output.diff(state)
        rate_factor = self.output.diff(element.derivative)
        if factor == 0 and rate_factor == 0:
            return 0.0
        _require(factor.is_number and rate_factor.is_number, reason)
        force = float(factor)
        damper = float(rate_factor)
        _require(force >= 0.0, f"the factor of {state} is negative, {force:.3g}")
        if isinstance(element, Stop):
            follows_joint = element.velocity == DQ and damper == 0.0
            _require(follows_joint, f"the velocity of the stop {state} is not that of the joint")
            storage_factor = force * float(element.deflection) / 2.0
            bound = format_expression(element.bound)
            self.conditions.append(f"F({state}) = {force:.3g} >= 0, bound {bound} >= 0")
        else:
            storage_factor = self._prove_bristle(element, force)
        self.storage_factors[element.name] = storage_factor
        self.storage_terms.append(f"{storage_factor:.3g} {state}^2")
        if damper == 0.0:
            return 0.0
        return self._find_damper_requirement(element, damper)

    def _prove_bristle(self, element: Relaxation, force: float) -> float:
        state = element.state
        gain = sympy.simplify(element.drive / DQ)
        is_proportional = gain.is_number and float(gain) > 0.0
        _require(is_proportional, f"the drive of {state} is not proportional to the velocity")
        inputs = element.rate.free_symbols
        if inputs <= {DQ}:
            bound = _find_lower_bound(element.rate, sufficient_bound=0.0)
            _require(bound >= 0.0, f"the rate of {state} has no bound >= 0 at all speeds")
        else:
            has_valid_rate = inputs <= {DQ, TAU_LOAD} and is_never_negative(element.rate)
            _require(has_valid_rate, f"the rate of {state} depends on more than velocity and load")
        self.conditions.append(f"F({state}) = {force:.3g} >= 0, rate of {state} >= 0")
        if self.law.discretisation != "exact":
            self.largest_step = None
        return force / (2.0 * float(gain))

    def _find_damper_requirement(self, element: Element, damper: float) -> float:
        """Return d (max k / min k - 1) for the rate |v| k(v), by Barabanov and Ortega."""
        if not isinstance(element, Relaxation) or damper < 0.0:
            raise _UnprovenError(f"the factor of {element.derivative} is negative, {damper:.3g}")
        is_constant = TAU_LOAD not in element.rate.free_symbols
        _require(is_constant, f"the rate of {element.name} with damping depends on the load")
        k = sympy.expand_mul(element.rate / absolute(DQ))
        lower = _find_lower_bound(k)
        upper = -_find_lower_bound(-k)
        _require(lower > 0.0, f"{element.name} has no steady deflection at some speed")
        gain = float(element.drive.diff(DQ))
        bound = f"{gain / lower:.3g} {element.unit}"
        self.conditions.append(f"|{element.name}| <= {bound} times coulomb_scale at the start")
        return damper * (upper / lower - 1.0) * gain

    def _prove_viscous(self, steady: sympy.Expr, waves: list[sympy.Expr], damping: float) -> None:
        depends_on_speed_only = steady.free_symbols <= {DQ}
        _require(
            depends_on_speed_only, "the torque without states depends on more than the velocity"
        )
        curve = _SteadyTorque(steady)
        viscous_bound = curve.find_viscous_bound()
        self.conditions.append(f"f(v) >= {viscous_bound:.3g} N.m.s/rad at all speeds")
        if damping > 0.0:

            def require_damping(speeds: Array) -> Array:
                return np.full_like(speeds, damping)

            share = curve.find_share(require_damping)
            _require(
                share >= 1.0 - _RELATIVE_ROUND_OFF,
                f"Barabanov and Ortega require {damping:.3g} N.m.s/rad of viscous friction, "
                f"found {viscous_bound:.3g}",
            )
            self.conditions.append(f"Barabanov and Ortega require {damping:.3g} of it")
            self.min_viscous_scale = 1.0 / share
        if waves:
            self._prove_ripple(waves, curve, damping)
        if abs(curve.offset) > curve.slack:
            # Over a full turn the position does not return: the offset does work of 2 pi times it.
            self.storage_terms.append(f"{curve.offset:.3g} q")
            self.conditions.append(
                f"the offset of {curve.offset:.3g} N.m does no work over a closed path"
            )
        self.min_viscous_scale = min(self.min_viscous_scale, 1.0)

    def collect_scaled_parts(self) -> list[sympy.Expr]:
        """Return the torque of speed alone that each factor of `SCALES` multiplies."""
        level = {larger(COULOMB.symbol, MIN_SCALE): COULOMB.symbol}
        torque = add_scales(self.law.form).output.xreplace(
            {**self.values, **self.zero_states, **level}
        )
        terms = sympy.Add.make_args(sympy.expand_mul(torque))
        speed_torque = sympy.Add(*(t for t in terms if not t.free_symbols & {Q, TAU_LOAD}))
        return [speed_torque.coeff(scale.symbol) for scale in SCALES]

    def _prove_ripple(
        self, waves: list[sympy.Expr], curve: "_SteadyTorque", damping: float
    ) -> None:
        amplitudes: dict[_WaveShape, list[float]] = {}
        for term in waves:
            shape, amplitude = _read_wave(term)
            amplitudes.setdefault(shape, []).append(amplitude)
        groups = [(_combine_amplitudes(group), *shape) for shape, group in amplitudes.items()]

        def find_margin(step: float) -> float:
            def require_viscosity(speeds: Array) -> Array:
                return damping + _compute_required_viscosity(groups, step, speeds)

            return curve.find_share(require_viscosity)

        def fails(step: float) -> bool:
            return find_margin(step) < 1.0 - 1e-6

        steps = _STEP_CANDIDATES
        if all(shape.window >= 0.0 for shape in amplitudes):
            steps = np.array([inf])
        holding_count = bisect_left(steps, True, key=fails)  # longer steps need more
        _require(
            holding_count, "lagging ripple generates more energy than viscous friction dissipates"
        )
        step = float(steps[holding_count - 1])
        self.min_viscous_scale = 1.0 / find_margin(step)
        if self.largest_step is not None:
            self.largest_step = min(self.largest_step, step)
        self.conditions.append(
            "f(v) >= sum_k A_k min(n_k c, 2/|v|) at all speeds, of lag, sampling and smoothing"
        )


class _WaveShape(NamedTuple):
    """What waves that add up have in common; see `laws.ripple`.

    Attributes
    ----------
    n : waves per turn.
    lag : of the angle behind the position [s].
    smoothing : time [s] over which speed lowers the amplitude.
    window : longest step [s] without averaging; negative if nothing is averaged.
    """

    n: float
    lag: float
    smoothing: float
    window: float


def _read_wave(term: sympy.Expr) -> tuple[_WaveShape, float]:
    """Return the shape and the amplitude [N.m] of a wave A sin(n q - n lag dq) or its cosine."""
    wave_functions = term.atoms(sympy.cos, sympy.sin)
    if len(wave_functions) != 1:
        raise _UnprovenError("the torque of position is not a sum of waves")
    (wave,) = wave_functions
    argument = wave.args[0]
    factor = term / wave
    n = argument.diff(Q)
    lag = -argument.subs({DT: 0, Q: 0}).diff(DQ)
    is_linear = n.is_number and float(n) != 0.0 and (lag / n).is_number
    _require(is_linear, "the argument of a wave is not linear in angle and speed")
    window = -1.0
    for mean in factor.atoms(cardinal_sine):
        window = next((-float(f.args[0].subs(DT, 0)) for f in mean.atoms(positive)), 0.0)
        factor = factor / mean
    amplitude = factor
    smoothing = 0.0
    if not factor.is_number:
        # It falls as 1 / (1 + (n smoothing dq)^2).
        amplitude = factor.subs(DQ, 0)
        smoothing_square = sympy.simplify((amplitude / factor - 1) / DQ**2)
        is_smoothing = amplitude.is_number and smoothing_square.is_number and smoothing_square >= 0
        _require(is_smoothing, "the amplitude of a wave depends on more than smoothing")
        smoothing = float(sympy.sqrt(smoothing_square)) / abs(float(n))
    return _WaveShape(abs(float(n)), float(lag / n), smoothing, window), float(amplitude)


def _combine_amplitudes(amplitudes: Sequence[float]) -> float:
    """Return a bound of the amplitude of a sum of waves; a pair is a cosine and a sine."""
    if len(amplitudes) == 2:
        return float(np.hypot(amplitudes[0], amplitudes[1]))
    return sum(map(abs, amplitudes))


class _SteadyTorque:
    """Steady torque r(v) + v p(v), whose viscous friction is f = (r - offset) / v + p."""

    def __init__(self, torque: sympy.Expr) -> None:
        terms = sympy.Add.make_args(sympy.expand_mul(torque))
        linear = [t for t in terms if t.as_powers_dict().get(DQ, 0) >= 1]
        self.p = sympy.Add(*(t / DQ for t in linear))
        self.constant, self.r = sympy.Add(*(t for t in terms if t not in linear)).as_coeff_Add()
        # At a speed of 1 rad/s either way.
        directions = np.array(_DIRECTIONS)
        torque_bounds = bound_expression(torque, {DQ: (directions, directions)})
        size = max(float(np.max(np.abs(torque_bounds))), 1e-12)
        unbounded = "the torque of steady motion has no sufficient bound at all speeds"
        _require(size < inf, unbounded)
        self.slack = _RELATIVE_ROUND_OFF * size

        def bound_torque(r: Array, p: Array, a: Array, b: Array) -> Array:
            return r + np.where(p >= 0.0, p * a, p * b)

        self.offset = 0.0
        forward_minimum, backward_minimum = self._find_minima(bound_torque)
        drop = -forward_minimum.value - backward_minimum.value
        forward_speed = max(forward_minimum.minimiser, _REST_SPEED)
        backward_speed = max(backward_minimum.minimiser, _REST_SPEED)
        _require(
            drop <= self.slack,
            f"forward at {forward_speed:.3g} rad/s friction is {drop:.3g} N.m less than backward "
            f"at {backward_speed:.3g} rad/s",
            (forward_speed, backward_speed),
        )
        _require(forward_minimum.bound + backward_minimum.bound >= -self.slack, unbounded)
        # The offset must lie between both directions, or round-off looks like negative friction.
        lower = -backward_minimum.bound
        upper = forward_minimum.bound
        self.offset = float(torque.subs(DQ, 0))
        if not lower - self.slack <= self.offset <= upper + self.slack:
            self.offset = min(max(self.offset, lower), upper)

    def find_viscous_bound(self) -> float:
        """Return a lower bound >= 0 of f [N.m.s/rad]."""

        def bound_viscous(r: Array, p: Array, a: Array, b: Array) -> Array:
            return self._bound_viscous(r, p, a, b, 0.0)

        minima = self._find_minima(bound_viscous)
        lowest_viscous = min(minimum.value for minimum in minima)
        bound = min(minimum.bound for minimum in minima)
        _require(
            lowest_viscous >= -self.slack,
            f"viscous friction is negative, {lowest_viscous:.3g} N.m.s/rad",
        )
        _require(bound >= -self.slack, "viscous friction has no bound >= 0 at all speeds")
        if bound <= self.slack:
            return 0.0
        return bound

    def find_share(self, required_viscosity: Callable[[Array], Array]) -> float:
        """Return a lower bound of f / `required_viscosity`, which must not rise with speed."""

        def bound_share(r: Array, p: Array, a: Array, b: Array) -> Array:
            requirement = required_viscosity(a)
            f = self._bound_viscous(r, p, a, b, requirement)
            return np.where(requirement > 0.0, f / requirement, inf)

        return min(minimum.bound for minimum in self._find_minima(bound_share))

    def _bound_viscous(
        self, r: Array, p: Array, a: Array, b: Array, requirement: Array | float
    ) -> Array:
        is_sufficient = r + np.minimum(p - requirement, 0.0) * b >= -self.slack
        f = p + np.where(r >= 0.0, r / b, r / a)
        return np.where(is_sufficient & (b <= _REST_SPEED), inf, f)

    def _find_minima(
        self, function: Callable[[Array, Array, Array, Array], Array]
    ) -> list[Minimum]:
        def bound_interval(direction: float, a: Array, b: Array) -> Array:
            speeds = _build_speed_interval(direction, a, b)
            lower, upper = bound_expression(self.r, {DQ: speeds})
            p = bound_expression(self.p, {DQ: speeds})[0]
            r = lower
            if direction < 0.0:
                r = -upper
            constant = direction * float(self.constant - self.offset)
            # Round-off of the offset, over a tiny speed, would be much viscous friction.
            if abs(constant) <= 1e-3 * self.slack:
                constant = 0.0
            r = r + constant
            with np.errstate(all="ignore"):
                return function(*np.broadcast_arrays(r, p, a, b))

        return [
            find_minimum(partial(bound_interval, direction), _SPEED_EDGES, size=1e6 * self.slack)
            for direction in _DIRECTIONS
        ]


def _build_speed_interval(direction: float, a: Array, b: Array) -> Enclosure:
    """Return speeds from `a` to `b` > 0 in a direction, in ascending order."""
    if direction > 0.0:
        return a, b
    return -b, -a


def _find_lower_bound(expression: sympy.Expr, sufficient_bound: float = inf) -> float:
    """Return a lower bound of a function of speed over all speeds, up to a sufficient one."""

    def bound_interval(direction: float, a: Array, b: Array) -> Array:
        speeds = _build_speed_interval(direction, a, b)
        lower, _ = bound_expression(expression, {DQ: speeds})
        return np.broadcast_to(lower, a.shape)

    bounds = []
    for direction in _DIRECTIONS:
        minimum = find_minimum(
            partial(bound_interval, direction), _SPEED_EDGES, sufficient_bound=sufficient_bound
        )
        bounds.append(minimum.bound)
    return min(bounds)


def _compute_required_viscosity(
    groups: Sequence[tuple[float, ...]], step: float, speeds: Array
) -> Array:
    """Return the viscous friction (K,) that waves need at speeds > 0, sampled by a step [s].

    Each of the `groups` is an amplitude [N.m] and a `_WaveShape`.
    """
    requirement = np.zeros_like(speeds)
    for amplitude, n, lag, smoothing, window in groups:
        # What is averaged over its own window does not see the step.
        sampling = window if window >= 0.0 else step
        c = distance(lag, sampling)
        requirement += amplitude * np.minimum(n * c, 2.0 / speeds)
        requirement += amplitude * np.minimum(n * smoothing / 2.0, 1.0 / speeds)
    return requirement
