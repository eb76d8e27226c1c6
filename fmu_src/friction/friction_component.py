"""Friction component: its variables and its equations, from a friction model."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np
import sympy

from fmu_src.equations.header import Joint, equations_header, indicators, memory_size
from fmu_src.export.interface import Enumeration, Interface, Role, Variable
from fmu_src.friction.validity import find_discretisation
from hesr_model.audit.certificate import find_scale_limits
from hesr_model.equations.component import Component, Equation, Quantity
from hesr_model.equations.memory import Element, Relaxation
from hesr_model.equations.program import find_sources, initial_state, initial_symbol, remove_events
from hesr_model.friction.band import (
    COVERAGE,
    LOWER,
    MAX_COVERAGE,
    MIN_COVERAGE,
    NUMBERS,
    UPPER,
    band_equations,
)
from hesr_model.friction.inputs import DQ, INPUTS, MOVING, QUANTITIES, TAU_LOAD, TORQUE
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.scales import SCALES, VISCOUS, add_scales, has_viscous
from hesr_model.robots.transmission import Coupling
from hesr_model.units import unit_of_joint

DISCRETISATION = Enumeration(
    name="Discretisation",
    items=(
        ("exact", "exact for inputs held over a step, stable at any step"),
        ("euler", "explicit Euler, requires rate * step < 1"),
    ),
)

# Round-off of the inverse of a coupling; smaller coefficients count as zero.
_MIN_COEFFICIENT = 1e-12
_STEADY = (
    "in the steady state of the first inputs, faded in from the start values at rest up to "
    f"a speed of {MOVING:g} in SI units"
)
START = Enumeration(name="Start", items=(("steady", _STEADY), ("given", "at their start values")))

STEADY = 1.0
GIVEN = 2.0

START_MODE = "start_mode"  # name of the parameter that selects the initial state

_NOMINAL_SPEED = 0.1  # speed of the steady state that defines the nominal value of a state [rad/s]

_EFFORT = {False: "torque", True: "force"}

POWER = Equation(
    name="power",
    unit="W",
    description="power that the friction of {joint} takes",
    expression=sympy.Symbol(TORQUE, real=True) * DQ,
    output=True,
)

SLOPE = Quantity(
    name=f"d{TORQUE}_d{DQ.name}",
    unit="N.m.s/rad",
    description="slope of tau[{number}] over dq[{number}] held over the last step, the states "
    "following; in model exchange that at the last event, the states at rest",
)


MAX_PARAMETERS = 64  # laws with more coefficients than this show only their factors


@dataclass(frozen=True, kw_only=True)
class Place:
    """Names of one joint's variables in the order of the C code."""

    states: tuple[str, ...]
    derivatives: tuple[str, ...]
    starts: tuple[str, ...]
    parameters: tuple[str, ...]


def is_exposed(law: FrictionLaw) -> bool:
    """Whether the coefficients of a law are parameters of the FMU."""
    return len(law.values) <= MAX_PARAMETERS


def place(law: FrictionLaw, number: int) -> Place:
    """Return the names of a joint's variables; joints count from 1."""
    parameters: tuple[str, ...] = ()
    if is_exposed(law):
        parameters = tuple(f"joint[{number}].{name}" for name in law.values)
    state_names = [element.name for element in law.form.memory]
    return Place(
        states=tuple(f"{name}[{number}]" for name in state_names),
        derivatives=tuple(f"der({name}[{number}])" for name in state_names),
        starts=tuple(f"{name}_start[{number}]" for name in state_names),
        parameters=parameters,
    )


def scale_names(number: int) -> tuple[str, ...]:
    """Return the names of a joint's factors on Coulomb and viscous friction."""
    return tuple(f"{scale.name}[{number}]" for scale in SCALES)


def component(
    law: FrictionLaw,
    extra_outputs: Iterable[Equation] = (),
    *,
    band: bool = False,
    coupled: bool = False,
    events: bool = True,
) -> Component:
    """Return the equations of a joint: its law with `SCALES`, further outputs and the band.

    Reversals are solver events if `events`, else jumps become steep. Joints that are `coupled` add
    squares of their bands.
    """
    form = add_scales(law.form)
    shared: tuple[Quantity, ...] = SCALES
    equations = (*form.component.equations, *extra_outputs)
    if band:
        shared = (*shared, *NUMBERS, COVERAGE)
        band_outputs = band_equations(
            form.memory, form.output, steady_speed=form.steady_speed, squares=coupled
        )
        equations = (*equations, *band_outputs)
    component = replace(
        form.component, parameters=law.form.coefficients, shared=shared, equations=equations
    )
    if not events:
        component = remove_events(component)
    return component


