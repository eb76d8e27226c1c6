"""Logs of the twin with irregular stamps, pauses and resting joints: no refusal, no finding."""

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_twin import MOTIONS, fourier

from cosim.loop.excite import record_motions
from cosim.loop.motions import Motions
from fmu_src.arm.plant import Plant
from hesr_model.health.examine import examine
from hesr_model.health.proposal import inspect_logs
from hesr_model.health.timing import LagRows, find_lags
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

SEEDS = range(20)
WELL_KNOWN = {"sweep", "trial"}  # logs whose lags are known to 10 ms
_STEPS = (6, 17)  # rows of 5 ms between samples: 12 to 33 Hz

LONGER = (("period = 6.0", "period = 24.0"), ("length = 8.0", "length = 24.0"))


@pytest.fixture(scope="module")
def arm() -> Robot:
    return Robot(RobotDescription.read(models_folder() / "uf850" / "robot.toml"))


@pytest.fixture(scope="module")
def recorded() -> list[Log]:
    """Motions of the small twin at 200 Hz, and one whose last joint rests."""
    text = MOTIONS.replace("also_reversed = true\n", "")
    for old, new in LONGER:
        text = text.replace(old, new)
    resting = text.split("[[motions]]")[1].replace("excitation", "resting")
    text += "\n[[motions]]" + resting.replace("[1.0, 0.9, 1.0]", "[1.0, 0.9, 0.0]")
    return logs_of(text)


def logs_of(text: str) -> list[Log]:
    motions = Motions.model_validate(tomllib.loads(text))
    plant = Plant.read(models_folder() / "uf850" / "plant.toml")
    return [recording.log for recording in record_motions(motions, plant)]


def irregular(log: Log, seed: int) -> Log:
    """Some rows of a log, with a pause in two of three logs."""
    rng = np.random.default_rng(seed)
    rows = np.cumsum(rng.integers(*_STEPS, len(log.t) // _STEPS[0]))
    rows = rows[rows < len(log.t)]
    if seed % 3:
        start = rng.uniform(0.3, 0.6) * log.t[-1]
        rows = rows[(log.t[rows] < start) | (log.t[rows] > start + rng.uniform(0.2, 2.0))]
    return log.rows(rows)


def kinds(logs: list[Log]) -> Iterator[tuple[Log, int]]:
    for seed in SEEDS:
        yield irregular(logs[seed % len(logs)], seed), seed


@pytest.mark.ci
def test_twenty_irregular_logs_of_the_twin_are_sound(
    recorded: list[Log], arm: Robot, tmp_path: Path
) -> None:
    for log, seed in kinds(recorded):
        path = tmp_path / f"{log.name}{seed}.csv"
        log.write(path)
        found = inspect_logs([path], models_folder() / "uf850" / "robot.toml")
        known = ("gaps", "left-over")  # the twin's friction is damping of its actuators
        said = [f.sentence for f in found.examination.findings if f.check not in known]
        assert said == [], (log.name, seed)
        steps = np.diff(log.t)
        assert len(found.logs[0].gaps) == np.sum(steps > 10.0 * np.median(steps))
        assert set(found.reasons) <= {"log.filter_cutoff", "log.sample_rate", "locked"}, (
            found.reasons
        )


def test_an_irregular_log_of_the_twin_is_sound(recorded: list[Log], arm: Robot) -> None:
    description = arm.description.model_copy(
        update={"log": arm.description.log.model_copy(update={"filter_cutoff": 5.0})}
    )
    log = irregular(recorded[0], 0)
    assert examine([log], description, Robot(description)).findings == ()


def late_torques(log: Log, by: float) -> Log:
    return replace(log, tau=np.column_stack([np.interp(log.t - by, log.t, c) for c in log.tau.T]))


@pytest.mark.ci
@pytest.mark.parametrize("late", [0.0, 0.15])
def test_a_lag_is_reported_where_there_is_one(recorded: list[Log], arm: Robot, late: float) -> None:
    for log in recorded[:2]:
        told = examine([late_torques(log, late)], arm.description, arm).findings
        assert bool([f for f in told if f.check == "torque-lag"]) == bool(late)


@pytest.mark.ci
@pytest.mark.parametrize("late", [0.0, 0.01, 0.02, 0.035, 0.05])
def test_reported_lags_are_within_5_ms(recorded: list[Log], arm: Robot, late: float) -> None:
    base, known = base_columns(arm), []
    for log in recorded:
        found = find_lags(LagRows.from_log(late_torques(log, late), arm, base), range(arm.n))
        known += [(log.name, lag) for lag in found.values()]
        assert all(abs(lag.value - late) < min(0.005, 3.0 * lag.error) for lag in found.values())
    assert {name for name, _ in known} == (WELL_KNOWN if late else set())


FEW = fourier("few_harmonics", 1, 5, 20.0, "0.9, 0.8, 0.9")
MANY = fourier("many_harmonics", 7, 10, 20.0, "1.2, 1.0, 1.2")
LONG = fourier("long", 18, 12, 40.0, "1.2, 1.0, 1.2")
SLOW_AND_FAST = f"""{FEW}{MANY}{LONG}
[[motions]]
name = "chirp"
kind = "chirp"
first = 0.1
last = 1.0
length = 20.0
amplitude = [1.2, 1.2, 1.2]
start = [-1.1, -0.8, -3.0]
"""


@pytest.mark.ci
def test_lags_of_slow_and_fast_motions_are_within_5_ms(arm: Robot) -> None:
    """In a slow motion, the effect of memory is less certain than a small lag."""
    base, told = base_columns(arm), set()
    for log in logs_of(SLOW_AND_FAST):
        for late in (0.0, 0.01, 0.03, 0.05):
            found = find_lags(LagRows.from_log(late_torques(log, late), arm, base), range(arm.n))
            assert late or not found
            told |= {log.name} if found else set()
            for lag in found.values():
                assert abs(lag.value - late) < min(0.005, 3.0 * lag.error), (log.name, late)
    assert told == {"many_harmonics", "chirp"}
