"""Each check reports a mistake that is large enough, and is quiet about a smaller one.

A row holds a size that must not be reported and one that must, on both sides of the threshold.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from faulty_logs import (
    SOUND_TORQUE,
    TWO,
    as_part,
    at,
    cut,
    lossy,
    still,
    two_joints,
    wave,
    with_units,
)

from hesr_model.health.evidence import TorqueFit
from hesr_model.health.positions import (
    check_columns,
    check_jumps,
    check_limits,
    check_sliding,
    check_steps,
    check_time,
)
from hesr_model.health.referee import Estimate, Hypothesis, state
from hesr_model.health.timing import LagRows, _race_lag, _try_memory
from hesr_model.health.torque import check_raw_signals, check_speed, check_torque, compute_speeds
from hesr_model.health.velocity import check_velocity
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription

Spoil = Callable[[float], Iterable[Hypothesis]]
V = wave()
TURN = 2.0 * np.pi
RPM = 30.0 / np.pi


def leaping(by: float, *, step: float = 0.01) -> Log:
    """Shift the positions of the second joint after half of the rows."""
    log = two_joints()
    later = np.arange(len(log.t)) >= 500
    return replace(log, q=log.q + by * later[:, None] * [0.0, 1.0], t=log.t + (step - 0.01) * later)


def far_off(by: float) -> Log:
    log = two_joints()
    return replace(log, q=at(log.q, 500, 0, log.q[500, 0] + by))


def resting_but_once(by: float) -> Log:
    """The second joint rests but for a row, by a share of what the first one travels."""
    log = two_joints()
    q = log.q * [1.0, 0.0]
    return replace(log, q=at(q, 500, 1, by * np.ptp(q[:, 0])))


def rounded(step: float) -> Log:
    """Positions of the first joint, whose speed is at most 1, in steps of one height."""
    log = two_joints()
    return replace(log, q=at(log.q, slice(None), 0, step * np.round(log.q[:, 0] / step)))


def stairs(count: float) -> Log:
    """Positions of the first joint in some steps, each of which lasts for some rows."""
    log = two_joints()
    places = (np.arange(1000) // 7) % int(count)
    return replace(log, q=np.column_stack([0.01 * places, 0.0 * log.t]))


def even(rows: float) -> Log:
    """Positions of a constant speed, whose distances are equal, held for some rows each."""
    log = two_joints()
    return replace(log, q=np.column_stack([0.01 * (np.arange(1000) // int(rows)), 0.0 * log.t]))


def clipped(rows: float, run: float = 6) -> Log:
    """2000 rows with some at the largest torque, part of them in one run."""
    log = two_joints(2000)
    places = [*range(50, 50 + int(run)), *(100 + 4 * np.arange(int(rows) - int(run)))]
    return replace(log, tau=at(log.tau, places, 0, 9.0))


def repeated(rows: float) -> Log:
    """Every third row repeats the previous one, up to some row."""
    log = two_joints(1001)
    places = 3 * np.arange(int(rows)) + 1
    return replace(log, tau=at(log.tau, places, slice(None), log.tau[places - 1]))


def spiked(height: float) -> Log:
    log = two_joints()
    return replace(log, tau=at(log.tau, [499, 500, 501], 0, [0.0, height, 0.0]))


def moving_while_stuck(speed: float) -> Log:
    log = still(60)
    return replace(log, dq=np.full_like(log.q, speed))


def held(rows: float) -> Log:
    """Positions held for two or five rows in turn, and once for some rows, while it moves."""
    log = two_joints()
    lengths = [2, 5] * 60 + [int(rows)] + [2, 5] * 80
    places = np.repeat(np.arange(len(lengths)), lengths)[: len(log.t)]
    moving = np.ones_like(log.t)
    resting = np.zeros_like(log.t)
    return replace(
        log,
        q=np.column_stack([0.01 * places, resting]),
        dq=np.column_stack([0.3 * moving, resting]),
    )


def noisy(size: float) -> np.ndarray:
    return V + size * np.random.default_rng(3).normal(size=V.shape)


def against(v: np.ndarray, *, motion: np.ndarray = V, period: float = 0.01) -> list[Hypothesis]:
    """Findings on velocities `v` along a motion."""
    part = as_part(two_joints(len(motion), period), v=motion, dq=v)
    return list(check_velocity(part, TWO, ()))


def late(rows: float) -> list[Hypothesis]:
    period = 1.0 / 64.0
    v = wave(rate=2.0, late=rows * period, period=period)
    return against(v, motion=wave(rate=2.0, period=period), period=period)


LOGS: dict[str, tuple[str, Spoil, float, float]] = {
    "rows too close": ("time-unit", lambda x: check_time(two_joints(50, x), TWO), 6e-5, 4e-5),
    "rows too far apart": ("time-unit", lambda x: check_time(two_joints(50, x), TWO), 0.8, 1.0),
    "rows missing": ("missing-rows", lambda x: check_time(lossy(int(x)), TWO), 46, 56),
    "longer steps": ("missing-rows", lambda x: check_time(lossy(80, by=x), TWO), 1.7, 1.9),
    "a gap": ("gaps", lambda x: check_time(cut(breaks=(500,), by=x), TWO), 0.08, 0.1),
    "less than a turn": ("wrap", lambda x: check_jumps(leaping(x), TWO), 5.0, TURN),
    "more than a turn": ("wrap", lambda x: check_jumps(leaping(x), TWO), 7.5, TURN),
    "a turn in a gap": ("wrap", lambda x: check_jumps(leaping(TURN, step=x), TWO), 0.04, 0.02),
    "one position": ("spikes", lambda x: check_jumps(far_off(x), TWO), 0.0, 0.07),
    "one position of a resting joint": (
        "spikes", lambda x: check_jumps(resting_but_once(x), TWO), 0.009, 0.02,
    ),
    "height of steps": ("coarse", lambda x: check_steps(rounded(x), TWO), 1.1e-3, 1.5e-3),
    "count of steps": ("coarse", lambda x: check_steps(stairs(x), TWO), 18, 24),
    "rows of each step": ("coarse", lambda x: check_steps(even(x), TWO), 3, 12),
    "rows at the largest torque": (
        "saturation", lambda x: check_columns(as_part(clipped(x)), TWO), 18, 24,
    ),
    "rows at the largest torque in turn": (
        "saturation", lambda x: check_columns(as_part(clipped(40, x)), TWO), 4, 6,
    ),
    "torque of one row": ("torque-spikes", lambda x: check_raw_signals(spiked(x), TWO), 12.0, 17.0),
    "time without a new position": (
        "stuck", lambda x: check_raw_signals(still(20, period=x), TWO), 0.013, 0.017,
    ),
    "rows without a new position": (
        "stuck", lambda x: check_raw_signals(still(int(x), period=0.05), TWO), 13, 17,
    ),
    "rows held longer than the usual ones": (
        "stuck", lambda x: check_raw_signals(held(x), TWO), 39, 43,
    ),
    "speed at a constant position": (
        "stuck", lambda x: check_raw_signals(moving_while_stuck(x), TWO), 0.04, 0.06,
    ),
    "repeated torques": ("held-samples", lambda x: check_raw_signals(repeated(x), TWO), 290, 310),
    "slower than its velocity": ("velocity-scale", lambda x: against(x * V), 0.98, 0.96),
    "faster than its velocity": ("velocity-scale", lambda x: against(x * V), 1.02, 1.04),
    "another velocity": ("velocity-match", lambda x: against(noisy(x)), 0.3, 0.45),
    "velocities swapped under noise": (
        "velocity-columns", lambda x: against(noisy(x)[:, ::-1]), 0.45, 0.3,
    ),
    "late velocities": ("velocity-lag", late, 2, 3),
    "early velocities": ("velocity-lag", late, -2, -3),
}  # fmt: skip


def checks(hypotheses: Iterable[Hypothesis]) -> set[str]:
    """Checks of the hypotheses that win their trials."""
    return {finding.check for finding in state(hypotheses)}


@pytest.mark.parametrize("mistake", LOGS)
def test_a_mistake_in_a_log_is_reported_above_its_threshold(mistake: str) -> None:
    check, spoil, harmless, wrong = LOGS[mistake]
    assert check not in checks(spoil(harmless))
    assert check in checks(spoil(wrong))


ROBOT = """
<robot name="lift">
  <link name="base"/>
  <joint name="lift" type="prismatic">
    <parent link="base"/><child link="column"/><axis xyz="0 0 1"/>
    <limit lower="-0.5" upper="1.5" effort="2000" velocity="0.07"/>
  </joint>
  <link name="column"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="arm" type="revolute">
    <parent link="column"/><child link="forearm"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="100" velocity="1.5"/>
  </joint>
  <link name="forearm"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>
