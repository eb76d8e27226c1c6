"""The friction component: its variables and its equations, from a friction model."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from math import inf

import numpy as np
import sympy

from fmu_src.equations.header import FRICTION, Joint, Needs, equations_header, indicators, own_size
from fmu_src.friction.validity import discretisation_of
from fmu_src.friction.variable_names import exposed, place
from fmu_src.interface import Enumeration, Interface, Variable
from hesr_model.equations.component import Component, Equation, Quantity, Relaxation
from hesr_model.equations.memory import Element
from hesr_model.equations.program import beginning, begun, sources
from hesr_model.friction.band import COVERAGE, GREATEST, LEAST, NUMBERS, start_values
from hesr_model.friction.banded import band_equations
from hesr_model.friction.inputs import DQ, INPUTS, QUANTITIES, TAU_LOAD
from hesr_model.friction.law import MOVING, TORQUE, FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.scales import SCALES, VISCOUS, has_viscous, scaled
from hesr_model.robots.transmission import Coupling
from hesr_model.units import unit_of_joint

DISCRETISATION = Enumeration(
    name="Discretisation",
    items=(
        ("exact", "exact for inputs held over a step, stable at any step"),
        ("euler", "explicit Euler, requires rate * step < 1"),
    ),
)

_NONE = 1e-12
"""Of a coupling's inverse: a smaller share is rounding."""
START = Enumeration(
    name="Start",
    items=(
        (
            "steady",
            "in the steady state of the first inputs, faded in from the start values at "
            f"rest up to {MOVING:g} rad/s or m/s",
        ),
        ("given", "at their start values"),
    ),
)

STEADY, GIVEN = 1.0, 2.0
"""Its choices as numbers."""

START_MODE = "start_mode"
"""Name of the parameter that says where states begin."""

_CRAWL = 0.1
"""Speed at whose steady state a state's nominal value is taken [rad/s]."""

_EFFORT = {False: "torque", True: "force"}
"""What a joint that turns, or one that slides, takes to move."""

POWER = Equation(
    name="power",
    unit="W",
    description="power that the friction of {joint} takes",
    expression=sympy.Symbol(TORQUE, real=True) * DQ,
    output=True,
)
"""An output that every friction FMU can have."""

SLOPE = f"d{TORQUE}_d{DQ.name}"
"""Name of the slope of the torque over the velocity."""


def component(law: FrictionLaw, more: Iterable[Equation] = (), *, band: bool = False) -> Component:
    """Return the equations of a joint: its law, with `SCALES`, further outputs and the band."""
    form = scaled(law.form)
    own = form.component
    return replace(
        own,
        parameters=law.form.coefficients,
        shared=(*SCALES, *((*NUMBERS, COVERAGE) if band else ())),
        equations=(*own.equations, *more, *(band_equations(form) if band else ())),
    )


def interface(
    model: FrictionModel, more: tuple[Equation, ...] = (), *, band: bool = False
) -> Interface:
    """Return the variables of a friction FMU.

    The connectors `dq[i]`, `q[i]`, `tau_load[i]` -> `tau[i]` are those of every friction FMU.

    Parameters
    ----------
    model : one law for each joint.
    more : further outputs, as `POWER`.
    band : whether the ends of the model's band are outputs, too.

    Raises
    ------
    ExportError
        If the laws' names are not names in FMI, or their discretisations differ.
    """
    numbered = list(enumerate(zip(model.joints, model.slides, strict=True), start=1))
    inputs = [
        _of_joint(model, quantity, joint, name, slides, role="input")
        for quantity in QUANTITIES
        for joint, (name, slides) in numbered
    ]
    joints = joints_of(model, more, band=band)
    outputs = [
        _of_joint(
            model,
            equation,
            joint,
            name,
            slides,
            role="output",
            dependencies=_output_dependencies(model, joints, joint, equation),
        )
        for equation in joints[0].component.outputs
        for joint, (name, slides) in numbered
    ]
    slopes = [
        Variable(
            name=f"{SLOPE}[{joint}]",
            role="on_demand",
            description=f"slope of tau[{joint}] over dq[{joint}] held over the last step, the "
            "states following; in model exchange that at the last event, the states at rest",
            unit=unit_of_joint("N.m.s/rad", slides=slides),
            dependencies=_output_dependencies(model, joints, joint, joints[0].component.outputs[0]),
        )
        for joint, (_, slides) in numbered
    ]
    choice = discretisation(
        model,
        "how co-simulation integrates the states over a step; without meaning in model exchange, "
        "where the importer's solver does",
    )
    own = [
        v
        for joint, law in enumerate(model.laws, start=1)
        for v in law_variables(law, joint, joints[joint - 1], _mixed_inputs(model.coupling, joint))
    ]
    return Interface(
        variables=(
            *(*inputs, *outputs, *slopes, choice, start_mode(), *scales(model)),
            *(band_numbers(model) if band else ()),
            *own,
        ),
        indicators=indicators(joints),
        own=own_size(joints),
    )


