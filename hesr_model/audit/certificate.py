"""Passivity of a law: proven by a storage function, refuted by a cycle with net energy, or open.

A storage function S >= 0 with tau dq >= dS for every step dq = v dt proves passivity. S is a sum of
k x^2 over states, and tau is read after they have moved. Torques of position alone are left out.

    stop       F x, F >= 0                 S = F w x^2 / 2, any step and change of its bound: a clip
                                           is a projection on a set that contains 0
    bristle    c x, x' = b v - r x, r >= 0 S = c x^2 / (2 b), any step of an exact relaxation
                                           and change of its rate r with speed and load
    level      sgn(v) g, g(v, load) >= 0   dissipates g |v|
    with       + d x'                      f >= d (max k / min k - 1): Barabanov and Ortega (2000),
                                           in continuous time
    f(v) v     f >= 0
    ripple     see `laws.stops.passive`: f at every speed above the energy of its lag
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Literal

import numpy as np
import sympy

from hesr_model.audit.attack import Attack, attack
from hesr_model.equations.functions import absolute, cardinal_sine, lowered, positive, sgn
from hesr_model.equations.memory import DT, Element, Relaxation, Stop
from hesr_model.friction.equation import text_of
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.stops.passive import SPEEDS, distance
from hesr_model.support.arrays import Array

ProofVerdict = Literal["proven", "refuted", "open"]
_ROUNDING = 1e-9  # relative
_STEPS = np.geomspace(1e-6, 10.0, 141)  # [s] candidates of the largest certified step


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Result of the passivity analysis of a law."""

    verdict: ProofVerdict
    storage: str = ""  # empty without a proof
    rests_on: tuple[str, ...] = ()  # conditions of the proof, or the one that failed
    largest_step: float | None = None  # [s] inf for any; None in continuous time
    cycle: Attack | None = None  # with net energy


class _UnprovenError(Exception):
    """A condition of the proof fails."""


def _require(condition: object, otherwise: str) -> None:
    if not condition:
        raise _UnprovenError(otherwise)


def certify(law: FrictionLaw, trained: TrainedRange) -> Certificate:
    """Prove the passivity of a law, refute it by a cycle, or return the open condition."""
    try:
        return _Proof(law).certificate()
    except _UnprovenError as reason:
        cycle = attack(law, trained)
        return Certificate(
            verdict="refuted" if cycle else "open", rests_on=(str(reason),), cycle=cycle
        )


def least_viscosity(law: FrictionLaw) -> float:
    """Return the smallest factor on viscous friction that keeps the proof, else 0."""
    proof = _Proof(law)
    try:
        proof.certificate()
    except _UnprovenError:
        return 0.0
    return proof.least


def storage(law: FrictionLaw) -> Mapping[str, float]:
    """Return k of k x^2 [J per square of its unit] of each state in the storage of a proven law."""
    proof = _Proof(law)
    proof.certificate()
    return {m.name: proof.stored.get(m.name, 0.0) for m in law.form.memory}


