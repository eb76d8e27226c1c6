"""Gaps in the excitation are listed joint by joint."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hesr_model.health.examine import examine, find_unseen_effects
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.robots.robot import Robot


def words(log: Log, model: Robot) -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for joint, what in find_unseen_effects(examine([log], model.description, model), log.joints):
        found.setdefault(joint, set()).add(what.split(":")[0])
    return found


def test_missing_excitation_is_reported(
    make_motion: Callable[..., Motion], arm_model: Robot
) -> None:
    motion = make_motion(name="run", friction=0.8)
    noise = np.random.default_rng(0).normal(0.0, 0.05, motion.tau.shape)
    tau = motion.tau + noise
    log = Log(
        name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=tau, robot=arm_model.description
    )
    whole = words(log, arm_model)
    # The axis of the first joint is vertical.
    assert "no gravity torque" in whole["j1"]
    assert "no gravity torque" not in whole.get("j2", set())
    assert all("fewer than 4 reversals" not in said for said in whole.values())
    q = log.q.copy()
    q[:, 1] = 0.3
    still = replace(log, q=q, dq=None)
    (sentence,) = words(still, arm_model)["j2"]
    assert sentence.startswith("it does not move")
    brief = words(log.rows(slice(0, 250)), arm_model)
    assert "fewer than 4 reversals" in brief["j1"]
