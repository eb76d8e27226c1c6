"""Rules on modelDescription.xml, and on terminalsAndIcons.xml of FMI 2.0 and 3.0.

Those on variables yield one sentence for each variable that breaks them.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise

from lxml import etree

from fmu_src.check.archive import Contents
from fmu_src.check.description import (
    KINDS,
    STRUCTURE,
    ParsedDescription,
    ParsedVariable,
    Unknown,
    integer,
    name_of,
    names_of,
    real,
)
from fmu_src.check.rules import Problem
from hesr_model.support.text import listed, plain, quoted

TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
_ICON = "terminalsAndIcons/icon.png"
_C_NAME = re.compile("[A-Za-z_][A-Za-z0-9_]*")
_DATE = re.compile(r"[0-9]{4}(-[0-9]{2}){2}T[0-9]{2}(:[0-9]{2}){2}Z")


def _kinds(model_description: ParsedDescription) -> Iterator[Problem]:
    if not model_description.kinds:
        yield "kind-missing", f"the elements {' and '.join(KINDS)} are both missing."
    state = "FMUstate" if model_description.fmi == 2 else "FMUState"
    for kind in model_description.kinds:
        if not _C_NAME.fullmatch(kind.identifier):
            yield (
                "kind-identifier",
                f"{kind.element} has the modelIdentifier {quoted(kind.identifier)}, which is "
                "not a C identifier.",
            )
        if kind.can("needsExecutionTool"):
            yield (
                "kind-tool",
                f"{kind.element} has needsExecutionTool='true', so the FMU runs only where its "
                "tool is installed.",
            )
        if kind.can("canSerializeFMUstate") and not kind.can("canGetAndSetFMUstate"):
            yield (
                "kind-state",
                f"{kind.element} has canSerialize{state}='true', which "
                f"requires canGetAndSet{state}='true'.",
            )


def _identity(model_description: ParsedDescription) -> Iterator[Problem]:
    token = "guid" if model_description.fmi == 2 else "instantiationToken"
    if not model_description.attributes.get(token, "").strip():
        text = f"the attribute {token} is empty; it must identify the binaries of the FMU."
        yield "token-empty", text
    date = (
        model_description.attributes.get("generationDateAndTime")
        if model_description.fmi == 2
        else None
    )
    if date is not None and not _DATE.fullmatch(date):
        text = f"generationDateAndTime is {quoted(date)}; the format is YYYY-MM-DDThh:mm:ssZ."
        yield "date-format", text


def _experiment(model_description: ParsedDescription) -> Iterator[Problem]:
    start, stop, step, tolerance = (
        real(model_description.experiment.get(n))
        for n in ("startTime", "stopTime", "stepSize", "tolerance")
    )
    if start is not None and stop is not None and stop <= start:
        text = f"DefaultExperiment has stopTime {stop:.15g}, not after its startTime {start:.15g}."
        yield "experiment-times", text
    elif start is not None and stop is not None and step is not None and step > stop - start:
        text = f"DefaultExperiment has stepSize {step:.15g}, longer than the experiment."
        yield "experiment-step", text
    for name, value in (("stepSize", step), ("tolerance", tolerance)):
        if value is not None and value <= 0:
            text = f"DefaultExperiment has {name} {value:.15g}; it must be positive."
            yield "experiment-times", text
    for name, text in model_description.experiment.items():
        if text.strip() in ("INF", "+INF", "-INF", "NaN"):
            said = f"DefaultExperiment has {name} {text.strip()}; it must be finite."
            yield "experiment-times", said


def _definitions(model_description: ParsedDescription) -> Iterator[Problem]:
    yield from repeated("unit-twice", "unit", (name for name, _ in model_description.units))
    for unit, displays in model_description.units:
        yield from repeated("unit-twice", f"display unit of {quoted(unit)},", displays)
    yield from repeated("type-twice", "type", (t.name for t in model_description.types))
    yield from repeated("category-twice", "log category", model_description.categories)
    variables = {variable.name for variable in model_description.variables}
    for simple in model_description.types:
        if simple.name in variables:
            yield "type-name", f"the type {quoted(simple.name)} has the name of a variable."
        who = f"enumeration {quoted(simple.name)}"
        yield from repeated("type-twice", f"item of the {who},", (name for name, _ in simple.items))
        for value, times in Counter(value for _, value in simple.items).items():
            if times > 1:
                yield "type-twice", f"the {who} has {times} items of the value {value}."


def repeated(
    rule: str, what: str, names: Iterable[str], done: str = "defined"
) -> Iterator[Problem]:
    """Yield a sentence for each repeated name."""
    for name, times in Counter(names).items():
        if times > 1:
            yield rule, f"the {what} {quoted(name)} is {done} {times} times."


def _of_each(
    rule: Callable[[ParsedDescription, ParsedVariable], Iterator[Problem]],
) -> Callable[[ParsedDescription], Iterator[Problem]]:
    def of_all(model_description: ParsedDescription) -> Iterator[Problem]:
        for variable in model_description.variables:
            for name, text in rule(model_description, variable):
                yield name, f"the variable {quoted(variable.name)} {text}"

    return of_all


def _independent(model_description: ParsedDescription) -> Iterator[Problem]:
    found = [
        variable.name
        for variable in model_description.variables
        if variable.causality == "independent"
    ]
    if len(found) > 1:
        yield (
            "variable-independent",
            f"the variables {listed(found)} are all independent; only one may be.",
        )


@_of_each
def _ranges(model_description: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    if (
        variable.kind not in ("Real", "Integer", "Enumeration", *model_description.continuous)
        and "Int" not in variable.kind
    ):
        return
    low, high = (real(variable.get(name)) for name in ("min", "max"))
    bounded = low is not None or high is not None
    starts = [real(text) for text in (variable.get("start") or "").split()] if bounded else []
    if low is not None and high is not None and low > high:
        yield "variable-range", f"has min {low:.15g}, above its max {high:.15g}."
    elif outside := [
        start
        for start in starts
        if start is not None
        and ((low is not None and start < low) or (high is not None and start > high))
    ]:
        bounds = [f"{k} {x:.15g}" for k, x in (("min", low), ("max", high)) if x is not None]
        text = f"has the start value {outside[0]:.15g}, outside its {' and '.join(bounds)}."
        yield "variable-range", text
    nominal = real(variable.get("nominal"))
    if nominal is not None and nominal <= 0:
        yield "variable-nominal", f"has the nominal value {nominal:.15g}; it must be positive."
    if variable.kind == "Enumeration" and variable.type and variable.type.kind == "Enumeration":
        value = integer(variable.own.get("start"))
        if value is not None and value not in variable.type.values:
            yield (
                "variable-item",
                f"has the start value {value}, which is not an item of the enumeration "
                f"{quoted(variable.type.name)}.",
            )


@_of_each
def _inputs(_: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    if variable.causality == "input" and variable.declared_initial is not None:
        text = (
            f"has initial '{plain(variable.declared_initial)}', which is invalid with causality "
            "'input'."
        )
        yield "variable-initial", text


@_of_each
def _types(_: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    if variable.type is not None and variable.type.kind != variable.kind:
        yield (
            "variable-type",
            f"is of type {plain(variable.kind)}, but its declared type "
            f"{quoted(variable.type.name)} is of type "
            f"{plain(variable.type.kind)}.",
        )


@_of_each
def _display_units(_: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    display = variable.own.get("displayUnit")
    if display is not None and variable.get("unit") is None:
        yield "variable-unit", f"has the display unit {quoted(display)} but no unit."


@_of_each
def _derivatives(
    model_description: ParsedDescription, variable: ParsedVariable
) -> Iterator[Problem]:
    state = model_description.variable(integer(variable.own.get("derivative")))
    if state is not None and (
        state is variable
        or state.kind not in model_description.continuous
        or state.variability != "continuous"
        or state.size != variable.size
    ):
        size = "" if model_description.fmi == 2 else " and of its size"
        yield (
            "variable-derivative",
            f"is the derivative of {quoted(state.name)}, which is not another continuous "
            f"variable of type {' or '.join(model_description.continuous)}{size}.",
        )


def _aliases(model_description: ParsedDescription) -> Iterator[Problem]:
    sets: dict[tuple[str, int], list[ParsedVariable]] = defaultdict(list)
    for variable in model_description.variables:
        base = "Integer" if variable.kind == "Enumeration" else variable.kind
        if variable.reference is not None:
            sets[base, variable.reference].append(variable)
    for (_, reference), members in sets.items():
        if len(members) < 2:
            continue
        who = (
            f"the variables {listed(variable.name for variable in members)} share value reference "
            f"{reference}"
        )
        constants = [variable for variable in members if variable.variability == "constant"]
        if constants and len(constants) < len(members):
            yield "alias-constant", f"{who}, but only some of them are constant."
        if len({variable.own.get("start") for variable in constants}) > 1:
            yield "alias-constant", f"{who}, but as constants have different values."
        if sum(_settable(variable) for variable in members) > 1:
            yield "alias-settable", f"{who}, but more than one of them can be set."
        if len({variable.get("unit") for variable in members}) > 1:
            yield "alias-unit", f"{who}, but have different units."


@_of_each
def _sizes(_: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    given = len((variable.own.get("start") or "").split())
    if variable.size is None:
        yield "variable-size", "has a dimension of unknown size."
    elif variable.kind not in ("String", "Binary") and given > 1 and given != variable.size:
        yield "variable-size", f"has {given} start values for {variable.size} elements."


def _settable(variable: ParsedVariable) -> bool:
    initial = variable.declared_initial or ("exact" if variable.causality == "parameter" else "")
    started = variable.variability != "constant" and initial in ("exact", "approx")
    return started or variable.causality == "input"


def _listed_derivatives(model_description: ParsedDescription) -> Iterator[Problem]:
    if all(kind.element != "ModelExchange" for kind in model_description.kinds):
        return
    place = model_description.lists["Derivatives"]
    found = {u.index for u in model_description.structure["Derivatives"]}
    declared = [
        variable for variable in model_description.variables if "derivative" in variable.own
    ]
    wrong = {
        ("structure-states", "lacks"): [
            variable
            for variable in declared
            if variable.variability == "continuous" and variable.index not in found
        ],
        ("structure-derivatives", "lists"): [
            variable
            for variable in declared
            if variable.variability != "continuous" and variable.index in found
        ],
    }
    for (rule, verb), variables in wrong.items():
        if variables:
            yield (
                rule,
                f"{place} {verb} {listed(variable.name for variable in variables)}; it must list "
                "every "
                "derivative of a state and no other variable.",
            )


def _order(model_description: ParsedDescription) -> Iterator[Problem]:
    place = "InitialUnknowns"
    found = [
        variable
        for u in model_description.structure[place]
        if (variable := model_description.variable(u.index))
    ]
    for before, after in pairwise(found if model_description.fmi == 2 else ()):
        if after.index < before.index:
            yield (
                "structure-order",
                f"{model_description.lists[place]} lists {quoted(after.name)} after "
                f"{quoted(before.name)}; it "
                "must follow the order of the variables.",
            )


def _indices(model_description: ParsedDescription) -> Iterator[Problem]:
    for name in STRUCTURE:
        for index, times in Counter(u.index for u in model_description.structure[name]).items():
            variable = model_description.variable(index)
            if variable is None:
                text = (
                    f"{model_description.lists[name]} lists {model_description.shown(index)}, "
                    "which does not exist."
                )
                yield "structure-index", text
            elif times > 1:
                text = (
                    f"{model_description.lists[name]} lists {quoted(variable.name)} {times} times."
                )
                yield "structure-index", text


def _dependencies(model_description: ParsedDescription) -> Iterator[Problem]:
    inputs = any(
        variable.causality == "input" and variable.kind != "Clock"
        for variable in model_description.variables
    )
    for name in STRUCTURE:
        unknowns = model_description.structure[name]
        silent = [
            _named(model_description, u) for u in unknowns if u.dependencies is None and inputs
        ]
        if silent:
            yield (
                "structure-loops",
                f"{model_description.lists[name]} gives no dependencies for {listed(silent)}, "
                "so importers assume all inputs and find false algebraic loops.",
            )
        for unknown in unknowns:
            who = (
                f"{model_description.lists[name]} gives "
                f"{quoted(_named(model_description, unknown))}"
            )
            known = unknown.dependencies or ()
            missing = [i for i in known if model_description.variable(i) is None]
            if missing:
                text = (
                    f"{who} a dependency on {model_description.shown(missing[0])}, which does not "
                    "exist."
                )
                yield "structure-dependency", text
            elif model_description.fmi == 2 and any(a >= b for a, b in pairwise(known)):
                yield "structure-order", f"{who} dependencies that are not in ascending order."


def _named(model_description: ParsedDescription, unknown: Unknown) -> str:
    variable = model_description.variable(unknown.index)
    return variable.name if variable else model_description.shown(unknown.index)


def terminal_problems(
    root: etree._Element, model_description: ParsedDescription, contents: Contents
) -> Iterator[Problem]:
    """Yield missing references and repeated names of terminals."""
    known = {name for v in model_description.variables for name in (v.name, *v.others)}
    yield from repeated(
        "terminal-twice", "terminal", names_of(root.findall("Terminals/Terminal")), "there"
    )
    for terminal in root.iter("Terminal"):
        members = terminal.findall("TerminalMemberVariable")
        who = f"terminal {quoted(name_of(terminal))}"
        named = [e.get("memberName", "") for e in members if e.get("memberName")]
        yield from repeated("terminal-twice", f"member of the {who},", named, "there")
        nested = names_of(terminal.findall("Terminal"))
        yield from repeated("terminal-twice", f"nested terminal of the {who},", nested, "there")
        for member in members:
            variable = member.get("variableName", "")
            if variable not in known:
                yield (
                    "terminal-member",
                    f"the {who} has the member {quoted(variable)}, which is not a variable.",
                )
    if root.find("GraphicalRepresentation/Icon") is not None and _ICON not in contents.names:
        yield "terminal-icon", f"it declares an icon, but {_ICON} is missing."


RULES = (
    *(_kinds, _identity, _experiment, _definitions),
    *(_ranges, _types, _display_units, _derivatives),
    *(_listed_derivatives, _order, _indices, _dependencies),
)  # rules of every version
RULES_2 = (_independent, _inputs, _aliases)
RULES_3 = (_sizes,)
