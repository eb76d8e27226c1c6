"""Adaptive law as equations: a Kalman filter of three factors per joint.

    e = tau_meas - tau_rigid - tau          phi = (F_i xi_i .., v f(v), 1)
    g = P phi,  s = phi' g,  R = 2 T_c sigma^2
    theta+ = theta + g w e                  w = dt / (R + s dt)
    P+     = P - g g' (w - dt / (T_f s))    forgotten only along g, the observed direction

theta holds level, viscous factor and offset. R, the density of noise with the correlation time T_c,
makes the filter independent of the step; T_f is its memory. Forgetting along one direction: R.
Kulhavy, Restricted exponential forgetting in real-time identification, Automatica 23 (1987).

CUSUM on the innovations over their density detects changes of friction and of the offset,

    c+ = max(0, c + d p e w - d^2/2 p^2 w),    alarm at c > h
"""

from dataclasses import dataclass, replace

import sympy

from hesr_model.equations.component import Component, Equation, Parameter, Quantity, previous
from hesr_model.equations.functions import absolute, clip, exceeds, larger, positive
from hesr_model.equations.memory import DT
from hesr_model.friction.inputs import DQ, TORQUE
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.scales import MIN_CHANGE, MIN_OFFSET_CHANGE, split_torque
from hesr_model.friction.thermal import TEMPERATURE, Thermal, thermal_parameters, warmth


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Settings of the adaptation and thresholds of its alarms."""

    correlation_time: float = 0.5  # of the unexplained torque [s]
    forgetting_time: float = 60.0  # memory of the filter [s]
    level_sd: float = 0.05  # *_sd: initial and largest standard deviations
    viscosity_sd: float = 0.4
    offset_sd: float = 0.1  # relative to the noise, as are limit and rate of the offset
    level: tuple[float, float] = (0.5, 2.0)
    viscosity: tuple[float, float] = (0.3, 3.0)
    offset: float = 3.0  # limit
    offset_rate: float = 0.05  # [1/s]
    rest: float = 0.02  # share of the largest speed below which nothing is learned
    outlier: float = 6.0  # [standard deviations] innovations above are not learned from
    clipped: float = 3.0  # [standard deviations] limit of the innovation in use
    hold: float = 0.5  # time without learning after an outlier [s]
    carried: float = 0.25  # share of the learned factors in the next log
    change: float = MIN_CHANGE  # smallest detected change
    change_of_offset: float = MIN_OFFSET_CHANGE
    alarm: float = 20.0  # threshold of the log-likelihood ratio


TUNING = Tuning()
"""Chosen on training logs of the UR10e: laws of one or two logs, followed over the others."""


MEASURED = Quantity(name="tau_meas", unit="N.m", description="measured {effort} of {joint}")
RIGID = Quantity(
    name="tau_rigid",
    unit="N.m",
    description="rigid-body {effort} on {joint}, acceleration included",
)
ADAPT = Quantity(
    name="adapt", unit="1", description="whether factors adapt; else they are held", logical=True
)

INPUTS = (MEASURED, RIGID, ADAPT)  # inputs of an adaptive law in addition to those of every law
_FACTORS = (
    ("level", "1", "factor on Coulomb and static friction of {joint}"),
    ("viscosity", "1", "factor on viscous friction of {joint}"),
    ("offset", "N.m", "offset of {joint} in addition to that of the law"),
)
_FACTOR_INDICES = range(len(_FACTORS))
_ALARMS = {
    "drift": ("change of the friction of {joint}", ((-1, "fallen"), (0, "none"), (1, "risen"))),
    "shift": (
        "change of the load, gravity or sensor of {joint}",
        ((-1, "down"), (0, "none"), (1, "up")),
    ),
}
HEALTH = (
    (0, "active"),
    (1, "switched_off"),
    (2, "slow"),
    (3, "saturated"),
    (4, "outlier"),
    (5, "at_limit"),
)
"""Values of `health`: the factors adapt, or the reason why they do not."""
_MAX_REGRESSOR = sympy.Float(1e6)  # limit of regressors, in standard deviations of the noise
# Share of correlations lost per sample, which keeps round-off harmless.
_CORRELATION_LOSS = sympy.Float(1e-7)
_MIN_NOISE = sympy.Float(1e-9)  # [N.m]: densities divide by it
_DIVISION_GUARD = sympy.Float(1e-200)

_Limits = dict[str, tuple[float, float]]


def build_joint_parameters(tuning: Tuning, noise: float, speed: float) -> tuple[Parameter, ...]:
    """Return a joint's parameters beyond its law; `noise` [N.m], top `speed` [rad/s]."""
    rows = (
        ("noise", "N.m", "standard deviation of the unexplained torque", noise),
        ("speed_least", "rad/s", "smallest speed for learning", tuning.rest * speed),
        ("torque_limit", "N.m", "measured torque at motor saturation; 0: unknown", 0.0),
        ("level_start", "1", "initial level", 1.0),
        ("viscosity_start", "1", "initial viscous factor", 1.0),
        ("offset_start", "N.m", "initial offset", 0.0),
    )
    return tuple(
        Parameter(name=name, unit=unit, description=description, start=start)
        for name, unit, description, start in rows
    )


