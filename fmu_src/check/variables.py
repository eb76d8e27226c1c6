"""Rules on variables; each yields one sentence for each variable that breaks it."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping

from fmu_src.check.description import Description, Variable, integer, real
from hesr_model.support.text import listed, plain, quoted

# Allowed values of initial for each causality and variability; input and independent have none.
_EXACT, _COMPUTED = {"exact"}, {"calculated", "approx"}
_ANY = _EXACT | _COMPUTED
_INITIAL: dict[tuple[str, str], set[str]] = {
    ("parameter", "fixed"): _EXACT,
    ("parameter", "tunable"): _EXACT,
    ("calculatedParameter", "fixed"): _COMPUTED,
    ("calculatedParameter", "tunable"): _COMPUTED,
    ("input", "discrete"): set(),
    ("input", "continuous"): set(),
    ("structuralParameter", "fixed"): _EXACT,
    ("structuralParameter", "tunable"): _EXACT,
    ("output", "constant"): _EXACT,
    ("output", "discrete"): _ANY,
    ("output", "continuous"): _ANY,
    ("local", "constant"): _EXACT,
    ("local", "fixed"): _COMPUTED,
    ("local", "tunable"): _COMPUTED,
    ("local", "discrete"): _ANY,
    ("local", "continuous"): _ANY,
    ("independent", "continuous"): set(),
}

_PART = r"(?:[A-Za-z_][A-Za-z0-9_]*|'(?:[^'\\]|\\.)+')(?:\[[0-9]+(?:,[0-9]+)*\])?"
_IDENTIFIER = rf"{_PART}(?:\.{_PART})*"
_STRUCTURED = re.compile(rf"{_IDENTIFIER}|der\({_IDENTIFIER}(?:,[0-9]+)?\)")

_NUMBERS = ("Real", "Integer", "Enumeration")


def names(about: Description) -> Iterator[str]:
    """Check that names are unique and, where that is declared, structured."""
    every = (name for v in about.variables for name in (v.name, *v.others))
    for name, times in Counter(every).items():
        if times > 1:
            yield f"the variable {quoted(name)} is declared {times} times; names are unique."
    if about.attributes.get("variableNamingConvention") != "structured":
        return
    for variable in about.variables:
        if not _STRUCTURED.fullmatch(variable.name):
            yield (
                f"the variable {quoted(variable.name)} has no structured name, which "
                "variableNamingConvention promises."
            )


def combinations(about: Description) -> Iterator[str]:
    """Check that causality, variability and initial go together, and suit the type."""
    for v in about.variables:
        shown = quoted(v.name)
        allowed = _INITIAL.get((v.causality, v.variability))
        if allowed is None:
            yield (
                f"the variable {shown} has causality '{plain(v.causality)}' and variability "
                f"'{plain(v.variability)}', which do not go together."
            )
        elif v.declared_initial and v.declared_initial not in allowed:
            yield (
                f"the variable {shown} has initial '{plain(v.declared_initial)}', which does not "
                f"go with causality '{v.causality}' and variability '{v.variability}'."
            )
        if v.variability == "continuous" and v.kind not in (*about.continuous, ""):
            have = "(the default), which only Real has"
            if about.fmi == 3:
                have = "which only Float32 and Float64 have"
            yield (
                f"the variable {shown} is of type {v.kind} and has variability 'continuous' {have}."
            )
    independent = [v.name for v in about.variables if v.causality == "independent"]
    if len(independent) > 1:
        yield f"the variables {listed(independent)} are all independent; there is one at most."


def start_values(about: Description) -> Iterator[str]:
    """Check that start values are there where they must be and nowhere else but where they may."""
    for v in about.variables:
        has = "start" in v.own
        if demand := None if has else _demand(v):
            yield f"the variable {quoted(v.name)} has no start value, which its {demand} demands."
        if has and (v.causality == "independent" or v.initial == "calculated"):
            bar = (
                "causality 'independent'"
                if v.causality == "independent"
                else "initial 'calculated'"
            )
            yield f"the variable {quoted(v.name)} has a start value, which its {bar} forbids."


def _demand(v: Variable) -> str | None:
    if v.causality in ("input", "parameter"):
        return f"causality '{v.causality}'"
    if v.variability == "constant":
        return "variability 'constant'"
    return f"initial '{v.initial}'" if v.initial in ("exact", "approx") else None


def ranges(about: Description) -> Iterator[str]:
    """Check that start values lie within min and max or are items, and nominal is positive."""
    for v in about.variables:
        if v.kind not in (*_NUMBERS, *about.continuous) and "Int" not in v.kind:
            continue
        low, high = (real(v.get(name)) for name in ("min", "max"))
        starts = [real(text) for text in (v.get("start") or "").split()]
        shown = quoted(v.name)
        if low is not None and high is not None and low > high:
            yield f"the variable {shown} has min {low:.15g}, which is above its max {high:.15g}."
        elif outside := [
            start
            for start in starts
            if start is not None
            and ((low is not None and start < low) or (high is not None and start > high))
        ]:
            bounds = [f"{k} {x:.15g}" for k, x in (("min", low), ("max", high)) if x is not None]
            yield (
                f"the variable {shown} has the start value {outside[0]:.15g}, which is outside of "
                f"its {' and '.join(bounds)}."
            )
        nominal = real(v.get("nominal"))
        if nominal is not None and nominal <= 0:
            yield f"the variable {shown} has the nominal value {nominal:.15g}; it is above 0."
        if v.kind == "Enumeration" and v.type and v.type.kind == "Enumeration":
            value = integer(v.own.get("start"))
            if value is not None and value not in v.type.values:
                yield (
                    f"the variable {shown} has the start value {value}, which is no item of the "
                    f"enumeration {quoted(v.type.name)}."
                )


def types(about: Description) -> Iterator[str]:
    """Check that declared types exist and are of the variable's own type."""
    for v in about.variables:
        name = v.own.get("declaredType")
        if name is None:
            continue
        if v.type is None:
            yield (
                f"the variable {quoted(v.name)} has the declared type {quoted(name)}, which is "
                "not defined."
            )
        elif v.type.kind != v.kind:
            yield (
                f"the variable {quoted(v.name)} is of type {plain(v.kind)}, but its declared type "
                f"{quoted(name)} is of type {plain(v.type.kind)}."
            )


