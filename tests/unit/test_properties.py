"""Results of the physics checks: expectations and their file."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hesr_model.audit import properties
from hesr_model.audit.properties import (
    EXPECTATIONS,
    FORMAT,
    Curve,
    Figure,
    JointProperties,
    Plot,
    Properties,
    PropertyResult,
    read_properties,
    write_properties,
)
from hesr_model.errors import ArtifactError

Change = Callable[[dict[str, Any]], None]

PLOT = Plot(x="x [m]", y="y [N]", curves=(Curve(label="one", x=(0.0, 0.1), y=(1.0, -2.5)),))


def found(**changes: PropertyResult) -> Properties:
    """Results for one joint: everything passes except the given checks."""
    figure = Figure(name="miss", value=0.1 + 0.2, unit="1")
    passed = PropertyResult(verdict="pass", figures=(figure,), plot=PLOT)
    joint = JointProperties(
        joint="elbow",
        speed=1.2,
        level=10.0,
        deflection=1e-3,
        inertia=None,
        findings={key: changes.get(key, passed) for key in EXPECTATIONS},
    )
    return Properties(law="lugre", robot="arm", tau_load=-2.0, joints=(joint,))


def test_every_expectation_has_a_source_and_a_method() -> None:
    assert len(EXPECTATIONS) == 13
    for key, e in EXPECTATIONS.items():
        assert e.key == key
        assert e.sources
        for source in e.sources:
            who, year, title = re.fullmatch(r"(\D+) \((\d{4})\): (.+)", source).groups()
            assert who[0].isupper()
            assert 1900 < int(year) < 2030
            assert title[0].isupper()
        for text in (e.measured, e.expected):
            assert text.endswith(".")
        assert len(e.short) <= 6
    for attribute in ("title", "short", "measured"):
        assert len({getattr(e, attribute) for e in EXPECTATIONS.values()}) == 13


@pytest.mark.parametrize(
    ("key", "bound"),
    [
        ("presliding", f"{properties.MAX_JUMP:.0%}"),
        ("presliding", f"{properties.MAX_RATE_CHANGE:.0%}"),
        ("memory", f"{properties.MAX_CLOSING_ERROR:.0%}"),
        ("nested", f"{properties.MAX_CLOSING_ERROR:.0%}"),
        ("start", f"{properties.MAX_START_ERROR:.0%}"),
        ("breakaway", f"{properties.MIN_BREAKAWAY_FALL:.0%}"),
        ("lag", f"{properties.MIN_LAG_WIDTH:.0%}"),
        ("stick_slip", f"{properties.MIN_WEAKENING:.0%}"),
        ("dither", f"{1e6 * properties.MAX_DRIFT:.0f} urad"),
        ("hold", f"{1e6 * properties.MAX_DRIFT:.0f} urad"),
        ("chatter", f"{properties.MAX_CHATTER:.0%}"),
        ("coupling", f"{1e3 * properties.MIN_USEFUL_STEP:.0f} ms"),
    ],
)
def test_the_stated_bound_is_the_deciding_one(key: str, bound: str) -> None:
    assert bound in EXPECTATIONS[key].expected


def test_findings_survive_their_file_bit_for_bit(tmp_path: Path) -> None:
    file = tmp_path / "properties.json"
    failed = PropertyResult(verdict="fail", figures=(Figure(name="miss", value=None, unit="1"),))
    some = found(memory=failed, hold=PropertyResult(verdict="not run", reason="No inertia."))
    other = replace(found(), law="dahl")
    write_properties(file, {"a": some, "b": other})
    assert read_properties(file) == {"a": some, "b": other}
    data = json.loads(file.read_text(encoding="utf-8"))
    assert data["format"] == FORMAT
    assert "(1986)" in data["expectations"]["memory"]["sources"][0]


def _without(key: str) -> Change:
    def change(data: dict[str, Any]) -> None:
        del data["laws"]["a"]["joints"][0]["findings"][key]

    return change


def _with(key: str, value: object) -> Change:
    def change(data: dict[str, Any]) -> None:
        data["laws"]["a"]["joints"][0]["findings"]["hold"][key] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            _without("hold"),
            "not findings of the physics checks (key 'laws.a.joints.0.findings': "
            "'hold' is missing).",
        ),
        (
            _with("verdict", "maybe"),
            "not findings of the physics checks (key 'laws.a.joints.0.findings.hold.verdict': ",
        ),
        (_with("figures", [1]), "not findings of the physics checks ("),
        (
            lambda data: data.update(format="other"),
            f"'format' is 'other', expected '{FORMAT}'.",
        ),
    ],
)
def test_a_damaged_file_is_refused(change: Change, said: str, tmp_path: Path) -> None:
    file = tmp_path / "properties.json"
    write_properties(file, {"a": found()})
    data = json.loads(file.read_text(encoding="utf-8"))
    change(data)
    file.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(ArtifactError) as caught:
        read_properties(file)
    assert str(caught.value).startswith(f"{file}: {said}")


def test_checks_missing_in_older_files_count_as_not_run(tmp_path: Path) -> None:
    file = tmp_path / "properties.json"
    write_properties(file, {"a": found()})
    data = json.loads(file.read_text(encoding="utf-8"))
    for key in ("nested", "start", "drive"):
        del data["laws"]["a"]["joints"][0]["findings"][key]
    file.write_text(json.dumps(data), encoding="utf-8")
    joint = read_properties(file)["a"].joints[0]
    assert list(joint.findings) == list(EXPECTATIONS)
    assert joint.findings["drive"].verdict == "not run"
    assert "run: the file is older" in joint.findings["drive"].reason
    assert joint.findings["work"] == found().joints[0].findings["work"]


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match=r"none\.json: no such file\."):
        read_properties(tmp_path / "none.json")
