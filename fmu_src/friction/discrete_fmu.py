"""Friction FMUs with a discrete-time step: thermal ones, and adaptive ones of `hesr.extras`.

Joints' components add inputs and outputs, such as `temperature[i]`, to those of every friction FMU.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fmu_src.equations.header import Joint, equations_header, indicators, memory_size
from fmu_src.export.description import Description
from fmu_src.export.interface import Interface, Variable
from fmu_src.export.package import Content
from fmu_src.friction import friction_component
from fmu_src.friction.reference import joint_columns, reference_motion, torques
from fmu_src.pages.block_page import BlockPage, LawEntry, block_html
from fmu_src.pages.friction_page import title
from fmu_src.pages.mathml import equations
from fmu_src.run.reference_results import ROWS, Stimuli, round_stimulus, waves
from hesr_model.equations.component import Component, Parameter, Quantity
from hesr_model.equations.memory import Slow
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.thermal import COULOMB_RANGE, TEMPERATURE, VISCOUS_RANGE


def discrete_equations(
    model: FrictionModel, components: Sequence[Component], switches: Sequence[Quantity] = ()
) -> tuple[Interface, str]:
    """Return variables and equations.h of an FMU; all joints share the switches, initially 1."""
    joints = [
        _joint(model, i, component, switches) for i, component in enumerate(components, start=1)
    ]
    variables = [*_signals(model, joints, switches), friction_component.start_mode()]
    if components[0].shared:
        variables += friction_component.scales(model)
    variables += _joint_variables(model, components, joints)
    interface = Interface(
        variables=tuple(variables),
        indicators=indicators(joints),
        own=memory_size(joints),
        model_exchange=False,
        directional_derivatives=False,
    )
    places = {"START_MODE": friction_component.START_MODE}
    return interface, equations_header(joints, interface, places)


THERMAL_LINES = (
    "T = temperature if thermometer, else thermal_ambient + rise; within thermal_coldest to "
    "thermal_warmest",
    "d rise / dt = (thermal_resistance abs(tau dq) - rise) / thermal_time_constant",
    "c = thermal_coulomb_scale (1 - x), x = thermal_coulomb (T - thermal_reference) within "
    f"+-{COULOMB_RANGE:g}",
    "n = thermal_viscous_scale exp(-y), y = thermal_viscous (T - thermal_reference) within "
    f"+-{VISCOUS_RANGE:g}",
)
"""Equations of the temperature's factors c and n, in the names of a joint's variables."""

THERMAL_TORQUE = (
    "tau = law above with bounds times coulomb_scale c, viscous terms times viscous_scale n"
)


def add_documentation(
    bare: Content, model: FrictionModel, lines: Sequence[str], notes: Sequence[str]
) -> Content:
    """Add a page with further equations and notes, and stimuli for reference results."""
    entries = [
        LawEntry(name=name, title=title(law), equations=equations(law))
        for name, law in zip(model.joints, model.laws, strict=True)
    ]
    page = BlockPage(equations=lines, notes=notes, laws=entries)
    html = block_html(page, bare.table, bare.about)
    members = {"documentation/index.html": html.encode(), **bare.members}
    return replace(bare, members=members, stimuli=_stimuli(model, bare.table, bare.about))


_TEMPERATURE_AMPLITUDE = 10.0  # amplitude of temperatures in the reference results [K]
_UNEXPLAINED = 2.0  # peak of the measured friction beyond the law, in standard deviations


def _stimuli(model: FrictionModel, interface: Interface, about: Description) -> Stimuli:
    """Return a motion in the trained range; measured torques differ from those of the law.

    The difference grows with the speed, so that the factors of an adaptive law change.
    """
    step_size = about.step
    motion = reference_motion(
        model,
        frequency=1.0 / (ROWS * step_size),
        periods=(ROWS + 1) / ROWS,
        rows=ROWS + 1,
        phase=_PHASE,
    )
    inputs = motion.columns()
    if model.training_rmse:
        friction = torques(model, motion, "direct")
        relative = motion.dq / np.abs(motion.dq).max(axis=0)
        friction += _UNEXPLAINED * np.array(model.training_rmse) * relative
        inputs |= joint_columns("tau_rigid", motion.tau_load)
        inputs |= joint_columns("tau_meas", motion.tau_load + friction)
    for i, thermal in enumerate(model.thermal, start=1):
        inputs |= waves(
            {f"{TEMPERATURE.name}[{i}]": _TEMPERATURE_AMPLITUDE}, middle=thermal.reference
        )
    names = {variable.name for variable in interface.variables if variable.role == "input"}
    stimulus_inputs = {name: round_stimulus(rows) for name, rows in inputs.items() if name in names}
    return Stimuli(step=step_size, inputs=stimulus_inputs)


_PHASE = 0.35  # lead of each joint over the one before it [rad]


def _joint(
    model: FrictionModel, i: int, component: Component, switches: Sequence[Quantity]
) -> Joint:
    place = friction_component.place(model.laws[i - 1], i)
    slow_names = [element.name for element in component.memory if isinstance(element, Slow)]
    names = {
        quantity.name: f"{quantity.name}[{i}]"
        for quantity in (*component.inputs, *component.shared, *component.outputs)
    }
    # One switch serves all joints.
    names |= {switch.name: switch.name for switch in switches}
    parameters = tuple(map(_remove_start, component.parameters))
    return Joint(
        component=replace(component, parameters=parameters),
        names=names,
        states=(*(f"{name}[{i}]" for name in slow_names), *place.states),
        derivatives=(*(f"der({name}[{i}])" for name in slow_names), *place.derivatives),
        starts=(*(f"{name}_start[{i}]" for name in slow_names), *place.starts),
        parameters=tuple(f"joint[{i}].{p.name}" for p in component.parameters),
    )


def _remove_start(parameter: Quantity) -> Quantity:
    """Return a parameter without what C lacks: joints that differ only in it share C code."""
    parameter = replace(parameter, description="", unit="1")
    if isinstance(parameter, Parameter):
        return replace(parameter, start=0.0)
    return parameter


def _signals(
    model: FrictionModel, joints: list[Joint], switches: Sequence[Quantity]
) -> Iterator[Variable]:
    component = joints[0].component
    for quantity in component.inputs:
        if quantity in switches:
            text = quantity.description
            variable = friction_component.typed_variable(
                quantity, quantity.name, "input", text, slides=False
            )
            yield replace(variable, start=1.0)
            continue
        for i, _ in enumerate(joints, start=1):
            start = 0.0
            if quantity == TEMPERATURE:
                # The factors of temperature are 1 at the reference.
                start = model.thermal[i - 1].reference
            yield friction_component.build_joint_variable(model, quantity, i, "input", start=start)
    for quantity in component.outputs:
        for i, joint in enumerate(joints, start=1):
            # Later it changes with steps only, not with inputs set between them.
            at_start = friction_component.dependencies(joint, quantity.symbol, starting=True)
            yield friction_component.build_joint_variable(
                model, quantity, i, "output", initial_dependencies=at_start
            )


def _joint_variables(
    model: FrictionModel, components: Sequence[Component], joints: list[Joint]
) -> Iterator[Variable]:
    rows = zip(model.laws, components, joints, model.slides, strict=True)
    for i, (law, component, joint, slides) in enumerate(rows, start=1):
        count = len(law.values)
        law_joint = replace(joint, parameters=joint.parameters[:count])
        elements = dict(zip(joint.derivatives, component.memory, strict=True))
        for variable in friction_component.law_variables(law, i, law_joint):
            element = elements.get(variable.name)
            if element is not None:
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