def adaptive_component(
    law: FrictionLaw,
    tuning: Tuning,
    *,
    noise: float,
    speed: float,
    min_viscosity: float = 0.0,
    thermal: Thermal | None = None,
) -> Component:
    """Return the equations of a joint with an adaptive law.

    `noise` of the unexplained torque [N.m], largest `speed` [rad/s]; `min_viscosity` keeps the
    passivity certificate of the ripple.
    """
    joint_parameters = build_joint_parameters(tuning, noise, speed)
    noise_parameter, slowest_speed, torque_limit, *_ = joint_parameters
    sigma = larger(noise_parameter.symbol, _MIN_NOISE)
    base_component = law.form.component
    inputs = [*base_component.inputs, *INPUTS]
    parameters = [*base_component.parameters, *joint_parameters]
    viscosity = previous("viscosity")
    if thermal:
        warm = warmth(previous(TORQUE))
        law_parts = split_torque(law, previous("level"), warm.coulomb)
        memory = (warm.memory, *law_parts.memory)
        viscous = law_parts.viscous * warm.viscous
        # The factor after temperature still covers the ripple.
        viscosity = larger(viscosity * warm.viscous, min_viscosity)
        torque_start = sympy.S.Zero
        inputs.append(TEMPERATURE)
        parameters += thermal_parameters(thermal)
    else:
        law_parts = split_torque(law, previous("level"), sympy.S.One)
        memory = law_parts.memory
        viscous = law_parts.viscous
        torque_start = None
    limits = {
        "level": tuning.level,
        "viscosity": (max(tuning.viscosity[0], min_viscosity), tuning.viscosity[1]),
    }
    deviations = (tuning.level_sd, tuning.viscosity_sd, tuning.offset_sd * sigma)
    torque = law_parts.hysteresis + viscosity * law_parts.viscous + law_parts.unscaled
    torque += previous("offset")
    is_moving = exceeds(absolute(DQ), slowest_speed.symbol)
    has_torque_limit = exceeds(torque_limit.symbol, 0)
    is_saturated = exceeds(absolute(MEASURED.symbol), torque_limit.symbol) * has_torque_limit
    # NaN counts as 0; large values are clipped to the usual tail of the noise.
    largest_innovation = tuning.clipped * _expected_deviation(sigma)
    innovation = clip(_replace_nan(_make_symbol("raw")), largest_innovation)
    largest_slope = _MAX_REGRESSOR * sigma
    level_slope = is_moving * clip(_replace_nan(law_parts.level_slope), largest_slope)
    viscous_slope = is_moving * clip(_replace_nan(viscous), largest_slope)
    alarms, sums = _build_alarms(tuning, sigma)
    equations = (
        _output_equation(TORQUE, "N.m", "friction {effort} of {joint}", torque, torque_start),
        *_build_factors(tuning, sigma, joint_parameters, limits),
        *alarms,
        _build_health(limits, is_moving, is_saturated),
        *law_parts.sensitivities,
        _hidden_equation("raw", MEASURED.symbol - RIGID.symbol - _make_symbol(TORQUE)),
        _hidden_equation("innovation", innovation),
        _hidden_equation("phi_level", level_slope),
        _hidden_equation("phi_viscosity", viscous_slope),
        *_build_gains(tuning, sigma, is_moving, is_saturated),
        *_build_covariance(deviations),
        *sums,
    )
    return replace(
        base_component,
        inputs=tuple(inputs),
        parameters=tuple(parameters),
        memory=memory,
        equations=equations,
    )


