"""Friction FMUs with a discrete-time step: thermal ones, and adaptive ones of `hesr.extras`.

Joints' components add inputs and outputs, such as `temperature[i]`, to those of every friction FMU.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from fmu_src.equations.header import Joint, equations_header, indicators, own_size
from fmu_src.export.interface import Interface, Variable
from fmu_src.friction import friction_component
from hesr_model.equations.component import Component, Parameter, Quantity
from hesr_model.equations.memory import Slow
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.thermal import TEMPERATURE


def discrete_equations(
    model: FrictionModel, components: Sequence[Component], switches: Sequence[Quantity] = ()
) -> tuple[Interface, str]:
    """Return variables and equations.h of an FMU; all joints share the switches, initially 1."""
    joints = [_joint(model, i, own, switches) for i, own in enumerate(components, start=1)]
    factors = friction_component.scales(model) if components[0].shared else ()
    signals = (*_signals(model, joints, switches), friction_component.start_mode(), *factors)
    table = Interface(
        variables=(*signals, *_own(model, components, joints)),
        indicators=indicators(joints),
        own=own_size(joints),
        model_exchange=False,
        directional_derivatives=False,
    )
    return table, equations_header(joints, table, {"START_MODE": friction_component.START_MODE})


def _joint(model: FrictionModel, i: int, own: Component, switches: Sequence[Quantity]) -> Joint:
    at = friction_component.place(model.laws[i - 1], i)
    slow = tuple(m.name for m in own.memory if isinstance(m, Slow))
    names = {q.name: f"{q.name}[{i}]" for q in (*own.inputs, *own.shared, *own.outputs)}
    # Joints that differ only in starts share C code.
    parameters = (replace(p, description="", unit="1") for p in own.parameters)
    bare = tuple(replace(p, start=0.0) if isinstance(p, Parameter) else p for p in parameters)
    return Joint(
        component=replace(own, parameters=bare),
        names=names | {switch.name: switch.name for switch in switches},
        states=(*(f"{n}[{i}]" for n in slow), *at.states),
        derivatives=(*(f"der({n}[{i}])" for n in slow), *at.derivatives),
        starts=(*(f"{n}_start[{i}]" for n in slow), *at.starts),
        parameters=tuple(f"joint[{i}].{p.name}" for p in own.parameters),
    )


def _signals(
    model: FrictionModel, joints: list[Joint], switches: Sequence[Quantity]
) -> Iterator[Variable]:
    own = joints[0].component
    for quantity in own.inputs:
        if quantity in switches:
            text = quantity.description
            variable = friction_component.typed_variable(
                quantity, quantity.name, "input", text, slides=False
            )
            yield replace(variable, start=1.0)
            continue
        for i, _ in enumerate(joints, start=1):
            # The factors of temperature are 1 at the reference.
            start = model.thermal[i - 1].reference if quantity == TEMPERATURE else 0.0
            yield friction_component.of_joint(model, quantity, i, "input", start=start)
    for quantity in own.outputs:
        for i, joint in enumerate(joints, start=1):
            # Later it changes with steps only, not with inputs set between them.
            at_start = friction_component.dependencies(joint, quantity.symbol, starting=True)
            yield friction_component.of_joint(
                model, quantity, i, "output", initial_dependencies=at_start
            )


def _own(
    model: FrictionModel, components: Sequence[Component], joints: list[Joint]
) -> Iterator[Variable]:
    rows = zip(model.laws, components, joints, model.slides, strict=True)
    for i, (law, component, joint, slides) in enumerate(rows, start=1):
        count = len(law.values)
        known = replace(joint, parameters=joint.parameters[:count])
        elements = dict(zip(joint.derivatives, component.memory, strict=True))
        for variable in friction_component.law_variables(law, i, known):
            if (element := elements.get(variable.name)) is not None:
                at_start = friction_component.dependencies(joint, element.derivative, starting=True)
                variable = replace(variable, initial_dependencies=at_start)
            yield variable
        for name, parameter in zip(
            joint.parameters[count:], component.parameters[count:], strict=True
        ):
            if not isinstance(parameter, Parameter):
                raise TypeError(f"'{parameter.name}' has no start value")
            text = parameter.description
            variable = friction_component.typed_variable(
                parameter, name, "tunable", text, slides=slides
            )
            yield replace(variable, start=parameter.start)