def units(about: Description) -> Iterator[str]:
    """Check that units and display units that are used are defined."""
    users: list[tuple[str, Mapping[str, str], Variable | None]] = [
        (f"variable {quoted(v.name)}", v.own, v) for v in about.variables
    ]
    users += [(f"type {quoted(t.name)}", t.attributes, None) for t in about.types]
    for who, own, variable in users:
        unit, display = own.get("unit"), own.get("displayUnit")
        if unit is not None and unit not in about.display_units:
            yield f"the {who} has the unit {quoted(unit)}, which is not defined."
            continue
        unit = variable.get("unit") if variable else unit
        if display is not None and unit is None:
            yield f"the {who} has the display unit {quoted(display)} but no unit."
        elif display is not None and display not in about.display_units.get(unit or "", ()):
            yield (
                f"the {who} has the display unit {quoted(display)}, which its unit "
                f"{quoted(unit or '')} does not define."
            )


def derivatives(about: Description) -> Iterator[str]:
    """Check that what a variable is the derivative of exists and is a continuous Real."""
    for v in about.variables:
        if "derivative" not in v.own:
            continue
        index = integer(v.own["derivative"])
        if index is None:
            continue
        state = about.variable(index)
        if state is None:
            yield (
                f"the variable {quoted(v.name)} is the derivative of {about.shown(index)}, which "
                "does not exist."
            )
        elif (
            state is v
            or state.kind not in about.continuous
            or state.variability != "continuous"
            or state.size != v.size
        ):
            yield (
                f"the variable {quoted(v.name)} is the derivative of {quoted(state.name)}, which "
                f"is no other continuous variable of type {' or '.join(about.continuous)}"
                f"{'' if about.fmi == 2 else ' and of its size'}."
            )


def aliases(about: Description) -> Iterator[str]:
    """Check that variables of one value reference agree, and only one of them can be set."""
    sets: dict[tuple[str, int], list[Variable]] = defaultdict(list)
    for v in about.variables:
        base = "Integer" if v.kind == "Enumeration" else v.kind
        if v.reference is not None:
            sets[base, v.reference].append(v)
    for (_, reference), members in sets.items():
        if len(members) < 2:
            continue
        who = f"the variables {listed(v.name for v in members)} share value reference {reference}"
        constants = [v for v in members if v.variability == "constant"]
        if constants and len(constants) < len(members):
            yield f"{who}, but only some of them are constant."
        if len({v.own.get("start") for v in constants}) > 1:
            yield f"{who}, but as constants have different values."
        if sum(_settable(v) for v in members) > 1:
            yield f"{who}, but more than one of them can be set."
        if len({v.get("unit") for v in members}) > 1:
            yield f"{who}, but have different units."


def references(about: Description) -> Iterator[str]:
    """Check that each variable of FMI 3.0 has a value reference of its own."""
    sets: dict[int | None, list[str]] = defaultdict(list)
    for v in about.variables:
        sets[v.reference].append(v.name)
    for reference, names in sets.items():
        if reference is not None and len(names) > 1:
            yield (
                f"the variables {listed(names)} share value reference {reference}; in FMI 3.0 "
                "aliases are elements of one variable."
            )


def sizes(about: Description) -> Iterator[str]:
    """Check that an array has one start value, or one for each element."""
    for v in about.variables:
        given = len((v.own.get("start") or "").split())
        if v.size is None:
            yield f"the variable {quoted(v.name)} has a dimension whose size is not known."
        elif v.kind not in ("String", "Binary") and given > 1 and given != v.size:
            yield f"the variable {quoted(v.name)} has {given} start values for {v.size} elements."


def _settable(v: Variable) -> bool:
    started = v.variability != "constant" and v.initial in ("exact", "approx")
    return started or v.causality == "input"


RULES = (
    names,
    combinations,
    start_values,
    ranges,
    types,
    units,
    derivatives,
)
"""Of every version."""

RULES_2 = (aliases,)
RULES_3 = (references, sizes)
