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
    read_name,
    read_names,
    real,
)
from fmu_src.check.rules import Problem
from hesr_model.support.text import quote, quote_names, sanitise

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
                f"{kind.element} has the modelIdentifier {quote(kind.identifier)}, which is "
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
        text = f"generationDateAndTime is {quote(date)}; the format is YYYY-MM-DDThh:mm:ssZ."
        yield "date-format", text


def _experiment(model_description: ParsedDescription) -> Iterator[Problem]:
    start, stop, step_size, tolerance = (
        real(model_description.experiment.get(n))
        for n in ("startTime", "stopTime", "stepSize", "tolerance")
    )
    if start is not None and stop is not None and stop <= start:
        text = f"DefaultExperiment has stopTime {stop:.15g}, not after its startTime {start:.15g}."
        yield "experiment-times", text
    elif (
        start is not None
        and stop is not None
        and step_size is not None
        and step_size > stop - start
    ):
        text = f"DefaultExperiment has stepSize {step_size:.15g}, longer than the experiment."
        yield "experiment-step", text
    for name, value in (("stepSize", step_size), ("tolerance", tolerance)):
        if value is not None and value <= 0:
            text = f"DefaultExperiment has {name} {value:.15g}; it must be positive."
            yield "experiment-times", text
    for name, text in model_description.experiment.items():
        if text.strip() in ("INF", "+INF", "-INF", "NaN"):
            sentence = f"DefaultExperiment has {name} {text.strip()}; it must be finite."
            yield "experiment-times", sentence


def _definitions(model_description: ParsedDescription) -> Iterator[Problem]:
    yield from find_duplicates("unit-twice", "unit", (name for name, _ in model_description.units))
    for unit, displays in model_description.units:
        yield from find_duplicates("unit-twice", f"display unit of {quote(unit)},", displays)
    yield from find_duplicates("type-twice", "type", (t.name for t in model_description.types))
    yield from find_duplicates("category-twice", "log category", model_description.categories)
    variables = {variable.name for variable in model_description.variables}
    for simple in model_description.types:
        if simple.name in variables:
            yield "type-name", f"the type {quote(simple.name)} has the name of a variable."
        subject = f"enumeration {quote(simple.name)}"
        yield from find_duplicates(
            "type-twice", f"item of the {subject},", (name for name, _ in simple.items)
        )
        for value, times in Counter(value for _, value in simple.items).items():
            if times > 1:
                yield "type-twice", f"the {subject} has {times} items of the value {value}."


def find_duplicates(
    rule: str, noun: str, names: Iterable[str], predicate: str = "defined"
) -> Iterator[Problem]:
    """Yield a sentence for each repeated name."""
    for name, times in Counter(names).items():
        if times > 1:
            yield rule, f"the {noun} {quote(name)} is {predicate} {times} times."


def _apply_to_variables(
    rule: Callable[[ParsedDescription, ParsedVariable], Iterator[Problem]],
) -> Callable[[ParsedDescription], Iterator[Problem]]:
    def check_all(model_description: ParsedDescription) -> Iterator[Problem]:
        for variable in model_description.variables:
            for name, text in rule(model_description, variable):
                yield name, f"the variable {quote(variable.name)} {text}"

    return check_all


def _independent(model_description: ParsedDescription) -> Iterator[Problem]:
    independent_names = [
        variable.name
        for variable in model_description.variables
        if variable.causality == "independent"
    ]
    if len(independent_names) > 1:
        yield (
            "variable-independent",
            f"the variables {quote_names(independent_names)} are all independent; only one may be.",
        )


