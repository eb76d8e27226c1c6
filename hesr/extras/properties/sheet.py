"""Section of pages with the physics checks and small figures."""

from collections.abc import Sequence
from itertools import count
from typing import Any

from cosim.report.figures.style import svg
from fmu_src.pages.datasheet import figure
from fmu_src.pages.html import rendered
from hesr.extras.properties.figures import draw_check
from hesr_model.audit import properties
from hesr_model.audit.properties import EXPECTATIONS, Expectation
from hesr_model.units import unit_of_joint, unit_of_joints

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
    keys = (f"check-{expectation.key}-{number}" for number in count(1))
    return {
        "expectation": expectation,
        "unit": unit_of_joints(expectation.unit, sliding),
        "cells": [_cell(f, expectation) for f in findings],
        "joints": [
            {
                "name": joint.joint,
                "verdict": properties.MARKS[f.verdict],
                "reason": f.reason,
                "figures": [_spell_range(one) for one in f.figures],
                "plot": _plot(key, f.plot),
                "alt": f"{f.plot.y} over {f.plot.x}" if f.plot else "",
            }
            for key, joint, f in zip(keys, found.joints, findings, strict=False)
        ],
    }


def _cell(found: properties.PropertyResult, expectation: Expectation) -> str:
    value = found.figures[0].value if found.figures else None
    if value is None:
        return properties.MARKS[found.verdict]
    return f"{properties.MARKS[found.verdict]} {figure(expectation.factor * value, _DIGITS)}"


def _spell_range(one: properties.Figure) -> str:
    unit = "" if one.unit == "1" else f" {one.unit}"
    return f"{one.name}: {figure(one.value, _DIGITS)}{unit if one.value is not None else ''}"


def _plot(key: str, plot: properties.Plot | None) -> str:
    """Return the figure of a check as SVG; empty if it has no curves."""
    drawn = draw_check(plot) if plot else None
    return svg(drawn, key) if drawn else ""
