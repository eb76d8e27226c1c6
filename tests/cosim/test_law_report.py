"""Reports of `hesr.test`: which tests run, and summary, tables and JSON of their results."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from containing import Containing
from coulomb_slave import LEVEL, VISCOUS
from joint_data import law
from pythonfmu import FmuBuilder

import hesr
from cosim.report.tables.table import ResultTable
from cosim.workflow.test import LawReport, _describe_left_ranges, _scores_lines
from hesr_model.audit.properties import Subject
from hesr_model.errors import ArgumentError, ArtifactError
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.robots.robot import RobotDescription

COULOMB = {"F_c": 3.0, "F_s": 3.0, "v_s": 0.1, "sigma_2": 1.5, "tau_0": 0.0}
WIDE = TrainedRange(
    sample_time=0.005, dq=(-9.0, 9.0), q=(-9.0, 9.0), tau_load=(-99.0, 99.0), tau=(-9.0, 9.0)
)
SLOW = replace(WIDE, dq=(-0.1, 0.1))


def stribeck(*trained: TrainedRange, scale: float = 1.0) -> FrictionModel:
    """The friction of `arm_log` times a factor."""
    values = {name: value if name == "v_s" else scale * value for name, value in COULOMB.items()}
    return FrictionModel(
        law="stribeck",
        robot="arm",
        joints=("j1", "j2", "j3"),
        laws=(law("stribeck", {}, **values),) * 3,
        sample_time=0.005,
        trained=trained,
    )


@pytest.fixture
def file(arm: RobotDescription, arm_log: Log) -> Path:
    path = arm.model.with_name("run.csv")
    arm_log.write(path)
    return path


def test_inputs_beyond_the_trained_range_are_told() -> None:
    t = 0.005 * np.arange(400)
    dq, zero = np.sin(3.0 * t), np.zeros(400)
    records = [
        [FrictionRecord(log="a", joint=joint, t=t, dq=dq, q=t, tau_load=zero, tau=dq)]
        for joint in ("j1", "j2", "j3")
    ]
    own = Subject(name="own", model=stribeck(WIDE, SLOW, WIDE))
    (told,) = _describe_left_ranges(own, records)
    assert told.startswith("j2: dq leaves the trained range in ")
    assert "\n" not in told
    for other in (stribeck(WIDE, WIDE, WIDE), stribeck()):
        assert _describe_left_ranges(Subject(name="other", model=other), records) == []
    assert _describe_left_ranges(own, records[:2]) == []


def test_laws_are_compared_on_logs(arm: RobotDescription, file: Path) -> None:
    told: list[tuple[str, int, int]] = []
    body = hesr.identify(file, robot=arm, progress=lambda *one: told.append(one))
    assert {one[0]: one for one in reversed(told)}["identifying"] == ("identifying", 0, 1)
    told.clear()
    half = replace(stribeck(scale=0.5), robot="loader")
    laws = {"half": half, "own": stribeck(WIDE, SLOW, WIDE)}
    report = hesr.test(
        laws, on=[file], robot=arm, rigid_body=body, progress=lambda *one: told.append(one)
    )
    begun = {what: (done, total) for what, done, total in reversed(told)}
    assert begun == {"reading logs": (0, 1), "predicting": (0, 2), "simulating": (0, 1)}
    assert [one for one in told if one[0] == "predicting"][-1] == ("predicting", 2, 2)
    scores = report.scores
    assert scores is not None
    assert list(scores.laws) == ["half", "own"]
    assert all(np.less(scores.laws["own"].rmse, scores.laws["half"].rmse))
    percent = 100.0 * np.divide(scores.laws["own"].rmse, scores.tau_std)
    shares = ", ".join(f"j{k} {p:.0f} %" for k, p in enumerate(percent, start=1))
    lines = report.summary().splitlines()
    assert lines[0] == f"Best: own. Unexplained friction: {shares}."
    assert lines[-2:] == [f"{name}: passivity proven on j1, j2, j3." for name in laws]
    shown = report.tables()
    captions = [one.caption for one in shown if isinstance(one, ResultTable)]
    assert [one.partition(":")[0] for one in captions[:3]] == ["test"] * 3
    assert sum("position" in one for one in captions) == 1
    assert sum(one.startswith("Audit of") for one in captions) == 2
    texts = [one for one in shown if isinstance(one, str)]
    assert texts[0].startswith("'test': no motion occurs twice")
    assert [one.partition(":")[0] for one in texts[1:4]] == ["j1", "j2", "j3"]
    assert [one for one in texts if "leaves" in one] == [texts[-1]]
    assert texts[-1].startswith("j2: dq leaves the trained range in ")
    assert "\n" not in texts[-1]
    assert len(report.records) == 3
    data = report.result()
    assert set(data) == {"prediction", "replicates", "simulation", "passivity", "properties"}
    assert data["prediction"]["laws"]["own"]["rmse"] == list(scores.laws["own"].rmse)
    assert [one["verdict"] for one in data["passivity"]["own"]] == ["proven"] * 3
    (doubt,) = (finding for finding in report.findings if finding.check == "other-robot")
    assert "'loader'" in doubt.found
    assert data["simulation"]["joints"] == ["j1", "j2", "j3"]
    assert report.passed


def test_a_foreign_fmu_is_scored_on_logs(arm: RobotDescription, file: Path, tmp_path: Path) -> None:
    """An FMU of another exporter, which knows no law of HESR, scores as its formula does."""
    slave = FmuBuilder.build_FMU(Path(__file__).with_name("coulomb_slave.py"), dest=tmp_path)
    body = hesr.identify(file, robot=arm)
    report = hesr.test([slave], on=[file], robot=arm, rigid_body=body)
    assert report.scores is not None
    for joint, ((record,), (level, viscous)) in enumerate(
        zip(report.records, zip(LEVEL, VISCOUS, strict=True), strict=True)
    ):
        coulomb = level + 0.001 * np.abs(record.tau_load)
        tau = coulomb * np.tanh(record.dq / 0.02) + viscous * record.dq
        rmse = np.sqrt(np.mean(np.square(record.tau - tau)))
        assert report.scores.zero_phase["Coulomb"][joint] == pytest.approx(rmse, rel=1e-9)
    assert report.summary().startswith("Best: Coulomb.")


def test_without_logs_only_passivity_is_tested(table1: FrictionModel) -> None:
    report = hesr.test(table1)
    assert report.scores is report.positions is None
    summary = report.summary()
    assert summary.startswith("parfam_h: passivity refuted on joint1, joint2; ")
    assert "; tested on 816 sequences " in summary
    assert summary.endswith(" on joint3.")
    (finding,) = report.findings
    assert (finding.check, finding.where) == ("passivity", "parfam_h")
    assert finding.joints == ("joint1", "joint2")
    assert not report.passed
    assert report.result()["prediction"] is None
    tables = [one for one in report.tables() if isinstance(one, ResultTable)]
    assert [one.caption.partition(" of ")[0] for one in tables] == ["Audit"]


def test_physics_checks_of_one_law(tmp_path: Path) -> None:
    file = tmp_path / "found.json"
    model = replace(stribeck(), joints=("j1",), laws=stribeck().laws[:1])
    report = hesr.test({"own": model}, kind=["properties"], inertia=0.7, output=str(file))
    assert (report.audits, report.scores, report.files) == ({}, None, (file,))
    (joint,) = report.properties["own"].joints
    assert joint.inertia == 0.7
    failed = report.properties["own"].failed
    assert failed
    listed = "; ".join(f"{title} (J1)" for title in failed)
    assert report.summary() == f"own: fails {listed}.\nWritten: {file}"
    passing = replace(report.properties["own"], joints=())
    passed = replace(report, properties={"own": passing}, files=())
    assert passed.summary() == "own: passes all physics checks that apply."
    captions = [one.caption for one in report.tables() if isinstance(one, ResultTable)]
    assert captions[0].startswith("Physics checks by law")
    assert captions[1:] == ["", "Why"]
    assert list(report.result()["properties"]) == ["own"]


def test_missing_arguments_of_a_test_are_reported(table1: FrictionModel, tmp_path: Path) -> None:
    for arguments, error, sentence in (
        ({"load": float("nan")}, ArgumentError, "'load' is nan; expected a number."),
        ({"on": ["a.csv"]}, ArgumentError, "prediction needs 'rigid_body', the"),
        ({"kind": "prediction", "rigid_body": "b"}, ArgumentError, "needs 'on', a log."),
        ({"kind": "no"}, ArgumentError, "'kind' is no; allowed are prediction, passivity, prop"),
    ):
        with pytest.raises(error) as caught:
            hesr.test(table1, **arguments)
        assert sentence in str(caught.value)
    with pytest.raises(ArtifactError, match=r"Foreign\.fmu: no such file"):
        hesr.test(tmp_path / "Foreign.fmu", trust=True)
    empty = LawReport(laws=())
    assert (empty.summary(), empty.tables(), empty.passed) == ("", [], True)


def test_the_best_law_has_the_lowest_errors_of_all_joints() -> None:
    from cosim.study.scores import Comparison, LawScores, Ratios, Unseparated

    def errors(*rmse: float) -> LawScores:
        return LawScores(rmse=rmse, rmse_reversal=rmse, rmse_moving=rmse, r2=rmse)

    scores = Comparison(
        joints=("a", "b"),
        tau_std=(10.0, 1.0),
        laws={"x": errors(1.0, 0.5), "y": errors(3.0, 0.2)},
        ratios=Ratios(reference="x", laws={}),
        leading=(("x", "y"), ("y",)),
        detectable=({"y": 1.3}, {"x": 1.2}),
        seconds=(30.0, 10.0),
        unseparated=(
            {"y": Unseparated(laws=("x",), better=(), detectable=(1.3, 1.3), seconds=30.0)},
            {"y": Unseparated(laws=(), better=(), detectable=(1.2, 1.2), seconds=10.0)},
        ),
    )
    assert _scores_lines(scores) == [
        "Best: y. Unexplained friction: a 30 %, b 20 %.",
        Containing("1 law on J1; it would show 30 %"),
        Containing("find 10 %, record tests of about 30"),
    ]
