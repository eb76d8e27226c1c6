"""Section of pages with the physics checks and small plots."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from fmu_src.pages.datasheet import figure
from fmu_src.pages.html import rendered
from hesr_model.audit import properties
from hesr_model.audit.properties import EXPECTATIONS, Expectation
from hesr_model.units import unit_of_joint, unit_of_joints

_WIDTH = 236
_HEIGHT = 148  # size of a plot in its own units
_LEFT = 6
_RIGHT = 6
_TOP = 18
_BOTTOM = 18  # margins of the plot
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
                "figures": [_spell_range(one) for one in f.figures],
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


def _spell_range(one: properties.Figure) -> str:
    unit = "" if one.unit == "1" else f" {one.unit}"
    return f"{one.name}: {figure(one.value, _DIGITS)}{unit if one.value is not None else ''}"


def svg(plot: properties.Plot) -> str:
    """Return a plot as inline SVG; names come from the experiments, so nothing needs escaping."""
    curves = [c for c in plot.curves if len(c.x) > 1]
    if not curves:
        return ""
    x_range = _range([v for c in curves for v in c.x])
    y_range = _range([v for c in curves for v in c.y])
    across = partial(np.interp, xp=x_range, fp=(_LEFT + 2, _WIDTH - _RIGHT - 2))
    down = partial(np.interp, xp=y_range, fp=(_HEIGHT - _BOTTOM - 2, _TOP + 2))
    right = _WIDTH - _RIGHT
    bottom = _HEIGHT - _BOTTOM
    parts = [
        f'<rect x="{_LEFT}" y="{_TOP}" width="{right - _LEFT}" height="{bottom - _TOP}" '
        'fill="none" stroke="var(--line)"/>'
    ]
    if y_range[0] < 0.0 < y_range[1]:
        parts.append(f'<path d="M{_LEFT} {down(0.0):.1f}H{right}" stroke="var(--line)"/>')
    if x_range[0] < 0.0 < x_range[1]:
        parts.append(f'<path d="M{across(0.0):.1f} {_TOP}V{bottom}" stroke="var(--line)"/>')
    x, y = plot.labels
    left, end, low, high = (figure(v, _DIGITS) for v in x_range + y_range)
    parts += [
        _text(_LEFT, _HEIGHT - 5, "start", left),
        _text(_WIDTH / 2, _HEIGHT - 5, "middle", x),
        _text(right, _HEIGHT - 5, "end", end),
        _text(_LEFT, 12, "start", f"{y}, {low} to {high}"),
    ]
    labels = []
    for colour, curve in zip(_LINES, curves, strict=False):
        places = np.column_stack([across(curve.x), down(curve.y)])
        points = " ".join(f"{u:.1f},{v:.1f}" for u, v in places)
        line = f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.4"/>'
        parts.append(line)
        labels.append(f'<tspan fill="{colour}">{curve.label}</tspan>')
    parts.append(_text(right, 12, "end", "  ".join(labels)))
    return (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}" role="img" '
        f'aria-label="{y} over {x}">{"".join(parts)}</svg>'
    )


def _text(x: float, y: float, anchor: str, text: str) -> str:
    return (
        f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" font-size="9.5" fill="var(--soft)">'
        f"{text}</text>"
    )


def _range(values: list[float]) -> tuple[float, float]:
    low = min(values)
    high = max(values)
    if high > low:
        return low, high
    return low - 0.5 * max(abs(low), 1.0), high + 0.5 * max(abs(high), 1.0)
