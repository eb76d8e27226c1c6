"""The live section without a browser: its module, data and slider limits."""

import base64
import json
import re
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from registry_models import live_of

from fmu_src.friction.friction_component import friction_equations
from fmu_src.pages.live import ends, live_section, read_live_data
from hesr_model.errors import ArtifactError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange

IMPORTS = 2  # number of that section of a module


@pytest.fixture(scope="module")
def live(table1: FrictionModel) -> dict[str, Any]:
    return live_of(table1)


def sections(module: bytes) -> list[int]:
    """Identifiers of the sections of a WebAssembly module."""
    assert module[:8] == b"\0asm\1\0\0\0"
    place, found = 8, []
    while place < len(module):
        found.append(module[place])
        size = shift = 0
        while True:
            place += 1
            size |= (module[place] & 0x7F) << shift
            shift += 7
            if module[place] < 0x80:
                break
        place += 1 + size
    assert place == len(module)
    return found


def test_the_module_is_small_and_imports_nothing(live: dict[str, Any]) -> None:
    module = zlib.decompress(base64.b64decode(live["module"]))
    assert IMPORTS not in sections(module)
    assert len(module) < 48 * 1024
    assert b"/tmp" not in module


def test_data_of_a_page_are_read_as_written(live: dict[str, Any]) -> None:
    assert read_live_data(json.dumps(live), Path("a.fmu")) == json.loads(json.dumps(live))


MARKUP = ("<img src=x>", "<a href='x'>", "<math onclick='x'>", "<script>", '<mo class="a" id="b">')


@pytest.mark.parametrize(
    "change",
    [
        *({"symbol": text} for text in MARKUP),
        {"value": "text"}, {"value": None}, {"low": [1.0]},
    ],
)  # fmt: skip
def test_other_data_of_a_page_are_refused(change: dict[str, Any], live: dict[str, Any]) -> None:
    """Reports show the plots of FMUs that others have made."""
    data = json.loads(json.dumps(live))
    data["joints"][0]["coefficients"][0] |= change
    with pytest.raises(ArtifactError, match=r"^a\.fmu: "):
        read_live_data(json.dumps(data), Path("a.fmu"))


@pytest.mark.parametrize("change", [{"units": {}}, {"speeds": [1.0]}, {"references": {"q": "q"}}])
def test_other_joints_of_a_page_are_refused(change: dict[str, Any], live: dict[str, Any]) -> None:
    data = json.loads(json.dumps(live))
    data["joints"][0] |= change
    with pytest.raises(ArtifactError, match=r"^a\.fmu: "):
        read_live_data(json.dumps(data), Path("a.fmu"))


@pytest.mark.parametrize("text", ["", "[]", "{}", "null", "[" * 100_000, "9" * 5000])
def test_other_texts_of_a_page_are_refused(text: str, live: dict[str, Any]) -> None:
    for content in (text, json.dumps({**live, "joints": []})):
        with pytest.raises(ArtifactError, match=r"^a\.fmu: "):
            read_live_data(content, Path("a.fmu"))


def test_the_module_is_reproducible(table1: FrictionModel, live: dict[str, Any]) -> None:
    assert live_of(table1) == live


def test_the_fmu_stays_small(table1_fmu: Path) -> None:
    assert table1_fmu.stat().st_size <= 120 * 1024
    with zipfile.ZipFile(table1_fmu) as archive:
        assert not [name for name in archive.namelist() if "live" in name or "wasm" in name]


def test_every_tunable_parameter_has_a_slider(table1: FrictionModel, live: dict[str, Any]) -> None:
    table, _ = friction_equations(table1)
    tunable = {i for i, v in enumerate(table.variables) if v.role == "tunable"}
    knobs = [knob for joint in live["joints"] for knob in joint["coefficients"]]
    assert {knob["reference"] for knob in knobs} == tunable
    for knob in knobs:
        variable = table.variables[knob["reference"]]
        assert variable.name == knob["name"] or variable.name.endswith(f".{knob['name']}")
        assert knob["value"] == variable.start
        assert knob["low"] < knob["value"] < knob["high"]
        assert (knob["least"], knob["most"]) == (variable.least, variable.greatest)
        assert knob["scale"] != "log" or knob["low"] * knob["high"] > 0.0


def test_sliders_suit_their_parameters(live: dict[str, Any]) -> None:
    scales = {knob["name"]: knob["scale"] for knob in live["joints"][0]["coefficients"]}
    factors = {"c_0", "c_h", "c_dh", "c_g1", "coulomb_scale[1]", "viscous_scale[1]"}
    assert {name for name, scale in scales.items() if scale == "linear"} == factors
    assert scales["alpha"] == scales["beta"] == scales["theta1_h"] == "log"


@pytest.mark.parametrize(
    ("value", "factor", "wanted"),
    [
        (16.237, True, (0.0, 32.5, "linear")),
        (-2.128, True, (-4.26, 0.0, "linear")),
        (256.84, False, (51.4, 1280.0, "log")),
        (-0.606, False, (-3.03, -0.121, "log")),
        (0.0, True, (-1.0, 1.0, "linear")),
        (0.0, False, (-1.0, 1.0, "linear")),
    ],
)
def test_slider_limits_are_right(
    value: float, factor: bool, wanted: tuple[float, float, str]
) -> None:
    assert ends(value, factor=factor) == wanted


def test_a_law_of_many_coefficients_has_its_factors(
    make_law: Callable[[str], FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    (joint,) = live_of(make_model(make_law("gaussians")))["joints"]
    assert [
        (knob["name"], knob["low"], knob["value"], knob["high"]) for knob in joint["coefficients"]
    ] == [(f"{part}_scale[1]", 0.0, 1.0, 2.0) for part in ("coulomb", "viscous")]


def test_the_motion_is_within_the_training_range(
    make_law: Callable[[str], FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    model = make_model(make_law("viscous"))
    seen = TrainedRange(
        sample_time=0.005, dq=(-0.71239, 0.9), q=(0.5, 2.5), tau_load=(-10.0, 30.0), tau=(-1.0, 1.0)
    )
    for trained, expected in (
        ((), {"amplitude": 1.2, "frequency": 0.25, "cycles": 3.0, "centre": 0.0, "load": 0.0}),
        (
            (seen,),
            {"amplitude": 0.712, "frequency": 0.25, "cycles": 3.0, "centre": 1.5, "load": 10.0},
        ),
    ):
        (joint,) = live_of(replace(model, trained=trained))["joints"]
        knobs = joint["motion"]
        assert {knob["name"]: knob["value"] for knob in knobs} == expected
        assert all(knob["low"] < knob["value"] < knob["high"] for knob in knobs)
        assert all(knob["least"] is None or knob["least"] <= knob["low"] for knob in knobs)
        assert all(knob["most"] is None or knob["most"] >= knob["high"] for knob in knobs)
    slow = make_model(make_law("bare"), sample_time=0.5)
    knobs = {k["name"]: k for k in live_of(slow)["joints"][0]["motion"]}
    assert set(knobs) == {"amplitude", "frequency", "cycles"}
    assert knobs["frequency"]["low"] < knobs["frequency"]["high"] == 0.1


def test_data_cannot_close_its_script_element(table1: FrictionModel, live: dict[str, Any]) -> None:
    name = "</script><!-- & '"
    hostile = {**live, "joints": [{**live["joints"][0], "name": name}]}
    text = live_section(hostile)
    assert text.count("</script>") == 1
    (data,) = re.findall(r'<script type="application/json">(.*)</script>', text)
    assert json.loads(data)["joints"][0]["name"] == name
