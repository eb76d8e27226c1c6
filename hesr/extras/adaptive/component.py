"""Adaptive law as equations: a Kalman filter of three factors per joint.

    e = tau_meas - tau_rigid - tau          phi = (F_i xi_i .., v f(v), 1)
    g = P phi,  s = phi' g,  R = 2 T_c sigma^2
    theta+ = theta + g w e                  w = dt / (R + s dt)
    P+     = P - g g' (w - dt / (T_f s))    forgotten only along g, the observed direction

theta holds level, viscous factor and offset. The unexplained torque is not white noise: R, its
density from the correlation time T_c, makes the filter independent of the step. T_f is the
memory. tau is known before the torque is measured, so no loop closes through an adaptive FMU.
Forgetting along one direction: R. Kulhavy, Restricted exponential forgetting in real-time
identification, Automatica 23 (1987).

CUSUM on the innovations over their density detects changes of friction and of the offset,

    c+ = max(0, c + d p e w - d^2/2 p^2 w),    alarm at c > h

with a mean time between false alarms of 2 (exp(h) - h - 1) / d^2 in units of R / p^2 [s].
"""

from dataclasses import replace

import sympy

from hesr.extras.adaptive.tuning import Tuning
from hesr_model.equations.component import (
    Component,
    Equation,
    Parameter,
    Quantity,
    previous,
)
from hesr_model.equations.functions import absolute, clip, exceeds, larger, positive
from hesr_model.equations.memory import DT
from hesr_model.friction.factors import parts
from hesr_model.friction.inputs import DQ, TORQUE
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.thermal import TEMPERATURE, Thermal, thermal_parameters, warmth

MEASURED = Quantity(name="tau_meas", unit="N.m", description="measured {effort} of {joint}")
RIGID = Quantity(
    name="tau_rigid",
    unit="N.m",
    description="rigid-body {effort} on {joint}, acceleration included",
)
ADAPT = Quantity(name="adapt", unit="1", description="1 where factors follow, 0 where they stay")

INPUTS = (MEASURED, RIGID, ADAPT)
"""Inputs of an adaptive law in addition to those of every law."""

HEALTH = (
    "factors follow",
    "switched off",
    "at rest: nothing to learn from",
    "the motor saturates",
    "outlier, or shortly after one",
    "a factor is at its limit",
)
"""Meaning of the values of `health`, from 0."""

_FACTORS = (
    ("level", "1", "factor on Coulomb and static friction of {joint}"),
    ("viscosity", "1", "factor on viscous friction of {joint}"),
    ("offset", "N.m", "offset of {joint}, beside that of the law"),
)
_HUGE = sympy.Float(1e6)  # limit of regressors, in standard deviations of the noise
_MIXED = sympy.Float(1e-7)  # share of correlations lost per sample, which keeps round-off harmless
_LEAST_NOISE = sympy.Float(1e-9)  # [N.m]: densities divide by it
_TINY = sympy.Float(1e-200)


def own_parameters(tuning: Tuning, noise: float, speed: float) -> tuple[Parameter, ...]:
    """Return a joint's parameters beyond its law from `noise` [N.m] and top `speed` [rad/s]."""

    def one(name: str, unit: str, text: str, start: float) -> Parameter:
        return Parameter(name=name, unit=unit, description=text, start=start)

    return (
        one("noise", "N.m", "what the law does not explain, standard deviation", noise),
        one("speed_least", "rad/s", "below it nothing is learned", tuning.rest * speed),
        one("torque_limit", "N.m", "measured torque where the motor saturates; 0: unknown", 0.0),
        one("level_start", "1", "level to start from", 1.0),
        one("viscosity_start", "1", "viscous factor to start from", 1.0),
        one("offset_start", "N.m", "offset to start from", 0.0),
    )  # fmt: skip