def _make_symbol(name: str) -> sympy.Symbol:
    return sympy.Symbol(name, real=True)


_PHI = (_make_symbol("phi_level"), _make_symbol("phi_viscosity"), sympy.Integer(1))
_G = tuple(_make_symbol(f"g_{i}") for i in _FACTOR_INDICES)


def _covariance_name(i: int, j: int) -> str:
    return f"P_{min(i, j)}{max(i, j)}"


def _output_equation(
    name: str, unit: str, text: str, expression: sympy.Expr, start: sympy.Expr | None = None
) -> Equation:
    return Equation(
        name=name, unit=unit, description=text, output=True, expression=expression, start=start
    )


def _hidden_equation(
    name: str, expression: sympy.Expr, start: sympy.Expr | None = None
) -> Equation:
    return Equation(name=name, expression=expression, start=start)


def _build_factors(
    tuning: Tuning, sigma: sympy.Expr, joint_parameters: tuple[Parameter, ...], limits: _Limits
) -> list[Equation]:
    def limit_factor(name: str, factor: sympy.Expr) -> sympy.Expr:
        if name not in limits:
            return clip(factor, tuning.offset * sigma)
        return larger(_minimum(factor, limits[name][1]), limits[name][0])

    steps = [g * _make_symbol("gain") * _make_symbol("innovation") for g in _G]
    steps[2] = clip(steps[2], tuning.offset_rate * sigma * DT)
    start_parameters = joint_parameters[3:]
    factors = []
    for i, (name, unit, text) in enumerate(_FACTORS):
        factor = limit_factor(name, previous(name) + steps[i])
        start = limit_factor(name, start_parameters[i].symbol)
        factors.append(_output_equation(name, unit, text, factor, start))
    for i, (name, unit, _) in enumerate(_FACTORS):
        text = f"standard deviation of {name}[{{number}}]"
        # The variance may be below 0 by round-off.
        deviation = sympy.sqrt(positive(_make_symbol(_covariance_name(i, i))))
        factors.append(_output_equation(f"{name}_sd", unit, text, deviation))
    return factors


def _build_alarms(tuning: Tuning, sigma: sympy.Expr) -> tuple[list[Equation], list[Equation]]:
    rows = (
        ("drift", "friction", _PHI[0] + _PHI[1], sympy.Float(tuning.change)),
        ("shift", "offset", _PHI[2], tuning.change_of_offset * sigma),
    )
    weight = _make_symbol("weight")
    error = _make_symbol("innovation")
    alarms = []
    sums = []
    for name, sum_prefix, regressor, change in rows:
        rising = f"{sum_prefix}_up"
        falling = f"{sum_prefix}_down"
        has_risen = exceeds(_make_symbol(rising), tuning.alarm)
        has_fallen = exceeds(_make_symbol(falling), tuning.alarm)
        text, values = _ALARMS[name]
        alarm = Equation(
            name=name,
            description=text,
            output=True,
            expression=has_risen - has_fallen,
            values=values,
        )
        alarms.append(alarm)
        for sum_name, signed_change in ((rising, change), (falling, -change)):
            step = signed_change * regressor
            gain = step * weight * error - step**2 * weight / 2
            # The sum is limited, so that an alarm can end.
            total = _minimum(positive(previous(sum_name) + gain), 1.5 * tuning.alarm)
            sums.append(_hidden_equation(sum_name, total, sympy.S.Zero))
    return alarms, sums


