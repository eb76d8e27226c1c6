"""Laws with a thermal model as equations, for FMUs and logs.

    stop, bristle    bounds times c(T)
    torque           tau = hysteresis + n(T) v f(v) + ripple + tau_0
    heat             x' = (R |tau dq| - x) / T_th, of the torque at the last sample

`SCALES` multiply these factors.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import sympy

from hesr_model.audit.certificate import find_min_viscous_scale
from hesr_model.equations.component import Component, previous
from hesr_model.equations.functions import larger
from hesr_model.equations.stepping import Steps
from hesr_model.friction.inputs import TORQUE
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.scales import COULOMB, MIN_SCALE, SCALES, VISCOUS, split_torque
from hesr_model.friction.thermal import (
    TEMPERATURE,
    THERMOMETER,
    Thermal,
    thermal_parameters,
    warmth,
)
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array


def thermal_component(law: FrictionLaw, thermal: Thermal) -> Component:
    """Return the equations of a joint with a thermal model; raise ExportError without a bound."""
    warmth_factors = warmth(previous(TORQUE))
    torque_parts = split_torque(law, larger(COULOMB.symbol, MIN_SCALE), warmth_factors.coulomb)
    # Ripple needs a minimum viscosity.
    viscous = larger(VISCOUS.symbol * warmth_factors.viscous, find_min_viscous_scale(law))
    torque = torque_parts.hysteresis + viscous * torque_parts.viscous + torque_parts.unscaled
    component = law.form.component
    [equation] = component.equations
    return replace(
        component,
        inputs=(*component.inputs, TEMPERATURE),
        parameters=(*component.parameters, *thermal_parameters(thermal)),
        shared=SCALES,
        memory=(warmth_factors.memory, *torque_parts.memory),
        equations=(replace(equation, expression=torque, start=sympy.S.Zero),),
    )


def build_inputs(record: FrictionRecord) -> tuple[dict[str, Array], dict[str, float]]:
    """Return a thermal law's inputs over a record, and the parameters that depend on them."""
    columns = {"dq": record.dq, "q": record.q, "tau_load": record.tau_load}
    if record.temperature is None:  # then friction heats the joint
        return columns, {THERMOMETER: 0.0}
    return columns | {TEMPERATURE.name: record.temperature}, {}


def predict_thermal(
    law: FrictionLaw, thermal: Thermal, record: FrictionRecord, start: tuple[float, ...] | None
) -> Array:
    """Return the (N,) torque [N.m] of a thermal law; steady at the first row without a `start`."""
    component = thermal_component(law, thermal)
    columns, input_parameters = build_inputs(record)
    values: Mapping[str, float] = {
        **law.values,
        **{parameter.name: parameter.start for parameter in thermal_parameters(thermal)},
        **{scale.name: 1.0 for scale in SCALES},
        **input_parameters,
    }
    is_settled = start is None
    if start is None:
        start = law.start
    first_states = (0.0, *start)  # the joint is as warm as the ambient
    steps = Steps(component, [TORQUE])
    [tau] = steps.simulate(record.t, columns, values, first_states, settled=is_settled)
    return np.asarray(tau)
