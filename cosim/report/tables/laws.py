"""Tables of robots, and of laws: registry, audits, conventions, ranges, physics checks."""

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from cosim.report.tables.table import (
    ResultTable,
    TableCell,
    TableRow,
    fixed_cell,
    joints,
    make_row,
    title,
)
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
    from fmu_src.friction.reference import Error

_DIGITS = 4  # maximum length of a figure without its sign
_MIN_SHOWN = 1e-4  # passing figures below this are shown as 0


def properties(properties_by_law: Mapping[str, Properties], *, full: bool = False) -> ResultTable:
    """Return figure and verdict of each joint, by law and check; `full` names checks."""
    heads = [expectation.short for expectation in EXPECTATIONS.values()]
    if full:
        heads = [expectation.title for expectation in EXPECTATIONS.values()]
    rows = []
    for name, law_properties in properties_by_law.items():
        cells = [_cell(law_properties, expectation) for expectation in EXPECTATIONS.values()]
        rows.append(make_row(title(name), *cells))
    return ResultTable(
        caption="Physics checks by law, one mark per joint: ✓ pass, ✗ fail",
        head=("law", *heads),
        rows=rows,
    )


def find_most_passing(properties_by_law: Mapping[str, Properties]) -> tuple[list[str], int]:
    """Return the laws that pass the most checks on all joints, and the number of these."""
    passed_counts = {name: properties.passed for name, properties in properties_by_law.items()}
    max_passed = max(passed_counts.values())
    laws = [name for name, passed_count in passed_counts.items() if passed_count == max_passed]
    return laws, max_passed


def legend(sliding: Sequence[bool] = ()) -> ResultTable:
    """Return the meaning of the columns of `properties`."""
    rows = []
    for expectation in EXPECTATIONS.values():
        sources_text = "; ".join(
            re.sub(r" \((\d+)\):.*", r" \1", source) for source in expectation.sources
        )
        unit = unit_of_joints(expectation.unit, sliding)
        meaning = f"{expectation.shows} [{unit}]. {expectation.expected} ({sources_text})"
        rows.append(make_row(expectation.short, meaning))
    return ResultTable(caption="", head=("column", "shows"), rows=rows, numeric=False)


def reasons(properties_by_law: Mapping[str, Properties]) -> ResultTable:
    """Return reasons of failures and other remarks by law."""
    rows = []
    for name, properties in properties_by_law.items():
        rows.append(make_row(title(name)))
        for key, expectation in EXPECTATIONS.items():
            by_reason: dict[str, list[str]] = {}
            for short, joint in zip(joints(len(properties.joints)), properties.joints, strict=True):
                reason = joint.findings[key].reason
                if reason:
                    by_reason.setdefault(reason, []).append(short)
            rows += [
                make_row(expectation.short, " ".join(joint_names), reason)
                for reason, joint_names in by_reason.items()
            ]
    return ResultTable(caption="Why", head=("property", "joint", "found"), rows=rows, numeric=False)


def _cell(properties: Properties, expectation: Expectation) -> TableCell:
    property_results = [joint.findings[expectation.key] for joint in properties.joints]
    return TableCell(
        text="\n".join(
            _figure(property_result, expectation) for property_result in property_results
        ),
        marks=tuple(property_result.verdict for property_result in property_results),
    )


def _figure(property_result: PropertyResult, expectation: Expectation) -> str:
    if not property_result.figures or property_result.verdict not in ("pass", "fail"):
        return ""
    value = property_result.figures[0].value
    if value is None:
        return ""
    scaled = expectation.factor * value
    if abs(scaled) < _MIN_SHOWN and property_result.verdict == "pass":
        return _shorten_number(0.0)
    return _shorten_number(scaled)


def _shorten_number(value: float) -> str:
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
    lower, upper, speed = robot.limits
    torque = np.where(robot.torque_limits > 0.0, robot.torque_limits, np.inf)
    gears = robot.description.gear_ratio or (np.inf,) * robot.n
    places = zip(robot.tree, robot.places(np.zeros(robot.n)), strict=True)
    axes = {frame.name: rotation @ frame.axis for frame, (rotation, _) in places}
    rows = []
    for j, (name, slides) in enumerate(zip(robot.joints, robot.slides, strict=True)):
        source = "not stated"
        if np.isfinite([lower[j], speed[j], torque[j]]).any():
            source = robot.description.model.name
        positions = "–"
        if np.isfinite(lower[j]):
            positions = f"{lower[j]:.4g} to {upper[j]:.4g}"
        axis = np.round(axes[name], 6) + 0.0  # the sum turns -0 into 0
        rows.append(
            make_row(
                f"{name} [{unit_of_joint('rad', is_prismatic=slides)}]",
                " ".join(f"{x:.3g}" for x in axis),
                positions,
                _format_finite(speed[j]),
                _format_finite(torque[j]),
                source,
                _format_finite(gears[j]),
            )
        )
    limits = ("position limits", "speed limit", "torque limit", "source of limits")
    head = ("joint", "axis in the base at q = 0", *limits, "gear ratio")
    return ResultTable(caption="Joints", head=head, rows=rows, words=(1, 2, 5))


def _format_finite(value: float) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{value:.4g}"


