"""A hypothesis is stated if it wins its trials by more than their uncertainty."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planted_mistakes import MISTAKES
from sound_benches import BENCHES, Bench, sines

from hesr_model.health.examine import examine
from hesr_model.health.joints import apply_changes
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
from hesr_model.robots.robot import Robot, RobotDescription

Array = np.ndarray
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
    error = lucky.gain.error
    gain, uncertainty = map(int, re.findall(r"(\d+) %", lucky.doubt))
    assert gain == round(100.0 * lucky.gain.value)
    assert uncertainty == pytest.approx(300.0 * error, abs=0.5)


def test_the_error_of_a_gain_is_the_scatter_of_blocks() -> None:
    """Of three rows each is a block, whose gains 0.25, 0.2 and 0.25 are of 0.25, 0.25 and 0.5."""
    few = Race(
        rival="nothing", rival_squares=np.array([1.0, 1.0, 2.0]), squares=np.array([0.0, 0.2, 1.0])
    )
    scatter = np.array([0.25, 0.2, 0.25]) - 0.7 * np.array([0.25, 0.25, 0.5])
    assert few.gain.value == pytest.approx(0.7)
    assert few.gain.error == pytest.approx(np.sqrt(np.sum(scatter**2) * 3.0 / 2.0))


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


def let_swing(bench: Bench, start: float, damping: float) -> tuple[Array, Array]:
    """Return time, position and velocity (N, 3), and the torque (N,) of a motor that damps."""
    step = 0.0005
    rows = np.empty((40_000, 4))
    q = start - 0.5 * np.pi
    dq = 0.0
    for k in range(len(rows)):
        tau = -damping * dq
        rows[k] = k * step, q, dq, tau
        friction = bench.coulomb * np.tanh(dq / 0.01) + bench.viscous * dq
        dq += step * (tau - friction - bench.gravity * np.cos(q)) / bench.inertia
        q += step * dq
    return rows[::10, :3], rows[::10, 3]


@pytest.mark.parametrize("start", [0.5, 1.5])
@pytest.mark.parametrize("damping", [0.0, 0.03])
def test_free_swing_shows_no_mistake(start: float, damping: float, tmp_path: Path) -> None:
    """Gravity and inertia cancel, and what is left is friction and the damping of the motor.

    At the ends of the log smoothing guesses, and the acceleration is largest.
    """
    bench = replace(BENCHES["pendulum"], viscous=0.02, coulomb=0.01)
    robot = Robot(bench.write_description(tmp_path))
    motion, tau = let_swing(bench, start, damping)
    rng = np.random.default_rng(0)
    tau = tau + rng.normal(0.0, 1e-3, len(tau))
    log = Log(name="swing", t=motion[:, 0], q=motion[:, 1], dq=motion[:, 2], tau=tau)
    checks = {finding.check for finding in examine([log], robot.description, robot).findings}
    assert checks <= {"torque-signal"}
    assert bool(checks) == (damping == 0.0)  # then the torque is noise


@pytest.mark.parametrize("shape", ["one way", "strokes"])
@pytest.mark.parametrize("count", [0.0, 0.002, 0.004])
def test_steps_of_a_ramp_that_a_low_pass_removes_are_not_coarse(
    shape: str, count: float, tmp_path: Path
) -> None:
    t = 0.001 * np.arange(8000)
    direction = np.where((t // 2.0) % 2 < 1, 1.0, -1.0) if shape == "strokes" else np.ones(8000)
    dq = 0.4 * direction
    q = 0.001 * np.concatenate([[0.0], np.cumsum(dq)[:-1]])
    q = count * np.round(q / count) if count else q
    tau = 0.3 * direction + np.random.default_rng(0).normal(0.0, 0.02, len(t))
    robot = Robot(BENCHES["strokes"].write_description(tmp_path))
    log = Log(name="ramp", t=t, q=q, dq=dq, tau=tau)
    assert examine([log], robot.description, robot).findings == ()


def test_motor_torques_are_not_called_currents(arm_log: Log, arm: RobotDescription) -> None:
    """Only the gear decides, which the remedy asks for; with it the unit is known."""
    gear_ratio = (80.0, 100.0, 120.0)
    log = replace(arm_log, tau=arm_log.tau / np.array(gear_ratio))
    findings = examine([log], arm, Robot(arm)).findings
    scales = [finding for finding in findings if finding.check == "torque-scale"]
    assert scales
    assert all("gear_ratio" in finding.remedy and not finding.changes for finding in scales)
    geared = apply_changes(arm, {"gear_ratio": gear_ratio})
    findings = examine([log], geared, Robot(geared)).findings
    scales = [finding for finding in findings if finding.check == "torque-scale"]
    assert scales
    assert all(finding.changes for finding in scales)
    for finding in scales:
        np.testing.assert_allclose(finding.changes["log.units.tau"], gear_ratio)


def test_slow_friction_with_memory_is_no_lag(tmp_path: Path) -> None:
    """A single frequency, at which friction builds up for longer than a clock is usually wrong."""
    bench = replace(
        BENCHES["cylinder"], speed=sines((15e-3, 0.5)), seconds=20.0, deflection=1e-3, rise=0.0
    )
    robot = Robot(bench.write_description(tmp_path))
    (log,) = bench.record(0)
    assert examine([log], robot.description, robot).findings == ()


@pytest.mark.parametrize(
    ("what", "check", "key", "value"),
    [
        ("q and dq in degrees", "angle-unit", "log.units.q", "deg"),
        ("a zero a quarter turn off", "zero", "log.zero", (-np.pi / 2.0,)),
    ],
)
def test_angles_of_a_model_without_limits_are_mended(
    what: str, check: str, key: str, value: object, tmp_path: Path
) -> None:
    bench = replace(BENCHES["pendulum"], rate=100.0)
    robot = Robot(bench.write_description(tmp_path))
    spoilt = MISTAKES[what].apply(bench.record(0)[0], 0, robot)
    findings = examine([spoilt], robot.description, robot).findings
    (finding,) = (finding for finding in findings if finding.check == check)
    assert finding.changes[key] == value
    # For one joint gravity from another side is the same as a zero.
    assert ("cannot show which" in finding.remedy) == (check == "zero")


@pytest.mark.parametrize(
    ("speed", "noise", "factor", "is_found"),
    [
        (sines((0.3, 0.23), (0.2, 0.7)), 3e-4, 0.05, True),
        (sines((0.1, 0.1), (0.05, 0.3)), 3e-4, 1.0, False),
        (sines((0.1, 0.1), (0.05, 0.3)), 1e-3, 1.0, False),
    ],
)
def test_a_scale_is_not_told_by_accelerations_of_noise(
    speed: Callable[[Array], Array], noise: float, factor: float, is_found: bool, tmp_path: Path
) -> None:
    """Noise of a position that is slow against it hides the inertia, however large."""
    bench = replace(
        BENCHES["500 Hz"], speed=speed, known=True, inertia=0.5, position_noise=noise,
        torque_noise=0.01,
    )  # fmt: skip
    robot = Robot(bench.write_description(tmp_path))
    (log,) = bench.record(0)
    log = replace(log, tau=factor * log.tau, dq=None)
    checks = {finding.check for finding in examine([log], robot.description, robot).findings}
    assert checks == ({"torque-scale"} if is_found else set())