class _Proof:
    def __init__(self, law: FrictionLaw) -> None:
        self.law = law
        numbers = {c.symbol: sympy.Float(law.values[c.name]) for c in law.form.coefficients}
        self.memory: tuple[Element, ...] = tuple(m.subs(numbers) for m in law.form.memory)
        self.output = law.form.output.xreplace(numbers)
        self.stored: dict[str, float] = {}
        self.texts: list[str] = []
        self.conditions: list[str] = []
        self.step: float | None = inf
        self.least = 0.0

    def certificate(self) -> Certificate:
        states = {s: sympy.Integer(0) for m in self.memory for s in (m.state, m.derivative)}
        damping = 0.0
        for element in self.memory:
            damping += self._element(element)
        rest = self.output.xreplace(states)
        linear = sum(self.output.diff(s) * s for s in states if self.output.has(s))
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

    @cached_property
    def _curved(self) -> set[sympy.Symbol]:
        """Symbols in the arguments of functions."""
        return set().union(*(f.free_symbols for f in self.output.atoms(sympy.Function)))

    def _element(self, element: Element) -> float:
        """Return the requirement on f [N.m.s/rad]."""
        x = element.state
        linear = f"the factor of {x} depends on inputs or states"
        _require(not self._curved & {x, element.derivative}, linear)  # avoids slow derivatives
        factor, rate_factor = self.output.diff(x), self.output.diff(element.derivative)
        if factor == 0 and rate_factor == 0:
            return 0.0
        _require(factor.is_number and rate_factor.is_number, linear)
        force, damper = float(factor), float(rate_factor)
        _require(force >= 0.0, f"the factor of {x} is negative, {force:.3g}")
        if isinstance(element, Stop):
            own = element.velocity == DQ and damper == 0.0
            _require(own, f"the velocity of the stop {x} is not that of the joint")
            k = force * float(element.deflection) / 2.0
            self.conditions.append(
                f"F({x}) = {force:.3g} >= 0, bound {text_of(element.bound)} >= 0"
            )
        else:
            k = self._bristle(element, force)
        self.stored[element.name] = k
        self.texts.append(f"{k:.3g} {x}^2")
        if damper == 0.0:
            return 0.0
        return self._damper(element, damper)

    def _bristle(self, element: Relaxation, force: float) -> float:
        x = element.state
        gain = sympy.simplify(element.drive / DQ)
        proportional = gain.is_number and float(gain) > 0.0
        _require(proportional, f"the drive of {x} is not proportional to the velocity")
        inputs = element.rate.free_symbols
        if inputs <= {DQ}:
            rate = _values(element.rate, np.concatenate([-SPEEDS[::-1], SPEEDS]))
            _require(rate.min() >= 0.0, f"the rate of {x} is negative at some speed")
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
        speeds = SPEEDS[1:]
        k = np.concatenate([_values(element.rate, s * speeds) / speeds for s in (1.0, -1.0)])
        _require(k.min() > 0.0, f"{element.name} has no steady deflection at some speed")
        self.step = None
        return damper * (float(k.max() / k.min()) - 1.0) * float(element.drive.diff(DQ))

    def _viscous(self, steady: sympy.Expr, waves: list[sympy.Expr], damping: float) -> None:
        speeds = SPEEDS[1:]
        own = steady.free_symbols <= {DQ}
        _require(own, "the torque without states depends on more than the velocity")
        ahead, back = _values(steady, speeds), _values(steady, -speeds)
        # A constant offset between forward and backward torques does no work over a closed path.
        low, high = float(back.max()), float(ahead.min())
        scale = max(float(np.abs([ahead, back]).max()), 1e-12)
        v = (speeds[ahead.argmin()], speeds[back.argmax()])
        _require(
            low <= high + _ROUNDING * scale,
            f"ahead at {v[0]:.3g} rad/s friction is {low - high:.3g} N.m less than back at "
            f"{v[1]:.3g} rad/s",
        )
        least = low if low == high else float(_values(steady, np.zeros(1))[0])
        offset = min(max(least, low), high)
        f = np.minimum(ahead - offset, offset - back) / speeds
        known = float(f.min())
        positive_f = known >= -_ROUNDING * scale
        _require(positive_f, f"viscous friction is negative, {known:.3g} N.m.s/rad")
        self.conditions.append(f"f(v) >= {max(known, 0.0):.3g} N.m.s/rad at all speeds")
        if damping > 0.0:
            _require(
                np.min(f - damping) >= -_ROUNDING * damping,
                f"Barabanov and Ortega require {damping:.3g} N.m.s/rad of viscous friction, "
                f"found {known:.3g}",
            )
            self.conditions.append(f"Barabanov and Ortega require {damping:.3g} of it")
        need = np.full_like(f, damping)
        if waves:
            need += self._ripple(waves, f - damping)
        self.least = float(np.max(need / np.maximum(f, np.finfo(float).tiny)))

    def _ripple(self, waves: list[sympy.Expr], f: Array) -> Array:
        """Return the requirement on f at each speed [N.m.s/rad]."""
        found: dict[tuple[float, float, float, float], list[float]] = {}
        for term in waves:
            wave = next(iter(term.atoms(sympy.cos, sympy.sin)), None)
            if wave is None or len(term.atoms(sympy.cos, sympy.sin)) != 1:
                raise _UnprovenError("the torque of position is not a sum of waves")
            argument, factor = wave.args[0], term / wave
            n = argument.diff(Q)
            lag = -argument.subs({DT: 0, Q: 0}).diff(DQ)
            linear = n.is_number and float(n) != 0.0 and (lag / n).is_number
            _require(linear, "the argument of a wave is not linear in angle and speed")
            window = -1.0
            for mean in factor.atoms(cardinal_sine):
                window = _window(mean)
                factor = factor / mean
            amplitude, smoothing = factor, 0.0
            if not factor.is_number:
                amplitude = factor.subs(DQ, 0)
                slow = sympy.simplify((amplitude / factor - 1) / DQ**2)
                smoothed = amplitude.is_number and slow.is_number and slow >= 0
                _require(smoothed, "the amplitude of a wave is not a smoothed one")
                smoothing = float(sympy.sqrt(slow)) / abs(float(n))
            key = (abs(float(n)), float(lag / n), smoothing, window)
            found.setdefault(key, []).append(float(amplitude))
        groups = [
            (float(np.hypot(a[0], a[1])) if len(a) == 2 else sum(map(abs, a)), *key)
            for key, a in found.items()
        ]
        any_step = all(window >= 0.0 for *_, window in groups)
        steps = [h for h in ([inf] if any_step else _STEPS) if _holds(groups, f, float(h))]
        _require(steps, "lagging ripple generates more energy than viscous friction dissipates")
        step = float(steps[-1])
        self.step = None if self.step is None else min(self.step, step)
        self.conditions.append(
            "f(v) >= sum_k A_k min(n_k c, 2/|v|) at all speeds, of lag, sampling and smoothing"
        )
        return _needed(groups, step)


