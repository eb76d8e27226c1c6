"""Section of pages with the physics checks and small figures."""

from collections.abc import Sequence
from typing import Any

from cosim.report.figures.style import svg
from fmu_src.pages.datasheet import figure as format_number
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
        tau_load=f"{format_number(found.tau_load, _DIGITS)} {unit_of_joints('N.m', sliding)}",
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
    return "not known" if value is None else f"{format_number(value, _DIGITS)} {unit}"


def _property(
    found: properties.Properties, expectation: Expectation, sliding: Sequence[bool]
) -> dict[str, Any]:
    """Return the values of the template for one experiment: a cell and an entry per joint."""
    cells = []
    joints = []
    for number, joint in enumerate(found.joints, start=1):
        result = joint.findings[expectation.key]
        cells.append(_cell(result, expectation))
        entry = {
            "name": joint.joint,
            "verdict": properties.MARKS[result.verdict],
            "reason": result.reason,
            "figures": [_spell_range(figure) for figure in result.figures],
        }
        joints.append(entry | _draw_plot(f"check-{expectation.key}-{number}", result.plot))
    return {
        "expectation": expectation,
        "unit": unit_of_joints(expectation.unit, sliding),
        "cells": cells,
        "joints": joints,
    }


def _cell(found: properties.PropertyResult, expectation: Expectation) -> str:
    value = found.figures[0].value if found.figures else None
    if value is None:
        return properties.MARKS[found.verdict]
    return f"{properties.MARKS[found.verdict]} {format_number(expectation.factor * value, _DIGITS)}"


def _spell_range(one: properties.Figure) -> str:
    unit = "" if one.unit == "1" else f" {one.unit}"
    return f"{one.name}: {format_number(one.value, _DIGITS)}{unit if one.value is not None else ''}"


def _draw_plot(key: str, plot: properties.Plot | None) -> dict[str, str]:
    """Return the figure of a check as SVG and its description; both are empty without curves."""
    drawing = draw_check(plot) if plot else None
    if plot is None or drawing is None:
        return {"plot": "", "alt": ""}
    return {"plot": svg(drawing, key), "alt": f"{plot.y} over {plot.x}"}
