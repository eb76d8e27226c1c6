"""Jumps of outputs under adverse masters, judged on made-up runs of known size."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from containing import Containing

from fmu_src.check.description import ParsedVariable
from hesr.extras.hostile.master import _choose_excitation, _Master, _measure_scale, _read_run, _Run

STEP = 0.1


def variable(name: str, variability: str = "continuous", **own: str) -> ParsedVariable:
    return ParsedVariable(
        index=1,
        name=name,
        reference=7,
        causality="output",
        variability=variability,
        declared_initial=None,
        kind="Real",
        type_attributes=own,
        type=None,
    )


@pytest.fixture
def master(tmp_path: Path) -> _Master:
    about = SimpleNamespace(
        variables=[variable("y"), variable("z"), variable("d", "discrete")],
        experiment={"stepSize": str(STEP)},
        attributes={},
        structure={"Derivatives": []},
    )
    return _Master(about, {}, tmp_path)  # type: ignore[arg-type]


def run(step: float, *, at: float = 1.0, y: float = 0.0, z: float = 0.0, d: float = 0.0) -> _Run:
    """Outputs of 0 until 2 s that rise to 1 at 4 s, with additions at one time."""
    times = step * np.arange(1, round(5.0 / step) + 1)
    rows = np.tile(np.clip(0.5 * (times - 2.0), 0.0, 1.0)[:, None], 3)
    rows[np.argmin(np.abs(times - at))] += (y, z, d)
    return _Run(
        times=times,
        steps=np.full_like(times, step),
        rows=rows,
        fresh=rows[:-1],
        refused="",
        taken=None,
    )


def jumps(master: _Master, nominal: _Run | None = None, **runs: _Run) -> list[str]:
    usual = {"nominal": nominal or run(STEP), "dense": run(STEP / 8.0), "held": run(STEP / 2.0)}
    return list(master._find_jumps(usual | runs))


@pytest.mark.parametrize("name", ["summed", "fifth", "irrational", "tiny"])
def test_jumps_above_2_percent_of_the_range_are_reported(master: _Master, name: str) -> None:
    assert jumps(master, **{name: run(0.02, y=0.0199)}) == []
    (found,) = jumps(master, **{name: run(0.02, y=0.0201)})
    assert found == Containing("'y' is 0.0201 at 1 s", "0.02 s", "0.1 s and less give 0.")
    assert jumps(master, **{name: run(0.02, y=-0.0199)}) == []
    assert len(jumps(master, **{name: run(0.02, y=-0.0201)})) == 1
    assert jumps(master, **{name: run(0.02, d=9.0)}) == []


@pytest.mark.parametrize(("step", "most"), [(0.02, 0.07), (0.2, 0.12)])
def test_five_step_errors_are_allowed(master: _Master, step: float, most: float) -> None:
    """Errors of longer steps in proportion."""
    name = "fifth" if step < STEP else "double"
    nominal = run(STEP, y=0.01)
    assert jumps(master, nominal, **{name: run(step, y=most - 1e-4)}) == []
    assert len(jumps(master, nominal, **{name: run(step, y=most + 1e-4)})) == 1


def test_outputs_may_have_any_value_of_the_two_steps_around(master: _Master) -> None:
    """From 0.15 to 0.35 at 2.5 s."""
    assert jumps(master, fifth=run(0.02, at=2.5, y=0.1199, z=-0.1199)) == []
    (found,) = jumps(master, fifth=run(0.02, at=2.5, y=0.1201))
    assert found == Containing("'y' is 0.3701 at 2.5 s", "0.02 s", "0.1 s", "from 0.15 to 0.35.")
    assert len(jumps(master, fifth=run(0.02, at=2.5, z=-0.1201))) == 1


def test_repeated_steps_must_give_equal_outputs(master: _Master) -> None:
    for name in ("refreshed", "repeated"):
        assert jumps(master, **{name: run(STEP, y=0.5e-9)}) == []
        assert len(jumps(master, **{name: run(STEP, y=2e-9)})) == 1
        assert len(jumps(master, **{name: run(STEP, d=2e-9)})) == 1


def test_further_outputs_are_counted_and_nan_is_worst(master: _Master) -> None:
    (found,) = jumps(master, fifth=run(0.02, y=0.3, z=0.4))
    assert "'z' (and 1 more output) is 0.4 at 1 s" in found
    (found,) = jumps(master, fifth=run(0.02, y=0.3, z=np.nan))
    assert "'z' (and 1 more output) is nan at 1 s" in found
    (found,) = jumps(master, repeated=run(STEP, y=0.3, z=0.4, d=0.5))
    assert "'d' (and 2 more outputs) is 0.5 at 1 s" in found


def test_without_a_nominal_run_nothing_is_compared(master: _Master) -> None:
    refused = _read_run({"refused": "no"}, 3)
    assert (refused.rows.shape, refused.fresh.shape, refused.refused) == ((0, 3), (0, 3), "no")
    assert jumps(master, refused, fifth=run(0.02, y=9.0)) == []
    assert jumps(master, fifth=refused) == []
    alone = {"nominal": run(STEP), "fifth": run(0.02, y=9.0)}
    assert len(list(master._find_jumps(alone))) == 1


@pytest.mark.parametrize(
    ("own", "centre", "amplitude"),
    [
        ({}, 0.0, 0.5),
        ({"start": "2", "nominal": "4"}, 2.0, 2.0),
        ({"start": "inf", "nominal": "0"}, 0.0, 0.5),
        ({"min": "0", "max": "1"}, 0.5, 0.4),
        ({"start": "0.9", "min": "0", "max": "9"}, 4.5, 0.5),
        ({"min": "1"}, 1.5, 0.5),
        ({"min": "-9", "start": "3"}, 3.0, 0.5),
        ({"max": "-1"}, -1.5, 0.5),
        ({"max": "9", "start": "3"}, 3.0, 0.5),
        ({"min": "-inf", "max": "inf"}, 0.0, 0.5),
    ],
)
def test_inputs_are_moved_within_their_limits(
    own: dict[str, str], centre: float, amplitude: float
) -> None:
    found = _choose_excitation(variable("u", **own))
    assert found == {"reference": 7, "centre": pytest.approx(centre), "amplitude": amplitude}


def test_the_range_of_an_output_is_at_least_its_rounding() -> None:
    rows = np.array([[1.0, 5.0, 0.0, np.inf], [3.0, 5.0, 0.0, 2.0]])
    np.testing.assert_allclose(_measure_scale(rows), [2.0, 5e-9, 1e-12, 2.0], rtol=1e-12)


@pytest.mark.parametrize(
    "outcome", [{"refused": 3}, {"times": [1.0], "steps": [1.0, 2.0]}, {"rows": [[1.0]]}, []]
)
def test_outcomes_of_wrong_form_are_refused(outcome: object) -> None:
    with pytest.raises((ValueError, TypeError, AttributeError)):
        _read_run(outcome, 2)
