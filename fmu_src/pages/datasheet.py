"""Figures of an FMU's data sheet: audit, conventions, fastest states."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fmu_src.friction.reference import (
    CONTINUOUS,
    SETTINGS,
    UNKNOWN_SPEED,
    Error,
    ReferenceMotion,
    errors,
    reference_motion,
    torques,
)
from hesr_model.audit.audit import ENCODER_NOISE, REACH, Audit, audit
from hesr_model.audit.certificate import Certificate, certify
from hesr_model.equations.functions import to_numpy_function
from hesr_model.errors import HesrError, SimulationError
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import coefficient_array
from hesr_model.friction.trained_range import Range, TrainedRange
from hesr_model.support.arrays import Array
from hesr_model.units import unit_of_joint, unit_of_joints

RK4 = 2.785
EULER = 2.0  # largest stable rate * step of fourth-order Runge-Kutta and forward Euler

_MAX_ROUNDING_ENERGY = 1e-6  # [J]; less is round-off


@dataclass(frozen=True, kw_only=True)
class ModelAudit:
    """Passivity of laws by joint: closed cycles, rest, and motion beyond the trained range."""

    certificates: tuple[Certificate, ...]
    audits: tuple[Audit, ...]

    @classmethod
    def from_model(
        cls, model: FrictionModel, trained_ranges: Sequence[TrainedRange]
    ) -> "ModelAudit":
        """Examine each joint's law with cycles within its range."""
        return cls(
            certificates=certificates(model, trained_ranges), audits=audits(model, trained_ranges)
        )


def ranges(model: FrictionModel, motion: ReferenceMotion) -> tuple[TrainedRange, ...]:
    """Return the trained range of each joint, or that of the reference motion if unknown."""
    if model.trained:
        return model.trained
    torque = torques(model, motion, "direct")
    return tuple(
        TrainedRange(
            sample_time=model.sample_time,
            dq=(-UNKNOWN_SPEED, UNKNOWN_SPEED),
            q=(float(q.min()), float(q.max())),
            tau_load=(0.0, 0.0),
            tau=(float(tau.min()), float(tau.max())),
        )
        for q, tau in zip(motion.q.T, torque.T, strict=True)
    )


def audits(model: FrictionModel, trained_ranges: Sequence[TrainedRange]) -> tuple[Audit, ...]:
    """Return the audit of each joint's law in a range."""
    return tuple(
        audit(law, trained_range)
        for law, trained_range in zip(model.laws, trained_ranges, strict=True)
    )


def audit_laws(model: FrictionModel) -> tuple[tuple[Audit, ...], str]:
    """Return the audit of each joint's law, or none and the reason."""
    try:
        return audits(model, ranges(model, reference_motion(model))), ""
    except HesrError as error:
        return (), str(error)


def certificates(
    model: FrictionModel, trained_ranges: Sequence[TrainedRange]
) -> tuple[Certificate, ...]:
    """Return the passivity of each joint's law, with cycles within its range."""
    return tuple(
        certify(law, trained_range)
        for law, trained_range in zip(model.laws, trained_ranges, strict=True)
    )


def describe_certificate(certificate: Certificate, *, slides: bool = False) -> str:
    """Return the certificate of one joint in words."""
    if certificate.verdict == "proven":
        if certificate.largest_step is None:
            reach = "in continuous time"
        elif certificate.largest_step == np.inf:
            reach = "at any step"
        else:
            reach = f"up to steps of {1e3 * certificate.largest_step:.3g} ms"
        sentence = f"passive, proven {reach}: {certificate.storage}; " + "; ".join(
            certificate.rests_on
        )
    elif certificate.cycle is not None:
        sentence = f"not passive, refuted by a cycle: {certificate.cycle.text}"
    else:
        sentence = f"{certificate.label} without energy gain; no proof: {certificate.rests_on[0]}"
    if slides:
        for unit in ("N.m.s/rad", "N.m", "rad/s"):
            sentence = sentence.replace(unit, unit_of_joint(unit, is_prismatic=True))
    return f"{sentence}."


def audit_rows(joint_audits: Sequence[Audit], sliding: Sequence[bool] = ()) -> dict[str, list[str]]:
    """Return the figures of audits as text: labels, and a cell per joint."""
    speed = unit_of_joints("rad/s", sliding)
    torque = unit_of_joints("N.m", sliding)
    slope = unit_of_joints("N.m.s/rad", sliding)
    angle = unit_of_joints("µrad", sliding)
    labels = (
        f"Steady sliding drives the joint for dq [{speed}]",
        f"The same without any offset, for |dq| [{speed}]",
        "Most energy given in a closed cycle [J]",
        f"In the cycle of this amplitude [{speed}] and frequency [Hz]",
        f"Jump of the torque at rest [{torque}]",
        f"Slope dtau/ddq at rest [{slope}]",
        f"The same, held over one sample [{slope}]",
        f"Chatter at rest, encoder noise {1e6 * ENCODER_NOISE:.0f} {angle} [{torque}]",
        f"Largest |tau| within the range [{torque}]",
        f"Largest |tau| up to {REACH:g} times outside [{torque}]",
    )
    rows: dict[str, list[str]] = {label: [] for label in labels}
    for joint_audit in joint_audits:
        for label, cell in zip(labels, _audit_cells(joint_audit), strict=True):
            rows[label].append(cell)
    return rows


