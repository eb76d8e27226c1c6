"""Figures of an FMU's data sheet: audit, conventions, fastest states, physics checks."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmu_src.friction.reference import UNKNOWN_SPEED, reference_motion
from fmu_src.friction.settings import CONTINUOUS, SETTINGS, Error, ReferenceMotion, errors, torques
from fmu_src.pages.html import rendered
from hesr_model.audit import properties
from hesr_model.audit.audit import ENCODER, REACH, Audit, audit
from hesr_model.audit.certificate import Certificate, certify
from hesr_model.audit.properties import EXPECTATIONS, Expectation
from hesr_model.equations.functions import lowered
from hesr_model.errors import HesrError, SimulationError
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import numbers
from hesr_model.friction.trained_range import Range, TrainedRange
from hesr_model.support.arrays import Array
from hesr_model.units import unit_of_joint, unit_of_joints

_WIDTH, _HEIGHT = 236, 148  # size of a plot in its own units
_LEFT, _RIGHT, _TOP, _BOTTOM = 6, 6, 18, 18  # margins of the plot
_LINES = ("var(--accent)", "#c2410c", "#15803d")
_DIGITS = 3


def properties_section(found: properties.Properties, *, sliding: Sequence[bool] = ()) -> str:
    """Return HTML: a table of properties by joint, then each experiment with its plots."""
    slides = sliding or (False,) * len(found.joints)
    return rendered(
        "properties.html.j2",
        joints=[joint.joint for joint in found.joints],
        tau_load=f"{figure(found.tau_load, _DIGITS)} {unit_of_joints('N.m', sliding)}",
        sizes=[_sizes(joint, s) for joint, s in zip(found.joints, slides, strict=True)],
        properties=[_property(found, e, sliding) for e in EXPECTATIONS.values()],
    )


def _sizes(joint: properties.JointProperties, slides: bool) -> list[tuple[str, str]]:
    rows = (
        ("trained speed", joint.speed, "rad/s"),
        ("friction level", joint.level, "N.m"),
        ("deflection", 1e3 * joint.deflection, "mrad"),
        ("inertia", joint.inertia, "kg.m2"),
    )
    return [(name, _size(value, unit_of_joint(unit, slides=slides))) for name, value, unit in rows]


def _size(value: float | None, unit: str) -> str:
    return "not known" if value is None else f"{figure(value, _DIGITS)} {unit}"


def _property(
    found: properties.Properties, expectation: Expectation, sliding: Sequence[bool]
) -> dict[str, Any]:
    findings = [joint.findings[expectation.key] for joint in found.joints]
    return {
        "expectation": expectation,
        "unit": unit_of_joints(expectation.unit, sliding),
        "cells": [_cell(f, expectation) for f in findings],
        "joints": [
            {
                "name": joint.joint,
                "verdict": properties.MARKS[f.verdict],
                "reason": f.reason,
                "figures": [_spelled(one) for one in f.figures],
                "plot": svg(f.plot) if f.plot else "",
            }
            for joint, f in zip(found.joints, findings, strict=True)
        ],
    }


def _cell(found: properties.PropertyResult, expectation: Expectation) -> str:
    value = found.figures[0].value if found.figures else None
    if value is None:
        return properties.MARKS[found.verdict]
    return f"{properties.MARKS[found.verdict]} {figure(expectation.factor * value, _DIGITS)}"


def _spelled(one: properties.Figure) -> str:
    unit = "" if one.unit == "1" else f" {one.unit}"
    return f"{one.name}: {figure(one.value, _DIGITS)}{unit if one.value is not None else ''}"


def svg(plot: properties.Plot) -> str:
    """Return a plot as inline SVG; names come from the experiments, so nothing needs escaping."""
    curves = [c for c in plot.curves if len(c.x) > 1]
    if not curves:
        return ""
    x_range = _range([v for c in curves for v in c.x])
    y_range = _range([v for c in curves for v in c.y])
    parts = [*_frame(plot, x_range, y_range)]
    for colour, curve in zip(_LINES, curves, strict=False):
        points = " ".join(
            f"{_across(x, x_range):.1f},{_down(y, y_range):.1f}"
            for x, y in zip(curve.x, curve.y, strict=True)
        )
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.4"/>'
        )
    labels = "  ".join(
        f'<tspan fill="{colour}">{curve.label}</tspan>'
        for colour, curve in zip(_LINES, curves, strict=False)
    )
    parts.append(_text(_WIDTH - _RIGHT, 12, "end", labels))
    x, y = plot.labels
    return (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}" role="img" '
        f'aria-label="{y} over {x}">{"".join(parts)}</svg>'
    )


def _frame(
    plot: properties.Plot, x_range: tuple[float, float], y_range: tuple[float, float]
) -> Iterator[str]:
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM
    yield (
        f'<rect x="{_LEFT}" y="{_TOP}" width="{right - _LEFT}" height="{bottom - _TOP}" '
        'fill="none" stroke="var(--line)"/>'
    )
    if y_range[0] < 0.0 < y_range[1]:
        y = f"{_down(0.0, y_range):.1f}"
        yield f'<path d="M{_LEFT} {y}H{right}" stroke="var(--line)"/>'
    if x_range[0] < 0.0 < x_range[1]:
        x = f"{_across(0.0, x_range):.1f}"
        yield f'<path d="M{x} {_TOP}V{bottom}" stroke="var(--line)"/>'
    low, high = (figure(v, _DIGITS) for v in x_range)
    yield _text(_LEFT, _HEIGHT - 5, "start", low)
    yield _text(_WIDTH / 2, _HEIGHT - 5, "middle", plot.labels[0])
    yield _text(right, _HEIGHT - 5, "end", high)
    low, high = (figure(v, _DIGITS) for v in y_range)
    yield _text(_LEFT, 12, "start", f"{plot.labels[1]}, {low} to {high}")


def _text(x: float, y: float, anchor: str, text: str) -> str:
    return (
        f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" font-size="9.5" fill="var(--soft)">'
        f"{text}</text>"
    )


def _range(values: list[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    if high > low:
        return low, high
    return low - 0.5 * max(abs(low), 1.0), high + 0.5 * max(abs(high), 1.0)


def _across(x: float, around: tuple[float, float]) -> float:
    share = (x - around[0]) / (around[1] - around[0])
    return _LEFT + 2 + share * (_WIDTH - _LEFT - _RIGHT - 4)


def _down(y: float, around: tuple[float, float]) -> float:
    share = (y - around[0]) / (around[1] - around[0])
    return _HEIGHT - _BOTTOM - 2 - share * (_HEIGHT - _TOP - _BOTTOM - 4)


RK4, EULER = 2.785, 2.0  # largest stable rate * step of fourth-order Runge-Kutta and forward Euler

_ALMOST_PASSIVE = 1e-6  # [J]; less is round-off


@dataclass(frozen=True, kw_only=True)
class ModelAudit:
    """Passivity of laws by joint: closed cycles, rest, and motion beyond the trained range."""

    certificates: tuple[Certificate, ...]
    audits: tuple[Audit, ...]

    @classmethod
    def of(cls, model: FrictionModel, seen: Sequence[TrainedRange]) -> "ModelAudit":
        """Examine each joint's law with cycles within its range."""
        return cls(certificates=certificates(model, seen), audits=audits(model, seen))


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


