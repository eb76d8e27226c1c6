"""The usual speed at which joints rest decides no statement about a log."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from planted_mistakes import MISTAKES
from sound_benches import BENCHES

from hesr_model.health.examine import examine
from hesr_model.health.joints import apply_changes
from hesr_model.logs import rest
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription

FACTORS = (0.3, 3.0)
TELLING_BENCHES = ("pendulum", "cylinder", "one way")
TELLING_MISTAKES = ("dq backwards", "torque backwards")

Case = tuple[list[Log], RobotDescription]


def plant_mistake(bench: str, what: str, folder: Path) -> Case | None:
    """Return the log of a bench with a mistake; None if it has not enough joints."""
    robot = Robot(BENCHES[bench].write_description(folder))
    mistake = MISTAKES[what]
    if robot.n < mistake.joints:
        return None
    (log,) = BENCHES[bench].record(0)
    spoilt = replace(mistake.apply(log, 0, robot), name="run")
    description = robot.description
    if spoilt.dq is None:
        description = apply_changes(description, {"log.columns.dq": ""})
    return [spoilt], description


def list_cases(folder: Path) -> Iterator[Case]:
    """Yield correct logs of all benches, and all mistakes of some."""
    for bench in BENCHES.values():
        yield bench.record(0), bench.write_description(folder)
    for bench in (*TELLING_BENCHES, "500 Hz", "staircase", "noisy torque"):
        for what in MISTAKES:
            case = plant_mistake(bench, what, folder)
            if case:
                yield case


def require_same_statements(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    logs, description = case
    robot = Robot(description)
    usual_speed = rest.MOVING
    statements = []
    for factor in (1.0, *FACTORS):
        monkeypatch.setattr(rest, "MOVING", factor * usual_speed)
        findings = examine(logs, description, robot).findings
        statements.append(
            sorted((f.check, f.joints, f.severity, *sorted(f.changes)) for f in findings)
        )
    monkeypatch.setattr(rest, "MOVING", usual_speed)
    assert statements[1:] == [statements[0]] * len(FACTORS)


@pytest.mark.parametrize("what", TELLING_MISTAKES)
@pytest.mark.parametrize("bench", TELLING_BENCHES)
def test_statements_do_not_depend_on_the_usual_speed(
    bench: str, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = plant_mistake(bench, what, tmp_path)
    assert case
    require_same_statements(case, monkeypatch)


@pytest.mark.soak
def test_no_statement_depends_on_the_usual_speed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for case in list_cases(tmp_path):
        require_same_statements(case, monkeypatch)
