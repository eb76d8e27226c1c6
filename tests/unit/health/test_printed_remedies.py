"""Lines that findings print are lines of a robot file, and make their statements go away."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from printed_lines import execute, read_settings

from hesr_model.health.examine import examine
from hesr_model.health.joints import apply_changes
from hesr_model.health.proposal import robot_text
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.text import format_settings

Array = np.ndarray
DEGREE = np.pi / 180.0


def scale(values: Array | None, *factors: float) -> Array:
    assert values is not None
    return values * np.array(factors)


def swap(values: Array | None, *order: int) -> Array:
    assert values is not None
    return values[:, list(order)]


# Mistakes whose findings print lines, and the check of one of them.
MISTAKES: dict[str, tuple[Callable[[Log], Log], str]] = {
    "degrees": (lambda log: replace(log, q=log.q / DEGREE), "velocity-scale"),
    "degrees of both": (
        lambda log: replace(log, q=log.q / DEGREE, dq=scale(log.dq, *[1 / DEGREE] * 3)), "limits",
    ),
    "rpm": (lambda log: replace(log, dq=scale(log.dq, *[30 / np.pi] * 3)), "velocity-scale"),
    "rpm of one joint": (
        lambda log: replace(log, dq=scale(log.dq, 1.0, 30 / np.pi, 1.0)), "velocity-scale",
    ),
    "a velocity backwards": (
        lambda log: replace(log, dq=scale(log.dq, 1.0, 1.0, -1.0)), "velocity-sign",
    ),
    "swapped velocities": (
        lambda log: replace(log, dq=swap(log.dq, 0, 2, 1)), "velocity-columns",
    ),
    "no velocity": (lambda log: replace(log, dq=scale(log.dq, 0, 0, 0)), "velocity-constant"),
    "milliseconds": (lambda log: replace(log, t=1e3 * log.t), "time-unit"),
    "half the rate": (lambda log: replace(log, t=2.0 * log.t), "velocity-scale"),
    "a torque backwards": (
        lambda log: replace(log, tau=scale(log.tau, 1.0, -1.0, 1.0)), "torque-sign",
    ),
    "all torques backwards": (
        lambda log: replace(log, tau=-log.tau), "torque-sign",
    ),
    "a position backwards": (
        lambda log: replace(log, q=scale(log.q, 1, -1, 1), dq=scale(log.dq, 1, -1, 1)),
        "position-sign",
    ),
    "swapped torques": (
        lambda log: replace(log, tau=swap(log.tau, 0, 2, 1)), "torque-columns",
    ),
    "millinewtons": (lambda log: replace(log, tau=1e3 * log.tau), "torque-scale"),
    "another order": (
        lambda log: replace(
            log, q=swap(log.q, 2, 0, 1), dq=swap(log.dq, 2, 0, 1), tau=swap(log.tau, 2, 0, 1)
        ), "joint-order",
    ),
    "a zero off by a quarter": (
        lambda log: replace(log, q=log.q + np.array([0.0, 0.5 * np.pi, 0.0])), "zero",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_printed_lines_make_the_statement_go_away(
    mistake: str, make_motion: Callable[..., Motion], arm: RobotDescription, tmp_path: Path
) -> None:
    spoil, check = MISTAKES[mistake]
    motion = make_motion(name="run", friction=0.8)
    noise = np.random.default_rng(0).normal(0.0, 0.05, motion.tau.shape)
    log = Log(name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau + noise)
    path = tmp_path / "run.csv"
    spoil(log).write(path)
    robot_path = tmp_path / "robot.toml"
    arm = apply_changes(arm, {"log.sample_rate": None})
    text = robot_text(arm, robot_path, "A robot.")
    robot_path.write_text(text, encoding="utf-8")

    def find() -> dict[tuple[str, str], str]:
        robot = Robot(robot_path)
        findings = examine([Log.read(path, robot)], robot.description, robot).findings
        return {(f.check, joint): f.sentence for f in findings for joint in f.joints or ("",)}

    sentences = find()
    printed = {place: text for place, text in sentences.items() if "; set " in text}
    assert check in {place[0] for place in printed}, sentences
    for place, sentence in printed.items():
        robot_path.write_text(execute(text, sentence), encoding="utf-8")
        assert robot_path.read_text(encoding="utf-8") != text
        assert place not in find(), sentence
        robot_path.write_text(text, encoding="utf-8")


def test_settings_are_lines_of_toml() -> None:
    changes = {
        "log.units.q": ("deg", "it's", 0.5),
        "log.columns.dq": "",
        "gravity": (0.0, 0.0, -9.81),
        "log.sort": True,
    }
    text = format_settings(changes)
    assert text.startswith("[log.units] q = ['deg', \"it's\", 0.5], [log.columns] dq = ''")
    settings = {
        f"{table}.{key}".lstrip("."): value for table, key, value in read_settings(f"; set {text}")
    }
    assert settings["log.units.q"] == ["deg", "it's", 0.5]
    assert settings["gravity"] == [0.0, 0.0, -9.81]
