"""Tables of robots, and of laws: registry, audits, conventions, ranges, physics checks."""

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from cosim.report.tables.table import ResultTable, TableCell, fixed, joints, row_of, title
from hesr_model.audit.audit import Audit
from hesr_model.audit.properties import EXPECTATIONS, Expectation, Properties, PropertyResult
from hesr_model.fitting.estimator import registry
from hesr_model.friction.inputs import INPUT_UNITS
from hesr_model.friction.thermal import TEMPERATURE
from hesr_model.friction.trained_range import Excess
from hesr_model.rigid_body.elasticity import ElasticGear
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.units import unit_of_joint, unit_of_joints

if TYPE_CHECKING:
    from fmu_src.friction.convention import Convention

_DIGITS = 4  # maximum length of a figure without its sign
_LITTLE = 1e-4  # passing figures below this are shown as 0


def properties(found: Mapping[str, Properties], *, full: bool = False) -> ResultTable:
    """Return figure and verdict of each joint, by law and check; `full` names checks."""
    return ResultTable(
        caption="Physics checks by law, one mark per joint: ✓ pass, ✗ fail",
        head=("law", *(e.title if full else e.short for e in EXPECTATIONS.values())),
        rows=[
            row_of(title(name), *(_cell(properties, e) for e in EXPECTATIONS.values()))
            for name, properties in found.items()
        ],
    )


def find_most_passing(found: Mapping[str, Properties]) -> tuple[list[str], int]:
    """Return the laws that pass the most checks on all joints, and the number of these."""
    most = max(properties.passed for properties in found.values())
    return [name for name, properties in found.items() if properties.passed == most], most


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
    for name, properties in found.items():
        rows.append(row_of(title(name)))
        for key, expectation in EXPECTATIONS.items():
            by_reason: dict[str, list[str]] = {}
            for short, joint in zip(joints(len(properties.joints)), properties.joints, strict=True):
                said = joint.findings[key].reason
                if said:
                    by_reason.setdefault(said, []).append(short)
            rows += [
                row_of(expectation.short, " ".join(where), said)
                for said, where in by_reason.items()
            ]
    return ResultTable(caption="Why", head=("property", "joint", "found"), rows=rows, numeric=False)


def _cell(properties: Properties, expectation: Expectation) -> TableCell:
    found = [joint.findings[expectation.key] for joint in properties.joints]
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


def robot_tables(robot: Robot) -> tuple[ResultTable, ResultTable]:
    """Return the tables of a robot's joints and links."""
    return _joints(robot), _links(robot)


def _joints(robot: Robot) -> ResultTable:
    low, high, speed = robot.limits
    torque = np.where(robot.torque_limits > 0.0, robot.torque_limits, np.inf)
    gears = robot.description.gear_ratio or (np.inf,) * robot.n
    places = zip(robot.tree, robot.places(np.zeros(robot.n)), strict=True)
    axes = {frame.name: rotation @ frame.axis for frame, (rotation, _) in places}
    rows = []
    for j, (name, slides) in enumerate(zip(robot.joints, robot.slides, strict=True)):
        stated = np.isfinite([low[j], speed[j], torque[j]]).any()
        rows.append(
            row_of(
                f"{name} [{unit_of_joint('rad', slides=slides)}]",
                " ".join(f"{x:.3g}" for x in np.round(axes[name], 6) + 0.0),
                f"{low[j]:.4g} to {high[j]:.4g}" if np.isfinite(low[j]) else "–",
                *map(_stated, (speed[j], torque[j])),
                robot.description.model.name if stated else "not stated",
                _stated(gears[j]),
            )
        )
    limits = ("position limits", "speed limit", "torque limit", "source of limits")
    head = ("joint", "axis in the base at q = 0", *limits, "gear ratio")
    return ResultTable(caption="Joints", head=head, rows=rows, words=(1, 2, 5))


