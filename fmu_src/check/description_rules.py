"""Rules on modelDescription.xml, and on terminalsAndIcons.xml of FMI 2.0 and 3.0.

Those on variables yield one sentence for each variable that breaks them.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from itertools import pairwise

from lxml import etree

from fmu_src.check.archive import Contents
from fmu_src.check.description import (
    FLOATS,
    KINDS,
    STRUCTURE,
    ParsedDescription,
    ParsedVariable,
    SimpleType,
    Unknown,
    integer,
    read_name,
    read_names,
    real,
)
from fmu_src.check.rules import Problem
from hesr_model.support.text import join_with_or, quote, quote_names, sanitise

TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
_ICON = "terminalsAndIcons/icon.png"
_C_NAME = re.compile("[A-Za-z_][A-Za-z0-9_]*")
_DATE = re.compile(r"[0-9]{4}(-[0-9]{2}){2}T[0-9]{2}(:[0-9]{2}){2}Z")


def _kinds(model_description: ParsedDescription) -> Iterator[Problem]:
    if not model_description.kinds:
        yield "kind-missing", f"the elements {' and '.join(KINDS)} are both missing."
    state = _choose_by_version(model_description, "FMUstate", "FMUState")
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


def _choose_by_version(model_description: ParsedDescription, of_fmi_2: str, of_fmi_3: str) -> str:
    if model_description.fmi == 2:
        return of_fmi_2
    return of_fmi_3


def _identity(model_description: ParsedDescription) -> Iterator[Problem]:
    token = _choose_by_version(model_description, "guid", "instantiationToken")
    if not model_description.attributes.get(token, "").strip():
        text = f"the attribute {token} is empty; it must identify the binaries of the FMU."
        yield "token-empty", text
    if model_description.fmi != 2:
        return
    date = model_description.attributes.get("generationDateAndTime")
    if date is not None and not _DATE.fullmatch(date):
        text = f"generationDateAndTime is {quote(date)}; the format is YYYY-MM-DDThh:mm:ssZ."
        yield "date-format", text


def _experiment(model_description: ParsedDescription) -> Iterator[Problem]:
    experiment = model_description.experiment
    start = real(experiment.get("startTime"))
    stop = real(experiment.get("stopTime"))
    step_size = real(experiment.get("stepSize"))
    tolerance = real(experiment.get("tolerance"))
    if start is not None and stop is not None:
        if stop <= start:
            sentence = (
                f"DefaultExperiment has stopTime {stop:.15g}, not after its startTime {start:.15g}."
            )
            yield "experiment-times", sentence
        elif step_size is not None and step_size > stop - start:
            sentence = (
                f"DefaultExperiment has stepSize {step_size:.15g}, longer than the experiment."
            )
            yield "experiment-step", sentence
    for name, value in (("stepSize", step_size), ("tolerance", tolerance)):
        if value is not None and value <= 0:
            sentence = f"DefaultExperiment has {name} {value:.15g}; it must be positive."
            yield "experiment-times", sentence
    for name, text in experiment.items():
        if text.strip() in ("INF", "+INF", "-INF", "NaN"):
            sentence = f"DefaultExperiment has {name} {text.strip()}; it must be finite."
            yield "experiment-times", sentence


def _definitions(model_description: ParsedDescription) -> Iterator[Problem]:
    yield from find_duplicates("unit-twice", "unit", (name for name, _ in model_description.units))
    for unit, displays in model_description.units:
        yield from find_duplicates("unit-twice", f"display unit of {quote(unit)},", displays)
    yield from find_duplicates("type-twice", "type", (t.name for t in model_description.types))
    yield from find_duplicates("category-twice", "log category", model_description.categories)
    units = {name for name, _ in model_description.units}
    variables = {variable.name for variable in model_description.variables}
    if "" in variables:
        yield "variable-name", "a variable has an empty name."
    for simple in model_description.types:
        yield from _check_type(simple, units)
        if simple.name in variables:
            yield "type-name", f"the type {quote(simple.name)} has the name of a variable."
        subject = f"enumeration {quote(simple.name)}"
        yield from find_duplicates(
            "type-twice", f"item of the {subject},", (name for name, _ in simple.items)
        )
        for value, times in Counter(value for _, value in simple.items).items():
            if times > 1:
                yield "type-twice", f"the {subject} has {times} items of the value {value}."


def _check_type(simple: SimpleType, units: Container[str]) -> Iterator[Problem]:
    subject = f"the type {quote(simple.name)}"
    for rule, text in _check_limits(simple):
        yield rule, f"{subject} {text}"
    unit = simple.get("unit")
    if unit is not None and unit not in units:
        yield "type-unit", f"{subject} has the unit {quote(unit)}, which is not defined."
    display_unit = simple.get("displayUnit")
    if display_unit is not None and unit is None:
        yield "type-unit", f"{subject} has the display unit {quote(display_unit)} but no unit."


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
    limited_kinds = ("Real", "Integer", "Enumeration", *model_description.continuous)
    if variable.kind not in limited_kinds and "Int" not in variable.kind:
        return
    yield from _check_limits(variable)
    nominal = real(variable.get("nominal"))
    if nominal is not None and nominal <= 0:
        yield "variable-nominal", f"has the nominal value {nominal:.15g}; it must be positive."
    if variable.kind == "Enumeration":
        yield from _check_item(variable)


def _check_limits(variable: ParsedVariable | SimpleType) -> Iterator[Problem]:
    lower = real(variable.get("min"))
    upper = real(variable.get("max"))
    bounds = []
    if lower is not None:
        bounds.append(f"min {lower:.15g}")
    if upper is not None:
        bounds.append(f"max {upper:.15g}")
    if not bounds:
        return
    if lower is not None and upper is not None and lower > upper:
        yield "variable-range", f"has min {lower:.15g}, above its max {upper:.15g}."
        return
    for text in (variable.get("start") or "").split():
        start = real(text)
        if start is not None and not _is_within(start, lower, upper):
            sentence = f"has the start value {start:.15g}, outside its {' and '.join(bounds)}."
            yield "variable-range", sentence
            return


def _is_within(value: float, lower: float | None, upper: float | None) -> bool:
    if lower is not None and value < lower:
        return False
    return upper is None or value <= upper


def _check_item(variable: ParsedVariable) -> Iterator[Problem]:
    if variable.type is None or variable.type.kind != "Enumeration":
        return
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
        or not _is_continuous(model_description, state)
        or state.size != variable.size
    ):
        size = _choose_by_version(model_description, "", " and of its size")
        yield (
            "variable-derivative",
            f"is the derivative of {quote(state.name)}, which is not another continuous "
            f"variable of type {' or '.join(model_description.continuous)}{size}.",
        )


def _is_continuous(model_description: ParsedDescription, variable: ParsedVariable) -> bool:
    return variable.kind in model_description.continuous and variable.variability == "continuous"


@_apply_to_variables
def _attributes(
    model_description: ParsedDescription, variable: ParsedVariable
) -> Iterator[Problem]:
    if (
        "reinit" in variable.type_attributes
        and model_description.has_kind("ModelExchange")
        and variable.index not in model_description.state_indices
    ):
        yield "variable-attribute", "has 'reinit', but no variable is its derivative."
    can_update = variable.type_attributes.get("intermediateUpdate") in ("true", "1")
    if can_update and (variable.kind == "Clock" or variable.causality == "parameter"):
        sentence = "has 'intermediateUpdate', which clocks and parameters must not have."
        yield "variable-attribute", sentence


@_apply_to_variables
def _clocks(model_description: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    indices = variable.type_attributes.get("clocks", "").split()
    clocks = [model_description.variable(integer(index)) for index in indices]
    if any(clock is None or clock.kind != "Clock" for clock in clocks):
        yield "variable-clock", "has 'clocks' that are not variables of type Clock."
    if clocks and variable.variability not in ("discrete", "tunable"):
        yield "variable-clock", "has 'clocks', but is neither discrete nor tunable."
    if "previous" in variable.type_attributes:
        if not clocks or variable.variability != "discrete":
            yield "variable-clock", "has 'previous', but is not a discrete variable with 'clocks'."
        previous = model_description.variable(integer(variable.type_attributes["previous"]))
        if not _can_be_previous(previous, variable):
            sentence = "has a 'previous' that is not another discrete variable of its type."
            yield "variable-clock", sentence
    if variable.kind == "Clock":
        yield from _check_clock(model_description, variable)


def _can_be_previous(previous: ParsedVariable | None, variable: ParsedVariable) -> bool:
    """Return whether a variable may hold the value that a clocked one had at its last tick."""
    return (
        previous is not None
        and previous is not variable
        and previous.kind == variable.kind
        and previous.variability == "discrete"
        and previous.causality != "input"
    )


def _check_clock(model_description: ParsedDescription, clock: ParsedVariable) -> Iterator[Problem]:
    names = ("intervalDecimal", "intervalCounter", "resolution")
    interval, counter, resolution = (real(clock.get(name)) for name in names)
    is_periodic = clock.get("intervalVariability") in ("constant", "fixed")
    if is_periodic and interval is None and None in (counter, resolution):
        yield "variable-clock", "has neither intervalDecimal nor intervalCounter and resolution."
    if any(value is not None and value <= 0 for value in (interval, counter, resolution)):
        yield "variable-clock", "has an interval that is not positive."
    is_scheduled = model_description.has_kind("ScheduledExecution")
    if is_scheduled and clock.causality == "input" and clock.get("priority") is None:
        yield "variable-clock", "has no priority, which scheduled execution requires."


def _aliases(model_description: ParsedDescription) -> Iterator[Problem]:
    sets: dict[tuple[str, int], list[ParsedVariable]] = defaultdict(list)
    for variable in model_description.variables:
        if variable.reference is not None:
            sets[_choose_base(variable), variable.reference].append(variable)
    for (_, reference), members in sets.items():
        if len(members) > 1:
            names = quote_names(variable.name for variable in members)
            subject = f"the variables {names} share value reference {reference}"
            for rule, predicate in _judge_aliases(members):
                yield rule, f"{subject}, but {predicate}."


def _choose_base(variable: ParsedVariable) -> str:
    """Return the type of the functions that access a variable."""
    if variable.kind == "Enumeration":
        return "Integer"
    return variable.kind


def _judge_aliases(members: list[ParsedVariable]) -> Iterator[Problem]:
    constants = [variable for variable in members if variable.variability == "constant"]
    if constants and len(constants) < len(members):
        yield "alias-constant", "only some of them are constant"
    if len({variable.type_attributes.get("start") for variable in constants}) > 1:
        yield "alias-constant", "as constants have different values"
    if sum(_is_settable(variable) for variable in members) > 1:
        yield "alias-settable", "more than one of them can be set"
    if len({variable.get("unit") for variable in members}) > 1:
        yield "alias-unit", "have different units"


@_apply_to_variables
def _sizes(_: ParsedDescription, variable: ParsedVariable) -> Iterator[Problem]:
    start_count = len((variable.type_attributes.get("start") or "").split())
    if variable.size is None:
        yield (
            "variable-size",
            "has a dimension of unknown size; it must be a number, or refer to a constant or "
            "structural parameter of type UInt64.",
        )
    elif variable.size == 0:
        yield "variable-size", "has a dimension of size 0; it must be positive at first."
    elif (
        variable.kind not in ("String", "Binary")
        and start_count > 1
        and start_count != variable.size
    ):
        yield "variable-size", f"has {start_count} start values for {variable.size} elements."


def _is_settable(variable: ParsedVariable) -> bool:
    if variable.causality == "input":
        return True
    initial = variable.declared_initial
    if not initial and variable.causality == "parameter":
        initial = "exact"
    return variable.variability != "constant" and initial in ("exact", "approx")


def _listed_derivatives(model_description: ParsedDescription) -> Iterator[Problem]:
    if not model_description.has_kind("ModelExchange"):
        return
    listed_indices = {u.index for u in model_description.structure["Derivatives"]}
    # Several variables may be the derivative of one state, of which one is listed.
    listed_states = set()
    unlisted = []
    not_continuous = []
    for variable in model_description.variables:
        state = variable.type_attributes.get("derivative")
        if state is None:
            continue
        if variable.index in listed_indices:
            listed_states.add(state)
            if variable.variability != "continuous":
                not_continuous.append(variable)
        elif variable.variability == "continuous" and not _is_derived_signal(
            model_description, variable
        ):
            unlisted.append((variable, state))
    missing = [variable for variable, state in unlisted if state not in listed_states]
    list_name = model_description.lists["Derivatives"]
    for rule, verb, variables in (
        ("structure-states", "lacks", missing),
        ("structure-derivatives", "lists", not_continuous),
    ):
        if variables:
            yield (
                rule,
                f"{list_name} {verb} {quote_names(variable.name for variable in variables)}; "
                "it must list every derivative of a state and no other variable.",
            )


def _is_derived_signal(model_description: ParsedDescription, variable: ParsedVariable) -> bool:
    """Return whether a derivative only relates two inputs or two outputs, without a state."""
    base = model_description.variable(integer(variable.type_attributes.get("derivative")))
    return base is not None and variable.causality == base.causality != "local"


def _listed_events(model_description: ParsedDescription) -> Iterator[Problem]:
    for unknown in model_description.structure["EventIndicators"]:
        variable = model_description.variable(unknown.index)
        if variable is not None and not _is_continuous(model_description, variable):
            yield (
                "structure-derivatives",
                f"{model_description.lists['EventIndicators']} lists {quote(variable.name)}, "
                f"which is not a continuous variable of type {' or '.join(FLOATS)}.",
            )
    listed_indices = {u.index for u in model_description.structure["ClockedStates"]}
    wrong_names = [
        variable.name
        for variable in model_description.variables
        if (variable.index in listed_indices) != ("previous" in variable.type_attributes)
    ]
    if wrong_names:
        yield (
            "structure-clocks",
            f"{model_description.lists['ClockedStates']} must have exactly the variables with a "
            f"previous value, unlike {quote_names(wrong_names)}.",
        )


def _order(model_description: ParsedDescription) -> Iterator[Problem]:
    if model_description.fmi != 2:
        return
    list_name = "InitialUnknowns"
    initial_variables = []
    for unknown in model_description.structure[list_name]:
        variable = model_description.variable(unknown.index)
        if variable is not None:
            initial_variables.append(variable)
    for before, after in pairwise(initial_variables):
        if after.index < before.index:
            yield (
                "structure-order",
                f"{model_description.lists[list_name]} lists {quote(after.name)} after "
                f"{quote(before.name)}; it must follow the order of the variables.",
            )


def _indices(model_description: ParsedDescription) -> Iterator[Problem]:
    for name, unknowns in model_description.structure.items():
        for index, times in Counter(unknown.index for unknown in unknowns).items():
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
    has_inputs = any(
        variable.causality == "input" and variable.kind != "Clock"
        for variable in model_description.variables
    )
    for name, unknowns in model_description.structure.items():
        subject = f"{model_description.lists[name]} gives"
        silent = [unknown for unknown in unknowns if unknown.dependencies is None]
        if silent and has_inputs and name in STRUCTURE:
            names = quote_names(_describe_unknown(model_description, u) for u in silent)
            yield (
                "structure-loops",
                f"{subject} no dependencies for {names}, so importers assume all inputs and find "
                "false algebraic loops.",
            )
        for unknown in unknowns:
            unknown_name = quote(_describe_unknown(model_description, unknown))
            allowed_kinds = _list_allowed_kinds(model_description, name, unknown)
            for rule, predicate in _judge_dependencies(model_description, unknown, allowed_kinds):
                yield rule, f"{subject} {unknown_name} {predicate}"


def _list_allowed_kinds(
    model_description: ParsedDescription, list_name: str, unknown: Unknown
) -> tuple[str, ...]:
    variable = model_description.variable(unknown.index)
    if variable is not None and variable.kind not in model_description.continuous:
        return ("dependent",)
    if list_name == "InitialUnknowns":
        return ("dependent", "constant")
    return ("dependent", "constant", "fixed", "tunable", "discrete")


def _judge_dependencies(
    model_description: ParsedDescription, unknown: Unknown, allowed_kinds: Sequence[str]
) -> Iterator[Problem]:
    kinds = [kind for kind in unknown.dependency_kinds if kind not in allowed_kinds]
    if kinds:
        allowed = join_with_or(allowed_kinds)
        yield "structure-kind", f"a dependency of kind {quote(kinds[0])}; it must be {allowed}."
    dependencies = unknown.dependencies or ()
    for index in dependencies:
        if model_description.variable(index) is None:
            dependency = model_description.name_index(index)
            yield "structure-dependency", f"a dependency on {dependency}, which does not exist."
            return
    if model_description.fmi == 2 and any(a >= b for a, b in pairwise(dependencies)):
        yield "structure-order", "dependencies that are not in ascending order."


def _describe_unknown(model_description: ParsedDescription, unknown: Unknown) -> str:
    variable = model_description.variable(unknown.index)
    if variable is None:
        return model_description.name_index(unknown.index)
    return variable.name


def terminal_problems(
    root: etree._Element, model_description: ParsedDescription, contents: Contents
) -> Iterator[Problem]:
    """Yield missing references and repeated names of terminals."""
    variable_names = set[str]()
    for variable in model_description.variables:
        variable_names.update((variable.name, *variable.others))
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
        needs_names = terminal.get("matchingRule") in ("plug", "bus")
        if needs_names and len(member_names) < len(members):
            yield "terminal-member", f"the {subject} has a member without memberName."
        member_variables = [member.get("variableName", "") for member in members]
        for stream in terminal.findall("TerminalStreamMemberVariable"):
            member_variables += [
                stream.get(name, "") for name in ("inStreamVariableName", "outStreamVariableName")
            ]
        for member_variable in member_variables:
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
    *(_ranges, _types, _display_units, _derivatives, _attributes),
    *(_listed_derivatives, _order, _indices, _dependencies),
)  # rules of every version
RULES_2 = (_independent, _inputs, _aliases)
RULES_3 = (_sizes, _clocks, _listed_events)
