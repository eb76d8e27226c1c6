"""Common parts of the blocks: vectors of variables, their indices in C, and the FMU."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from fmu_src.export.description import RELEASED, Description
from fmu_src.export.interface import Interface, Role, Variable
from fmu_src.export.package import Content
from fmu_src.run.reference_results import Stimuli, waves
from hesr_model.robots.owner import OURS, Owner


def vector(
    name: str,
    role: Role,
    unit: str,
    text: str,
    start: Iterable[float],
    dependencies: Sequence[str] = (),
) -> Iterator[Variable]:
    """Yield one variable per joint; `{}` in a dependency is replaced by the joint number."""
    for i, value in enumerate(start, start=1):
        own = tuple(d.format(i) for d in dependencies)
        one = Variable(f"{name}[{i}]", role, f"{text}, joint {i}", unit=unit, dependencies=own)
        yield replace(one, start=float(value))


def places(table: Interface, guard: str, first: Mapping[str, str], **sizes: int) -> str:
    """Return a C header with indices and constants, inside a guard.

    `first` maps a name in C to the first variable of a kind; `sizes` are further constants.
    """
    constants = {name: table.places[variable] for name, variable in first.items()} | sizes
    lines = ",\n".join(f"    {name} = {value}" for name, value in constants.items())
    return (
        "/* Generated: where the first variable of each kind stands; other joints follow it. */\n"
        f"#ifndef {guard}\n#define {guard}\n\nenum {{\n{lines},\n}};\n\n#endif\n"
    )


def content(
    table: Interface,
    *,
    name: str,
    text: str,
    sources: Mapping[str, str],
    step: float,
    example: Mapping[str, float] | None = None,
    owner: Owner = OURS,
) -> Content:
    """Return the FMU of a block, whose binaries have its name in lower case.

    The preferred step is in s; `example` has the parameters of the reference results that differ
    from their start values. The owner is HESR if the block contains nothing of a robot.
    """
    about = Description(
        name=name, identifier=name.lower(), text=text, created=RELEASED, step=step, owner=owner
    )
    inputs = waves({v.name: 1.0 for v in table.variables if v.role == "input"})
    stimuli = Stimuli(step=step, inputs=inputs, parameters=example or {})
    return Content(table=table, about=about, sources=sources, members={}, stimuli=stimuli)
