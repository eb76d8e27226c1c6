"""Rules on variables; each yields one sentence for each variable that breaks it."""

from collections import defaultdict
from collections.abc import Callable, Iterator

from fmu_src.check.description import ParsedDescription, ParsedVariable, integer, real
from fmu_src.check.rules import Problem
from hesr_model.support.text import listed, plain, quoted


def _of_each(
    rule: Callable[[ParsedDescription, ParsedVariable], Iterator[Problem]],
) -> Callable[[ParsedDescription], Iterator[Problem]]:
    def of_all(about: ParsedDescription) -> Iterator[Problem]:
        for v in about.variables:
            for name, text in rule(about, v):
                yield name, f"the variable {quoted(v.name)} {text}"

    return of_all


def _independent(about: ParsedDescription) -> Iterator[Problem]:
    found = [v.name for v in about.variables if v.causality == "independent"]
    if len(found) > 1:
        yield (
            "variable-independent",
            f"the variables {listed(found)} are all independent; only one may be.",
        )


@_of_each
def _ranges(about: ParsedDescription, v: ParsedVariable) -> Iterator[Problem]:
    if v.kind not in ("Real", "Integer", "Enumeration", *about.continuous) and "Int" not in v.kind:
        return
    low, high = (real(v.get(name)) for name in ("min", "max"))
    bounded = low is not None or high is not None
    starts = [real(text) for text in (v.get("start") or "").split()] if bounded else []
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
    if (nominal := real(v.get("nominal"))) is not None and nominal <= 0:
        yield "variable-nominal", f"has the nominal value {nominal:.15g}; it must be positive."
    if v.kind == "Enumeration" and v.type and v.type.kind == "Enumeration":
        value = integer(v.own.get("start"))
        if value is not None and value not in v.type.values:
            yield (
                "variable-item",
                f"has the start value {value}, which is not an item of the enumeration "
                f"{quoted(v.type.name)}.",
            )


@_of_each
def _inputs(_: ParsedDescription, v: ParsedVariable) -> Iterator[Problem]:
    if v.causality == "input" and v.declared_initial is not None:
        text = (
            f"has initial '{plain(v.declared_initial)}', which is invalid with causality 'input'."
        )
        yield "variable-initial", text


@_of_each
def _types(_: ParsedDescription, v: ParsedVariable) -> Iterator[Problem]:
    if v.type is not None and v.type.kind != v.kind:
        yield (
            "variable-type",
            f"is of type {plain(v.kind)}, but its declared type {quoted(v.type.name)} is of type "
            f"{plain(v.type.kind)}.",
        )


@_of_each
def _display_units(_: ParsedDescription, v: ParsedVariable) -> Iterator[Problem]:
    if (display := v.own.get("displayUnit")) is not None and v.get("unit") is None:
        yield "variable-unit", f"has the display unit {quoted(display)} but no unit."


@_of_each
def _derivatives(about: ParsedDescription, v: ParsedVariable) -> Iterator[Problem]:
    state = about.variable(integer(v.own.get("derivative")))
    if state is not None and (
        state is v
        or state.kind not in about.continuous
        or state.variability != "continuous"
        or state.size != v.size
    ):
        size = "" if about.fmi == 2 else " and of its size"
        yield (
            "variable-derivative",
            f"is the derivative of {quoted(state.name)}, which is not another continuous "
            f"variable of type {' or '.join(about.continuous)}{size}.",
        )


def _aliases(about: ParsedDescription) -> Iterator[Problem]:
    sets: dict[tuple[str, int], list[ParsedVariable]] = defaultdict(list)
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
            yield "alias-constant", f"{who}, but only some of them are constant."
        if len({v.own.get("start") for v in constants}) > 1:
            yield "alias-constant", f"{who}, but as constants have different values."
        if sum(_settable(v) for v in members) > 1:
            yield "alias-settable", f"{who}, but more than one of them can be set."
        if len({v.get("unit") for v in members}) > 1:
            yield "alias-unit", f"{who}, but have different units."


@_of_each
def _sizes(_: ParsedDescription, v: ParsedVariable) -> Iterator[Problem]:
    given = len((v.own.get("start") or "").split())
    if v.size is None:
        yield "variable-size", "has a dimension of unknown size."
    elif v.kind not in ("String", "Binary") and given > 1 and given != v.size:
        yield "variable-size", f"has {given} start values for {v.size} elements."


def _settable(v: ParsedVariable) -> bool:
    initial = v.declared_initial or ("exact" if v.causality == "parameter" else "")
    started = v.variability != "constant" and initial in ("exact", "approx")
    return started or v.causality == "input"


RULES = (_ranges, _types, _display_units, _derivatives)  # rules of every version
RULES_2 = (_independent, _inputs, _aliases)
RULES_3 = (_sizes,)