def adaptive_component(
    law: FrictionLaw, tuning: Tuning, *, noise: float, speed: float, viscosity_least: float = 0.0,
    thermal: Thermal | None = None,
) -> Component:  # fmt: skip
    """Return the equations of a joint with an adaptive law.

    `noise` is the standard deviation of the unexplained torque [N.m], `speed` the largest speed of
    the joint [rad/s]; `viscosity_least` keeps the passivity certificate of the ripple. Raises
    ExportError if the law has neither stops nor bristles.
    """
    own = own_parameters(tuning, noise, speed)
    sigma = larger(own[0].symbol, _LEAST_NOISE)
    slowest, limit = own[1].symbol, own[2].symbol
    warm = warmth(previous(TORQUE)) if thermal else None
    law_parts = parts(law, previous("level"), warm.coulomb if warm else sympy.S.One)
    viscous = law_parts.viscous * (warm.viscous if warm else sympy.S.One)
    # The factor after temperature still covers the ripple.
    thickness = (
        larger(previous("viscosity") * warm.viscous, viscosity_least)
        if warm
        else previous("viscosity")
    )
    low, high = tuning.level
    thin, thick = max(tuning.viscosity[0], viscosity_least), tuning.viscosity[1]
    deviations = (tuning.level_sd, tuning.viscosity_sd, tuning.offset_sd * sigma)
    phi = [_named("phi_level"), _named("phi_viscosity"), sympy.Integer(1)]
    error, gain, learns = _named("innovation"), _named("gain"), _named("learns")
    # Names for sums that are used in several places.
    g = [_named(f"g_{i}") for i in range(3)]
    p = {(i, j): previous(_p(i, j)) for i in range(3) for j in range(3)}
    spread, density = _named("spread"), 2 * tuning.correlation_time * sigma**2
    expected = sympy.sqrt(sigma**2 + spread)
    fits = exceeds(tuning.outlier * expected, absolute(_named("raw")))
    saturates = exceeds(absolute(MEASURED.symbol), limit) * exceeds(limit, 0)
    moving = exceeds(absolute(DQ), slowest)
    calm = _named("calm")
    looks = exceeds(ADAPT.symbol, 0.5) * moving * (1 - saturates)
    net = _named("net")
    forgets = learns * DT / ((tuning.forgetting_time + DT) * (spread + _TINY))
    factors = tuple(
        Equation(name=name, unit=unit, description=text, output=True, expression=e, start=start)
        for (name, unit, text), e, start in zip(
            _FACTORS,
            (
                _between(previous("level") + g[0] * gain * error, low, high),
                _between(previous("viscosity") + g[1] * gain * error, thin, thick),
                clip(
                    previous("offset") + clip(g[2] * gain * error, tuning.offset_rate * sigma * DT),
                    tuning.offset * sigma,
                ),
            ),
            (
                _between(own[3].symbol, low, high),
                _between(own[4].symbol, thin, thick),
                clip(own[5].symbol, tuning.offset * sigma),
            ),
            strict=True,
        )
    )
    cut = [_named(f"cut_{i}") for i in range(3)]
    grown = {(i, j): p[i, j] - g[i] * g[j] * net for i in range(3) for j in range(i, 3)}
    covariance = [
        Equation(
            name=_p(i, j),
            expression=(
                larger(grown[i, i] * cut[i] ** 2, (1e-6 * deviations[i]) ** 2)
                if i == j
                else grown[i, j] * cut[i] * cut[j] * (1 - _MIXED * learns)
            ),
            start=sympy.S.Zero + (deviations[i] ** 2 if i == j else 0),
        )
        for i, j in grown
    ]
    cuts = [
        Equation(
            name=f"cut_{i}",
            expression=deviations[i] / larger(deviations[i], sympy.sqrt(positive(grown[i, i]))),
        )
        for i in range(3)
    ]
    friction = phi[0] + phi[1]
    weight = _named("weight")
    sums = {
        "friction": (friction, sympy.Float(tuning.change)),
        "offset": (sympy.Integer(1), tuning.change_of_offset * sigma),
    }
    cusum = [
        _cusum(f"{name}_{way}", sign * d, regressor, weight, error, tuning.alarm)
        for name, (regressor, d) in sums.items()
        for way, sign in (("up", 1), ("down", -1))
    ]
    alarm = [
        Equation(
            name=name,
            unit="1",
            description=text,
            output=True,
            expression=exceeds(_named(f"{of}_up"), tuning.alarm)
            - exceeds(_named(f"{of}_down"), tuning.alarm),
        )
        for name, of, text in (
            ("drift", "friction", "alarm of {joint}: friction has risen (1) or fallen (-1)"),
            ("shift", "offset", "alarm of {joint}: load, gravity or sensor, up (1) or down (-1)"),
        )
    ]
    at_limit = sum(
        exceeds(_named(name), b - 1e-9) + exceeds(a + 1e-9, _named(name))
        for name, a, b in (("level", low, high), ("viscosity", thin, thick))
    )
    reasons = (
        (5, exceeds(at_limit, 0.5)),
        (4, 1 - _named("settled")),
        (3, saturates),
        (2, 1 - moving),
        (1, 1 - exceeds(ADAPT.symbol, 0.5)),
    )
    health = sympy.Integer(0)
    for number, so in reasons:  # the last true one wins
        health = so * number + (1 - so) * health
    base = law.form.component
    return replace(
        base,
        inputs=(*base.inputs, *INPUTS, *((TEMPERATURE,) if warm else ())),
        parameters=(*base.parameters, *own, *(thermal_parameters(thermal) if thermal else ())),
        memory=(*((warm.memory,) if warm else ()), *law_parts.memory),
        equations=(
            Equation(
                name=TORQUE, unit="N.m", description="friction {effort} of {joint}", output=True,
                expression=law_parts.hysteresis + thickness * law_parts.viscous
                + law_parts.rest + previous("offset"),
                start=sympy.S.Zero if warm else None,
            ),
            *factors,
            *(
                Equation(
                    name=f"{name}_sd", unit=unit, output=True,
                    description=f"standard deviation of {name}[{{number}}]",
                    expression=sympy.sqrt(positive(_named(_p(i, i)))),
                )
                for i, (name, unit, _) in enumerate(_FACTORS)
            ),
            *alarm,
            Equation(name="health", unit="1", output=True, expression=health,
                     description="of {joint}, 0 where factors follow, else why they do not"),
            *law_parts.sensitivities,
            Equation(name="raw", expression=MEASURED.symbol - RIGID.symbol - _named(TORQUE)),
            # NaN counts as 0; large values are clipped to the usual tail of the noise.
            Equation(name="innovation", expression=clip(_number(_named("raw")),
                                                        tuning.clipped * expected)),
            *(
                Equation(name=f"phi_{name}", expression=moving * clip(_number(e), _HUGE * sigma))
                for name, e in (("level", law_parts.along), ("viscosity", viscous))
            ),
            *(
                Equation(name=f"g_{i}", expression=sum(p[min(i, j), max(i, j)] * phi[j]
                                                       for j in range(3)))
                for i in range(3)
            ),
            Equation(name="spread", expression=positive(sum(phi[i] * g[i] for i in range(3)))),
            Equation(name="calm", start=sympy.Float(tuning.hold),
                     expression=fits * _at_most(previous("calm") + DT, tuning.hold)),
            Equation(name="settled", expression=1 - exceeds(tuning.hold, calm)),
            Equation(name="learns", expression=looks * _named("settled")),
            Equation(name="weight", expression=looks * DT / (density + spread * DT)),
            Equation(name="gain", expression=weight * _named("settled")),
            Equation(name="net", expression=gain - forgets),
            *cuts,
            *covariance,
            *cusum,
        ),
    )  # fmt: skip


def _named(name: str) -> sympy.Symbol:
    return sympy.Symbol(name, real=True)


def _p(i: int, j: int) -> str:
    return f"P_{min(i, j)}{max(i, j)}"


def _number(x: sympy.Expr) -> sympy.Expr:
    """Return x, or 0 for NaN."""
    return positive(x) - positive(-x)


def _at_most(x: sympy.Expr, most: float) -> sympy.Expr:
    return -larger(-x, -most)


def _between(x: sympy.Expr, low: float, high: float) -> sympy.Expr:
    return larger(_at_most(x, high), low)


def _cusum(
    name: str, d: sympy.Expr, regressor: sympy.Expr, weight: sympy.Expr, error: sympy.Expr,
    alarm: float,
) -> Equation:  # fmt: skip
    """Return the log-likelihood ratio of a shift d of a factor, not below 0.

    It saturates above the alarm and falls again once the innovations fit.
    """
    change = d * regressor * weight * error - (d * regressor) ** 2 * weight / 2
    top = 1.5 * alarm
    return Equation(
        name=name, expression=_at_most(positive(previous(name) + change), top), start=sympy.S.Zero
    )