"""


@pytest.fixture
def model(tmp_path: Path) -> Robot:
    """A sliding and a turning joint with limits."""
    path = tmp_path / "lift.urdf"
    path.write_text(ROBOT, encoding="utf-8")
    return Robot(RobotDescription(name="lift", model=path, joints=("lift", "arm")))


def at_positions(extreme: float, joint: int) -> Callable[[Robot], Iterable[Hypothesis]]:
    q = np.linspace([-0.4, -1.0], [1.0, 1.0], 100)
    q[-1, joint] = extreme
    return lambda model: check_limits(as_part(replace(two_joints(100), q=q)), model)


def at_speeds(*peaks: float) -> Callable[[Robot], Iterable[Hypothesis]]:
    rising = np.linspace(-1.0, 0.7, 1001)[:, None]
    return lambda model: check_speed(as_part(two_joints(1001), v=peaks * rising), model)


LIMITS: dict[
    str, tuple[str, Callable[[float], Callable[[Robot], Iterable[Hypothesis]]], float, float]
]
LIMITS = {
    "position of the turning joint": ("limits", lambda x: at_positions(x, 1), 2.07, 2.09),
    "position of the sliding joint": ("limits", lambda x: at_positions(x, 0), 1.53, 1.55),
    "low position of the turning joint": ("limits", lambda x: at_positions(x, 1), -2.07, -2.09),
    "low position of the sliding joint": ("limits", lambda x: at_positions(x, 0), -0.53, -0.55),
    "speed of the sliding joint": ("speed-limit", lambda x: at_speeds(x, 1.0), 0.08, 0.11),
    "speed of the turning joint": ("speed-limit", lambda x: at_speeds(0.01, x), 1.8, 2.1),
}


@pytest.mark.parametrize("mistake", LIMITS)
def test_limits_of_a_model_are_compared_with_its_log(mistake: str, model: Robot) -> None:
    check, spoil, harmless, wrong = LIMITS[mistake]
    assert check not in checks(spoil(harmless)(model))
    assert check in checks(spoil(wrong)(model))


@pytest.mark.parametrize(
    ("length", "speed", "is_reported"),
    [(19.0, 0.1, False), (21.0, 0.1, True), (0.2, 4.3, False), (0.2, 4.6, True)],
)
def test_lengths_in_another_unit_are_reported(
    length: float, speed: float, is_reported: bool, model: Robot
) -> None:
    """A joint does not slide by ten widths of its limits, nor as after a fall of five strokes."""
    q = np.linspace([0.0, -1.0], [length, 1.0], 100)
    v = np.linspace([-speed, 0.0], [0.5 * speed, 1.0], 100)
    found = check_sliding(as_part(replace(two_joints(100), q=q), v=v), model)
    assert ("sliding-unit" in checks(found)) == is_reported


def of(value: float, error: float = 0.01) -> Estimate:
    return Estimate(value=value, error=error)


def fit(**changes: object) -> dict[int, TorqueFit]:
    return {1: replace(SOUND_TORQUE, **changes)}


UNSEEN = {"gravity": of(1.0, 1.0)}
"""Gravity that cannot be seen, so that inertia tells the scale."""

EXACT = {"friction": of(0.01), "residual": 0.1}
"""A torque that model and friction explain completely."""

TORQUES: dict[str, tuple[str, Callable[[float], dict[int, TorqueFit]], float, float]] = {
    "too small": ("torque-scale", lambda x: fit(gravity=of(x)), 0.3, 0.26),
    "too large": ("torque-scale", lambda x: fit(gravity=of(x)), 2.9, 3.2),
    "too small and turned": ("torque-scale", lambda x: fit(gravity=of(x)), -0.3, -0.26),
    "small but uncertain": ("torque-scale", lambda x: fit(gravity=of(0.2, x)), 0.03, 0.02),
    "large but uncertain": ("torque-scale", lambda x: fit(gravity=of(6.0, x)), 0.7, 0.5),
    "inertia too small": ("torque-scale", lambda x: fit(**UNSEEN, inertia=of(x)), 0.3, 0.26),
    "unexplained": ("torque-scale", lambda x: fit(gravity=of(0.1), residual=x), 2.4, 2.0),
    "hardly seen": (
        "torque-scale",
        lambda x: fit(gravity=of(x), gravity_size=0.01, residual=0.3), 9.0, 11.0,
    ),
    "friction drives, uncertain": (
        "torque-sign", lambda x: fit(friction=of(-1.0, x)), 0.22, 0.18,
    ),
    "friction drives, small": (
        "torque-sign", lambda x: fit(friction=of(-0.5), friction_size=x), 0.08, 0.1,
    ),
    "gravity turned, uncertain": ("gravity-sign", lambda x: fit(gravity=of(-1.0, x)), 0.22, 0.18),
    "gravity turned, small": (
        "gravity-sign", lambda x: fit(gravity=of(-1.0), gravity_size=x), 0.09, 0.11,
    ),
    "no signal": ("torque-signal", lambda x: fit(residual=x), 3.9, 4.2),
    "without friction": ("no-friction", lambda x: fit(**EXACT | {"friction": of(x)}), 0.06, 0.04),
    "driven without friction": (
        "no-friction", lambda x: fit(**EXACT | {"friction": of(x)}), -0.06, -0.04,
    ),
    "explained completely": ("no-friction", lambda x: fit(**EXACT | {"residual": x}), 0.55, 0.45),
}  # fmt: skip


def of_torque(model: Robot, fits: dict[int, TorqueFit], peak: float = 3.0) -> list[Hypothesis]:
    # In random order, so that no motion explains it.
    levels = np.random.default_rng(0).permutation(np.linspace(0.0, 1.0, 1001))
    tau = levels[:, None] * [60.0, peak]
    return list(check_torque(as_part(two_joints(1001), tau=tau), fits, model, ()))


@pytest.mark.parametrize("mistake", TORQUES)
def test_a_wrong_torque_is_reported_above_its_threshold(mistake: str, model: Robot) -> None:
    check, fits, harmless, wrong = TORQUES[mistake]
    assert checks(of_torque(model, fit())) == set()
    assert check not in checks(of_torque(model, fits(harmless)))
    assert check in checks(of_torque(model, fits(wrong)))


def test_torques_are_compared_with_the_limits_of_a_model(model: Robot) -> None:
    joints = {0: SOUND_TORQUE, 1: SOUND_TORQUE}
    assert "torque-limit" not in checks(of_torque(model, joints, 1000.0))
    assert "torque-limit" in checks(of_torque(model, joints, 1020.0))


def test_a_joint_uses_a_share_of_its_limit_as_the_others_do(
    arm_model: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thirtieth of the others' share, unless gravity or inertia have the size of the model's."""
    rising = np.linspace(0.0, 1.0, 1001)[:, None]
    zeros = np.zeros((1001, 3))
    log = Log(name="run", t=0.01 * np.arange(1001), q=zeros, dq=zeros, tau=zeros)
    of_friction = replace(SOUND_TORQUE, gravity=of(0.0, 1.0), inertia=of(0.0, 1.0))
    fits = dict.fromkeys(range(3), of_friction)
    limits = np.array([10.0, 20.0, 30.0])
    monkeypatch.setattr(Robot, "torque_limits", limits)
    for share, is_small in ((1 / 25, False), (1 / 35, True)):
        tau = rising * limits * [0.5 * share, 0.5, 0.5]
        found = check_torque(as_part(log, tau=tau), fits, arm_model, ())
        assert ("torque-small" in checks(found)) == is_small
        for column in ("gravity", "inertia"):
            light = {0: replace(of_friction, **{column: of(1.1)})}
            assert "torque-small" not in checks(
                check_torque(as_part(log, tau=tau), fits | light, arm_model, ())
            )