def audits(model: FrictionModel, seen: Sequence[TrainedRange]) -> tuple[Audit, ...]:
    """Return the audit of each joint's law in a range."""
    return tuple(audit(law, range_) for law, range_ in zip(model.laws, seen, strict=True))


def audited(model: FrictionModel) -> tuple[tuple[Audit, ...], str]:
    """Return the audit of each joint's law, or none and the reason."""
    try:
        return audits(model, ranges(model, reference_motion(model))), ""
    except HesrError as error:
        return (), str(error)


def certificates(model: FrictionModel, seen: Sequence[TrainedRange]) -> tuple[Certificate, ...]:
    """Return the passivity of each joint's law, with cycles within its range."""
    return tuple(certify(law, range_) for law, range_ in zip(model.laws, seen, strict=True))


def certified(found: Certificate, *, slides: bool = False) -> str:
    """Return the certificate of one joint in words."""
    if found.verdict == "proven":
        if found.largest_step is None:
            reach = "in continuous time"
        elif found.largest_step == np.inf:
            reach = "at any step"
        else:
            reach = f"up to steps of {1e3 * found.largest_step:.3g} ms"
        said = f"passive, proven {reach}: {found.storage}; " + "; ".join(found.rests_on)
    elif found.cycle is not None:
        said = f"not passive, refuted by a cycle: {found.cycle.text}"
    else:
        said = f"{found.label} without energy gain; no proof: {found.rests_on[0]}"
    for unit in ("N.m.s/rad", "N.m", "rad/s"):
        said = said.replace(unit, unit_of_joint(unit, slides=slides)) if slides else said
    return f"{said}."