def _build_health(limits: _Limits, is_moving: sympy.Expr, is_saturated: sympy.Expr) -> Equation:
    at_limit = sum(
        exceeds(_make_symbol(name), upper - 1e-9) + exceeds(lower + 1e-9, _make_symbol(name))
        for name, (lower, upper) in limits.items()
    )
    reasons = {
        "at_limit": exceeds(at_limit, 0.5),
        "outlier": 1 - _make_symbol("settled"),  # also shortly after one
        "saturated": is_saturated,
        "slow": 1 - is_moving,
        "switched_off": 1 - exceeds(ADAPT.symbol, 0.5),
    }
    numbers = {reason: number for number, reason in HEALTH}
    health = sympy.Integer(0)
    for reason, condition in reasons.items():  # the last true one wins
        health = condition * numbers[reason] + (1 - condition) * health
    return Equation(
        name="health",
        description="adaptation of {joint}",
        output=True,
        expression=health,
        values=HEALTH,
    )


def _expected_deviation(sigma: sympy.Expr) -> sympy.Expr:
    return sympy.sqrt(sigma**2 + _make_symbol("spread"))


def _build_gains(
    tuning: Tuning, sigma: sympy.Expr, is_moving: sympy.Expr, is_saturated: sympy.Expr
) -> tuple[Equation, ...]:
    """Return g = P phi, s = phi' g, and the weights of the update and of forgetting."""
    spread = _make_symbol("spread")
    learns = _make_symbol("learns")
    settled = _make_symbol("settled")
    weight = _make_symbol("weight")
    gain = _make_symbol("gain")
    hold = tuning.hold
    is_observing = exceeds(ADAPT.symbol, 0.5) * is_moving * (1 - is_saturated)
    fits = exceeds(tuning.outlier * _expected_deviation(sigma), absolute(_make_symbol("raw")))
    density = 2 * tuning.correlation_time * sigma**2
    forgets = learns * DT / ((tuning.forgetting_time + DT) * (spread + _DIVISION_GUARD))
    gains = []
    for i, g in enumerate(_G):
        row = [previous(_covariance_name(i, j)) * _PHI[j] for j in _FACTOR_INDICES]
        gains.append(_hidden_equation(g.name, sum(row)))
    return (
        *gains,
        _hidden_equation("spread", positive(sum(x * g for x, g in zip(_PHI, _G, strict=True)))),
        _hidden_equation("calm", fits * _minimum(previous("calm") + DT, hold), sympy.Float(hold)),
        _hidden_equation("settled", 1 - exceeds(hold, _make_symbol("calm"))),
        _hidden_equation("learns", is_observing * settled),
        _hidden_equation("weight", is_observing * DT / (density + spread * DT)),
        _hidden_equation("gain", weight * settled),
        _hidden_equation("net", gain - forgets),
    )


def _build_covariance(deviations: tuple[sympy.Expr, ...]) -> list[Equation]:
    """Return P after a sample, with deviations of at most the initial ones."""
    factors = [_make_symbol(f"cut_{i}") for i in _FACTOR_INDICES]
    updated = {}
    for i in _FACTOR_INDICES:
        for j in _FACTOR_INDICES[i:]:
            removed = _G[i] * _G[j] * _make_symbol("net")
            updated[i, j] = previous(_covariance_name(i, j)) - removed
    equations = []
    for i, deviation in enumerate(deviations):
        updated_deviation = sympy.sqrt(positive(updated[i, i]))
        cut = deviation / larger(deviation, updated_deviation)
        equations.append(_hidden_equation(factors[i].name, cut))
    remaining_correlation = 1 - _CORRELATION_LOSS * _make_symbol("learns")
    for (i, j), covariance in updated.items():
        # Rows and columns are cut alike: correlations stay.
        cut_covariance = covariance * factors[i] * factors[j]
        start = sympy.S.Zero
        if i == j:
            cut_covariance = larger(cut_covariance, (1e-6 * deviations[i]) ** 2)
            start += deviations[i] ** 2
        else:
            cut_covariance *= remaining_correlation
        equations.append(_hidden_equation(_covariance_name(i, j), cut_covariance, start))
    return equations


def _replace_nan(x: sympy.Expr) -> sympy.Expr:
    return positive(x) - positive(-x)


def _minimum(x: sympy.Expr, upper: float) -> sympy.Expr:
    return -larger(-x, -upper)