GEARED = with_units(TWO, gear_ratio=(7.0, 11.0))
CAUSES: dict[str, tuple[list[float], RobotDescription, float, dict[str, object]]] = {
    "rpm": ([RPM, RPM], TWO, 1.0, {"log.units.dq": "rpm"}),
    "rpm of one joint": ([1.0, RPM], TWO, 1.0, {"log.units.dq": ("rad/s", "rpm")}),
    "rpm of one joint, stated of the other": (
        [RPM, 1.0], with_units(TWO, dq=("rad/s", "rpm")), 1.0, {"log.units.dq": ("rpm", "rpm")},
    ),
    "rpm that count backwards": (
        [RPM, RPM], with_units(TWO, dq="-rad/s"), 1.0, {"log.units.dq": "-rpm"},
    ),
    "far positions in degrees": (
        [np.pi / 180.0] * 2, TWO, 60.0, {"log.units.q": "deg"},
    ),
    "velocities of motors": (
        [7.0, 11.0], GEARED, 1.0, {"log.units.dq": (pytest.approx(1 / 7, rel=1e-5), "rad/s")},
    ),
    "positions of motors": (
        [1 / 7, 1 / 11], GEARED, 1.0, {"log.units.q": (pytest.approx(1 / 7, rel=1e-5), "rad")},
    ),
    # Rows 10 ms apart cannot be 10 us apart.
    "a gear of 1000": ([1e3, 1e3], TWO, 1.0, {}),
    "time of another rate": ([2.0, 2.0], TWO, 1.0, {"log.units.t": pytest.approx(0.5, rel=0.01)}),
    "motors in rpm": (
        [7.0 * RPM, 11.0 * RPM], GEARED, 1.0,
        {"log.units.dq": (pytest.approx(1 / RPM / 7, rel=1e-5), "rad/s")},
    ),
    "a gear of 3": (
        [3.0, 1.0], TWO, 1.0, {"log.units.dq": (pytest.approx(1 / 3, rel=1e-5), "rad/s")},
    ),
    # Any large ratio is close to a whole number in some unit.
    "a gear of 100": ([100.0, 1.0], TWO, 1.0, {}),
    "a gear of 60": ([60.0, 1.0], TWO, 1.0, {}),
    # A stated unit leaves less to chance.
    "a gear of 60 before a motor in rpm": (
        [60.0, 1.0], with_units(TWO, dq="rpm"), 1.0,
        {"log.units.dq": (pytest.approx(1 / RPM / 60, rel=1e-5), "rpm")},
    ),
    "nothing known": ([3.3, 1.0], TWO, 1.0, {}),
}  # fmt: skip


