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
from collections.abc import Mapping
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
    if form.stops:
        raise NoCounterpartError(
            f"its state '{form.stops[0].name}' is a stop, and MuJoCo's bristles relax"
        )
    for relaxation, start in zip(form.relaxations, law.start, strict=True):
        if start:
            raise NoCounterpartError(
                f"its state '{relaxation.name}' starts at {start:g}, MuJoCo's at 0"
            )
    values = {coefficient.symbol: law.values[coefficient.name] for coefficient in form.coefficients}
    zeros = {symbol: 0 for symbol, value in values.items() if value == 0.0}
    motions = [_Motion.from_relaxation(r, zeros, values) for r in form.relaxations]
    if form.relaxations and law.discretisation != "exact":
        raise NoCounterpartError("it has Euler steps, and MuJoCo relaxes a bristle exactly")
    forces = {s: sympy.S.Zero for r in form.relaxations for s in (r.state, r.derivative)}
    viscous = 0.0
    waves = []
    for term in sympy.Add.make_args(sympy.expand_mul(form.output.subs(zeros))):
        states = forces.keys() & term.free_symbols
        factors = {symbol: term / symbol for symbol in states or {DQ}}
        linear = [
            (symbol, factor)
            for symbol, factor in factors.items()
            if not _uses_inputs(factor) and not states & factor.free_symbols
        ]
        if states and linear:
            [(state, factor)] = linear
            forces[state] += factor
        elif linear:
            viscous += _evaluate(factors[DQ], values, "its viscous friction")
        elif not states and not _uses_inputs(term):
            torque = _evaluate(term, values, "a term of its torque")
            waves.append(Wave(amplitude=-torque, poles=0.0, phase=math.pi / 2.0))
        elif not states and (wave := _find_wave(term, values)):
            waves.append(wave)
        elif TAU_LOAD in term.free_symbols:
            raise NoCounterpartError(
                f"its torque has the term {to_text(term)}, which depends on the load"
            )
        else:
            raise NoCounterpartError(
                f"its torque has the term {to_text(term)}, which is neither a bristle's nor "
                "viscous nor a ripple in the joint's angle alone"
            )
    bristles = [
        _build_bristle(r, motion, forces[r.state], forces[r.derivative], values)
        for r, motion in zip(form.relaxations, motions, strict=True)
    ]
    return JointFriction(
        bristles=tuple(bristle for bristle in bristles if bristle is not None),
        viscous=viscous,
        waves=tuple(waves),
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
        stribeck = (
            _find_stribeck_velocity(peaks[0], values, state_label) if len(peaks) == 1 else None
        )
        speed = sympy.Dummy(positive=True)
        slope = sympy.cancel(
            rate.subs(dict.fromkeys(peaks, _PEAK)).subs(absolute(DQ), speed) / speed
        )
        is_shape_supported = not peaks or stribeck is not None
        if not is_shape_supported or speed in slope.free_symbols or _uses_inputs(slope):
            raise NoCounterpartError(
                f"{state_label} relaxes at the rate {to_text(rate)}, a bristle in proportion "
                "to the speed with one Stribeck peak at most"
            )
        return cls(scale=scale, rate=slope, peak=peaks[0] if peaks else None, stribeck=stribeck)


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
    coulomb, static = (
        _evaluate(level.subs(_PEAK, peak), values, f"the sliding torque of {state_label}")
        for peak in (0, 1)
    )
    if not (coulomb > 0.0 and static > 0.0):
        raise NoCounterpartError(
            f"{state_label} slides at {coulomb:g} to {static:g} {{unit}}, a bristle at more than 0",
            "N.m",
        )
    stribeck = 1.0 if motion.stribeck is None else motion.stribeck
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