def _audit_cells(a: Audit) -> tuple[str, ...]:
    """Return the figures of an audit in the order of the labels of `audit_rows`."""
    cycle_text = "–"
    if a.generating is not None:
        cycle_text = f"{figure(a.generating.amplitude, 2)}, {figure(a.generating.frequency, 2)}"
    largest_outside = figure(a.largest_outside, 3)
    if a.explodes:
        largest_outside += ": explodes"
    return (
        _ranges(a.driving),
        _ranges(a.driving_both_ways),
        figure(a.generated, 3),
        cycle_text,
        figure(a.jump, 3),
        figure(a.slope),
        figure(a.slope_of_step),
        figure(a.chatter, 3),
        figure(a.largest, 3),
        largest_outside,
    )


def verdict(audit: Audit, *, is_trained: bool, slides: bool = False) -> str:
    """Return the conclusions of an audit in words; `is_trained` if its range is the trained one."""
    speed = unit_of_joint("rad/s", is_prismatic=slides)
    cycle = audit.generating
    if cycle is None or audit.generated < _MAX_ROUNDING_ENERGY:
        sentence = "None of the tested sines generates energy over a closed cycle."
    else:
        sentence = (
            f"It is not passive: over a closed cycle of {figure(cycle.amplitude, 2)} {speed} at "
            f"{figure(cycle.frequency, 2)} Hz it generates {figure(audit.generated, 3)} J."
        )
    if audit.driving_both_ways:
        sentence += (
            f" Steady sliding drives at speeds of {_ranges(audit.driving_both_ways)} {speed}, so "
            "do not use it as the friction of a simulated plant."
        )
    if is_trained and audit.explodes:
        sentence += " Just outside the trained range its torque explodes."
    return sentence


def costs(model: FrictionModel, motion: ReferenceMotion) -> dict[str, dict[str, tuple[Error, ...]]]:
    """Return the errors of each input convention by truth, convention and joint.

    The truths are the law in the direct convention, and in continuous time with linear inputs
    between rows. Raises SimulationError if a torque is unstable or not finite.
    """
    torque_by_setting = {setting: torques(model, motion, setting) for setting in SETTINGS}
    fine = torques(model, motion, CONTINUOUS)
    if not np.all(np.isfinite([fine, *torque_by_setting.values()])):
        raise SimulationError("the torque is not finite on this motion.")

    def compare_with(truth: Array) -> dict[str, tuple[Error, ...]]:
        return {
            setting: errors(motion, torque, truth) for setting, torque in torque_by_setting.items()
        }

    return {
        "the log's convention": compare_with(torque_by_setting["direct"]),
        "the law in continuous time": compare_with(fine),
    }


def find_fastest_rates(law: FrictionLaw, trained_range: TrainedRange) -> dict[str, float]:
    """Return the largest rate [1/s] of each state within a range."""
    slow_speeds = np.clip([-1e-3, 0.0, 1e-3], *trained_range.dq)
    speeds = np.unique([*np.linspace(*trained_range.dq, 401), *slow_speeds])
    positions = np.linspace(*trained_range.q, 33)
    loads = np.unique([*trained_range.tau_load, np.clip(0.0, *trained_range.tau_load)])
    grid: list[Array] = [u.ravel() for u in np.meshgrid(speeds, positions, loads)]
    symbols = tuple(quantity.symbol for quantity in law.form.coefficients)
    at_rest = dict.fromkeys((element.state for element in law.form.memory), 0)
    relaxations = law.form.relaxations
    rates = to_numpy_function((*symbols, *INPUTS), [r.rate.subs(at_rest) for r in relaxations])
    with np.errstate(all="ignore"):  # results that are not finite are reported as such
        values = rates(*coefficient_array(law), *grid)
    return {r.name: float(np.max(value)) for r, value in zip(relaxations, values, strict=True)}


def figure(value: float | None, digits: int = 4) -> str:
    """Return a number rounded to some digits; a dash for None."""
    if value is None:
        return "–"
    if value and not 1e-4 <= abs(value) < 1e6:
        text = f"{value:.{digits}g}"
    else:
        text = np.format_float_positional(value + 0.0, precision=digits, fractional=False, trim="-")
    return text.replace("-", "−")


def spell_interval(range_: Range, digits: int = 3) -> str:
    """Return a range as text."""
    return " to ".join(figure(value, digits) for value in range_)


def _ranges(intervals: Sequence[Range]) -> str:
    return ", ".join(spell_interval(interval, 2) for interval in intervals) or "none"