@pytest.mark.parametrize("cause", CAUSES)
def test_the_cause_of_a_wrong_velocity_is_corrected(cause: str) -> None:
    factors, robot, travel, changes = CAUSES[cause]
    log = two_joints(len(V))
    part = replace(as_part(log, v=V, dq=V * factors), q=travel * log.q)
    findings = state(check_velocity(part, robot))
    found, *_ = (f for f in findings if f.check == "velocity-scale")
    assert dict(found.changes) == changes


def test_a_sliding_joint_is_offered_no_unit_of_a_motor() -> None:
    part = as_part(two_joints(len(V)), v=V, dq=V * [7.0 * RPM, 11.0 * RPM])
    findings = state(check_velocity(part, GEARED, slides=(True, True)))
    assert {finding.check for finding in findings} == {"velocity-scale"}
    assert [dict(finding.changes) for finding in findings] == [{}, {}]


@pytest.mark.parametrize(
    ("period", "around"), [(0.005, 10), (0.01, 5), (0.03, 2), (0.05, 1), (0.2, 1)]
)
def test_speeds_are_differences_over_a_tenth_of_a_second(period: float, around: int) -> None:
    log = two_joints(60, period)
    found = compute_speeds(replace(log, q=np.column_stack([log.t**3, log.t**2])))
    inner = slice(around, -around)
    # Central differences of a cube and a square.
    wide = (around * period) ** 2
    np.testing.assert_allclose(found[inner, 0], 3.0 * log.t[inner] ** 2 + wide, rtol=1e-9)
    np.testing.assert_allclose(found[:1, 1], log.t[around], rtol=1e-9)
    np.testing.assert_allclose(
        found[1, 1], log.t[1 + around] + log.t[max(1 - around, 0)], rtol=1e-9
    )
    np.testing.assert_allclose(found[-1, 1], log.t[-1] + log.t[-1 - around], rtol=1e-9)


def test_time_is_in_milliseconds_only_if_its_rate_is_plausible() -> None:
    for repetitions, changes in ((3, {"log.units.t": "ms"}), (1, {})):
        v = np.tile(V, (repetitions, 1))
        part = as_part(two_joints(len(v), 0.5), v=v, dq=1e3 * v)
        found, *_ = (f for f in state(check_velocity(part, TWO)) if f.check == "velocity-scale")
        # A log of half a second is rather one of a motor before a gear.
        assert dict(found.changes) == changes


def test_a_lag_is_neither_stated_nor_denied_of_a_joint_without_known_friction() -> None:
    rows = LagRows(
        torques=np.ones((60, 101, 1)),
        static=np.zeros((60, 1, 2)),
        inertial=np.zeros((60, 1, 2)),
        friction_shapes=(np.ones((60, 21)),),
        is_known=np.zeros((60, 1), dtype=bool),
    )
    lag = Estimate(value=0.1, error=0.001)
    for trial in (_race_lag(rows, 0, lag), *_try_memory(rows, 0, lag)):
        assert trial.outcome == "open"