def audit_rows(found: Sequence[Audit], sliding: Sequence[bool] = ()) -> dict[str, list[str]]:
    """Return the figures of audits as text: labels, and a cell per joint."""
    speed, torque, slope, angle = (
        unit_of_joints(unit, sliding) for unit in ("rad/s", "N.m", "N.m.s/rad", "µrad")
    )
    labels = (
        f"Steady sliding drives the joint for dq [{speed}]",
        f"The same without any offset, for |dq| [{speed}]",
        "Most energy given in a closed cycle [J]",
        f"In the cycle of this amplitude [{speed}] and frequency [Hz]",
        f"Jump of the torque at rest [{torque}]",
        f"Slope dtau/ddq at rest [{slope}]",
        f"The same, held over one sample [{slope}]",
        f"Chatter at rest, encoder noise {1e6 * ENCODER:.0f} {angle} [{torque}]",
        f"Largest |tau| within the range [{torque}]",
        f"Largest |tau| up to {REACH:g} times outside [{torque}]",
    )
    columns = list(map(_audit_cells, found))
    return {label: [cells[i] for cells in columns] for i, label in enumerate(labels)}


def _audit_cells(a: Audit) -> tuple[str, ...]:
    cycle = a.generating
    return (
        _ranges(a.driving),
        _ranges(a.driving_both_ways),
        figure(a.generated, 3),
        f"{figure(cycle.amplitude, 2)}, {figure(cycle.frequency, 2)}" if cycle else "–",
        figure(a.jump, 3),
        figure(a.slope),
        figure(a.slope_of_step),
        figure(a.chatter, 3),
        figure(a.largest, 3),
        figure(a.largest_outside, 3) + (": explodes" if a.explodes else ""),
    )


def verdict(found: Audit, *, known: bool, slides: bool = False) -> str:
    """Return the conclusions of an audit in words; `known` if its range is that of the training."""
    speed = unit_of_joint("rad/s", slides=slides)
    cycle = found.generating
    if cycle is None or found.generated < _ALMOST_PASSIVE:
        said = "None of the tested closed cycles generates energy."
    else:
        said = (
            f"It is not passive: over a closed cycle of {figure(cycle.amplitude, 2)} {speed} at "
            f"{figure(cycle.frequency, 2)} Hz it generates {figure(found.generated, 3)} J."
        )
    if found.driving_both_ways:
        said += (
            f" Steady sliding drives at speeds of {_ranges(found.driving_both_ways)} {speed}, so "
            "do not use it as the friction of a simulated plant."
        )
    if known and found.explodes:
        said += " Just outside the trained range its torque explodes."
    return said


def costs(model: FrictionModel, motion: ReferenceMotion) -> dict[str, dict[str, tuple[Error, ...]]]:
    """Return the errors of each input convention by truth, convention and joint.

    The truths are the law in the direct convention, and in continuous time with linear inputs
    between rows. Raises SimulationError if a torque is unstable or not finite.
    """
    found = {way: torques(model, motion, way) for way in SETTINGS}
    fine = torques(model, motion, CONTINUOUS)
    if not np.all(np.isfinite([fine, *found.values()])):
        raise SimulationError("the torque is not finite on this motion.")
    truths = {"the log's convention": found["direct"], "the law in continuous time": fine}
    return {
        name: {way: errors(motion, tau, truth) for way, tau in found.items()}
        for name, truth in truths.items()
    }


def fastest(law: FrictionLaw, seen: TrainedRange) -> dict[str, float]:
    """Return the largest rate [1/s] of each state within a range."""
    speeds = np.unique([*np.linspace(*seen.dq, 401), *np.clip([-1e-3, 0.0, 1e-3], *seen.dq)])
    places = np.linspace(*seen.q, 33)
    loads = np.unique([*seen.tau_load, np.clip(0.0, *seen.tau_load)])
    grid: list[Array] = [u.ravel() for u in np.meshgrid(speeds, places, loads)]
    symbols = tuple(c.symbol for c in law.form.coefficients)
    at_rest = dict.fromkeys((m.state for m in law.form.memory), 0)
    own = law.form.relaxations
    rates = lowered((*symbols, *INPUTS), [r.rate.subs(at_rest) for r in own])
    with np.errstate(all="ignore"):  # results that are not finite are reported as such
        values = rates(*numbers(law), *grid)
    return {r.name: float(np.max(value)) for r, value in zip(own, values, strict=True)}


def figure(value: float | None, digits: int = 4) -> str:
    """Return a number rounded to some digits; a dash for None."""
    if value is None:
        return "–"
    if value and not 1e-4 <= abs(value) < 1e6:
        text = f"{value:.{digits}g}"
    else:
        text = np.format_float_positional(value + 0.0, precision=digits, fractional=False, trim="-")
    return text.replace("-", "−")


def spelled(range_: Range, digits: int = 3) -> str:
    """Return a range as text."""
    return " to ".join(figure(value, digits) for value in range_)


def _ranges(found: Sequence[Range]) -> str:
    return ", ".join(spelled(one, 2) for one in found) or "none"
