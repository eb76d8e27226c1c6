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
from math import inf
from typing import Literal

import numpy as np
import sympy

from hesr_model.audit.attack import Attack, attack
from hesr_model.audit.audit import SLOWEST
from hesr_model.equations.functions import absolute, cardinal_sine, larger, positive, sgn
from hesr_model.equations.intervals import (
    Enclosure,
    Least,
    bound_expression,
    lowest,
    never_negative,
)
from hesr_model.equations.memory import DT, Element, Relaxation, Stop
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw, text_of
from hesr_model.friction.scales import COULOMB, LEAST, SCALES, scaled
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.stops.form import distance
from hesr_model.support.arrays import Array

ProofVerdict = Literal["proven", "refuted", "tested"]
_ROUNDING = 1e-9  # relative
_STEPS = np.geomspace(1e-6, 10.0, 141)  # [s] candidates of the largest certified step
_REST = 1e-12  # [rad/s]; below, only torques above round-off count
_EDGES = np.concatenate([[1e-300], np.geomspace(_REST, 1e6, 73)])  # [rad/s]
_WAYS = (1.0, -1.0)


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
        """The verdict in words."""
        return f"tested on {self.sequences} sequences" if self.verdict == "tested" else self.verdict


class _UnprovenError(Exception):
    """A condition of the proof fails, possibly at a pair of forward and backward speeds [rad/s]."""

    def __init__(self, why: str, *speeds: tuple[float, float]) -> None:
        super().__init__(why)
        self.speeds = speeds


def _require(condition: object, otherwise: str, *speeds: tuple[float, float]) -> None:
    if not condition:
        raise _UnprovenError(otherwise, *speeds)


def certify(law: FrictionLaw, trained_range: TrainedRange) -> Certificate:
    """Prove the passivity of a law, refute it by a cycle, or return the condition that fails."""
    try:
        return _Proof(law).certificate()
    except _UnprovenError as reason:
        slowest = (trained_range.speed * SLOWEST, trained_range.speed * SLOWEST**2, 0.0)
        pairs = [(max(v, s), max(w, s)) for v, w in reason.speeds for s in slowest]
        cycle, tried = attack(law, trained_range, pairs)
        verdict: ProofVerdict = "refuted" if cycle else "tested"
        return Certificate(verdict=verdict, rests_on=(str(reason),), cycle=cycle, sequences=tried)


def proven(law: FrictionLaw) -> bool:
    """Return whether a proof of passivity exists, without a search for cycles."""
    try:
        _Proof(law).certificate()
    except _UnprovenError:
        return False
    return True


def least_viscosity(law: FrictionLaw) -> float:
    """Return the smallest factor on viscous friction that keeps the proof, else 0."""
    return scale_limits(law)[1][0]


def scale_limits(law: FrictionLaw) -> list[tuple[float, float | None]]:
    """Return limits of each factor of `SCALES` (None: any) that keep the proof of a proven law.

    Both remain 1 if either part alone could generate energy, or Coulomb friction covers ripple.
    """
    proof = _Proof(law)
    try:
        proof.certificate()
    except _UnprovenError:
        return [(0.0, None)] * len(SCALES)
    coulomb, viscous = proof.scaled_parts()
    try:
        _require(coulomb == 0 or not proof.least, "")
        for part in (coulomb, viscous):
            _Steady(part).least_viscous()
    except _UnprovenError:
        return [(1.0, 1.0)] * len(SCALES)
    least = min(float(f"{proof.least * (1.0 + 1e-5):.6g}"), 1.0)  # rounded up
    return [(0.0, None), (least, None)]


def storage(law: FrictionLaw) -> Mapping[str, float]:
    """Return k of k x^2 [J per square of its unit] of each state in the storage of a proven law."""
    proof = _Proof(law)
    proof.certificate()
    return {element.name: proof.stored.get(element.name, 0.0) for element in law.form.memory}


