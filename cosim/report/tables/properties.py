"""Tables of the physics checks."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from cosim.report.tables.table import ResultTable, TableCell, joints, row_of, title
from hesr_model.audit.expectations import EXPECTATIONS, Expectation
from hesr_model.audit.properties import Properties, PropertyResult
from hesr_model.units import unit_of_joints

_DIGITS = 4  # maximum length of a figure without its sign
_LITTLE = 1e-4  # passing figures below this are shown as 0


def properties(found: Mapping[str, Properties], *, full: bool = False) -> ResultTable:
    """Return figure and verdict of each joint, by law and check; `full` names checks."""
    return ResultTable(
        caption="Physics checks by law, one mark per joint: ✓ pass, ✗ fail",
        head=("law", *(e.title if full else e.short for e in EXPECTATIONS.values())),
        rows=[
            row_of(title(name), *(_cell(of_law, e) for e in EXPECTATIONS.values()))
            for name, of_law in found.items()
        ],
    )


def most_passed(found: Mapping[str, Properties]) -> tuple[list[str], int]:
    """Return the laws that pass the most checks on all joints, and the number of these."""
    most = max(of_law.passed for of_law in found.values())
    return [name for name, of_law in found.items() if of_law.passed == most], most


def legend(sliding: Sequence[bool] = ()) -> ResultTable:
    """Return the meaning of the columns of `properties`."""
    rows = []
    for e in EXPECTATIONS.values():
        who = "; ".join(re.sub(r" \((\d+)\):.*", r" \1", s) for s in e.sources)
        said = f"{e.shows} [{unit_of_joints(e.unit, sliding)}]. {e.expected} ({who})"
        rows.append(row_of(e.short, said))
    return ResultTable(caption="", head=("column", "shows"), rows=rows, numeric=False)


def reasons(found: Mapping[str, Properties]) -> ResultTable:
    """Return reasons of failures and other remarks by law."""
    rows = []
    for name, of_law in found.items():
        rows.append(row_of(title(name)))
        for key, expectation in EXPECTATIONS.items():
            by_reason: dict[str, list[str]] = {}
            for short, joint in zip(joints(len(of_law.joints)), of_law.joints, strict=True):
                if said := joint.findings[key].reason:
                    by_reason.setdefault(said, []).append(short)
            rows += [
                row_of(expectation.short, " ".join(where), said)
                for said, where in by_reason.items()
            ]
    return ResultTable(caption="Why", head=("property", "joint", "found"), rows=rows, numeric=False)


def _cell(of_law: Properties, expectation: Expectation) -> TableCell:
    found = [joint.findings[expectation.key] for joint in of_law.joints]
    return TableCell(
        text="\n".join(_figure(one, expectation) for one in found),
        marks=tuple(one.verdict for one in found),
    )


def _figure(found: PropertyResult, expectation: Expectation) -> str:
    value = found.figures[0].value if found.figures else None
    if value is None or found.verdict not in ("pass", "fail"):
        return ""
    shown = expectation.factor * value
    little = abs(shown) < _LITTLE and found.verdict == "pass"
    return _short(0.0 if little else shown)


def _short(value: float) -> str:
    for digits in (3, 2, 1):
        text = np.format_float_positional(float(f"{value:.{digits}g}"), trim="-")
        if len(text.removeprefix("-")) <= _DIGITS:
            return text
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa}e{int(exponent)}"
