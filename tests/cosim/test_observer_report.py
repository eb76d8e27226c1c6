"""Fold "External torque" of a run's report, and calibration on the run's left-out logs."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from observer_bench import MODELS, STEP, Push, arm, bench, moved, pushed, seeds_within
from small_study import hesr_here, uf850

from cosim.report.page import write_report
from cosim.report.results import Results
from cosim.study.results import read_torques
from hesr.extras.observer.chapter import external_torque, find_events
from hesr.extras.observer.observation import read_calibration_logs
from hesr_model.errors import LogError
from hesr_model.logs.tables import read_table, write_table
from hesr_model.robots.robot import Robot


@pytest.fixture
def copied(small_results: Path, tmp_path: Path) -> Path:
    unfinished = shutil.ignore_patterns(".hesr-*")  # of another test
    return Path(shutil.copytree(small_results, tmp_path / "copied", ignore=unfinished))


def push_trace(results: Path, size: float) -> str:
    """Add a push of 0.4 s to joint 2 in the saved torques of the last log; return its name."""
    log = [log for log in Results.read(results).run.logs if log.trace][-1]
    file = results / "traces" / log.trace
    columns = {name: values.copy() for name, values in read_torques(file).items()}
    t = columns["t"]
    columns["tau2"][(t > 2.0) & (t < 2.4)] += size
    write_table(file, {name: values.astype(np.float32) for name, values in columns.items()})
    return log.name


@pytest.mark.ci
def test_the_report_has_the_fold_if_a_log_has_events(copied: Path) -> None:
    assert external_torque(Results.read(copied)) is None
    assert "External torque" not in write_report(copied).read_text(encoding="utf-8")
    name = push_trace(copied, 60.0)
    page = write_report(copied).read_text(encoding="utf-8")
    assert "External torque" in page
    assert f"External torque on {name} behind a low pass of 15 Hz" in page
    table = read_table(copied / "tables" / "external_torque.csv")
    values = table.numbers([n for n in table.names if n not in ("log", "joint")])
    [[at, lasting, largest, threshold]] = values
    assert 2.0 <= at <= 2.06
    assert 0.35 <= lasting <= 0.45
    assert largest == pytest.approx(
        -60.0,  # not of the motor, which works against it
        abs=0.6 * threshold,
    )
    assert (copied / "figures" / "external.png").is_file()


def test_events_are_apart_and_of_one_joint() -> None:
    t = 0.01 * np.arange(1000)
    external, threshold = np.zeros((1000, 2)), np.full((1000, 2), 2.0)
    external[100:120, 0] = -5.0
    external[110, 0] = 0.0  # a pause of 10 ms belongs to the event
    external[300:310, 0] = 3.0
    external[200:210, 1] = 2.0  # not beyond
    external[205, 1] = 2.5
    assert find_events(t, external, threshold) == [
        (100, 119, 0, 100), (205, 205, 1, 205), (300, 309, 0, 300)
    ]  # fmt: skip


STUDY = """
name = "pushed"
robot = "{robot}"
laws = ["stribeck", "parfam_s"]

[logs]
identification = ["excitation.csv"]
reversed = ["excitation_reversed.csv"]
friction = ["sweep.csv"]
test.pushed = ["pushed.csv"]
test.free = ["free1.csv", "free2.csv", "free3.csv"]
"""


@pytest.mark.ci
def test_pushes_of_the_twin_are_in_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    hesr, own = hesr_here(capsys, monkeypatch), bench(tmp_path / "arm", None, "stribeck")
    events = [
        Push("motion", 0, 800, 60.0),
        Push("motion", 1, 2000, -70.0),
        Push("rest", 2, 5300, 40.0),
    ]
    first, *others = seeds_within(own, 4000, 4)
    with arm(own) as fmu:
        runs = {"pushed": moved(fmu, first, pushed(events, 6000))}
        runs |= {f"free{k}": moved(fmu, seed) for k, seed in enumerate(others, start=1)}
    logs = {name: replace(log, dq=dq) for name, (log, dq) in runs.items()}
    for name, log in {**own.logs, **logs}.items():
        log.write(tmp_path / f"{name}.csv")
    robot = MODELS / "uf850" / "robot.toml"
    study, results = tmp_path / "study.toml", tmp_path / "results"
    study.write_text(STUDY.format(robot=robot), encoding="utf-8")
    answer = hesr("run", study, "--platform", "linux64", "-o", results)
    assert answer.code == 0, answer.err
    found = external_torque(Results.read(results))
    assert found is not None
    rows = {
        (row.head, row.cells[0].text): [c.value for c in row.cells[1:]]
        for row in found["events"].rows
    }
    assert all(log == "pushed" for log, _ in rows)
    for one in events:
        at, lasting, largest, _ = rows["pushed", f"J{one.joint + 1}"]
        assert at == pytest.approx(STEP * one.row, abs=0.06)
        assert 0.2 < lasting < 0.45
        assert np.sign(largest) == np.sign(one.size)
        assert 0.7 < largest / one.size < 1.5
    # The free logs of the run, all left out of the fit, calibrate the observer.
    for name in ("pushed", "sweep"):
        (tmp_path / f"{name}.csv").rename(tmp_path / f"{name}_elsewhere.csv")
    law = results / "laws" / "parfam_s.json"
    options = ("--format", "observer", "--robot", robot)
    refused = hesr("export", law, *options, "--calibration", results, "-o", tmp_path / "O.fmu")
    assert refused.code == 2
    assert "its log 'pushed.csv'" in refused.err


def test_results_stand_for_their_left_out_logs(small_results: Path, copied: Path) -> None:
    robot = Robot(uf850("robot.toml"))
    run = json.loads((copied / "run.json").read_text(encoding="utf-8"))
    trained = {
        log["sha256"] for log in run["logs"] if {"identification", "training"} & {*log["roles"]}
    }
    expected = {log["name"] for log in run["logs"] if log["sha256"] not in trained}
    assert expected
    assert {log.name for log in read_calibration_logs([copied], robot)} == expected
    for log in run["logs"]:
        log["roles"] = [*log["roles"], "training"]
    (copied / "run.json").write_text(json.dumps(run), encoding="utf-8")
    with pytest.raises(LogError, match="log was left out"):
        read_calibration_logs([copied], robot)
