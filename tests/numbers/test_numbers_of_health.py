"""Measurements of the checks on a sound and a faulty log, and the numbers of their advice."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from unchanged import Unchanged

from hesr_model.health.examine import examine
from hesr_model.health.proposal import propose, robot_file, summary_rows
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion, smooth
from hesr_model.robots.robot import Robot

MakeMotion = Callable[..., Motion]


def late(values: np.ndarray, rows: int) -> np.ndarray:
    return np.concatenate([np.repeat(values[:1], rows, axis=0), values[:-rows]])


def rates(log: Log) -> np.ndarray:
    assert log.dq is not None
    return log.dq


MISTAKES: dict[str, Callable[[Log], Log]] = {
    "none": lambda log: log,
    "degrees": lambda log: replace(log, q=log.q * 57.3),
    "motor": lambda log: replace(log, q=log.q * [1.0, 100.0, 1.0]),
    "motor's rates": lambda log: replace(log, dq=rates(log) * [1.0, 100.0, 50.0]),
    "rpm": lambda log: replace(log, dq=rates(log) * 9.55),
    "lag": lambda log: replace(log, dq=late(rates(log), 4)),
    "stamps": lambda log: replace(log, t=log.t * 1.3),
    "no rates": lambda log: replace(log, dq=None),
    "sign": lambda log: replace(log, tau=log.tau * [1.0, -1.0, 1.0]),
    "scale": lambda log: replace(log, tau=log.tau * [0.1, 1.0, 1.0]),
    "motor's torques": lambda log: replace(log, tau=log.tau / [100.0, 100.0, 50.0]),
    "noisy rates": lambda log: replace(
        log, dq=1.04 * rates(log) + np.random.default_rng(1).normal(0.0, 0.3, log.q.shape)
    ),
    "dropped rows": lambda log: log.rows(
        np.flatnonzero(np.random.default_rng(2).random(len(log.t)) < 0.7)
    ),
    "torque lag": lambda log: replace(log, tau=late(log.tau, 5)),
    "saturation": lambda log: replace(log, tau=np.clip(log.tau, -8.0, 8.0)),
    "zero": lambda log: replace(log, q=log.q + np.array([0.0, 0.6, 0.0])),
    "columns": lambda log: replace(log, tau=log.tau[:, [1, 0, 2]]),
    "joints": lambda log: replace(log, q=log.q[:, [0, 2, 1]], dq=rates(log)[:, [0, 2, 1]]),
    "held": lambda log: replace(log, tau=np.repeat(log.tau[::4], 4, axis=0)[: len(log.t)]),
    "coarse": lambda log: replace(log, q=np.round(log.q, 2)),
    "gap": lambda log: replace(
        log, t=log.t + 0.5 * (log.t > 5.0)
    ),
    "no friction": lambda log: replace(
        log, tau=log.tau - 0.8 * (np.sign(rates(log)) + 0.5 * rates(log))
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_findings(mistake: str, log: Log, arm_model: Robot, unchanged: Unchanged) -> None:
    robot = arm_model.description.model_copy(update={"gear_ratio": (100.0, 100.0, 50.0)})
    found = examine([MISTAKES[mistake](log)], robot, Robot(robot))
    about = sum(map(ord, "".join(f.check + "".join(f.joints) for f in found.findings)))
    unchanged(
        {
            "findings": len(found.findings),
            "about": about,
            "said": [f.sentence for f in found.findings],
            "explained": found.explained,
            "torques": found.torques,
        },
        rtol=1e-5,
    )


def test_a_smoothed_log(log: Log, unchanged: Unchanged) -> None:
    unchanged({str(cutoff): smooth(log, cutoff) for cutoff in (5.0, 15.0)})


def test_proposals(log: Log, arm_model: Robot, tmp_path: Path, unchanged: Unchanged) -> None:
    path = tmp_path / "run.csv"
    names = ["time", *(f"{x}_{k}" for x in ("angle_deg", "speed_degs", "amps") for k in (1, 2, 3))]
    columns = [log.t[:, None], np.rad2deg(log.q), np.rad2deg(rates(log)), log.tau / [9.0, 8.0, 7.0]]
    np.savetxt(path, np.hstack(columns), delimiter=",", header=",".join(names), comments="")
    found = propose([path], arm_model.description, known=False)
    text = robot_file(found, tmp_path / "robot.toml").replace(str(tmp_path), "")
    rows = [row[1:] for row in summary_rows(found)]
    unchanged({"rows": rows, "file": text, "columns": sum(map(ord, "".join(names)))}, rtol=1e-4)
