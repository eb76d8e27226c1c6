"""Tables of laws: the registry, audits, conventions and trained ranges."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cosim.report.tables.table import ResultTable, fixed, joints, row_of, title
from hesr_model.audit.audit import Audit
from hesr_model.friction.inputs import INPUT_UNITS
from hesr_model.friction.registry import registry
from hesr_model.friction.thermal import TEMPERATURE
from hesr_model.friction.trained_range import Excess
from hesr_model.rigid_body.elasticity import ElasticGear
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.units import unit_of_joint, unit_of_joints

if TYPE_CHECKING:
    from fmu_src.check.convention import Convention


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
    from fmu_src.friction.settings import SETTINGS

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