def _links(robot: Robot) -> ResultTable:
    rows = []
    for frame, (mass, centre, inertia) in zip(robot.tree, robot.bodies, strict=True):
        inertia_entries = (
            inertia[np.diag_indices(3)].tolist() + inertia[np.triu_indices(3, 1)].tolist()
        )
        rows.append(make_row(frame.name, *(f"{x:.4g}" for x in (mass, *centre, *inertia_entries))))
    inertias = (f"I{axes} in kg.m2" for axes in ("xx", "yy", "zz", "xy", "xz", "yz"))
    head = ("link after joint", "mass in kg", *(f"{axis} in m" for axis in "xyz"), *inertias)
    note = "Centre of mass in the frame of the joint, inertia about it; fixed parts are included."
    return ResultTable(caption="Links", head=head, rows=rows, note=note)


def laws() -> ResultTable:
    """Return the registry."""
    return ResultTable(
        caption="",
        head=("name", "law", "equation"),
        rows=[make_row(name, entry.title, entry.as_text()) for name, entry in registry().items()],
        numeric=False,
    )


def audit(name: str, audits: Sequence[Audit], sliding: Sequence[bool] = ()) -> ResultTable:
    """Return the audit of a friction model by joint."""
    from fmu_src.pages.datasheet import audit_rows

    return ResultTable(
        caption=f"Audit of {title(name)}",
        head=("", *joints(len(audits))),
        rows=[make_row(label, *cells) for label, cells in audit_rows(audits, sliding).items()],
    )


def convention(name: str, errors: "Convention") -> ResultTable:
    """Return the error of each input setting of an FMU, by joint."""
    from fmu_src.friction.reference import SETTINGS

    rows = [
        make_row("against the replay of a log"),
        *_make_setting_rows(errors.replay),
        make_row("against continuous time"),
        *_make_setting_rows(errors.continuous),
    ]
    speeds = ", ".join(f"{speed:.3g}" for speed in errors.speeds)
    settings = "; ".join(f"{setting_name}: {text}" for setting_name, text in SETTINGS.items())
    torque_unit = unit_of_joints("N.m", errors.sliding)
    return ResultTable(
        caption=f"{name}: RMSE [{torque_unit}] of all rows; small: within 0.1 s of reversals",
        head=("inputs", *joints(len(errors.joints))),
        rows=rows,
        note=f"Velocity: a sine of {errors.frequency:g} Hz and {speeds} "
        f"{unit_of_joints('rad/s', errors.sliding)}, in steps of {errors.step:g} s. {settings}",
    )


def _make_setting_rows(errors_by_setting: "Mapping[str, Sequence[Error]]") -> list[TableRow]:
    """Return the row of each input setting: its errors by joint."""
    rows = []
    for setting, joint_errors in errors_by_setting.items():
        cells = []
        for error in joint_errors:
            reversal_error = fixed_cell(error.rmse_reversal, 3).text
            cells.append(fixed_cell(error.rmse, 3, notes=(reversal_error,)))
        rows.append(make_row(setting, *cells))
    return rows


def describe_excesses(
    names: Sequence[str], excesses: Sequence[Mapping[str, Excess]], sliding: Sequence[bool] = ()
) -> str:
    """Return one line per joint and input that leaves the trained range."""
    slides = sliding or (False,) * len(names)
    units = {**INPUT_UNITS, TEMPERATURE.name: TEMPERATURE.unit}
    lines = []
    for joint, joint_excesses, joint_slides in zip(names, excesses, slides, strict=True):
        for name, excess in joint_excesses.items():
            unit = unit_of_joint(units[name], is_prismatic=joint_slides)
            lines.append(
                f"{joint}: {name} leaves the trained range in {100.0 * excess.rows:.1f} % of the "
                f"rows, by up to {max(excess.below, excess.above):.3g} {unit}."
            )
    return "\n".join(lines)


def rigid_body(body: RigidBody, sliding: Sequence[bool] = ()) -> str:
    """Return a summary of the rigid body."""
    rotors = sum(name.endswith(".Ir") for name in body.names)
    rotor_text = ""
    if rotors:
        rotor_text = f" ({rotors} of them rotor inertias)"
    errors = ", ".join(f"{e:.3g}" for e in body.rmse)
    sentence = (
        f"Rigid body: {len(body.base)} base parameters of {len(body.names)}{rotor_text}, condition "
        f"{body.condition:.3g}, from {', '.join(body.logs)}; residual RMSE {errors} "
        f"{unit_of_joints('N.m', sliding)}."
    )
    lines = [sentence]
    if body.sentence:
        lines.append(body.sentence)
    return "\n".join([*lines, *map(_gear, body.gears)])


def _gear(gear: ElasticGear) -> str:
    parameter_texts = {}
    for name, (value, error) in gear.parameters.items():
        half_width = _round_digits(1.96 * error, 2)
        parameter_texts[name] = f"{_round_digits(value, 4)} +- {half_width}"
    stiffness, error = gear.parameters["stiffness"]
    if 1.96 * error > 0.2 * stiffness:
        return (
            f"Gear of {gear.joint}: these logs do not determine its stiffness "
            f"({parameter_texts['stiffness']} N.m/rad); record faster motion, or a payload."
        )
    parameters = ", ".join(f"{name} {text}" for name, text in parameter_texts.items())
    return f"Gear of {gear.joint} [SI]: {parameters}."


def _round_digits(value: float, digits: int) -> str:
    """Return a number with significant digits, without an exponent below a million."""
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.6g}"