def friction_equations(
    model: FrictionModel,
    extra_outputs: tuple[Equation, ...] = (),
    *,
    band: bool = False,
    events: bool = True,
    steps_together: bool = True,
) -> tuple[Interface, str]:
    """Return the variables of a friction FMU, and its equations.h.

    The connectors `dq[i]`, `q[i]`, `tau_load[i]` -> `tau[i]` are those of every friction FMU;
    `extra_outputs` are outputs such as `POWER`, and `band` adds its limits; for `events` see
    `component`, for `steps_together` see `equations_header`. Raises ExportError for names that FMI
    forbids, or different discretisations.
    """
    joints = build_joints(model, extra_outputs, band=band, events=events)
    interface = Interface(
        variables=tuple(_variables(model, joints, band=band)),
        indicators=indicators(joints),
        own=memory_size(joints),
    )
    places = {"DISCRETISATION": "discretisation", "START_MODE": START_MODE}
    header = equations_header(
        joints, interface, places, coupling=model.coupling, steps_together=steps_together
    )
    return interface, header


def _variables(
    model: FrictionModel, joints: tuple[Joint, ...], *, band: bool
) -> Iterator[Variable]:
    numbers = range(1, len(joints) + 1)
    for quantity in QUANTITIES:
        for i in numbers:
            size = _trained_size(model, quantity, i)
            yield build_joint_variable(model, quantity, i, "input", nominal=size)
    outputs = joints[0].component.outputs
    for equation in outputs:
        for i in numbers:
            size = _trained_size(model, equation, i)
            source_names = _output_dependencies(model, joints, i, equation)
            yield build_joint_variable(
                model, equation, i, "output", nominal=size, dependencies=source_names
            )
    for i in numbers:
        source_names = _output_dependencies(model, joints, i, outputs[0])
        yield build_joint_variable(model, SLOPE, i, "on_demand", dependencies=source_names)
    yield discretisation(
        model,
        "how co-simulation integrates the states over a step; without meaning in model exchange, "
        "where the importer's solver does",
    )
    yield start_mode()
    yield from scales(model)
    if band:
        yield from band_numbers(model)
    for i, law in enumerate(model.laws, start=1):
        yield from law_variables(law, i, joints[i - 1], _find_joint_inputs(model.coupling, i))


def find_joint_signals(name: str, coordinate: int, coupling: Coupling | None) -> tuple[str, ...]:
    """Return the variables of joints that a signal of a friction coordinate depends on."""
    if coupling is None:
        return (f"{name}[{coordinate}]",)
    matrix = coupling.forward
    if name == TAU_LOAD.name:
        matrix = coupling.backward
    added_joints = np.flatnonzero(np.abs(matrix[coordinate - 1]) > _MIN_COEFFICIENT)
    return tuple(f"{name}[{j + 1}]" for j in added_joints)


def find_added_coordinates(number: int, coupling: Coupling | None) -> tuple[int, ...]:
    """Return the friction coordinates whose torques add to that of a joint."""
    if coupling is None:
        return (number,)
    return tuple(int(i) + 1 for i in np.flatnonzero(coupling.forward[:, number - 1]))


def _find_joint_inputs(coupling: Coupling | None, coordinate: int) -> dict[str, tuple[str, ...]]:
    return {
        quantity.name: find_joint_signals(quantity.name, coordinate, coupling)
        for quantity in QUANTITIES
    }


def _output_dependencies(
    model: FrictionModel, joints: tuple[Joint, ...], number: int, output: Equation
) -> tuple[str, ...]:
    coordinates: tuple[int, ...] = (number,)
    if output.name in (TORQUE, LOWER, UPPER):
        coordinates = find_added_coordinates(number, model.coupling)
    names: list[str] = []
    for i in coordinates:
        inputs = _find_joint_inputs(model.coupling, i)
        names += dependencies(joints[i - 1], output.symbol, inputs)
    return tuple(dict.fromkeys(names))


def build_joint_variable(
    model: FrictionModel, quantity: Quantity, number: int, role: Role, **attributes: Any
) -> Variable:
    """Return a variable that every joint has, for the joint with this number from 1."""
    slides = model.slides[number - 1]
    text = quantity.description.format(
        joint=model.joints[number - 1], effort=_EFFORT[slides], number=number
    )
    name = f"{quantity.name}[{number}]"
    return replace(typed_variable(quantity, name, role, text, slides=slides), **attributes)


