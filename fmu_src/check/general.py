"""Rules on modelDescription.xml except for variables and their structure."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator

from fmu_src.check.description import KINDS, ParsedDescription, real
from fmu_src.check.rules import Problem
from hesr_model.support.text import quoted

_C_NAME = re.compile("[A-Za-z_][A-Za-z0-9_]*")
_DATE = re.compile(r"[0-9]{4}(-[0-9]{2}){2}T[0-9]{2}(:[0-9]{2}){2}Z")


def _kinds(about: ParsedDescription) -> Iterator[Problem]:
    if not about.kinds:
        yield "kind-missing", f"the elements {' and '.join(KINDS)} are both missing."
    state = "FMUstate" if about.fmi == 2 else "FMUState"
    for kind in about.kinds:
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


def _identity(about: ParsedDescription) -> Iterator[Problem]:
    token = "guid" if about.fmi == 2 else "instantiationToken"
    if not about.attributes.get(token, "").strip():
        text = f"the attribute {token} is empty; it must identify the binaries of the FMU."
        yield "token-empty", text
    date = about.attributes.get("generationDateAndTime") if about.fmi == 2 else None
    if date is not None and not _DATE.fullmatch(date):
        text = f"generationDateAndTime is {quoted(date)}; the format is YYYY-MM-DDThh:mm:ssZ."
        yield "date-format", text


def _experiment(about: ParsedDescription) -> Iterator[Problem]:
    start, stop, step, tolerance = (
        real(about.experiment.get(n)) for n in ("startTime", "stopTime", "stepSize", "tolerance")
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
    for name, text in about.experiment.items():
        if text.strip() in ("INF", "+INF", "-INF", "NaN"):
            said = f"DefaultExperiment has {name} {text.strip()}; it must be finite."
            yield "experiment-times", said


def _definitions(about: ParsedDescription) -> Iterator[Problem]:
    yield from repeated("unit-twice", "unit", (name for name, _ in about.units))
    for unit, displays in about.units:
        yield from repeated("unit-twice", f"display unit of {quoted(unit)},", displays)
    yield from repeated("type-twice", "type", (t.name for t in about.types))
    yield from repeated("category-twice", "log category", about.categories)
    variables = {v.name for v in about.variables}
    for simple in about.types:
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


RULES = (_kinds, _identity, _experiment, _definitions)
