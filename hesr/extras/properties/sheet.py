"""Section of pages with the physics checks and small figures."""

from collections.abc import Sequence
from typing import Any

from cosim.report.figures.style import svg
from fmu_src.pages.datasheet import figure as format_number
from fmu_src.pages.html import render_template
from hesr.extras.properties.figures import draw_check
from hesr_model.audit import properties
from hesr_model.audit.properties import EXPECTATIONS, Expectation
from hesr_model.units import unit_of_joint, unit_of_joints

_DIGITS = 3


def properties_section(
    law_properties: properties.Properties, *, sliding: Sequence[bool] = ()
) -> str:
    """Return HTML: a table of properties by joint, then each experiment with its plots."""
    slides = sliding or (False,) * len(law_properties.joints)
    load_text = format_number(law_properties.tau_load, _DIGITS)
    return render_template(
        "properties.html.j2",
        joints=[joint.joint for joint in law_properties.joints],
        tau_load=f"{load_text} {unit_of_joints('N.m', sliding)}",
        sizes=[
            _list_sizes(joint, is_prismatic)
            for joint, is_prismatic in zip(law_properties.joints, slides, strict=True)
        ],
        properties=[
            _describe_property(law_properties, expectation, sliding)
            for expectation in EXPECTATIONS.values()
        ],
    )


def _list_sizes(joint: properties.JointProperties, is_prismatic: bool) -> list[tuple[str, str]]:
    rows = (
        ("trained speed", joint.speed, "rad/s"),
        ("friction level", joint.level, "N.m"),
        ("deflection", 1e3 * joint.deflection, "mrad"),
        ("inertia", joint.inertia, "kg.m2"),
    )
    return [
        (name, _format_size(value, unit_of_joint(unit, is_prismatic=is_prismatic)))
        for name, value, unit in rows
    ]


def _format_size(value: float | None, unit: str) -> str:
    if value is None:
        return "not known"
    return f"{format_number(value, _DIGITS)} {unit}"


def _describe_property(
    law_properties: properties.Properties, expectation: Expectation, sliding: Sequence[bool]
) -> dict[str, Any]:
    """Return the values of the template for one experiment: a cell and an entry per joint."""
    cells = []
    joints = []
    for number, joint in enumerate(law_properties.joints, start=1):
        result = joint.findings[expectation.key]
        cells.append(_format_cell(result, expectation))
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


def _format_cell(property_result: properties.PropertyResult, expectation: Expectation) -> str:
    mark = properties.MARKS[property_result.verdict]
    if not property_result.figures:
        return mark
    value = property_result.figures[0].value
    if value is None:
        return mark
    return f"{mark} {format_number(expectation.factor * value, _DIGITS)}"


def _spell_range(property_figure: properties.Figure) -> str:
    text = f"{property_figure.name}: {format_number(property_figure.value, _DIGITS)}"
    if property_figure.value is None or property_figure.unit == "1":
        return text
    return f"{text} {property_figure.unit}"


def _draw_plot(key: str, plot: properties.Plot | None) -> dict[str, str]:
    """Return the figure of a check as SVG and its description; both are empty without curves."""
    no_plot = {"plot": "", "alt": ""}
    if plot is None:
        return no_plot
    drawing = draw_check(plot)
    if drawing is None:
        return no_plot
    return {"plot": svg(drawing, key), "alt": f"{plot.y} over {plot.x}"}