class _Proof:
    def __init__(self, law: FrictionLaw) -> None:
        self.law = law
        self.numbers = {
            quantity.symbol: sympy.Float(law.values[quantity.name])
            for quantity in law.form.coefficients
        }
        self.memory: tuple[Element, ...] = tuple(
            element.subs(self.numbers) for element in law.form.memory
        )
        self.still = {
            s: sympy.S.Zero for element in self.memory for s in (element.state, element.derivative)
        }
        self.output = law.form.output.xreplace(self.numbers)
        self.stored: dict[str, float] = {}
        self.texts: list[str] = []
        self.conditions: list[str] = []
        self.step: float | None = inf
        self.least = 0.0
        functions = self.output.atoms(sympy.Function)
        self._curved = set[sympy.Symbol]().union(*(f.free_symbols for f in functions))

    def certificate(self) -> Certificate:
        damping = 0.0
        for element in self.memory:
            damping += self._element(element)
        rest = self.output.xreplace(self.still)
        linear = sum(self.output.diff(s) * s for s in self.still if self.output.has(s))
        remainder = sympy.expand(self.output - rest - linear)
        _require(remainder == 0, "the torque is not linear in the states")
        terms = list(sympy.Add.make_args(sympy.expand_mul(rest)))
        levels = [term for term in terms if TAU_LOAD in term.free_symbols]
        for term in levels:
            braking = never_negative(term / sgn(DQ))
            _require(braking, "the load is in the torque itself, not in a bound")
            terms.remove(term)
        if levels:
            self.conditions.append("factors of friction that rises with the load are >= 0")
        waves = [term for term in terms if Q in term.free_symbols]
        self._viscous(sympy.Add(*(t for t in terms if Q not in t.free_symbols)), waves, damping)
        return Certificate(
            verdict="proven",
            storage=f"S = {' + '.join(self.texts)}" if self.texts else "S = 0",
            rests_on=tuple(self.conditions),
            largest_step=self.step,
        )

    def _element(self, element: Element) -> float:
        """Return the requirement on f [N.m.s/rad]."""
        x = element.state
        linear = f"the factor of {x} depends on inputs or states"
        _require(not self._curved & {x, element.derivative}, linear)  # avoids slow derivatives
        factor = self.output.diff(x)
        rate_factor = self.output.diff(element.derivative)
        if factor == 0 and rate_factor == 0:
            return 0.0
        _require(factor.is_number and rate_factor.is_number, linear)
        force = float(factor)
        damper = float(rate_factor)
        _require(force >= 0.0, f"the factor of {x} is negative, {force:.3g}")
        if isinstance(element, Stop):
            own = element.velocity == DQ and damper == 0.0
            _require(own, f"the velocity of the stop {x} is not that of the joint")
            k = force * float(element.deflection) / 2.0
            bound = text_of(element.bound)
            self.conditions.append(f"F({x}) = {force:.3g} >= 0, bound {bound} >= 0")
        else:
            k = self._bristle(element, force)
        self.stored[element.name] = k
        self.texts.append(f"{k:.3g} {x}^2")
        return 0.0 if damper == 0.0 else self._damper(element, damper)

    def _bristle(self, element: Relaxation, force: float) -> float:
        x = element.state
        gain = sympy.simplify(element.drive / DQ)
        proportional = gain.is_number and float(gain) > 0.0
        _require(proportional, f"the drive of {x} is not proportional to the velocity")
        inputs = element.rate.free_symbols
        if inputs <= {DQ}:
            bound = _least_of(element.rate, enough=0.0)
            _require(bound >= 0.0, f"the rate of {x} has no bound >= 0 at all speeds")
        else:
            known = inputs <= {DQ, TAU_LOAD} and never_negative(element.rate)
            _require(known, f"the rate of {x} depends on more than velocity and load")
        self.conditions.append(f"F({x}) = {force:.3g} >= 0, rate of {x} >= 0")
        if self.law.discretisation != "exact":
            self.step = None
        return force / (2.0 * float(gain))

    def _damper(self, element: Element, damper: float) -> float:
        """Return d (max k / min k - 1) for the rate |v| k(v), by Barabanov and Ortega."""
        if not isinstance(element, Relaxation) or damper < 0.0:
            raise _UnprovenError(f"the factor of {element.derivative} is negative, {damper:.3g}")
        constant = TAU_LOAD not in element.rate.free_symbols
        _require(constant, f"the rate of {element.name} with damping depends on the load")
        k = sympy.expand_mul(element.rate / absolute(DQ))
        low = _least_of(k)
        high = -_least_of(-k)
        _require(low > 0.0, f"{element.name} has no steady deflection at some speed")
        gain = float(element.drive.diff(DQ))
        bound = f"{gain / low:.3g} {element.unit}"
        self.conditions.append(f"|{element.name}| <= {bound} times coulomb_scale at the start")
        return damper * (high / low - 1.0) * gain

    def _viscous(self, steady: sympy.Expr, waves: list[sympy.Expr], damping: float) -> None:
        own = steady.free_symbols <= {DQ}
        _require(own, "the torque without states depends on more than the velocity")
        curve = _Steady(steady)
        known = curve.least_viscous()
        self.conditions.append(f"f(v) >= {known:.3g} N.m.s/rad at all speeds")
        if damping > 0.0:
            share = curve.share(lambda v: np.full_like(v, damping))
            _require(
                share >= 1.0 - _ROUNDING,
                f"Barabanov and Ortega require {damping:.3g} N.m.s/rad of viscous friction, "
                f"found {known:.3g}",
            )
            self.conditions.append(f"Barabanov and Ortega require {damping:.3g} of it")
            self.least = 1.0 / share
        if waves:
            self._ripple(waves, curve, damping)
        self.least = min(self.least, 1.0)

    def scaled_parts(self) -> list[sympy.Expr]:
        """Return the torque of speed alone that each factor of `SCALES` multiplies."""
        level = {larger(COULOMB.symbol, LEAST): COULOMB.symbol}
        torque = scaled(self.law.form).output.xreplace({**self.numbers, **self.still, **level})
        terms = sympy.Add.make_args(sympy.expand_mul(torque))
        own = sympy.Add(*(t for t in terms if not t.free_symbols & {Q, TAU_LOAD}))
        return [own.coeff(scale.symbol) for scale in SCALES]

    def _ripple(self, waves: list[sympy.Expr], curve: "_Steady", damping: float) -> None:
        found: dict[tuple[float, float, float, float], list[float]] = {}
        for term in waves:
            wave = next(iter(term.atoms(sympy.cos, sympy.sin)), None)
            if wave is None or len(term.atoms(sympy.cos, sympy.sin)) != 1:
                raise _UnprovenError("the torque of position is not a sum of waves")
            argument = wave.args[0]
            factor = term / wave
            n = argument.diff(Q)
            lag = -argument.subs({DT: 0, Q: 0}).diff(DQ)
            linear = n.is_number and float(n) != 0.0 and (lag / n).is_number
            _require(linear, "the argument of a wave is not linear in angle and speed")
            window = -1.0  # longest step [s] without averaging
            for mean in factor.atoms(cardinal_sine):
                window = next((-float(f.args[0].subs(DT, 0)) for f in mean.atoms(positive)), 0.0)
                factor = factor / mean
            amplitude = factor
            smoothing = 0.0
            if not factor.is_number:
                amplitude = factor.subs(DQ, 0)
                slow = sympy.simplify((amplitude / factor - 1) / DQ**2)
                smoothed = amplitude.is_number and slow.is_number and slow >= 0
                _require(smoothed, "the amplitude of a wave depends on more than smoothing")
                smoothing = float(sympy.sqrt(slow)) / abs(float(n))
            key = (abs(float(n)), float(lag / n), smoothing, window)
            found.setdefault(key, []).append(float(amplitude))
        groups = [
            (float(np.hypot(a[0], a[1])) if len(a) == 2 else sum(map(abs, a)), *key)
            for key, a in found.items()
        ]
        any_step = all(window >= 0.0 for *_, window in groups)

        def share(step: float) -> float:
            return curve.share(lambda v: damping + _needed(groups, step, v))

        def fails(step: float) -> bool:
            return share(step) < 1.0 - 1e-6

        steps = np.array([inf]) if any_step else _STEPS
        holding = bisect_left(steps, True, key=fails)  # longer steps need more
        _require(holding, "lagging ripple generates more energy than viscous friction dissipates")
        step = float(steps[holding - 1])
        self.least = 1.0 / share(step)
        self.step = None if self.step is None else min(self.step, step)
        self.conditions.append(
            "f(v) >= sum_k A_k min(n_k c, 2/|v|) at all speeds, of lag, sampling and smoothing"
        )


