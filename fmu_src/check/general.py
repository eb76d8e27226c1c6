"""Rules on modelDescription.xml except for variables and their structure."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator

from fmu_src.check.description import KINDS, ParsedDescription, real
from hesr_model.support.text import quoted

_C_NAME = re.compile("[A-Za-z_][A-Za-z0-9_]*")
_DATE = re.compile(r"[0-9]{4}(-[0-9]{2}){2}T[0-9]{2}(:[0-9]{2}){2}Z")


def _kinds(about: ParsedDescription) -> Iterator[str]:
    if not about.kinds:
        yield f"the elements {' and '.join(KINDS)} are both missing."
    state = "FMUstate" if about.fmi == 2 else "FMUState"
    for kind in about.kinds:
        if not _C_NAME.fullmatch(kind.identifier):
            yield (
                f"{kind.element} has the modelIdentifier {quoted(kind.identifier)}, which is "
                "not a C identifier."
            )
        if kind.can("needsExecutionTool"):
            yield (
                f"{kind.element} has needsExecutionTool='true', so the FMU runs only where its "
                "tool is installed."
            )
        if kind.can("canSerializeFMUstate") and not kind.can("canGetAndSetFMUstate"):
            yield (
                f"{kind.element} has canSerialize{state}='true', which "
                f"requires canGetAndSet{state}='true'."
            )


def _identity(about: ParsedDescription) -> Iterator[str]:
    token = "guid" if about.fmi == 2 else "instantiationToken"
    if not about.attributes.get(token, "").strip():
        yield (f"the attribute {token} is empty; it must identify the binaries of the FMU.")
    date = about.attributes.get("generationDateAndTime") if about.fmi == 2 else None
    if date is not None and not _DATE.fullmatch(date):
        yield f"generationDateAndTime is {quoted(date)}; the format is YYYY-MM-DDThh:mm:ssZ."


def _experiment(about: ParsedDescription) -> Iterator[str]:
    start, stop, step, tolerance = (
        real(about.experiment.get(n)) for n in ("startTime", "stopTime", "stepSize", "tolerance")
    )
    if start is not None and stop is not None and stop <= start:
        yield f"DefaultExperiment has stopTime {stop:.15g}, not after its startTime {start:.15g}."
    elif start is not None and stop is not None and step is not None and step > stop - start:
        yield f"DefaultExperiment has stepSize {step:.15g}, longer than the experiment."
    for name, value in (("stepSize", step), ("tolerance", tolerance)):
        if value is not None and value <= 0:
            yield f"DefaultExperiment has {name} {value:.15g}; it must be positive."
    for name, text in about.experiment.items():
        if text.strip() in ("INF", "+INF", "-INF", "NaN"):
            yield f"DefaultExperiment has {name} {text.strip()}; it must be finite."


def _definitions(about: ParsedDescription) -> Iterator[str]:
    yield from repeated("unit", (name for name, _ in about.units))
    for unit, displays in about.units:
        yield from repeated(f"display unit of {quoted(unit)},", displays)
    yield from repeated("type", (t.name for t in about.types))
    yield from repeated("log category", about.categories)
    variables = {v.name for v in about.variables}
    for simple in about.types:
        if simple.name in variables:
            yield f"the type {quoted(simple.name)} has the name of a variable."
        who = f"enumeration {quoted(simple.name)}"
        yield from repeated(f"item of the {who},", (name for name, _ in simple.items))
        for value, times in Counter(value for _, value in simple.items).items():
            if times > 1:
                yield f"the {who} has {times} items of the value {value}."


def repeated(what: str, names: Iterable[str], done: str = "defined") -> Iterator[str]:
    """Yield a sentence for each repeated name."""
    for name, times in Counter(names).items():
        if times > 1:
            yield f"the {what} {quoted(name)} is {done} {times} times."


RULES = (_kinds, _identity, _experiment, _definitions)
