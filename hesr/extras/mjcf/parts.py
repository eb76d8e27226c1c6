"""Friction laws as parts of MuJoCo.

A passive dcmotor (no input, no electrical branch; XML reference of MuJoCo 4, actuator/dcmotor:
lugre, damping, cogging) puts on its joint

    - (stiffness z + damping z') - viscous v + amplitude sin(poles q + phase)
    z' = v - stiffness |v| / g(v) z,    g = coulomb + (static - coulomb) exp(-(v / stribeck)^2)

With the state x = k z, a relaxation x' = k v - r x is a bristle whose stiffness is k times the
torque per x; with a constant level g = stiffness |v| / r it is a Dahl element. A constant torque is
a cogging without poles.
"""

import math
from collections.abc import Mapping, Set
from dataclasses import dataclass
from typing import Self

import sympy

from fmu_src.friction.validity import to_text
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import DQ, INPUTS, TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw
from hesr_model.units import unit_of_joint

Values = Mapping[sympy.Symbol, float]


class NoCounterpartError(ExportError):
    """A law has a term, described with `{unit}`, without a counterpart in MuJoCo."""

    def __init__(self, text: str, unit: str = "1") -> None:
        super().__init__(text.replace("{unit}", unit))
        self._text = text
        self._unit = unit

    def format_for_joint(self, *, is_prismatic: bool) -> str:
        """Return the text in the unit of the joint."""
        return self._text.replace("{unit}", unit_of_joint(self._unit, is_prismatic=is_prismatic))


@dataclass(frozen=True, kw_only=True)
class Bristle:
    """LuGre element: stiffness [N.m/rad], damping [N.m.s/rad], levels [N.m], velocity [rad/s]."""

    stiffness: float
    damping: float
    coulomb: float
    static: float
    stribeck: float


@dataclass(frozen=True, kw_only=True)
class Wave:
    """Torque amplitude [N.m] sin(poles q + phase [rad]), any number of poles."""

    amplitude: float
    poles: float
    phase: float


@dataclass(frozen=True, kw_only=True)
class JointFriction:
    """Friction of one joint; viscous in [N.m.s/rad]."""

    bristles: tuple[Bristle, ...]
    viscous: float
    waves: tuple[Wave, ...]


def find_parts(law: FrictionLaw) -> JointFriction:
    """Return the exact parts for a law; raises NoCounterpartError."""
    form = law.form
    _require_bristles_at_rest(law)
    values = {coefficient.symbol: law.values[coefficient.name] for coefficient in form.coefficients}
    zeros = {symbol: 0 for symbol, value in values.items() if value == 0.0}
    motions = [_Motion.from_relaxation(r, zeros, values) for r in form.relaxations]
    if form.relaxations and law.discretisation != "exact":
        raise NoCounterpartError("it has Euler steps, and MuJoCo relaxes a bristle exactly")
    forces = {}  # torque per state, and per its derivative
    for relaxation in form.relaxations:
        forces[relaxation.state] = sympy.S.Zero
        forces[relaxation.derivative] = sympy.S.Zero
    viscous = 0.0
    waves = []
    for term in sympy.Add.make_args(sympy.expand_mul(form.output.subs(zeros))):
        states = forces.keys() & term.free_symbols
        linear = _split_linear_term(term, states)
        if linear is not None:
            symbol, factor = linear
            if symbol in states:
                forces[symbol] += factor
            else:
                viscous += _evaluate(factor, values, "its viscous friction")
        elif states:
            raise _refuse_term(term)
        else:
            waves.append(_build_wave(term, values))
    bristles = []
    for relaxation, motion in zip(form.relaxations, motions, strict=True):
        bristle = _build_bristle(
            relaxation, motion, forces[relaxation.state], forces[relaxation.derivative], values
        )
        if bristle is not None:
            bristles.append(bristle)
    return JointFriction(bristles=tuple(bristles), viscous=viscous, waves=tuple(waves))


def _require_bristles_at_rest(law: FrictionLaw) -> None:
    """Raise NoCounterpartError unless all states relax and start at 0."""
    if law.form.stops:
        raise NoCounterpartError(
            f"its state '{law.form.stops[0].name}' is a stop, and MuJoCo's bristles relax"
        )
    for relaxation, start in zip(law.form.relaxations, law.start, strict=True):
        if start:
            raise NoCounterpartError(
                f"its state '{relaxation.name}' starts at {start:g}, MuJoCo's at 0"
            )


def _split_linear_term(
    term: sympy.Expr, states: Set[sympy.Symbol]
) -> tuple[sympy.Symbol, sympy.Expr] | None:
    """Return the state of a term, or the velocity, and its constant factor; None if not linear.

    `states` are those in the term, with their derivatives; a product of two is not linear in one.
    """
    for symbol in states or {DQ}:
        factor = term / symbol
        if not _uses_inputs(factor) and not states & factor.free_symbols:
            return symbol, factor
    return None


def _build_wave(term: sympy.Expr, values: Values) -> Wave:
    """Return the cogging of a term of constants and the position, or raise NoCounterpartError."""
    if not _uses_inputs(term):
        torque = _evaluate(term, values, "a term of its torque")
        return Wave(amplitude=-torque, poles=0.0, phase=math.pi / 2.0)
    wave = _find_wave(term, values)
    if wave is None:
        raise _refuse_term(term)
    return wave


