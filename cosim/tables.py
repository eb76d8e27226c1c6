"""Tables for the terminal."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.markup import escape
from rich.table import Table

from cosim.scoring import ORACLE, Comparison
from hesr_model.friction.audit import REACH, Audit
from hesr_model.friction.cycles import ENCODER
from hesr_model.friction.functions import INPUT_UNITS
from hesr_model.friction.laws import registry
from hesr_model.friction.trained import Excess, Range
from hesr_model.rigid_body import RigidBody
from hesr_model.units import unit_of_joint, unit_of_joints

if TYPE_CHECKING:
    from cosim.convention import Convention

_INTERVALS = 6
"""So many intervals stand side by side in 80 columns."""

_TITLES = {
    "rmse": "RMSE of the predicted torque [{torque}], all rows",
    "rmse_moving": "RMSE [{torque}] while moving (|dq| > 0.02 {speed})",
    "rmse_reversal": "RMSE [{torque}] within 0.1 s of velocity reversals",
}


def comparison(
    name: str,
    scores: Comparison,
    measure: str,
    inputs: Mapping[str, str] | None = None,
    sliding: Sequence[bool] = (),
) -> Table:
    """Return laws by joints of one measure on one test set; the best law of a joint is bold.

    Parameters
    ----------
    name : of the test set.
    scores : of the laws.
    measure : one of `scoring.MEASURES`.
    inputs : inputs of each law; where given, laws of equal inputs stand together.
    sliding : whether each joint slides; empty if all turn.
    """
    heading = _TITLES[measure].format(**_units(sliding))
    table = _by_joint(f"{name}: {heading}", "law", len(scores.joints))
    values = {law: [getattr(s, measure) for s in row] for law, row in scores.laws.items()}
    if measure == "rmse":
        first = next(iter(scores.laws.values()))
        table.add_row("(std of friction)", *(_figure(s.tau_std) for s in first))
        table.add_section()
    best = [
        min((v for v in column if v is not None), default=None)
        for column in zip(*(row for law, row in values.items() if law != ORACLE), strict=True)
    ]
    for label, laws_of_class in _classes(values, inputs):
        if label:
            table.add_row(f"[italic]{label}[/]")
        for law in laws_of_class:
            cells = [
                f"[bold]{_figure(v)}[/]" if v is not None and v == b else _figure(v)
                for v, b in zip(values[law], best, strict=True)
            ]
            table.add_row(title(law), *cells)
        table.add_section()
    return table


def ratios(name: str, scores: Comparison, inputs: Mapping[str, str] | None = None) -> Table:
    """Return the RMSE of every law over that of the reference, with 95 % intervals below."""
    heading = f"{name}: RMSE relative to {title(scores.reference)}, 95 % interval below"
    table = _by_joint(heading, "law", len(scores.joints))
    # In 80 columns, the ends of more intervals do not stand side by side.
    dash = "-" if len(scores.joints) <= _INTERVALS else "-\n"
    for label, laws_of_class in _classes(scores.ratios, inputs):
        if label:
            table.add_row(f"[italic]{label}[/]")
        for law in laws_of_class:
            cells = [f"{r.value:.2f}\n{r.low:.2f}{dash}{r.high:.2f}" for r in scores.ratios[law]]
            table.add_row(title(law), *cells)
        table.add_section()
    return table


def audit(name: str, audits: Sequence[Audit], sliding: Sequence[bool] = ()) -> Table:
    """Return what a friction model must be known for before it is trusted, by joint.

    Parameters
    ----------
    name : of the model.
    audits : of each joint.
    sliding : whether each joint slides; empty if all turn.
    """
    table = _by_joint(f"Audit of {title(name)}", "", len(audits))
    units = _units(sliding)
    slides = sliding or (False,) * len(audits)
    rows = {
        f"steady torque drives for dq in [{units['speed']}]": [_ranges(a.driving) for a in audits],
        "the same without offset, |dq| in": [_ranges(a.driving_both_ways) for a in audits],
        "most energy given per cycle [J]": [
            unit_of_joint(_generated(a), slides=s) for a, s in zip(audits, slides, strict=True)
        ],
        f"slope d tau/d dq at rest [{units['slope']}]": [
            unit_of_joint(_slope(a), slides=s) for a, s in zip(audits, slides, strict=True)
        ],
        f"chatter at rest, encoder {1e6 * ENCODER:.0f} {units['angle']} [{units['torque']}]": [
            f"{a.chatter:.3g}" for a in audits
        ],
        f"largest |tau| in the trained range [{units['torque']}]": [
            f"{a.largest:.3g}" for a in audits
        ],
        f"largest |tau| up to {REACH:g} times outside": [_outside(a) for a in audits],
    }
    for label, cells in rows.items():
        table.add_row(escape(label), *cells)
    return table


def convention(name: str, found: "Convention") -> Table:
    """Return what each way of handing inputs over to an FMU costs, by joint.

    Parameters
    ----------
    name : of the FMU.
    found : what was measured.
    """
    from fmu_src.friction.settings import (
        SETTINGS,  # most tables are of no FMU, which takes long to load
    )

    units = _units(found.sliding)
    speeds = ", ".join(f"{speed:.3g}" for speed in found.speeds)
    table = _by_joint(
        f"{escape(name)}: RMSE [{units['torque']}] of all rows; below, within 0.1 s of reversals",
        "inputs",
        len(found.joints),
    )
    table.caption = (
        f"Velocity: a sine of {found.frequency:g} Hz and {speeds} {units['speed']}, in steps of "
        f"{found.step:g} s. " + "; ".join(f"{way}: {text}" for way, text in SETTINGS.items())
    )
    table.caption_justify = "left"
    for truth, by_setting in (
        ("against the replay of a log", found.replay),
        ("against continuous time", found.continuous),
    ):
        table.add_row(f"[italic]{truth}[/]")
        for setting, of_joints in by_setting.items():
            cells = [f"{_figure(e.rmse)}\n{_figure(e.rmse_reversal)}" for e in of_joints]
            table.add_row(setting, *cells)
        table.add_section()
    return table


def leaving(
    joints: Sequence[str], found: Sequence[Mapping[str, Excess]], sliding: Sequence[bool] = ()
) -> str:
    """Return one line for each input that leaves the trained range in the logs, by joint.

    Parameters
    ----------
    joints : names of the joints.
    found : for each joint how far which input leaves the range.
    sliding : whether each joint slides; empty if all turn.
    """
    slides = sliding or (False,) * len(joints)
    return "\n".join(
        f"{joint}: {name} leaves the trained range in {100.0 * excess.rows:.1f} % of the rows, by "
        f"up to {max(excess.below, excess.above):.3g} {unit_of_joint(INPUT_UNITS[name], slides=s)}."
        for joint, of_joint, s in zip(joints, found, slides, strict=True)
        for name, excess in of_joint.items()
    )


def rigid_body(found: RigidBody, sliding: Sequence[bool] = ()) -> str:
    """Return what was identified, in a sentence or two.

    Parameters
    ----------
    found : the rigid body.
    sliding : whether each joint slides; empty if all turn.
    """
    rotors = sum(name.endswith(".Ir") for name in found.names)
    more = f" ({rotors} of them rotor inertias)" if rotors else ""
    errors = ", ".join(f"{e:.3g}" for e in found.rmse)
    return (
        f"Rigid body: {len(found.base)} base parameters of {len(found.names)}{more}, condition "
        f"{found.condition:.3g}, from {', '.join(found.logs)}; residual RMSE {errors} "
        f"{unit_of_joints('N.m', sliding)}."
    )


def laws() -> Table:
    """Return the registry."""
    table = Table()
    for column in ("name", "law", "equation"):
        table.add_column(column)
    for name, entry in registry().items():
        table.add_row(name, entry.title, entry.equation)
    return table


def title(law: str) -> str:
    """Return the title of a law, or the name itself where it is none of the registry."""
    known = registry()
    return known[law].title if law in known else law


def _units(sliding: Sequence[bool]) -> dict[str, str]:
    turning = {"torque": "N.m", "speed": "rad/s", "slope": "N.m.s/rad", "angle": "urad"}
    return {name: unit_of_joints(unit, sliding) for name, unit in turning.items()}


def _by_joint(heading: str, first: str, joints: int) -> Table:
    table = Table(title=heading, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 0))
    table.add_column(first, no_wrap=True)
    for k in range(1, joints + 1):
        table.add_column(f"J{k}", justify="right")
    return table


def _classes(
    laws_of_table: Mapping[str, object], inputs: Mapping[str, str] | None
) -> list[tuple[str, list[str]]]:
    """Return the laws in classes of equal inputs, the fewest inputs first."""
    if inputs is None:
        return [("", list(laws_of_table))]
    classes: dict[str, list[str]] = {}
    for law in laws_of_table:
        classes.setdefault(inputs.get(law, "for comparison"), []).append(law)
    return sorted(
        classes.items(), key=lambda entry: (not entry[0].startswith("v"), entry[0].count(","))
    )


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _ranges(ranges: Sequence[Range]) -> str:
    return ", ".join(f"{low:.2g} to {high:.2g}" for low, high in ranges) or "none"


def _generated(a: Audit) -> str:
    c = a.generating
    if c is None:
        return "0"
    return f"{a.generated:.3g} ({c.amplitude:.2g} rad/s, {c.frequency:.2g} Hz)"


def _slope(a: Audit) -> str:
    return f"jump of {a.jump:.3g} N.m" if a.slope is None else f"{a.slope:.4g}"


def _outside(a: Audit) -> str:
    torque = "not finite" if a.largest_outside is None else f"{a.largest_outside:.3g}"
    return f"[bold]{torque}: explodes[/]" if a.explodes else torque
