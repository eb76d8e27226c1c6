"""FMUs of blocks: vectors of variables, their indices in C, and equations of all joints."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from fmu_src.equations.header import Joint, equations_header, memory_size
from fmu_src.export.description import RELEASE_DATE, Description
from fmu_src.export.interface import Enumeration, Interface, Role, Variable
from fmu_src.export.package import Content, equation_sources
from fmu_src.pages.block_page import BlockPage, block_html, component_page
from fmu_src.run.reference_results import Stimuli, waves
from hesr_model.equations.component import Choice, Component, Parameter, Quantity
from hesr_model.errors import ExportError
from hesr_model.support.owner import OURS, Owner


def vector(
    name: str,
    role: Role,
    unit: str,
    text: str,
    start: Iterable[float],
    dependencies: Sequence[str] = (),
) -> Iterator[Variable]:
    """Yield one variable per joint; `{}` in a dependency is replaced by the joint number."""
    for i, value in enumerate(map(float, start), start=1):
        joint_dependencies = tuple(d.format(i) for d in dependencies)
        yield Variable(
            f"{name}[{i}]",
            role,
            f"{text}, joint {i}",
            unit=unit,
            start=value,
            dependencies=joint_dependencies,
        )


def places(interface: Interface, guard: str, first: Mapping[str, str], **sizes: int) -> str:
    """Return a C header with the index of the first variable of each kind and further constants."""
    constants = {name: interface.places[variable] for name, variable in first.items()} | sizes
    lines = ",\n".join(f"    {name} = {value}" for name, value in constants.items())
    return (
        "/* Generated: index of the first variable of each kind; other joints follow it. */\n"
        f"#ifndef {guard}\n#define {guard}\n\nenum {{\n{lines},\n}};\n\n#endif\n"
    )


def content(
    interface: Interface,
    *,
    name: str,
    text: str,
    sources: Mapping[str, str],
    step: float,
    page: BlockPage,
    example: Mapping[str, float] | None = None,
    owner: Owner = OURS,
) -> Content:
    """Return the FMU of a block, with its preferred step [s].

    `example` has the parameters of the reference results that differ from their start values.
    """
    about = Description(
        name=name, identifier=name.lower(), text=text, created=RELEASE_DATE, step=step, owner=owner
    )
    inputs = waves(
        {variable.name: 1.0 for variable in interface.variables if variable.role == "input"}
    )
    stimuli = Stimuli(step=step, inputs=inputs, parameters=example or {})
    members = {"documentation/index.html": block_html(page, interface, about).encode()}
    return Content(table=interface, about=about, sources=sources, members=members, stimuli=stimuli)


def block(
    component: Component,
    joints: int,
    *,
    name: str,
    text: str,
    step: float,
    example: Mapping[str, float],
    notes: str | Iterable[str] = (),
) -> Content:
    """Return the FMU of a component, with its preferred step [s].

    Signals are `name[1]`, .., shared parameters `name`; `example` has the
    parameters of the reference results by their own name; `notes` are
    paragraphs of the FMU's page. Raises ExportError for states, whose start
    values have no variables.
    """
    if isinstance(notes, str):
        notes = [notes]
    if component.memory:
        raise ExportError(
            f"block '{name}': state '{component.memory[0].name}' has no start value; write what is "
            "remembered with previous()."
        )
    block_joints = [
        Joint(component=component, names=_names(component, i)) for i in range(1, joints + 1)
    ]
    # Values of the last sample are not states of a solver.
    supports_exchange = not (component.remembered or component.sample_time)
    interface = Interface(
        variables=tuple(_variables(component, block_joints)),
        own=memory_size(block_joints),
        model_exchange=supports_exchange,
        directional_derivatives=supports_exchange,
    )
    joint_example: dict[str, float] = {}
    for parameter_name, value in example.items():
        names = (joint.names[parameter_name] for joint in block_joints)
        joint_example |= dict.fromkeys(names, value)
    return content(
        interface,
        name=name,
        text=text,
        sources=equation_sources(equations_header(block_joints, interface, {})),
        step=step,
        page=component_page(component, list(notes)),
        example=joint_example,
    )


def _names(component: Component, number: int) -> dict[str, str]:
    joint_quantities = (*component.inputs, *component.parameters, *component.outputs)
    names = {quantity.name: f"{quantity.name}[{number}]" for quantity in joint_quantities}
    names |= {quantity.name: quantity.name for quantity in component.shared}
    return names


def _variables(component: Component, joints: list[Joint]) -> Iterator[Variable]:
    zeros = [0.0] * len(joints)
    for quantity in component.inputs:
        yield from vector(quantity.name, "input", quantity.unit, quantity.description, zeros)
    for equation in component.outputs:
        at_once: Collection[object] = ()
        if not component.holds:  # else outputs change with samples only
            at_once = component.find_sources(equation.symbol)
        initial = component.find_sources(equation.symbol, starting=True)
        for i, joint in enumerate(joints, start=1):
            yield Variable(
                joint.names[equation.name],
                "output",
                f"{equation.description}, joint {i}",
                unit=equation.unit,
                dependencies=_select_names(component, joint, at_once),
                initial_dependencies=_select_names(component, joint, initial),
            )
    for parameter in component.shared:
        yield _parameter(parameter, parameter.name, parameter.description)
    for parameter in component.parameters:
        for i, joint in enumerate(joints, start=1):
            name = joint.names[parameter.name]
            yield _parameter(parameter, name, f"{parameter.description}, joint {i}")


def _select_names(
    component: Component, joint: Joint, symbols: Collection[object]
) -> tuple[str, ...]:
    return tuple(
        joint.names[quantity.name] for quantity in component.given if quantity.symbol in symbols
    )


def _parameter(parameter: Quantity, name: str, text: str) -> Variable:
    if not isinstance(parameter, Parameter):
        raise TypeError(f"'{parameter.name}' has no start value")
    role: Role = "fixed"
    if parameter.tunable:
        role = "tunable"
    if isinstance(parameter, Choice):
        choice = Enumeration(name=parameter.name.capitalize(), items=parameter.items)
        return Variable(name, role, text, enumeration=choice, start=parameter.start)
    return Variable(name, role, text, unit=parameter.unit, start=parameter.start)
