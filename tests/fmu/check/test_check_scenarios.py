"""Scenarios of an adverse master with a lag in this process: steps, inputs and outputs."""

import math
import re
import zipfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_fmus import lag

from hesr.extras.hostile.scenarios import outcome

U, Y, T = 0, 1, 4  # value references
STEP, STEPS = 0.1, 10


@pytest.fixture(scope="module")
def plan(shared: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("unpacked")
    with zipfile.ZipFile(shared("lag", lag) / "Lag.fmu") as archive:
        archive.extractall(folder)
    text = (folder / "modelDescription.xml").read_text(encoding="utf-8")
    found = re.search(r'guid="([^"]+)"', text)
    assert found
    return {
        "folder": str(folder), "guid": found[1], "simulation": "lag", "exchange": "lag",
        "step": STEP, "steps": STEPS, "variable": True, "states": 1, "indicators": 0,
        "inputs": [{"reference": U, "centre": 1.0, "amplitude": 0.5}], "outputs": [Y],
    }  # fmt: skip


def given(time: float) -> float:
    """Two periods of a sine over the experiment."""
    return 1.0 + 0.5 * math.sin(4.0 * math.pi * time / (STEP * STEPS))


def lagged(times: list[float], hold: int = 1) -> list[float]:
    """The lag at some times, with inputs of the first of each `hold` steps."""
    x = [0.25]
    for k, (begin, end) in enumerate(pairwise(times)):
        u = given(times[k - k % hold])
        x.append(x[-1] + (u - x[-1]) * -math.expm1(-(end - begin) / 0.5))
    return x


SHARES = [math.sqrt(0.5), math.pi / 3.0, math.e - 2.0, math.sqrt(2.0) - 1.0, math.pi / 7.0]


@pytest.mark.parametrize(
    ("scenario", "steps", "hold"),
    [
        ("nominal", [STEP] * 12, 1),
        ("dense", [STEP / 8.0] * 96, 1),
        ("fifth", [STEP / 5.0] * 50, 1),
        ("double", [2.0 * STEP] * 5, 1),
        ("irrational", [STEP * share for share in SHARES] * 3, 1),
        ("summed", [STEP] * 10 + [1e-14], 1),
        ("tiny", [1e-14, STEP - 1e-14] * 10, 1),
        ("held", [STEP / 2.0] * 28, 4),
        ("refreshed", [STEP] * 10, 1),
        ("repeated", [STEP] * 10, 1),
    ],
)
def test_steps_inputs_and_outputs_are_those_of_the_scenario(
    plan: dict[str, Any], scenario: str, steps: list[float], hold: int
) -> None:
    found = outcome(plan, scenario)
    assert "refused" not in found
    np.testing.assert_allclose(found["steps"], [0.0, *steps], rtol=1e-12)
    times = np.concatenate([[0.0], np.cumsum(steps)]).tolist()
    np.testing.assert_allclose(found["times"], times, atol=1e-12)
    np.testing.assert_allclose(np.ravel(found["rows"]), lagged(times, hold), atol=1e-12)
    if scenario == "refreshed":
        assert found["fresh"] == found["rows"][:-1]


@pytest.mark.parametrize("scenario", ["exchange", "late"])
def test_a_solver_reaches_the_same_outputs(plan: dict[str, Any], scenario: str) -> None:
    """As far as its default tolerance goes, for a solution with kinks."""
    found = outcome(plan, scenario)
    assert "refused" not in found
    np.testing.assert_allclose(found["times"], STEP * np.arange(1, 11), rtol=1e-9)
    exact = lagged([0.0, *found["times"]])[1:]
    np.testing.assert_allclose(np.ravel(found["rows"]), exact, rtol=0.035)


def test_inputs_differ_in_phase(plan: dict[str, Any]) -> None:
    """The second value of an input that is set twice."""
    inputs = [{"reference": U, "centre": 2.0, "amplitude": 0.5}] * 2
    found = outcome(plan | {"inputs": inputs, "outputs": [U]}, "nominal")
    wanted = 2.0 + 0.5 * np.sin(4.0 * np.pi * STEP * np.arange(11) / (STEP * STEPS) + 2.4)
    np.testing.assert_allclose(np.ravel(found["rows"])[1:12], wanted, rtol=1e-12)


def test_one_state_too_many_is_tried(plan: dict[str, Any]) -> None:
    assert outcome(plan, "sizes")["taken"] is False


def test_refusals_carry_the_message_of_the_fmu(plan: dict[str, Any]) -> None:
    negative = [{"reference": T, "centre": -1.0, "amplitude": 0.0}]
    found = outcome(plan | {"inputs": negative}, "nominal")
    assert found["refused"] == (
        "fmi2ExitInitializationMode ends in an error with 'T is -1 s; it must be positive.'"
    )
    assert found["rows"] == []
    missing = outcome(plan | {"simulation": "none"}, "nominal")
    assert missing["refused"].startswith("its binary cannot be loaded (")


def test_without_inputs_and_outputs_it_only_steps(plan: dict[str, Any]) -> None:
    found = outcome(plan | {"inputs": [], "outputs": []}, "nominal")
    assert found["rows"] == [[]] * 13