class _Steady:
    """Steady torque r(v) + v p(v), whose viscous friction is f = (r - offset) / v + p."""

    def __init__(self, torque: sympy.Expr) -> None:
        terms = sympy.Add.make_args(sympy.expand_mul(torque))
        linear = [t for t in terms if t.as_powers_dict().get(DQ, 0) >= 1]
        self.p = sympy.Add(*(t / DQ for t in linear))
        self.constant, self.r = sympy.Add(*(t for t in terms if t not in linear)).as_coeff_Add()
        ways = np.array(_WAYS)
        size = max(float(np.max(np.abs(bound_expression(torque, {DQ: (ways, ways)})))), 1e-12)
        unbounded = "the torque of steady motion has no sufficient bound at all speeds"
        _require(size < inf, unbounded)
        self.slack = _ROUNDING * size
        self.offset = 0.0
        ahead, back = self._least(lambda r, p, a, b: r + np.where(p >= 0.0, p * a, p * b))
        drop = -ahead.value - back.value
        v = max(ahead.at, _REST)
        w = max(back.at, _REST)
        _require(
            drop <= self.slack,
            f"forward at {v:.3g} rad/s friction is {drop:.3g} N.m less than backward at {w:.3g} "
            "rad/s",
            (v, w),
        )
        _require(ahead.bound + back.bound >= -self.slack, unbounded)
        self.offset = float(torque.subs(DQ, 0))
        if not -back.bound - self.slack <= self.offset <= ahead.bound + self.slack:
            self.offset = min(max(self.offset, -back.bound), ahead.bound)

    def least_viscous(self) -> float:
        """Return a lower bound >= 0 of f [N.m.s/rad]."""
        found = self._least(lambda r, p, a, b: self._viscous(r, p, a, b, 0.0))
        value = min(one.value for one in found)
        bound = min(one.bound for one in found)
        _require(value >= -self.slack, f"viscous friction is negative, {value:.3g} N.m.s/rad")
        _require(bound >= -self.slack, "viscous friction has no bound >= 0 at all speeds")
        return bound if bound > self.slack else 0.0

    def share(self, need: Callable[[Array], Array]) -> float:
        """Return a lower bound of f / need, which must not rise with speed."""

        def share(r: Array, p: Array, a: Array, b: Array) -> Array:
            f = self._viscous(r, p, a, b, need(a))
            needed = need(a)
            return np.where(needed > 0.0, f / needed, inf)

        return min(one.bound for one in self._least(share))

    def _viscous(self, r: Array, p: Array, a: Array, b: Array, need: Array | float) -> Array:
        enough = r + np.minimum(p - need, 0.0) * b >= -self.slack
        f = p + np.where(r >= 0.0, r / b, r / a)
        return np.where(enough & (b <= _REST), inf, f)

    def _least(self, of: Callable[[Array, Array, Array, Array], Array]) -> list[Least]:
        def bound(way: float, a: Array, b: Array) -> Array:
            low, high = bound_expression(self.r, {DQ: _speeds(way, a, b)})
            p = bound_expression(self.p, {DQ: _speeds(way, a, b)})[0]
            constant = way * float(self.constant - self.offset)
            r = (low if way > 0.0 else -high) + constant * (abs(constant) > 1e-3 * self.slack)
            with np.errstate(all="ignore"):
                return of(*np.broadcast_arrays(r, p, a, b))

        return [lowest(partial(bound, way), _EDGES, size=1e6 * self.slack) for way in _WAYS]


def _speeds(way: float, a: Array, b: Array) -> Enclosure:
    return (a, b) if way > 0.0 else (-b, -a)


def _least_of(expression: sympy.Expr, enough: float = inf) -> float:
    def bound(way: float, a: Array, b: Array) -> Array:
        return np.broadcast_to(bound_expression(expression, {DQ: _speeds(way, a, b)})[0], a.shape)

    return min(lowest(partial(bound, way), _EDGES, enough=enough).bound for way in _WAYS)


def _needed(groups: Sequence[tuple[float, ...]], step: float, speeds: Array) -> Array:
    need = np.zeros_like(speeds)
    for amplitude, n, lag, smoothing, window in groups:
        c = distance(lag, window if window >= 0.0 else step)
        need += amplitude * np.minimum(n * c, 2.0 / speeds)
        need += amplitude * np.minimum(n * smoothing / 2.0, 1.0 / speeds)
    return need
