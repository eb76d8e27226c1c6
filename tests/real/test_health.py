"""Measured logs pass the checks without false alarms, and mistakes in them are detected."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hesr_model.health.examine import examine
from hesr_model.health.proposal import inspect_logs, propose
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription

SHARED = Path(__file__).parents[2].parent / "shared" / "data"


def findings(robot: str, logs: list[Path]) -> list[tuple[str, tuple[str, ...]]]:
    """Checks with findings, and their joints."""
    if not all(log.is_file() for log in logs) or not logs:
        pytest.skip(f"measured logs are not next to the repository, in {SHARED}")
    description = RobotDescription.read(Path(__file__).with_name(robot))
    read = [Log.read(log, description) for log in logs]
    examination = examine(read, description, Robot(description))
    return [(finding.check, finding.joints) for finding in examination.findings]


def test_thirteen_logs_of_a_ur10e_are_sound() -> None:
    logs = sorted((SHARED / "ur10e").glob("*.csv"))
    assert len(logs) in (0, 13)
    assert findings("ur10e.toml", logs) == []


def test_a_panda_is_sound_despite_its_low_friction() -> None:
    assert findings("panda.toml", [SHARED / "panda" / "panda_first.csv"]) == []


def test_a_coupled_wrist_seen_from_the_motors_is_sound() -> None:
    assert findings("tx40.toml", [SHARED / "tx40" / "tx40_first.csv"]) == []


def test_only_the_last_wrist_joint_of_a_tiago_is_odd_for_lack_of_signal() -> None:
    """Of joint 6 three quarters are white noise, and most of the rest is friction."""
    found = findings("tiago.toml", [SHARED / "tiago_arm" / "tiago_excitation.csv"])
    assert found == [("torque-signal", ("arm_7_joint",))]


@pytest.mark.parametrize(("start", "stop"), [(9.0, 44.4), (44.4, 68.0)])
def test_accelerations_of_noise_tell_no_torque_constant(start: float, stop: float) -> None:
    """Nine tenths of a slow torso's acceleration are noise of its position."""
    path = SHARED / "tiago_arm" / "tiago_excitation.csv"
    if not path.is_file():
        pytest.skip(f"measured logs are not next to the repository, in {SHARED}")
    robot = Robot(Path(__file__).with_name("tiago.toml"))
    log = Log.read(path, robot)
    part = log.rows(np.flatnonzero((log.t >= start) & (log.t < stop)))
    checks = {finding.check for finding in examine([part], robot.description, robot).findings}
    assert checks == {"torque-signal"}


def test_backward_currents_of_a_tiago_are_found_from_its_urdf_alone() -> None:
    """The source of the log gives -8.7 N.m/A for joints 3 and 4; positions stay in the limits."""
    folder = SHARED / "tiago_arm"
    if not folder.is_dir():
        pytest.skip(f"measured logs are not next to the repository, in {SHARED}")
    found = inspect_logs([folder / "tiago_excitation.csv"], folder / "tiago_arm.urdf")
    gains = found.description.log.torque_per_ampere
    assert gains is not None
    assert [gain < 0.0 for gain in gains] == [False] * 3 + [True] * 2 + [False] * 3
    np.testing.assert_allclose(gains[3:5], [-8.7, -8.7], rtol=0.1)
    assert found.description.log.units.q == "rad"
    assert found.reasons["log.torque_per_ampere"].startswith("guess: ")
    checks = {finding.check for finding in found.examination.findings}
    assert checks == {"impossible-inertia", "torque-signal"}


@pytest.mark.parametrize(
    ("log", "checks"),
    [("id_fourier_20s_5harm", {"other-robot", "limits"}), ("test_ptp_10_points", {"limits"})],
)
def test_no_correction_makes_a_foreign_model_that_of_the_log(log: str, checks: set[str]) -> None:
    """Six joints of a UR10e with the model of a uf850; a moved zero would halve the errors."""
    path = SHARED / "ur10e" / f"{log}.csv"
    model = SHARED.parent / "robots" / "uf850.urdf"
    if not path.is_file() or not model.is_file():
        pytest.skip(f"measured logs are not next to the repository, in {SHARED}")
    logged = RobotDescription.read(Path(__file__).with_name("ur10e.toml")).log
    foreign = Robot(model).description.model_copy(update={"log": logged})
    proposal = propose([path], foreign, has_model=True)
    assert {finding.check for finding in proposal.examination.findings} == checks
    assert proposal.description.log.zero is None
    assert proposal.description.gravity == foreign.gravity
    assert not any(finding.changes for finding in proposal.examination.findings)


def one_torque_backwards(log: Log) -> Log:
    return replace(log, tau=log.tau * np.array([1, 1, -1, 1, 1, 1]))


def two_torques_swapped(log: Log) -> Log:
    return replace(log, tau=log.tau[:, [0, 2, 1, 3, 4, 5]])


def a_hundredth(log: Log) -> Log:
    return replace(log, tau=log.tau * np.array([1, 1, 0.01, 1, 1, 1]))


def amperes(log: Log) -> Log:
    return replace(log, tau=log.tau / np.array([11.976, 11.976, 9.839, 10.763, 10.763, 10.763]))


@pytest.mark.parametrize(
    ("mistake", "check", "joint"),
    [
        (one_torque_backwards, "torque-sign", "elbow_joint"),
        (two_torques_swapped, "torque-columns", "shoulder_lift_joint"),
        (a_hundredth, "torque-scale", "elbow_joint"),
        (amperes, "torque-scale", "wrist_1_joint"),
    ],
)
def test_mistakes_in_measured_logs_are_detected(
    mistake: Callable[[Log], Log],
    check: str,
    joint: str,
    id_logs: list[Log],
    ur10e_model: Robot,
) -> None:
    found = examine([mistake(id_logs[1])], ur10e_model.description, ur10e_model).findings
    assert any(f.check == check and joint in f.joints for f in found), found
