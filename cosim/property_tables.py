"""Tables of the property battery for the terminal."""

from collections.abc import Mapping, Sequence

import numpy as np
from rich import box
from rich.markup import escape
from rich.table import Table

from cosim.tables import title
from hesr_model.friction.expectations import EXPECTATIONS, Expectation
from hesr_model.friction.properties import Finding, Properties
from hesr_model.units import unit_of_joints

_MARKS = {"pass": "[green]✓[/]", "fail": "[red]✗[/]"}
_LAW_WIDTH, _WIDTH, _NARROW = 12, 6, 5
_WIDE_COLUMNS = ("presliding", "memory", "breakaway", "lag", "dither")
_LITTLE = 1e-4  # in the units of the table; less is shown as 0, where it passes


def properties(found: Mapping[str, Properties]) -> Table:
    """Return laws by properties: a line for each joint, its figure and whether it passes.

    Parameters
    ----------
    found : findings by name of the law.
    """
    table = Table(
        title="Property battery: a line for each joint; ✓ as the field expects, ✗ not",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 0),
        pad_edge=False,
    )
    table.add_column("law", width=_LAW_WIDTH, overflow="fold")
    for key, expectation in EXPECTATIONS.items():
        width = _WIDTH if key in _WIDE_COLUMNS else _NARROW
        table.add_column(expectation.short, justify="right", no_wrap=True, width=width)
    for name, of_law in found.items():
        columns = [
            "\n".join(_cell(joint.findings[key], expectation) for joint in of_law.joints)
            for key, expectation in EXPECTATIONS.items()
        ]
        table.add_row(escape(_folded(title(name))), *columns, end_section=True)
    return table


def legend(sliding: Sequence[bool] = ()) -> Table:
    """Return what each column of `properties` shows, and what passes.

    `sliding` is whether each joint slides; empty if all turn.
    """
    table = Table(box=None, show_header=False, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column()
    for e in EXPECTATIONS.values():
        unit = unit_of_joints(e.unit, sliding)
        who = "; ".join(f"{s.who} {s.year}" for s in e.sources)
        table.add_row(e.short, escape(f"{e.shows} [{unit}]. {e.expected} ({who})"))
    return table


def reasons(found: Mapping[str, Properties]) -> Table:
    """Return why joints fail, or what else was found, law by law."""
    table = Table(
        title="Why", title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False
    )
    for column in ("property", "joint", "found"):
        table.add_column(column, no_wrap=column != "found")
    for name, of_law in found.items():
        table.add_row(f"[italic]{escape(title(name))}[/]")
        for key, expectation in EXPECTATIONS.items():
            for joint, said in _grouped(of_law, key).items():
                table.add_row(expectation.short, escape(joint), escape(said))
        table.add_section()
    return table


def _folded(name: str) -> str:
    """Return a title in two lines where it is too long for its column and has a plus in it."""
    at = name.rfind("+", 0, _LAW_WIDTH) + 1
    return f"{name[:at]}\n{name[at:]}" if len(name) > _LAW_WIDTH and at else name


def _grouped(of_law: Properties, key: str) -> dict[str, str]:
    """Return reasons by joint; joints of one reason stand together."""
    by_reason: dict[str, list[str]] = {}
    for number, joint in enumerate(of_law.joints, start=1):
        if said := joint.findings[key].reason:
            by_reason.setdefault(said, []).append(f"J{number}")
    return {" ".join(joints): said for said, joints in by_reason.items()}


def _cell(found: Finding, expectation: Expectation) -> str:
    if found.verdict == "not run":
        return "-"
    if found.verdict == "not applicable":
        return "n/a"
    value = found.figures[0].value if found.figures else None
    if value is None:
        return _MARKS[found.verdict]
    shown = expectation.factor * value
    little = abs(shown) < _LITTLE and found.verdict == "pass"
    characters = (_WIDTH if expectation.key in _WIDE_COLUMNS else _NARROW) - 1  # the mark
    return f"{_short(0.0 if little else shown, characters)}{_MARKS[found.verdict]}"


def _short(value: float, characters: int) -> str:
    """Return a number with at most three digits in so many characters, four at the least."""
    for digits in (3, 2, 1):
        rounded = float(f"{value:.{digits}g}")
        text = np.format_float_positional(rounded, trim="-")
        if len(text) <= characters:
            return text
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa}e{int(exponent)}"