def typed_variable(
    quantity: Quantity, name: str, role: Role, text: str, *, slides: bool
) -> Variable:
    """Return the variable of a quantity: boolean, integer, or real with a unit.

    The description of an integer has the meanings of its values.
    """
    if quantity.logical:
        return Variable(name, role, text, boolean=True)
    if not quantity.values:
        unit = unit_of_joint(quantity.unit, is_prismatic=slides)
        return Variable(name, role, text, unit=unit)
    meanings = ", ".join(f"{number} = {meaning}" for number, meaning in quantity.values)
    numbers = [number for number, _ in quantity.values]
    lower = min(numbers)
    upper = max(numbers)
    return Variable(name, role, f"{text}: {meanings}", integer=True, least=lower, greatest=upper)


def _trained_size(model: FrictionModel, quantity: Quantity, number: int) -> float:
    """Return the nominal value of a joint's quantity from the range of its logs, 1 if unknown."""
    if not model.trained:
        return 1.0
    limits = getattr(model.trained[number - 1], quantity.name, (0.0,))
    return _round_nominal(max(map(abs, limits)))


def discretisation(model: FrictionModel, description: str) -> Variable:
    """Return the parameter that selects the integration of the states."""
    start = 1.0 + ("exact", "euler").index(find_discretisation(model))
    return Variable("discretisation", "fixed", description, enumeration=DISCRETISATION, start=start)


def start_mode() -> Variable:
    """Return the parameter that selects the initial state."""
    return Variable(START_MODE, "fixed", "where states begin", enumeration=START, start=STEADY)


def scales(model: FrictionModel) -> Iterator[Variable]:
    """Yield the factors on Coulomb and viscous friction of every joint, limited by the proof."""
    limits = list(map(find_scale_limits, model.laws))
    for k, scale in enumerate(SCALES):
        for i, law in enumerate(model.laws, start=1):
            lower, upper = limits[i - 1][k]
            limit_attributes = {"least": lower, "greatest": upper, "limited": True}
            variable = build_joint_variable(
                model, scale, i, "tunable", start=1.0, **limit_attributes
            )
            if scale == VISCOUS and not has_viscous(law.form):
                variable = replace(
                    variable, description=f"{variable.description}; its law has no such term"
                )
            yield variable


def band_numbers(model: FrictionModel) -> Iterator[Variable]:
    """Yield the parameters of a band: coverage, and the numbers of every joint."""
    coverage_variable = Variable(COVERAGE.name, "tunable", COVERAGE.description, unit=COVERAGE.unit)
    yield replace(
        coverage_variable, start=COVERAGE.start, least=MIN_COVERAGE, greatest=MAX_COVERAGE
    )
    for number in NUMBERS:
        for i, law in enumerate(model.laws, start=1):
            attributes: dict[str, float] = {"start": 0.0}
            if law.band:
                attributes["start"] = law.band.values[number.name]
            if not number.logical:
                attributes["least"] = 0.0
            yield build_joint_variable(model, number, i, "tunable", **attributes)


def build_joints(
    model: FrictionModel,
    extra_outputs: tuple[Equation, ...] = (),
    names: dict[str, str] | None = None,
    *,
    band: bool = False,
    events: bool = True,
) -> tuple[Joint, ...]:
    """Return each joint with the names of its variables; `names` has stems that differ."""
    joints = []
    # C has no units, the only difference between revolute and prismatic forms.
    laws = [replace(law, form=law.form.sliding) for law in model.laws]
    for number, law in enumerate(laws, start=1):
        joint_component = component(
            law, extra_outputs, band=band, coupled=model.coupling is not None, events=events
        )
        joint_names = _name_quantities(joint_component, number, names or {})
        if band:
            joint_names[COVERAGE.name] = COVERAGE.name  # one for all joints
        constants: tuple[float, ...] = ()
        if not is_exposed(law):
            constants = tuple(law.values.values())
        slope = ""
        if not names:
            slope = f"{SLOPE.name}[{number}]"
        joints.append(
            Joint(
                component=joint_component,
                names=joint_names,
                **vars(place(law, number)),
                constants=constants,
                slope=slope,
            )
        )
    return tuple(joints)