def _stated(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "–"


def _links(robot: Robot) -> ResultTable:
    rows = []
    for frame, (mass, centre, inertia) in zip(robot.tree, robot.bodies, strict=True):
        about = inertia[np.diag_indices(3)].tolist() + inertia[np.triu_indices(3, 1)].tolist()
        rows.append(row_of(frame.name, *(f"{x:.4g}" for x in (mass, *centre, *about))))
    inertias = (f"I{axes} in kg.m2" for axes in ("xx", "yy", "zz", "xy", "xz", "yz"))
    head = ("link after joint", "mass in kg", *(f"{axis} in m" for axis in "xyz"), *inertias)
    note = "Centre of mass in the frame of the joint, inertia about it; fixed parts are included."
    return ResultTable(caption="Links", head=head, rows=rows, note=note)


def laws() -> ResultTable:
    """Return the registry."""
    return ResultTable(
        caption="",
        head=("name", "law", "equation"),
        rows=[row_of(name, entry.title, entry.as_text()) for name, entry in registry().items()],
        numeric=False,
    )


def audit(name: str, audits: Sequence[Audit], sliding: Sequence[bool] = ()) -> ResultTable:
    """Return the audit of a friction model by joint."""
    from fmu_src.pages.datasheet import audit_rows

    return ResultTable(
        caption=f"Audit of {title(name)}",
        head=("", *joints(len(audits))),
        rows=[row_of(label, *cells) for label, cells in audit_rows(audits, sliding).items()],
    )


def convention(name: str, found: "Convention") -> ResultTable:
    """Return the error of each input setting of an FMU, by joint."""
    from fmu_src.friction.reference import SETTINGS

    torque, speed = (unit_of_joints(unit, found.sliding) for unit in ("N.m", "rad/s"))
    rows = []
    for truth, by_setting in (
        ("against the replay of a log", found.replay),
        ("against continuous time", found.continuous),
    ):
        rows.append(row_of(truth))
        for setting, of_joints in by_setting.items():
            cells = [fixed(e.rmse, 3, notes=(fixed(e.rmse_reversal, 3).text,)) for e in of_joints]
            rows.append(row_of(setting, *cells))
    return ResultTable(
        caption=f"{name}: RMSE [{torque}] of all rows; small: within 0.1 s of reversals",
        head=("inputs", *joints(len(found.joints))),
        rows=rows,
        note=f"Velocity: a sine of {found.frequency:g} Hz and "
        f"{', '.join(f'{v:.3g}' for v in found.speeds)} {speed}, in steps of {found.step:g} s. "
        + "; ".join(f"{way}: {text}" for way, text in SETTINGS.items()),
    )


def leaving(
    names: Sequence[str], found: Sequence[Mapping[str, Excess]], sliding: Sequence[bool] = ()
) -> str:
    """Return one line per joint and input that leaves the trained range."""
    slides = sliding or (False,) * len(names)
    units = {**INPUT_UNITS, TEMPERATURE.name: TEMPERATURE.unit}
    return "\n".join(
        f"{joint}: {name} leaves the trained range in {100.0 * excess.rows:.1f} % of the rows, by "
        f"up to {max(excess.below, excess.above):.3g} {unit_of_joint(units[name], slides=s)}."
        for joint, of_joint, s in zip(names, found, slides, strict=True)
        for name, excess in of_joint.items()
    )


def rigid_body(found: RigidBody, sliding: Sequence[bool] = ()) -> str:
    """Return a summary of the rigid body."""
    rotors = sum(name.endswith(".Ir") for name in found.names)
    more = f" ({rotors} of them rotor inertias)" if rotors else ""
    errors = ", ".join(f"{e:.3g}" for e in found.rmse)
    body = (
        f"Rigid body: {len(found.base)} base parameters of {len(found.names)}{more}, condition "
        f"{found.condition:.3g}, from {', '.join(found.logs)}; residual RMSE {errors} "
        f"{unit_of_joints('N.m', sliding)}."
    )
    return "\n".join([body, *map(_gear, found.gears)])


def _gear(gear: ElasticGear) -> str:
    shown = {
        name: " +- ".join(f"{float(f'{x:.{n}g}'):.6g}" for x, n in ((value, 4), (1.96 * error, 2)))
        for name, (value, error) in gear.parameters.items()
    }
    stiffness, error = gear.parameters["stiffness"]
    if 1.96 * error > 0.2 * stiffness:
        return (
            f"Gear of {gear.joint}: these logs do not determine its stiffness "
            f"({shown['stiffness']} N.m/rad); record faster motion, or a payload."
        )
    return f"Gear of {gear.joint} [SI]: {', '.join(f'{n} {text}' for n, text in shown.items())}."
