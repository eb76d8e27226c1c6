"""A hypothesis is stated if it wins its trials by more than their uncertainty."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planted_mistakes import MISTAKES
from sound_benches import BENCHES

from hesr_model.health.examine import examine
from hesr_model.health.referee import (
    Estimate,
    Hypothesis,
    LeftOutRows,
    Race,
    Statistic,
    judge,
)
from hesr_model.inference.folds import FOLD_COUNT, split_into_folds
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.robots.robot import Robot

ONES = np.ones(400)


def race(squares: np.ndarray) -> Race:
    return Race(rival="nothing", rival_squares=ONES, squares=squares)


def suppose(*trials: Race | Statistic, contradictions: tuple[str, ...] = ()) -> Hypothesis:
    return Hypothesis(
        check="guess",
        joint="j1",
        observation="it is so",
        remedy="set it",
        trials=trials,
        contradictions=contradictions,
        record="more",
        changes={"key": 1},
    )


def test_a_race_is_won_by_more_than_its_scatter() -> None:
    assert race(0.5 * ONES).outcome == "won"
    assert race(0.95 * ONES).outcome == "lost"  # too little to matter
    assert race(1.5 * ONES).outcome == "lost"
    # All of the gain is in one block of time.
    rival_squares = np.where(np.arange(len(ONES)) < 20, 4.0, 1.0)
    lucky = Race(rival="nothing", rival_squares=rival_squares, squares=ONES)
    assert lucky.outcome == "open"


def test_a_statistic_lies_outside_its_range_by_more_than_its_error() -> None:
    outcomes = [
        Statistic(name="x", estimate=Estimate(value=value, error=0.1), low=0.0, high=1.0).outcome
        for value in (0.5, 1.2, 1.6, -0.4, -0.6)
    ]
    assert outcomes == ["lost", "open", "won", "open", "won"]


WON = race(0.5 * ONES)
LOST = race(ONES)
OPEN = Statistic(name="its scale", estimate=Estimate(value=1.2, error=0.1), high=1.0)


@pytest.mark.parametrize(
    ("hypothesis", "stated", "undecided"),
    [
        (suppose(), 1, 0),
        (suppose(WON), 1, 0),
        (suppose(WON, OPEN), 0, 1),
        (suppose(OPEN, LOST), 0, 0),
        (suppose(WON, contradictions=("it lies beyond its limits",)), 0, 1),
    ],
)
def test_what_cannot_be_told_is_no_finding(
    hypothesis: Hypothesis, stated: int, undecided: int
) -> None:
    judgement = judge([hypothesis])
    assert (len(judgement.findings), len(judgement.undecided)) == (stated, undecided)
    for finding in judgement.undecided:
        assert (finding.severity, finding.joints, dict(finding.changes)) == ("advice", ("j1",), {})
        assert "cannot tell, because" in finding.sentence
        assert "record more" in finding.sentence


def test_rows_are_judged_by_a_fit_to_the_others(make_motion: Callable[..., Motion]) -> None:
    """The folds are those of the choice of laws."""
    motion = make_motion()
    left_out = LeftOutRows.split([motion.name], [motion.t])
    folds = split_into_folds([motion])
    assert len(left_out.judged) == FOLD_COUNT
    for fold, judged, trained in zip(folds, left_out.judged, left_out.trained, strict=True):
        np.testing.assert_array_equal(fold.judged[0], judged)
        assert sum(len(piece.t) for piece in fold.training) == np.count_nonzero(trained)
    step = np.where(left_out.judged[2], 1.0, 0.0)
    errors = left_out.predict(np.ones((len(step), 1)), step)
    np.testing.assert_allclose(errors[left_out.judged[2]], 1.0)


NAMES = ("one reversal", "one way", "creeping", "light wrist")


@pytest.mark.parametrize("name", NAMES)
def test_a_correct_log_of_a_bench_raises_no_alarm(name: str, tmp_path: Path) -> None:
    """All benches are tried by the benchmark of decisions."""
    robot = Robot(BENCHES[name].write_description(tmp_path))
    found = examine(BENCHES[name].record(0), robot.description, robot).findings
    assert [finding.sentence for finding in found] == []


def test_motion_one_way_is_said_not_to_show_friction(tmp_path: Path) -> None:
    bench = BENCHES["one way"]
    robot = Robot(bench.write_description(tmp_path))
    undecided = examine(bench.record(0), robot.description, robot).undecided
    assert "one-way" in {finding.check for finding in undecided}


@pytest.mark.parametrize("what", [None, "dq backwards", "rounded positions", "a row far off"])
def test_findings_do_not_depend_on_units(what: str | None, tmp_path: Path) -> None:
    """A bench a thousandth in size, with torques a thousand times as large."""
    bench = BENCHES["cylinder"]
    robot = Robot(bench.write_description(tmp_path))
    log = bench.record(0)[0].rows(slice(0, 4000))
    log = log if what is None else MISTAKES[what].plant(log, 0, 0)
    assert log.dq is not None
    small = replace(log, q=1e-3 * log.q, dq=1e-3 * log.dq, tau=1e3 * log.tau)
    large = replace(log, q=30.0 * log.q, dq=30.0 * log.dq, tau=1e-3 * log.tau)
    checks = [
        [finding.check for finding in examine([each], robot.description, robot).findings]
        for each in (log, small, large)
    ]
    assert checks[0] == checks[1] == checks[2]
    assert bool(checks[0]) == (what is not None)


def test_free_swing_does_not_turn_gravity(tmp_path: Path) -> None:
    """Gravity and inertia cancel, and what is left is friction."""
    bench = replace(BENCHES["pendulum"], viscous=0.02, coulomb=0.03)
    robot = Robot(bench.write_description(tmp_path))
    step = 0.005
    q, dq = [1.0], [0.0]
    lever = bench.gravity / bench.inertia
    for _ in range(4000):
        dq.append(dq[-1] - step * (lever * np.cos(q[-1]) + 0.2 * dq[-1]))
        q.append(q[-1] + step * dq[-1])
    noise = np.random.default_rng(0).normal(0.0, 0.005, len(q))
    log = Log(
        name="swing",
        t=step * np.arange(len(q)),
        q=np.array(q)[:, None],
        dq=np.array(dq)[:, None],
        tau=noise[:, None],
    )
    checks = {finding.check for finding in examine([log], robot.description, robot).findings}
    assert not checks & {"gravity-sign", "gravity", "zero", "torque-sign", "position-sign"}
