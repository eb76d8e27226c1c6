"""Friction FMUs that move by steps: those that follow friction, and those that follow temperature.

`dq[i]`, `q[i]`, `tau_load[i]` -> `tau[i]` as of every friction FMU. One that follows temperature
has the input `temperature[i]` beside them. An adaptive one has `tau_meas[i]`, `tau_rigid[i]`,
`adapt` -> factors with standard deviations, alarms and health, too. What they remember of the last
sample is state of the FMU.
"""

from collections.abc import Iterator
from dataclasses import replace

from fmu_src.equations.header import FRICTION, Joint, Needs, equations_header, indicators, own_size
from fmu_src.export.interface import Interface, Variable
from fmu_src.friction.friction_component import (
    START_MODE,
    dependencies,
    law_variables,
    of_joint,
    scales,
    start_mode,
)
from fmu_src.friction.variable_names import place
from hesr.extras.adaptive.component import ADAPT
from hesr.extras.adaptive.follow import adaptive_components
from hesr_model.equations.component import Component, Parameter
from hesr_model.equations.memory import Slow
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.thermal import TEMPERATURE
from hesr_model.friction.thermal_law import thermal_component
from hesr_model.units import unit_of_joint


def adaptive_equations(model: FrictionModel) -> tuple[Interface, str]:
    """Return the variables of the adaptive FMU of a model, and its equations.h.

    Raises
    ------
    HesrError
        If the model does not say how well it fitted, its motors are coupled, or a law has nothing
        that a level could scale.
    """
    return _equations(model, adaptive_components(model))


def thermal_equations(model: FrictionModel) -> tuple[Interface, str]:
    """Return the same of the FMU of a model that follows temperature.

    Raises
    ------
    HesrError
        If a law has nothing that temperature could scale.
    """
    rows = zip(model.laws, model.thermal, strict=True)
    return _equations(model, tuple(thermal_component(law, thermal) for law, thermal in rows))


def _equations(model: FrictionModel, components: tuple[Component, ...]) -> tuple[Interface, str]:
    joints = [_joint(model, i, own) for i, own in enumerate(components, start=1)]
    table = Interface(
        variables=(
            *_signals(model, joints), start_mode(),
            *(scales(model) if components[0].shared else ()),
            *_own(model, components, joints),
        ),
        indicators=indicators(joints),
        own=own_size(joints),
        model_exchange=False,
        directional_derivatives=False,
    )  # fmt: skip
    return table, equations_header(
        joints, table, Needs(functions=FRICTION, places={"START_MODE": START_MODE})
    )


def _joint(model: FrictionModel, i: int, own: Component) -> Joint:
    at = place(model.laws[i - 1], i)
    slow = tuple(m.name for m in own.memory if isinstance(m, Slow))
    names = {q.name: f"{q.name}[{i}]" for q in (*own.inputs, *own.shared, *own.outputs)}
    return Joint(
        # Starts are no part of the equations: joints that differ in them alone share their C.
        component=replace(own, parameters=tuple(
            replace(p, start=0.0, description="", unit="1") if isinstance(p, Parameter)
            else replace(p, description="", unit="1") for p in own.parameters
        )),
        names=names | {ADAPT.name: ADAPT.name},
        states=(*(f"{n}[{i}]" for n in slow), *at.states),
        derivatives=(*(f"der({n}[{i}])" for n in slow), *at.derivatives),
        starts=(*(f"{n}_start[{i}]" for n in slow), *at.starts),
        parameters=tuple(f"joint[{i}].{p.name}" for p in own.parameters),
    )  # fmt: skip


def _signals(model: FrictionModel, joints: list[Joint]) -> Iterator[Variable]:
    own = joints[0].component
    for quantity in own.inputs:
        if quantity == ADAPT:
            yield Variable(name=ADAPT.name, role="input", unit="1", start=1.0, switch=True,
                           description=ADAPT.description)  # fmt: skip
            continue
        for i, _ in enumerate(joints, start=1):
            # A law is as it was fitted at the reference.
            start = model.thermal[i - 1].reference if quantity == TEMPERATURE else 0.0
            yield of_joint(model, quantity, i, "input", start=start)
    for quantity in own.outputs:
        for i, joint in enumerate(joints, start=1):
            # Afterwards it is held: it moves by steps, not with what is set between them.
            at_start = dependencies(joint, quantity.symbol, starting=True)
            yield of_joint(model, quantity, i, "output", initial_dependencies=at_start)


def _own(
    model: FrictionModel, components: tuple[Component, ...], joints: list[Joint]
) -> Iterator[Variable]:
    rows = zip(model.laws, components, joints, model.slides, strict=True)
    for i, (law, component, joint, slides) in enumerate(rows, start=1):
        count = len(law.values)
        known = replace(joint, parameters=joint.parameters[:count])
        elements = dict(zip(joint.derivatives, component.memory, strict=True))
        for variable in law_variables(law, i, known):
            element = elements.get(variable.name)
            if element is not None:
                at_start = dependencies(joint, element.derivative, starting=True)
                variable = replace(variable, initial_dependencies=at_start)
            yield variable
        for name, parameter in zip(
            joint.parameters[count:], component.parameters[count:], strict=True
        ):
            if not isinstance(parameter, Parameter):
                raise TypeError(f"'{parameter.name}' has no start value")
            yield Variable(
                name=name,
                role="tunable",
                description=parameter.description,
                unit=unit_of_joint(parameter.unit, slides=slides),
                start=parameter.start,
            )