def _name_quantities(component: Component, number: int, stems: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of a joint's quantities; `stems` has stems that are not their names."""
    quantities: tuple[Quantity, ...] = (
        *component.inputs,
        *component.shared,
        *component.outputs,
    )
    names = {**{quantity.name: quantity.name for quantity in quantities}, **stems}
    return {name: f"{stem}[{number}]" for name, stem in names.items()}


def dependencies(
    joint: Joint,
    symbol: sympy.Symbol,
    inputs: Mapping[str, tuple[str, ...]] | None = None,
    *,
    starting: bool = False,
) -> tuple[str, ...]:
    """Return the variables that an equation or derivative of a joint depends on.

    Initial states (`initial_symbol`) depend on start values. `inputs` has the variables behind
    inputs; `starting` means before the first step.
    """
    component = joint.component
    beginnings = initial_state(component.memory, component.settling)
    if symbol in beginnings:
        used_symbols = find_sources(beginnings, symbol)
        state_names = joint.starts
    else:
        used_symbols = component.find_sources(symbol, starting=starting)
        state_names = joint.states
    if inputs is None:
        inputs = {}
    variable_names: list[str] = []
    for quantity in (*component.inputs, *component.shared):
        if quantity.symbol in used_symbols:
            variable_names += inputs.get(quantity.name, (joint.names[quantity.name],))
    states = zip(component.memory, state_names, strict=True)
    variable_names += [name for element, name in states if element.state in used_symbols]
    parameters = zip(component.parameters, joint.parameters, strict=False)
    variable_names += [name for quantity, name in parameters if quantity.symbol in used_symbols]
    return tuple(variable_names)


def law_variables(
    law: FrictionLaw,
    number: int,
    joint_equations: Joint,
    inputs: Mapping[str, tuple[str, ...]] | None = None,
) -> Iterator[Variable]:
    """Yield the states of a joint's law, their derivatives and its parameters."""
    law_elements = {m.name: m for m in law.form.memory}
    memory = [law_elements.get(m.name, m) for m in joint_equations.component.memory]
    elements = list(zip(memory, joint_equations.states, joint_equations.derivatives, strict=True))
    for element, state, _ in elements:
        size = 1.0
        if element.name in law_elements:
            size = nominal(law, element)
        start_names = dependencies(joint_equations, initial_symbol(element), inputs)
        yield Variable(
            state,
            "state",
            f"friction state {element.name} of joint {number}",
            unit=element.unit,
            nominal=size,
            initial_dependencies=(START_MODE, *start_names),
        )
    for element, state, derivative in elements:
        yield Variable(
            derivative,
            "local",
            f"time derivative of {state}",
            unit=_per_second(element.unit),
            derivative_of=state,
            dependencies=dependencies(joint_equations, element.derivative, inputs),
        )
    # States that are not of the law come first, and begin at zero.
    added = (0.0,) * (len(memory) - len(law.start))
    starts = (*added, *law.start)
    for (element, state, _), name, start in zip(
        elements, joint_equations.starts, starts, strict=True
    ):
        text = f"start value of {state}; if the start is steady, that of a start at rest"
        yield Variable(name, "fixed", text, unit=element.unit, start=start)
    if not is_exposed(law):
        return
    for name, quantity in zip(joint_equations.parameters, law.form.coefficients, strict=True):
        yield Variable(
            name,
            "tunable",
            quantity.description,
            unit=quantity.unit,
            start=law.values[quantity.name],
        )


def nominal(law: FrictionLaw, element: Element) -> float:
    """Size of a state in slow sliding, drive / rate or the bound of a stop; 1 if unusable."""
    operating_point = {
        quantity.symbol: law.values[quantity.name] for quantity in law.form.coefficients
    }
    operating_point |= dict.fromkeys(INPUTS, 0.0)
    operating_point |= {memory_element.state: 0.0 for memory_element in law.form.memory}
    operating_point[DQ] = _NOMINAL_SPEED
    numbers = {symbol: sympy.Float(value) for symbol, value in operating_point.items()}
    first, second = (float(part.xreplace(numbers)) for part in element.parts)
    if not isinstance(element, Relaxation):
        return _round_nominal(second)
    if second == 0.0:
        return 1.0
    return _round_nominal(abs(first / second))


def _round_nominal(size: float) -> float:
    """Return a size with two digits, 1 for one that is no scale: zero, infinite or not a number."""
    if not 0.0 < size < inf:
        return 1.0
    return float(f"{size:.2g}")


def _per_second(unit: str) -> str:
    numerator, slash, denominator = unit.partition("/")
    if not slash:
        return f"{unit}/s"
    return f"{numerator}/({denominator}.s)"


def to_sliding(variable: Variable, words: Mapping[str, str]) -> Variable:
    """Return a variable of a turning joint as that of a sliding one, with other words and unit."""
    text = variable.description
    for turning, other in words.items():
        text = re.sub(rf"\b{turning}\b", other, text)
    unit = variable.unit and unit_of_joint(variable.unit, is_prismatic=True)
    return replace(variable, unit=unit, description=text)


def make_inputs_initial(variable: Variable, inputs: Collection[str]) -> Variable:
    """Return a variable that depends on inputs only until initialisation ends."""
    initial_names = tuple(name for name in variable.dependencies if name in inputs)
    running_names = tuple(name for name in variable.dependencies if name not in inputs)
    return replace(variable, dependencies=running_names, initial_dependencies=initial_names)