def _refuse_term(term: sympy.Expr) -> NoCounterpartError:
    if TAU_LOAD in term.free_symbols:
        return NoCounterpartError(
            f"its torque has the term {to_text(term)}, which depends on the load"
        )
    return NoCounterpartError(
        f"its torque has the term {to_text(term)}, which is neither a bristle's nor "
        "viscous nor a ripple in the joint's angle alone"
    )


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """Bristle x' = scale v - rate |v| x; scale of x against the deflection z."""

    scale: sympy.Expr
    rate: sympy.Expr  # with `_PEAK` for `peak`
    peak: sympy.Expr | None  # exp(-(v / v_s)^2)
    stribeck: float | None  # v_s [rad/s]

    @classmethod
    def from_relaxation(
        cls, relaxation: Relaxation, zeros: Mapping[sympy.Symbol, int], values: Values
    ) -> Self:
        drive = relaxation.drive.subs(zeros)
        rate = relaxation.rate.subs(zeros)
        scale = sympy.cancel(drive / DQ)
        state_label = f"its state '{relaxation.name}'"
        if _uses_inputs(scale) or _evaluate(scale, values, f"the drive of {state_label}") <= 0.0:
            raise NoCounterpartError(
                f"{state_label} is driven by {to_text(drive)}, a bristle by the velocity itself"
            )
        peaks = [exponential for exponential in rate.atoms(sympy.exp) if _uses_inputs(exponential)]
        peak = None
        stribeck = None
        if len(peaks) == 1:
            peak = peaks[0]
            stribeck = _find_stribeck_velocity(peak, values, state_label)
        speed = sympy.Dummy(positive=True)
        rate_of_speed = rate.subs(dict.fromkeys(peaks, _PEAK)).subs(absolute(DQ), speed)
        slope = sympy.cancel(rate_of_speed / speed)
        is_shape_supported = not peaks or stribeck is not None
        if not is_shape_supported or speed in slope.free_symbols or _uses_inputs(slope):
            raise NoCounterpartError(
                f"{state_label} relaxes at the rate {to_text(rate)}, a bristle in proportion "
                "to the speed with one Stribeck peak at most"
            )
        return cls(scale=scale, rate=slope, peak=peak, stribeck=stribeck)


_PEAK = sympy.Symbol("_peak", positive=True)  # exp(-(v / v_s)^2): 1 at rest, 0 at speed


def _find_stribeck_velocity(peak: sympy.Expr, values: Values, state_label: str) -> float | None:
    square = sympy.cancel(-(DQ**2) / peak.args[0])
    label = f"the Stribeck velocity of {state_label}"
    if _uses_inputs(square) or _evaluate(square, values, label) <= 0.0:
        return None
    return _evaluate(sympy.sqrt(square), values, label)


def _find_wave(term: sympy.Expr, values: Values) -> Wave | None:
    for function, phase_shift in ((sympy.sin, 0.0), (sympy.cos, math.pi / 2.0)):
        for wave in term.atoms(function):
            factor = term / wave
            angle = sympy.expand_mul(wave.args[0])
            poles = angle.coeff(Q, 1)
            phase = angle.coeff(Q, 0)
            is_linear = sympy.expand_mul(angle - poles * Q - phase) == 0
            if is_linear and not any(map(_uses_inputs, (factor, poles, phase))):
                return Wave(
                    amplitude=-_evaluate(factor, values, "the amplitude of its ripple"),
                    poles=_evaluate(poles, values, "the waves per radian of its ripple"),
                    phase=_evaluate(phase, values, "the phase of its ripple") + phase_shift,
                )
    return None


def _build_bristle(
    relaxation: Relaxation,
    motion: _Motion,
    force: sympy.Expr,
    damping: sympy.Expr,
    values: Values,
) -> Bristle | None:
    stiffness = force * motion.scale
    state_label = f"its state '{relaxation.name}'"
    numeric_stiffness = _evaluate(stiffness, values, f"the stiffness of {state_label}")
    micro_damping = _evaluate(damping * motion.scale, values, f"the damping of {state_label}")
    if not numeric_stiffness and not micro_damping:
        return None
    if numeric_stiffness <= 0.0:
        raise NoCounterpartError(
            f"the torque of {state_label} has the factor {numeric_stiffness:g} {{unit}}, and the "
            "stiffness of a bristle is positive",
            "N.m/rad",
        )
    if motion.rate == 0:
        raise NoCounterpartError(
            f"{state_label} never relaxes, a bristle in proportion to the speed"
        )
    level = sympy.cancel(stiffness / motion.rate)
    if not level.is_polynomial(_PEAK) or sympy.degree(level, _PEAK) > 1:
        raise NoCounterpartError(
            f"the sliding torque of {state_label} is "
            f"{to_text(level.subs(_PEAK, motion.peak))}, a bristle's a constant with a Stribeck "
            "peak"
        )
    label = f"the sliding torque of {state_label}"
    coulomb = _evaluate(level.subs(_PEAK, 0), values, label)
    static = _evaluate(level.subs(_PEAK, 1), values, label)
    if not (coulomb > 0.0 and static > 0.0):
        raise NoCounterpartError(
            f"{state_label} slides at {coulomb:g} to {static:g} {{unit}}, a bristle at more than 0",
            "N.m",
        )
    stribeck = motion.stribeck
    if stribeck is None:  # coulomb and static are equal, so any velocity will do
        stribeck = 1.0
    return Bristle(
        stiffness=numeric_stiffness,
        damping=micro_damping,
        coulomb=coulomb,
        static=static,
        stribeck=stribeck,
    )


def _uses_inputs(expression: sympy.Expr) -> bool:
    return not expression.free_symbols.isdisjoint(INPUTS)


def _evaluate(expression: sympy.Expr, values: Values, label: str) -> float:
    value = expression.subs(values)
    if not value.is_real:
        raise NoCounterpartError(
            f"its coefficients make {label} non-finite ({to_text(expression)})"
        )
    return float(value)
