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

from hesr_model.audit.certificate import least_viscosity
from hesr_model.equations.component import Component, previous
from hesr_model.equations.functions import larger
from hesr_model.equations.stepping import Steps
from hesr_model.friction import thermal as models
from hesr_model.friction.inputs import TORQUE
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.scales import COULOMB, LEAST, SCALES, VISCOUS, parts
from hesr_model.friction.thermal import TEMPERATURE, Thermal, thermal_parameters, warmth
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array


def thermal_component(law: FrictionLaw, thermal: Thermal) -> Component:
    """Return the equations of a joint with a thermal model; raise ExportError without a bound."""
    warm = warmth(previous(TORQUE))
    own = parts(law, larger(COULOMB.symbol, LEAST), warm.coulomb)
    # Ripple needs a minimum viscosity.
    viscous = larger(VISCOUS.symbol * warm.viscous, least_viscosity(law))
    torque = own.hysteresis + viscous * own.viscous + own.rest
    base = law.form.component
    [equation] = base.equations
    return replace(
        base,
        inputs=(*base.inputs, TEMPERATURE),
        parameters=(*base.parameters, *thermal_parameters(thermal)),
        shared=SCALES,
        memory=(warm.memory, *own.memory),
        equations=(replace(equation, expression=torque, start=sympy.S.Zero),),
    )


def build_inputs(record: FrictionRecord) -> tuple[dict[str, Array], dict[str, float]]:
    """Return a thermal law's inputs over a record, and the parameters that depend on them."""
    columns = {"dq": record.dq, "q": record.q, "tau_load": record.tau_load}
    if record.temperature is None:  # then friction heats the joint
        return columns, {models.THERMOMETER: 0.0}
    return columns | {TEMPERATURE.name: record.temperature}, {}


def predict_thermal(
    law: FrictionLaw, thermal: Thermal, record: FrictionRecord, start: tuple[float, ...] | None
) -> Array:
    """Return the (N,) torque [N.m] of a thermal law; steady at the first row without a `start`."""
    component = thermal_component(law, thermal)
    columns, more = build_inputs(record)
    values: Mapping[str, float] = {
        **law.values,
        **{p.name: p.start for p in thermal_parameters(thermal)},
        **{scale.name: 1.0 for scale in SCALES},
        **more,
    }
    first = (0.0, *(law.start if start is None else start))
    steps = Steps(component, [TORQUE])
    return np.asarray(steps.over(record.t, columns, values, first, settled=start is None)[0])