def mixed(name: str, coordinate: int, coupling: Coupling | None) -> tuple[str, ...]:
    """Return the joints' variables of which a signal of a friction coordinate is made."""
    if coupling is None:
        return (f"{name}[{coordinate}]",)
    matrix = coupling.backward if name == TAU_LOAD.name else coupling.forward
    return tuple(f"{name}[{m + 1}]" for m in np.flatnonzero(np.abs(matrix[coordinate - 1]) > _NONE))


def adding(joint: int, coupling: Coupling | None) -> tuple[int, ...]:
    """Return the friction coordinates whose torques add to that of a joint."""
    if coupling is None:
        return (joint,)
    return tuple(int(i) + 1 for i in np.flatnonzero(coupling.forward[:, joint - 1]))


def _mixed_inputs(coupling: Coupling | None, coordinate: int) -> dict[str, tuple[str, ...]]:
    return {q.name: mixed(q.name, coordinate, coupling) for q in QUANTITIES}


def _output_dependencies(
    model: FrictionModel, joints: tuple[Joint, ...], joint: int, output: Equation
) -> tuple[str, ...]:
    """Return the variables of which an output is made; the torque is the sum of coordinates'."""
    torque = output.symbol == joints[0].component.outputs[0].symbol
    coordinates = adding(joint, model.coupling) if torque else (joint,)
    found = [
        name
        for i in coordinates
        for name in dependencies(joints[i - 1], output.symbol, _mixed_inputs(model.coupling, i))
    ]
    return tuple(dict.fromkeys(found))


def _of_joint(
    model: FrictionModel, quantity: Quantity, joint: int, name: str, slides: bool, *, role: str,
    dependencies: tuple[str, ...] = (),
) -> Variable:  # fmt: skip
    seen = model.trained[joint - 1] if model.trained else None
    return Variable(
        name=f"{quantity.name}[{joint}]",
        role="input" if role == "input" else "output",
        description=quantity.description.format(joint=name, effort=_EFFORT[slides]),
        unit=unit_of_joint(quantity.unit, slides=slides),
        nominal=_usual(max(map(abs, getattr(seen, quantity.name, (0.0,))))),
        dependencies=dependencies,
    )


def discretisation(model: FrictionModel, description: str) -> Variable:
    """Return the parameter that says how states are integrated.

    Errors are those of `discretisation_of`.
    """
    return Variable(
        name="discretisation",
        role="fixed",
        description=description,
        enumeration=DISCRETISATION,
        start=1.0 + ("exact", "euler").index(discretisation_of(model)),
    )


def start_mode() -> Variable:
    """Return the parameter that says where states begin."""
    return Variable(
        name=START_MODE,
        role="fixed",
        description="where states begin",
        enumeration=START,
        start=STEADY,
    )


def scales(model: FrictionModel) -> Iterator[Variable]:
    """Yield the factors on Coulomb and on viscous friction, one of each for every joint."""
    for scale in SCALES:
        for i, (joint, law) in enumerate(zip(model.joints, model.laws, strict=True), start=1):
            idle = scale == VISCOUS and not has_viscous(law.form)
            yield Variable(
                name=f"{scale.name}[{i}]",
                role="tunable",
                description=scale.description.format(joint=joint)
                + ("; its law has no such term" if idle else ""),
                unit=scale.unit,
                start=1.0,
                least=0.0,
            )


def band_numbers(model: FrictionModel) -> Iterator[Variable]:
    """Yield what a band is made with: its coverage, and the numbers of every joint."""
    yield Variable(
        name=COVERAGE.name,
        role="tunable",
        description=COVERAGE.description,
        unit=COVERAGE.unit,
        start=COVERAGE.start,
        least=LEAST,
        greatest=GREATEST,
    )
    rows = list(enumerate(zip(model.joints, model.laws, model.slides, strict=True), start=1))
    for number in NUMBERS:
        for i, (joint, law, slides) in rows:
            yield Variable(
                name=f"{number.name}[{i}]",
                role="tunable",
                description=number.description.format(joint=joint),
                unit=unit_of_joint(number.unit, slides=slides),
                start=start_values(law.band)[number.name] if law.band else 0.0,
                least=0.0,
            )


def joints_of(
    model: FrictionModel,
    more: tuple[Equation, ...] = (),
    names: Mapping[str, str] | None = None,
    *,
    band: bool = False,
) -> tuple[Joint, ...]:
    """Return each joint of a model with the names of its variables.

    Parameters
    ----------
    model : one law for each joint.
    more : further outputs.
    names : for what is not called by its own name, the stem of its variables.
    band : whether they have the model's band.
    """
    found = []
    # C knows no units, in which the forms of joints that turn and that slide differ alone.
    laws = [replace(law, form=law.form.sliding) for law in model.laws]
    for joint, law in enumerate(laws, start=1):
        own, at = component(law, more, band=band), place(law, joint)
        stems = {q.name: q.name for q in (*own.inputs, *own.shared, *own.outputs)} | dict(
            names or {}
        )
        found.append(
            Joint(
                component=own,
                names={name: f"{stem}[{joint}]" for name, stem in stems.items()}
                | ({COVERAGE.name: COVERAGE.name} if band else {}),
                states=at.states,
                derivatives=at.derivatives,
                starts=at.starts,
                parameters=at.parameters if exposed(law) else (),
                constants=() if exposed(law) else tuple(law.values.values()),
                slope="" if names else f"{SLOPE}[{joint}]",
            )
        )
    return tuple(found)


