"""Error rates of the referee: false alarms on correct logs, and mistakes that it misses.

Tables are printed with `pytest -s`.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planted_mistakes import MISTAKES, can_tell
from sound_benches import BENCHES

from cosim.loop.excite import record_motions
from cosim.loop.motions import Motions
from fmu_src.arm.plant import Plant
from hesr_model.health.examine import Examination, examine
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

REAL = Path(__file__).parents[1] / "real"
DATA = Path(__file__).parents[2].parent / "shared" / "data"
SEEDS = range(8)
MAX_FALSE_WARNINGS = 3
MIN_FOUND = 0.95
MEASURED = {
    "ur10e": "ur10e/id_fourier_30s_12harm.csv",
    "tx40": "tx40/tx40_first.csv",
    "panda": "panda/panda_first.csv",
    "tiago": "tiago_arm/tiago_excitation.csv",
}
TELLING_BENCHES = ("pendulum", "500 Hz", "cylinder", "staircase", "one way", "noisy torque")


@pytest.mark.soak
def test_correct_logs_of_benches_raise_no_alarm(tmp_path: Path) -> None:
    alarms: Counter[str] = Counter()
    sentences = []
    for name, bench in BENCHES.items():
        robot = Robot(bench.write_description(tmp_path))
        for seed in SEEDS:
            for finding in examine(bench.record(seed), robot.description, robot).findings:
                alarms[finding.severity] += 1
                sentences.append(f"{name}, seed {seed}: {finding.check}: {finding.sentence}")
    print(*sentences, sep="\n")
    assert alarms["error"] == 0, sentences
    assert alarms["warning"] <= MAX_FALSE_WARNINGS, sentences


def read_sound_logs(folder: Path) -> Iterator[tuple[str, Log, Robot, int]]:
    """Yield correct logs with their robots, and a joint in which to plant mistakes."""
    for name, file in MEASURED.items():
        if (DATA / file).is_file():
            robot = Robot(RobotDescription.read(REAL / f"{name}.toml"))
            yield name, Log.read(DATA / file, robot.description), robot, 1
    twin = models_folder() / "uf850"
    robot = Robot(RobotDescription.read(twin / "robot.toml"))
    motions = Motions.read(models_folder() / "studies" / "uf850_motions.toml")
    for recorded in record_motions(motions, Plant.read(twin / "plant.toml")):
        if recorded.log.name == "excitation":
            yield "twin", recorded.log, robot, 1
    for name in TELLING_BENCHES:
        robot = Robot(BENCHES[name].write_description(folder))
        yield name, BENCHES[name].record(0)[0], robot, 0


@pytest.mark.soak
def test_planted_mistakes_are_found_where_the_data_can_tell(tmp_path: Path) -> None:
    missed = []
    cured = []
    found_count = 0
    for name, log, robot, j in read_sound_logs(tmp_path):
        before = {(f.check, f.joints) for f in examine([log], robot.description, robot).findings}
        for what, mistake in MISTAKES.items():
            if robot.n < mistake.joints:
                continue
            spoilt = mistake.plant(log, j, min(j + 1, robot.n - 1))
            unchanged = all(
                np.array_equal(getattr(log, key), getattr(spoilt, key)) for key in ("t", "q", "tau")
            )
            if unchanged and spoilt.dq is log.dq:
                continue
            examination = examine([replace(spoilt, name="run")], robot.description, robot)
            tells = can_tell(mistake, log, spoilt, j, robot)
            checks = {f.check for f in examination.findings if (f.check, f.joints) not in before}
            if tells and checks & set(mistake.checks):
                found_count += 1
            elif tells:
                missed.append(f"{name}: {what}: {_describe(examination)}")
            elif any(f.changes for f in examination.findings if f.check in checks):
                cured.append(f"{name}: {what}: {_describe(examination)}")
    share = found_count / (found_count + len(missed))
    print(f"found {found_count} of {found_count + len(missed)}", *missed, sep="\n")
    print("cured though nothing could tell:", *cured, sep="\n")
    assert share >= MIN_FOUND, missed


def _describe(examination: Examination) -> str:
    findings = [finding.check for finding in examination.findings]
    return f"{findings}, undecided {[finding.check for finding in examination.undecided]}"