@_apply_to_variables
def _ranges(model_description: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    if (
        variable.kind not in ("Real", "Integer", "Enumeration", *model_description.continuous)
        and "Int" not in variable.kind
    ):
        return
    lower, upper = (real(variable.get(name)) for name in ("min", "max"))
    bounded = lower is not None or upper is not None
    starts = [real(text) for text in (variable.get("start") or "").split()] if bounded else []
    if lower is not None and upper is not None and lower > upper:
        yield "variable-range", f"has min {lower:.15g}, above its max {upper:.15g}."
    elif outside := [
        start
        for start in starts
        if start is not None
        and ((lower is not None and start < lower) or (upper is not None and start > upper))
    ]:
        bounds = [f"{k} {x:.15g}" for k, x in (("min", lower), ("max", upper)) if x is not None]
        text = f"has the start value {outside[0]:.15g}, outside its {' and '.join(bounds)}."
        yield "variable-range", text
    nominal = real(variable.get("nominal"))
    if nominal is not None and nominal <= 0:
        yield "variable-nominal", f"has the nominal value {nominal:.15g}; it must be positive."
    if variable.kind == "Enumeration" and variable.type and variable.type.kind == "Enumeration":
        value = integer(variable.type_attributes.get("start"))
        if value is not None and value not in variable.type.values:
            yield (
                "variable-item",
                f"has the start value {value}, which is not an item of the enumeration "
                f"{quote(variable.type.name)}.",
            )


@_apply_to_variables
def _inputs(_: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    if variable.causality == "input" and variable.declared_initial is not None:
        text = (
            f"has initial '{sanitise(variable.declared_initial)}', which is invalid with causality "
            "'input'."
        )
        yield "variable-initial", text


@_apply_to_variables
def _types(_: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    if variable.type is not None and variable.type.kind != variable.kind:
        yield (
            "variable-type",
            f"is of type {sanitise(variable.kind)}, but its declared type "
            f"{quote(variable.type.name)} is of type {sanitise(variable.type.kind)}.",
        )


@_apply_to_variables
def _display_units(_: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    display = variable.type_attributes.get("displayUnit")
    if display is not None and variable.get("unit") is None:
        yield "variable-unit", f"has the display unit {quote(display)} but no unit."


@_apply_to_variables
def _derivatives(
    model_description: ParsedDescription, variable: ParsedVariable
) -> Iterator[Problem]:
    state = model_description.variable(integer(variable.type_attributes.get("derivative")))
    if state is not None and (
        state is variable
        or state.kind not in model_description.continuous
        or state.variability != "continuous"
        or state.size != variable.size
    ):
        size = "" if model_description.fmi == 2 else " and of its size"
        yield (
            "variable-derivative",
            f"is the derivative of {quote(state.name)}, which is not another continuous "
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
        subject = (
            f"the variables {quote_names(variable.name for variable in members)} share value "
            f"reference {reference}"
        )
        constants = [variable for variable in members if variable.variability == "constant"]
        if constants and len(constants) < len(members):
            yield "alias-constant", f"{subject}, but only some of them are constant."
        if len({variable.type_attributes.get("start") for variable in constants}) > 1:
            yield "alias-constant", f"{subject}, but as constants have different values."
        if sum(_is_settable(variable) for variable in members) > 1:
            yield "alias-settable", f"{subject}, but more than one of them can be set."
        if len({variable.get("unit") for variable in members}) > 1:
            yield "alias-unit", f"{subject}, but have different units."


@_apply_to_variables
def _sizes(_: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    start_count = len((variable.type_attributes.get("start") or "").split())
    if variable.size is None:
        yield "variable-size", "has a dimension of unknown size."
    elif (
        variable.kind not in ("String", "Binary")
        and start_count > 1
        and start_count != variable.size
    ):
        yield "variable-size", f"has {start_count} start values for {variable.size} elements."


def _is_settable(variable: ParsedVariable) -> bool:
    initial = variable.declared_initial or ("exact" if variable.causality == "parameter" else "")
    started = variable.variability != "constant" and initial in ("exact", "approx")
    return started or variable.causality == "input"


def _listed_derivatives(model_description: ParsedDescription) -> Iterator[Problem]:
    if all(kind.element != "ModelExchange" for kind in model_description.kinds):
        return
    list_name = model_description.lists["Derivatives"]
    listed_indices = {u.index for u in model_description.structure["Derivatives"]}
    declared = [
        variable
        for variable in model_description.variables
        if "derivative" in variable.type_attributes
    ]
    # Several variables may be the derivative of one state, of which one is listed.
    listed_states = {
        variable.type_attributes["derivative"]
        for variable in declared
        if variable.index in listed_indices
    }
    wrong = {
        ("structure-states", "lacks"): [
            variable
            for variable in declared
            if variable.variability == "continuous"
            and variable.type_attributes["derivative"] not in listed_states
        ],
        ("structure-derivatives", "lists"): [
            variable
            for variable in declared
            if variable.variability != "continuous" and variable.index in listed_indices
        ],
    }
    for (rule, verb), variables in wrong.items():
        if variables:
            yield (
                rule,
                f"{list_name} {verb} {quote_names(variable.name for variable in variables)}; "
                "it must list every derivative of a state and no other variable.",
            )


def _order(model_description: ParsedDescription) -> Iterator[Problem]:
    list_name = "InitialUnknowns"
    initial_variables = [
        variable
        for u in model_description.structure[list_name]
        if (variable := model_description.variable(u.index))
    ]
    for before, after in pairwise(initial_variables if model_description.fmi == 2 else ()):
        if after.index < before.index:
            yield (
                "structure-order",
                f"{model_description.lists[list_name]} lists {quote(after.name)} after "
                f"{quote(before.name)}; it must follow the order of the variables.",
            )


def _indices(model_description: ParsedDescription) -> Iterator[Problem]:
    for name in STRUCTURE:
        for index, times in Counter(u.index for u in model_description.structure[name]).items():
            variable = model_description.variable(index)
            if variable is None:
                text = (
                    f"{model_description.lists[name]} lists {model_description.name_index(index)}, "
                    "which does not exist."
                )
                yield "structure-index", text
            elif times > 1:
                text = (
                    f"{model_description.lists[name]} lists {quote(variable.name)} {times} times."
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
            _describe_unknown(model_description, u)
            for u in unknowns
            if u.dependencies is None and inputs
        ]
        if silent:
            yield (
                "structure-loops",
                f"{model_description.lists[name]} gives no dependencies for {quote_names(silent)}, "
                "so importers assume all inputs and find false algebraic loops.",
            )
        for unknown in unknowns:
            subject = (
                f"{model_description.lists[name]} gives "
                f"{quote(_describe_unknown(model_description, unknown))}"
            )
            dependencies = unknown.dependencies or ()
            missing = [i for i in dependencies if model_description.variable(i) is None]
            if missing:
                text = (
                    f"{subject} a dependency on {model_description.name_index(missing[0])}, "
                    "which does not exist."
                )
                yield "structure-dependency", text
            elif model_description.fmi == 2 and any(a >= b for a, b in pairwise(dependencies)):
                yield "structure-order", f"{subject} dependencies that are not in ascending order."


def _describe_unknown(model_description: ParsedDescription, unknown: Unknown) -> str:
    variable = model_description.variable(unknown.index)
    return variable.name if variable else model_description.name_index(unknown.index)


def terminal_problems(
    root: etree._Element, model_description: ParsedDescription, contents: Contents
) -> Iterator[Problem]:
    """Yield missing references and repeated names of terminals."""
    variable_names = {
        name
        for variable in model_description.variables
        for name in (variable.name, *variable.others)
    }
    yield from find_duplicates(
        "terminal-twice", "terminal", read_names(root.findall("Terminals/Terminal")), "there"
    )
    for terminal in root.iter("Terminal"):
        members = terminal.findall("TerminalMemberVariable")
        subject = f"terminal {quote(read_name(terminal))}"
        member_names = [e.get("memberName", "") for e in members if e.get("memberName")]
        yield from find_duplicates(
            "terminal-twice", f"member of the {subject},", member_names, "there"
        )
        nested = read_names(terminal.findall("Terminal"))
        yield from find_duplicates(
            "terminal-twice", f"nested terminal of the {subject},", nested, "there"
        )
        for member in members:
            member_variable = member.get("variableName", "")
            if member_variable not in variable_names:
                yield (
                    "terminal-member",
                    f"the {subject} has the member {quote(member_variable)}, which is not a "
                    "variable.",
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