def dependencies(
    joint: Joint, symbol: sympy.Symbol, inputs: Mapping[str, tuple[str, ...]] | None = None
) -> tuple[str, ...]:
    """Return the variables of which an equation or a derivative of a joint is made.

    Parameters
    ----------
    joint : the joint.
    symbol : what is asked for; where a state begins (`program.begun`) is made of start values.
    inputs : variables of which an input is made, where it is none itself.
    """
    own = joint.component
    beginnings = beginning(own.memory, own.settling)
    used = sources(beginnings, symbol) if symbol in beginnings else own.sources(symbol)
    found: list[str] = []
    for quantity in (*own.inputs, *own.shared):
        if quantity.symbol in used:
            found += (inputs or {}).get(quantity.name, (joint.names[quantity.name],))
    states = zip(own.memory, joint.starts if symbol in beginnings else joint.states, strict=True)
    found += [name for element, name in states if element.state in used]
    parameters = zip(own.parameters, joint.parameters, strict=False)
    found += [name for quantity, name in parameters if quantity.symbol in used]
    return tuple(found)


def law_variables(
    law: FrictionLaw, joint: int, own: Joint, inputs: Mapping[str, tuple[str, ...]] | None = None
) -> Iterator[Variable]:
    """Yield the states of a joint's law, their derivatives and its parameters.

    Parameters
    ----------
    law : of the joint.
    joint : number of the joint, from 1.
    own : the joint's equations and names.
    inputs : as for `dependencies`.
    """
    known = {m.name: m for m in law.form.memory}
    memory = [known.get(m.name, m) for m in own.component.memory]
    elements = list(zip(memory, own.states, own.derivatives, strict=True))
    for element, state, _ in elements:
        yield Variable(
            name=state,
            role="state",
            description=f"friction state {element.name} of joint {joint}",
            unit=element.unit,
            nominal=nominal(law, element) if element.name in known else 1.0,
            initial_dependencies=(START_MODE, *dependencies(own, begun(element), inputs)),
        )
    for element, state, derivative in elements:
        yield Variable(
            name=derivative,
            role="local",
            description=f"time derivative of {state}",
            unit=_per_second(element.unit),
            derivative_of=state,
            dependencies=dependencies(own, element.derivative, inputs),
        )
    first = (*(0.0,) * (len(memory) - len(law.start)), *law.start)
    for (element, state, _), name, start in zip(elements, own.starts, first, strict=True):
        yield Variable(
            name=name,
            role="fixed",
            description=f"value of {state} at the start; where this is steady, of a start at rest",
            unit=element.unit,
            start=start,
        )
    if not exposed(law):
        return
    for name, coefficient in zip(own.parameters, law.form.coefficients, strict=True):
        yield Variable(
            name=name,
            role="tunable",
            description=coefficient.description,
            unit=coefficient.unit,
            start=law.values[coefficient.name],
        )


def nominal(law: FrictionLaw, element: Element) -> float:
    """Size of a state in slow sliding; 1 where that is nothing usable.

    A relaxation's is drive / rate, a stop's its bound.
    """
    at = {c.symbol: law.values[c.name] for c in law.form.coefficients}
    at |= dict.fromkeys(INPUTS, 0.0) | {DQ: _CRAWL} | {m.state: 0.0 for m in law.form.memory}
    numbers = {symbol: sympy.Float(value) for symbol, value in at.items()}
    first, second = (float(e.xreplace(numbers)) for e in element.parts)
    slides_at = abs(first / second) if second else 0.0
    size = slides_at if isinstance(element, Relaxation) else second
    return _usual(size)


def _usual(size: float) -> float:
    """Return a size with two digits; 1 where it is nothing usable."""
    return float(f"{size:.2g}") if 0.0 < size < inf else 1.0


def _per_second(unit: str) -> str:
    """Return the unit of a quantity's time derivative."""
    above, slash, below = unit.partition("/")
    return f"{above}/({below}.s)" if slash else f"{above}/s"


def equations_to_c(
    model: FrictionModel,
    table: Interface,
    more: tuple[Equation, ...] = (),
    *,
    band: bool = False,
) -> str:
    """Return equations.h of a friction FMU."""
    places = {"DISCRETISATION": "discretisation", "START_MODE": START_MODE}
    needs = Needs(functions=FRICTION, places=places)
    return equations_header(joints_of(model, more, band=band), table, needs, model.coupling)
