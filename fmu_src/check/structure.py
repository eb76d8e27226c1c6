"""Rules on ModelStructure."""

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

from fmu_src.check.description import STRUCTURE, ParsedDescription, ParsedVariable, Unknown, integer
from hesr_model.support.text import listed, quoted


def outputs(about: ParsedDescription) -> Iterator[str]:
    """Check that Outputs lists exactly the outputs."""
    needed = [v for v in about.variables if v.causality == "output"]
    yield from _compared(
        about, "Outputs", needed, "every variable with causality 'output' and no other"
    )


def derivatives(about: ParsedDescription) -> Iterator[str]:
    """Check that Derivatives lists only derivatives, and all of them for model exchange."""
    declared = [v for v in about.variables if "derivative" in v.own]
    if about.exchanges:
        needed = [v for v in declared if v.variability == "continuous"]
        why = "every derivative of a state and no other variable"
        yield from _compared(about, "Derivatives", needed, why)
        return
    extra = [v for v in _listed_variables(about, "Derivatives") if "derivative" not in v.own]
    if extra:
        yield (
            f"{about.lists['Derivatives']} lists {listed(v.name for v in extra)}, "
            "which have no attribute 'derivative'."
        )


def initial_unknowns(about: ParsedDescription) -> Iterator[str]:
    """Check that InitialUnknowns lists the results of initialisation, in the variables' order."""
    needed = {
        v.index: v
        for v in about.variables
        if (v.causality == "output" and v.initial in ("approx", "calculated"))
        or v.causality == "calculatedParameter"
    }
    for derivative in _listed_variables(about, "Derivatives"):
        state = about.variable(integer(derivative.own.get("derivative")))
        for v in (derivative, state):
            if v is not None and v.initial in ("approx", "calculated"):
                needed[v.index] = v
    why = (
        "outputs, states and derivatives with initial 'approx' or 'calculated', calculated "
        "parameters, and no other variable"
    )
    yield from _compared(about, "InitialUnknowns", [needed[i] for i in sorted(needed)], why)
    found = _listed_variables(about, "InitialUnknowns")
    for before, after in pairwise(found if about.fmi == 2 else ()):
        if after.index < before.index:
            yield (
                f"{about.lists['InitialUnknowns']} lists {quoted(after.name)} after "
                f"{quoted(before.name)}; it must follow the order of the variables."
            )


def indices(about: ParsedDescription) -> Iterator[str]:
    """Check that the listed variables exist and are listed once."""
    for name in STRUCTURE:
        for index, times in Counter(u.index for u in about.structure[name]).items():
            variable = about.variable(index)
            if variable is None:
                yield f"{about.lists[name]} lists {about.shown(index)}, which does not exist."
            elif times > 1:
                yield f"{about.lists[name]} lists {quoted(variable.name)} {times} times."


def dependencies(about: ParsedDescription) -> Iterator[str]:
    """Check that all unknowns have existing dependencies, in order and with their kinds."""
    for name in STRUCTURE:
        unknowns = about.structure[name]
        silent = [_named(about, u) for u in unknowns if u.dependencies is None]
        if silent:
            yield (
                f"{about.lists[name]} gives no dependencies for {listed(silent)}, "
                "so importers assume all inputs and find false algebraic loops."
            )
        for unknown in unknowns:
            yield from _of_unknown(about, name, unknown)


def _of_unknown(about: ParsedDescription, name: str, unknown: Unknown) -> Iterator[str]:
    who = f"{about.lists[name]} gives {quoted(_named(about, unknown))}"
    known = unknown.dependencies
    if unknown.kinds is not None and known is None:
        yield f"{who} dependenciesKind without dependencies."
    if known is None:
        return
    missing = [i for i in known if about.variable(i) is None]
    if missing:
        yield f"{who} a dependency on {about.shown(missing[0])}, which does not exist."
    elif about.fmi == 2 and any(a >= b for a, b in pairwise(known)):
        yield f"{who} dependencies that are not in ascending order."
    if unknown.kinds is not None and len(unknown.kinds) != len(known):
        yield f"{who} {len(known)} dependencies and {len(unknown.kinds)} kinds of them."


def _compared(
    about: ParsedDescription, name: str, needed: list[ParsedVariable], why: str
) -> Iterator[str]:
    """Yield missing and surplus entries of a list."""
    found = {v.index for v in _listed_variables(about, name)}
    lacking = [v.name for v in needed if v.index not in found]
    extra = found - {v.index for v in needed}
    if lacking:
        yield f"{about.lists[name]} lacks {listed(lacking)}; it must list {why}."
    if extra:
        names = [about.variables[i - 1].name for i in sorted(extra)]
        yield f"{about.lists[name]} lists {listed(names)}; it must list {why}."


def _listed_variables(about: ParsedDescription, name: str) -> list[ParsedVariable]:
    found = (about.variable(u.index) for u in about.structure[name])
    return [v for v in found if v is not None]


def _named(about: ParsedDescription, unknown: Unknown) -> str:
    variable = about.variable(unknown.index)
    return variable.name if variable else about.shown(unknown.index)


RULES = (outputs, derivatives, initial_unknowns, indices, dependencies)