def never_negative(expression: sympy.Expr) -> bool:
    """Return True if signs alone prove an expression >= 0 for all real inputs."""
    e = expression
    if e.is_number:
        return bool(e >= 0)
    if isinstance(e, sympy.exp | absolute | positive):
        return True
    if isinstance(e, sympy.Pow):
        return bool(e.exp.is_even) or never_negative(e.base)
    return isinstance(e, sympy.Add | sympy.Mul) and all(map(never_negative, e.args))


def _holds(groups: Sequence[tuple[float, ...]], f: Array, step: float) -> bool:
    return bool(np.all(f >= _needed(groups, step) * (1.0 - 1e-6)))


def _needed(groups: Sequence[tuple[float, ...]], step: float) -> Array:
    speeds = SPEEDS[1:]
    need = np.zeros_like(speeds)
    for amplitude, n, lag, smoothing, window in groups:
        c = distance(lag, window if window >= 0.0 else step)
        need += amplitude * np.minimum(n * c, 2.0 / speeds)
        need += amplitude * np.minimum(n * smoothing / 2.0, 1.0 / speeds)
    return need


def _window(mean: sympy.Expr) -> float:
    """Return the longest step [s] without averaging of a wave."""
    for part in mean.atoms(sympy.Function):
        if part.func.__name__ == "positive":
            return -float(part.args[0].subs(DT, 0))
    return 0.0


def _values(expression: sympy.Expr, speeds: Array) -> Array:
    with np.errstate(all="ignore"):
        found = np.broadcast_to(lowered([DQ], [expression])(speeds)[0], speeds.shape)
    _require(np.all(np.isfinite(found)), "the law is not finite at some speeds")
    return np.asarray(found, dtype=float)
