"""Error rates of the referee: false alarms on correct logs, and mistakes that it misses.

Tables are printed with `pytest -s`.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
import pytest
from planted_mistakes import MISTAKES, can_tell, to_columns
from sound_benches import BENCHES

from cosim.loop.excite import record_motions
from cosim.loop.motions import Motions
from fmu_src.arm.plant import Plant
from hesr_model.health.evidence import ModelTorques, smooth_parts
from hesr_model.health.examine import Examination, examine
from hesr_model.health.joints import apply_changes
from hesr_model.health.proposal import propose
from hesr_model.logs.log_format import column_names
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

Array = np.ndarray
REAL = Path(__file__).parents[1] / "real"
DATA = Path(__file__).parents[2].parent / "shared" / "data"
SEEDS = range(8)
MAX_FALSE_WARNINGS = 3
MIN_FOUND = 0.95
MIN_RIGHT = 0.95  # share of cures
MAX_CURE_ERROR = 0.01  # of a signal, over its range: an estimated rate is no round number
MEASURED = {
    "ur10e": "ur10e/id_fourier_30s_12harm.csv",
    "tx40": "tx40/tx40_first.csv",
    "panda": "panda/panda_first.csv",
    "tiago": "tiago_arm/tiago_excitation.csv",
}
SOURCES = ("benches", "twin", *MEASURED)
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


def read_sound_logs(folder: Path, source: str) -> Iterator[tuple[str, Log, Robot, int]]:
    """Yield correct logs with their robots, and a joint in which to plant mistakes."""
    if source in MEASURED:
        if (DATA / MEASURED[source]).is_file():
            robot = Robot(RobotDescription.read(REAL / f"{source}.toml"))
            yield source, Log.read(DATA / MEASURED[source], robot.description), robot, 1
    elif source == "twin":
        twin = models_folder() / "uf850"
        robot = Robot(RobotDescription.read(twin / "robot.toml"))
        motions = Motions.read(models_folder() / "studies" / "uf850_motions.toml")
        for recorded in record_motions(motions, Plant.read(twin / "plant.toml")):
            if recorded.log.name == "excitation":
                yield "twin", recorded.log, robot, 1
    else:
        for name in TELLING_BENCHES:
            robot = Robot(BENCHES[name].write_description(folder))
            yield name, BENCHES[name].record(0)[0], robot, 0


@dataclass
class Outcomes:
    """What became of planted mistakes, as sentences by outcome."""

    found: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    undone: list[str] = field(default_factory=list)
    equivalent: list[str] = field(default_factory=list)
    wrongly_cured: list[str] = field(default_factory=list)
    cured_untold: list[str] = field(default_factory=list)

    def add(self, other: "Outcomes") -> None:
        """Add the sentences of other outcomes."""
        for outcome in fields(self):
            getattr(self, outcome.name).extend(getattr(other, outcome.name))

    def print(self) -> None:
        """Print counts, and all but what was found and undone."""
        for outcome in fields(self):
            sentences = getattr(self, outcome.name)
            print(f"{outcome.name}: {len(sentences)}")
            if outcome.name not in ("found", "undone"):
                print(*(f"  {sentence}" for sentence in sentences), sep="\n")


@pytest.mark.soak
def test_planted_mistakes_are_found_and_cured_where_the_data_can_tell(tmp_path: Path) -> None:
    """The shares are those of all logs; each alone has too few cures."""
    outcomes = Outcomes()
    for source in SOURCES:
        print(f"-- {source}")
        source_outcomes = _plant_mistakes(source, tmp_path)
        source_outcomes.print()
        outcomes.add(source_outcomes)
    print("-- all")
    outcomes.print()
    found_count = len(outcomes.found)
    cured_count = len(outcomes.undone) + len(outcomes.equivalent) + len(outcomes.wrongly_cured)
    assert found_count >= MIN_FOUND * (found_count + len(outcomes.missed)), outcomes.missed
    assert len(outcomes.wrongly_cured) <= (1.0 - MIN_RIGHT) * cured_count, outcomes.wrongly_cured
    assert outcomes.cured_untold == [], "the data cannot tell, but a cure was made"


def _plant_mistakes(source: str, folder: Path) -> Outcomes:
    outcomes = Outcomes()
    for name, log, robot, j in read_sound_logs(folder, source):
        before = {(f.check, f.joints) for f in examine([log], robot.description, robot).findings}
        for what, mistake in MISTAKES.items():
            if robot.n < mistake.joints:
                continue
            spoilt = mistake.apply(log, j, robot)
            if not _is_changed(log, spoilt):
                continue
            title = f"{name}: {what}"
            tells = can_tell(mistake, log, spoilt, j, robot)
            description = robot.description
            if spoilt.dq is None:
                description = apply_changes(description, {"log.columns.dq": ""})
            examination = examine([replace(spoilt, name="run")], description, robot)
            checks = {f.check for f in examination.findings if (f.check, f.joints) not in before}
            if tells and checks & set(mistake.checks):
                outcomes.found.append(title)
            elif tells:
                outcomes.missed.append(f"{title}: {_describe(examination)}")
            if not any(finding.changes for finding in examination.findings):
                continue
            path = folder / "run.csv"
            write_columns(path, spoilt, description)
            cured_description = propose([path], description, has_model=True).description
            changes = find_changes(description, cured_description)
            if changes:
                cured = Log.read(path, cured_description)
                sentence = f"{title}: {changes}"
                if not tells:
                    outcomes.cured_untold.append(sentence)
                if _is_undone(log, cured, robot, cured_description):
                    outcomes.undone.append(sentence)
                elif _is_equivalent(log, cured, robot, Robot(cured_description)):
                    outcomes.equivalent.append(sentence)
                else:
                    outcomes.wrongly_cured.append(sentence)
    return outcomes


def _describe(examination: Examination) -> str:
    findings = [finding.check for finding in examination.findings]
    return f"{findings}, undecided {[finding.check for finding in examination.undecided]}"


def _is_changed(log: Log, spoilt: Log) -> bool:
    keys = ("t", "q", "tau")
    has_same_rows = len(log.t) == len(spoilt.t)
    is_same = has_same_rows and all(
        np.allclose(getattr(log, key), getattr(spoilt, key), rtol=1e-9, atol=0.0) for key in keys
    )
    if log.dq is None or spoilt.dq is None:
        return not is_same or log.dq is not spoilt.dq
    return not (is_same and np.allclose(log.dq, spoilt.dq, rtol=1e-9, atol=0.0))


def write_columns(path: Path, log: Log, description: RobotDescription) -> None:
    """Write a log as a table with the columns and units that a robot file states."""
    raw = to_columns(log, description)
    log_columns = description.log.columns
    effort = "tau" if description.log.torque_per_ampere is None else "current"
    table = {log_columns.time_name: raw.t / description.log.units.factors("t", 1)[0]}
    for key, values in (("q", raw.q), ("dq", raw.dq), (effort, raw.tau)):
        if values is not None and getattr(log_columns, key):
            names = column_names(getattr(log_columns, key), description.joints)
            table |= dict(zip(names, values.T, strict=True))
    rows = np.column_stack(list(table.values()))
    np.savetxt(path, rows, "%.17g", ",", header=",".join(table), comments="")


def find_changes(before: RobotDescription, after: RobotDescription) -> dict[str, object]:
    """Return the values by key of a robot file that a proposal changed to mend a log."""
    changes: dict[str, object] = {}
    tables = [("", before.model_dump(), after.model_dump())]
    while tables:
        prefix, old, new = tables.pop()
        for key, value in new.items():
            if isinstance(value, dict) and isinstance(old.get(key), dict):
                tables.append((f"{prefix}{key}.", old[key], value))
            elif value != old.get(key):
                changes[f"{prefix}{key}"] = value
    changes.pop("log.filter_cutoff", None)
    return changes


def _is_undone(log: Log, cured: Log, robot: Robot, description: RobotDescription) -> bool:
    """Return whether a log, as a cured robot file reads it, is the one without the mistake."""
    signals = [(log.t - log.t[0], cured.t - cured.t[0]), (log.q, cured.q), (log.tau, cured.tau)]
    if log.dq is not None and cured.dq is not None:
        signals.append((log.dq, cured.dq))
    return (
        len(log.t) == len(cured.t)
        and description.gravity == robot.description.gravity
        and all(_are_alike(*pair) for pair in signals)
    )


def _are_alike(values: Array, cured_values: Array) -> bool:
    errors = np.max(np.abs(values - cured_values), axis=0)
    return bool(np.all(errors <= MAX_CURE_ERROR * np.ptp(values, axis=0)))


def _is_equivalent(log: Log, cured: Log, robot: Robot, cured_robot: Robot) -> bool:
    """Return whether nothing in a log and its model can tell a cured reading from the right one.

    The model then has the same torques, and those of a joint whose axis has no direction that
    matters, as a vertical one, may all be reversed.
    """
    if robot.n != cured_robot.n or len(log.t) != len(cured.t):
        return False
    readings = []
    for each, each_robot in ((log, robot), (cured, cured_robot)):
        (part,) = smooth_parts(replace(each, dq=None), each_robot.description.log.filter_cutoff)
        torques = ModelTorques.from_motion(each_robot, part.q, part.v, part.a)
        readings.append((part.v, part.tau, torques.gravity, torques.inertial))
    # Gravity of a vertical axis is round-off.
    sizes = [max(float(np.ptp(values)), 1e-9 * float(np.ptp(log.tau))) for values in readings[0]]
    for j in range(robot.n):
        signs = [
            sign
            for sign in (1.0, -1.0)
            if all(
                np.max(np.abs(right[:, j] - sign * cured_values[:, j])) <= MAX_CURE_ERROR * size
                for right, cured_values, size in zip(*readings, sizes, strict=True)
            )
        ]
        if not signs:
            return False
    return True
