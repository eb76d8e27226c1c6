"""Torques without a sign and logs without a position are named, and nothing is built on them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rotor import describe_rotor, signals

from hesr_model.fitting.fit import fit_models
from hesr_model.health.examine import HealthError, check_laws, check_logs, examine
from hesr_model.health.joints import apply_changes
from hesr_model.health.omissions import doubt_one_speed
from hesr_model.logs.long_log import LongLog
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.robots.robot import Robot, RobotDescription

SIGNALS = signals(30.0)


def log_torque(tau: np.ndarray, q: np.ndarray | None = None) -> Log:
    q = SIGNALS["q"] if q is None else q
    dq = np.gradient(q, SIGNALS["t"])
    columns = (values[:, None] for values in (q, dq, tau))
    return Log(name="run", t=SIGNALS["t"], **dict(zip(("q", "dq", "tau"), columns, strict=True)))


def find_checks(log: Log, description: RobotDescription, *, has_model: bool = True) -> set[str]:
    robot = Robot(description) if has_model else None
    return {finding.check for finding in examine([log], description, robot).findings}


NOISE = 0.02 * np.random.default_rng(1).standard_normal(SIGNALS["t"].size)
PUSHED = 0.3 * np.tanh(SIGNALS["dq"] / 0.05) + NOISE
# Torque, and whether it has lost its sign.
TORQUES: dict[str, tuple[np.ndarray, bool]] = {
    "size": (np.abs(SIGNALS["tau"]), True),
    "size of a current that counts backwards": (-np.abs(SIGNALS["amperes"]), True),
    "size and noise": (np.abs(SIGNALS["tau"]) + 0.3 * NOISE, True),
    "size of Coulomb friction": (np.abs(PUSHED), True),
    "signed": (SIGNALS["tau"], False),
    "backwards": (-SIGNALS["tau"], False),
    "with a load that keeps its sign": (SIGNALS["tau"] + 2.0, False),
    "noise of one sign": (np.abs(SIGNALS["noise"]), False),
}


@pytest.mark.parametrize("case", TORQUES)
@pytest.mark.parametrize("has_model", [True, False])
def test_a_torque_without_a_sign_is_named(case: str, has_model: bool, tmp_path: Path) -> None:
    tau, is_unsigned = TORQUES[case]
    checks = find_checks(log_torque(tau), describe_rotor(tmp_path), has_model=has_model)
    assert ("torque-unsigned" in checks) == is_unsigned
    assert not (is_unsigned and checks & {"torque-sign", "torque-signal", "torque-scale"})


def test_motion_one_way_does_not_show_whether_a_torque_has_a_sign(tmp_path: Path) -> None:
    t = SIGNALS["t"]
    q = 2.0 * t + 0.3 * np.sin(t)
    tau = 0.3 + 0.02 * np.gradient(q, t) + NOISE
    assert "torque-unsigned" not in find_checks(log_torque(tau, q), describe_rotor(tmp_path))


def test_commands_replace_a_torque_without_a_sign(tmp_path: Path) -> None:
    log = log_torque(TORQUES["size"][0])
    log = replace(log, q_cmd=log.q + 0.01 * np.sign(np.gradient(log.q, axis=0)))
    description = describe_rotor(tmp_path)
    robot = Robot(description)
    [finding] = [
        finding
        for finding in examine([log], robot.description, robot).findings
        if finding.check == "torque-unsigned"
    ]
    assert finding.changes["log.columns.current_size"] == ("tau1",)
    assert "follows from commands" in finding.sentence


def test_a_torque_without_a_sign_is_refused_by_what_learns(tmp_path: Path) -> None:
    robot = Robot(describe_rotor(tmp_path))
    with pytest.raises(HealthError, match="no sign"):
        check_logs([log_torque(TORQUES["size"][0])], robot)


def write_speeds(path: Path) -> Path:
    table = np.column_stack([SIGNALS["t"], SIGNALS["dq"], SIGNALS["tau"]])
    np.savetxt(path, table, delimiter=",", header="t,dq1,tau1", comments="", fmt="%.12g")
    return path


def test_a_position_is_the_integral_of_its_velocity(tmp_path: Path) -> None:
    description = apply_changes(describe_rotor(tmp_path), {"log.columns.q": ""})
    path = write_speeds(tmp_path / "speeds.csv")
    log = Log.read(path, description)
    np.testing.assert_allclose(log.q[:, 0], SIGNALS["q"] - SIGNALS["q"][0], atol=2e-3)
    assert log.dq is not None
    (finding,) = examine([log], description, Robot(description)).findings
    assert (finding.check, finding.severity) == ("position-integral", "warning")
    pieces = LongLog(path, description, max_rows=300).checked_pieces
    rows = np.searchsorted(log.t, pieces[-1].t)
    np.testing.assert_allclose(pieces[-1].q, log.q[rows], atol=1e-9)


def test_a_start_that_gravity_depends_on_is_missed(tmp_path: Path) -> None:
    """A pendulum: its torque depends on the angle, which a velocity does not tell."""
    description = describe_rotor(tmp_path)
    text = description.model.read_text(encoding="utf-8")
    text = text.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 1 0"/>')
    text = text.replace("<inertial>", '<inertial><origin xyz="0.1 0 0"/>')
    description.model.write_text(text, encoding="utf-8")
    description = apply_changes(description, {"log.columns.q": "", "known": None})
    log = Log.read(write_speeds(tmp_path / "speeds.csv"), description)
    log = replace(
        log,
        tau=log.tau
        + Robot(description).torque(
            Robot(description).nominal_parameters, log.q, 0.0 * log.q, 0.0 * log.q
        ),
    )
    findings = examine([log], description, Robot(description)).findings
    assert ("position-integral", "error") in {(f.check, f.severity) for f in findings}


T = np.arange(0.0, 40.0, 1.0 / 200.0)
TURNS = 2.0 * np.pi * T
# Velocities, and whether they are one speed in each direction.
SPEEDS: dict[str, tuple[np.ndarray, bool]] = {
    "one reversal": (np.where(T < 20.0, 0.4, -0.4), True),
    "strokes": (np.where((T // 10.0) % 2 < 1, 0.4, -0.4), True),
    "one speed each way": (np.where((T // 10.0) % 2 < 1, 0.4, -0.5), True),
    "one way": (np.full_like(T, 0.4), True),
    "two speeds": (np.where((T // 10.0) % 2 < 1, 1.0, -1.0) * np.where(T < 20.0, 0.4, 0.5), False),
    "staircase": (np.sign(np.sin(TURNS / 20.0)) * (0.1 + 0.2 * (T // 10.0)), False),
    "sine": (0.4 * np.sin(0.5 * TURNS), False),
    "ramps": (np.clip(1.2 * np.sin(0.2 * TURNS), -0.4, 0.4), False),
    "rest": (np.zeros_like(T), False),
}


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e3])
@pytest.mark.parametrize("name", SPEEDS)
def test_one_speed_cannot_separate_coulomb_and_viscous_friction(name: str, size: float) -> None:
    velocity, is_one_speed = SPEEDS[name]
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(T))
    hypotheses = list(doubt_one_speed("a", "rad/s", [T], [size * (velocity + noise)], 0.04 * size))
    assert [hypothesis.outcome for hypothesis in hypotheses] == ["open"] * is_one_speed


def test_a_fit_says_that_one_speed_cannot_separate_them() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.02, len(T))
    records = []
    for name in ("strokes", "staircase"):
        dq = SPEEDS[name][0]
        tau = 0.3 * np.sign(dq) + 0.1 * dq + noise
        q = np.cumsum(dq) / 200.0
        zeros = np.zeros_like(T)
        records.append(
            FrictionRecord(log=name, joint="a", t=T, dq=dq, q=q, tau_load=zeros, tau=tau)
        )
    strokes, staircase = records
    for joint_records, is_one_speed in (([strokes], True), ([strokes, staircase], False)):
        models = fit_models(["coulomb_viscous"], [joint_records], robot="bench", seed=0)
        checks = [finding.check for finding in check_laws(models, [joint_records])]
        assert checks == ["one-speed"] * is_one_speed
