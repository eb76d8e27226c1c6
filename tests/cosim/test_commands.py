"""Commands as Python calls: same results as the command line."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plugin_packages import lay_package
from small_study import hesr_here

import hesr
from hesr_model.errors import HesrError
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.owner import Owner


@pytest.fixture
def file(arm: RobotDescription, arm_log: Log) -> Path:
    path = arm.model.with_name("run.csv")
    arm_log.write(path)
    return path


@pytest.mark.ci
def test_four_calls_lead_from_a_log_to_scores(arm: RobotDescription, file: Path) -> None:
    log = hesr.Log.read(str(file), robot=str(arm.model))
    body = hesr.identify(log)
    assert body.joints == arm.joints
    model = hesr.fit(log, law="stribeck", rigid_body=body)
    report = hesr.test(model, on=[str(file)], rigid_body=body, robot=str(arm.model))
    assert report.scores is not None
    assert report.scores.joints == arm.joints
    np.testing.assert_allclose(report.scores.zero_phase["stribeck"], model.training_rmse, rtol=1e-9)
    assert report.summary().startswith("Best: stribeck. Unexplained friction: j1 ")
    assert len(report.audits["stribeck"].certificates) == 3
    fmu = hesr.export(model, str(file.with_name("Friction.fmu")), platform=["linux64"])
    replayed = hesr.test(fmu, on=[log], rigid_body=body, kind=["prediction"]).scores
    assert replayed is not None
    np.testing.assert_allclose(replayed.zero_phase["Friction"], model.training_rmse, rtol=1e-6)
    header = hesr.export(model, file.with_name("friction.h"), format="c")
    assert header.read_text(encoding="utf-8")


@pytest.mark.ci
def test_results_of_calls_and_of_the_command_line_are_equal(
    arm: RobotDescription,
    file: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Includes the provenance."""
    run = hesr_here(capsys, monkeypatch)
    written = {name: file.with_name(f"{name}.json") for name in ("body", "again", "law", "other")}
    hesr.identify(str(file), robot=str(arm.model), output=written["body"])
    done = run("identify", file, "--robot", arm.model, "-o", written["again"])
    assert done.code == 0, done.err
    assert written["body"].read_bytes() == written["again"].read_bytes()
    body = written["body"]
    hesr.fit(file, law="stribeck", robot=arm.model, rigid_body=body, output=written["law"])
    done = run(
        "fit",
        file,
        "--law",
        "stribeck",
        "--robot",
        arm.model,
        "--rigid-body",
        body,
        "-o",
        written["other"],
    )
    assert done.code == 0, done.err
    assert written["law"].read_bytes() == written["other"].read_bytes()
    names = [one["name"] for one in FrictionModel.read(written["law"]).provenance["files"]]
    assert names == ["arm.xml", "body.json", "run.csv"]
    adapted = hesr.fit(file, prior=written["law"], robot=arm.model, rigid_body=body, seed=3)
    assert adapted.provenance["seed"] == 3
    assert [one["name"] for one in adapted.provenance["files"]] == names


def test_a_start_from_measured_torques_has_a_row_of_its_own(
    arm: RobotDescription, file: Path, table1: FrictionModel
) -> None:
    laws = tuple(replace(law, start_samples=5) for law in table1.laws)
    model = replace(table1, joints=arm.joints, laws=laws)
    body = hesr.identify(str(file), robot=str(arm.model))
    known = {"on": [str(file)], "rigid_body": body, "robot": str(arm.model)}
    scores = hesr.test({"own": model}, kind=["prediction"], **known).scores
    assert scores is not None
    assert list(scores.laws) == ["own", "own + start"]
    assert scores.laws["own"] != scores.laws["own + start"]


@pytest.mark.ci
def test_models_have_the_owner_of_their_robot(arm: RobotDescription, file: Path) -> None:
    owned = arm.model_copy(update={"owner": Owner(author="A", license="MIT")})
    for robot, owner in ((arm, {}), (owned, {"author": "A", "license": "MIT"})):
        model = hesr.fit(str(file), law="stribeck", robot=robot)
        assert Owner.from_provenance(model.provenance).known == owner


def test_a_log_is_inspected(arm: RobotDescription, file: Path) -> None:
    told: list[tuple[str, int, int]] = []
    found = hesr.inspect(str(file), robot=str(arm.model), progress=lambda *one: told.append(one))
    assert told == [("inspecting logs", 0, 1)]
    assert [log.name for log in found.proposal.logs] == ["run"]
    assert hesr.inspect([file]).proposal.description.joints == ("joint1", "joint2", "joint3")


def test_a_project_folder_is_created(arm: RobotDescription, tmp_path: Path) -> None:
    made = hesr.new(str(tmp_path / "mine"), str(arm.model))
    assert made.joints == arm.joints
    assert (tmp_path / "mine" / "study.toml").is_file()


def test_the_laws_are_listed() -> None:
    assert "lugre" in hesr.laws()


def test_unusable_arguments_are_refused(
    arm_log: Log, table1: FrictionModel, tmp_path: Path
) -> None:
    fleet = tmp_path / "fleet.toml"
    fleet.write_text("[types]\n", encoding="utf-8")
    for call, sentence in [
        (lambda: hesr.identify(arm_log), "logs do not name their robot"),
        (lambda: hesr.identify("a.csv"), "a.csv: give 'robot' to read this log"),
        (lambda: hesr.inspect(arm_log), "logs are inspected as files"),
        (lambda: hesr.export(table1, "a", format="x"), "'format' is x; allowed are adaptive, c"),
        (lambda: hesr.export(table1, tmp_path / "a.txt"), "a.txt"),
        (lambda: hesr.export(table1, "a", robot="r"), "'robot' needs 'format' isaaclab,"),
        (
            lambda: hesr.export(table1, "a", format="c", robot="r", rigid_body="b"),
            "'robot' needs 'format' isaaclab, mjcf-joint,",
        ),
        (
            lambda: hesr.export(table1, "a", stiffness=[1.0]),
            "'stiffness' needs 'format' drive, but the format is 'fmu'.",
        ),
        (lambda: hesr.test([table1, table1]), "is given twice."),
        (lambda: hesr.test(table1, kind=["no"]), "'kind' is no; allowed are prediction, passiv"),
        (lambda: hesr.check("a.fmu", kind=["no"]), "'kind' is no; allowed are static, references,"),
        (lambda: hesr.identify("a", method="no"), "'method' is no; allowed are stacked, paper."),
        (lambda: hesr.export(table1, "a", fmi=4), "'fmi' is 4; allowed are 2, 3."),
        (lambda: hesr.export("a.toml", "a", ssp="3"), "'ssp' is 3; allowed are 1.0, 2.0."),
        (
            lambda: hesr.excite("a", output="b", purpose="no"),
            "'purpose' is no; allowed are body, friction, test, all.",
        ),
        (lambda: hesr.excite("a", output="b.csv", purpose="all"), "a: no such model file."),
        (lambda: hesr.test(table1, kind=["prediction"]), "'kind' prediction needs 'on', a log."),
        (lambda: hesr.fit("a.csv", law="no"), "law 'no' is unknown"),
        (lambda: hesr.fit("a.csv", law="lugre", add=["x"]), "'add' is 'x'; there are temperature"),
        (lambda: hesr.fit("a.csv", law="law.json"), "'law' is fitted already (law.json); give"),
        (lambda: hesr.report(3), "'results' is given as int; expected a path"),
        (lambda: hesr.report("a", output="b.pdf"), "b.pdf: reports are .html, .md, .mp4, .webp."),
        (lambda: hesr.report("a", magnify=2.0), "are for 'view' and videos"),
        (lambda: hesr.report(["a", "b"]), "page (.html) shows one result"),
        (lambda: hesr.report(["a", "b"], view=True), "give one result; use 'law'"),
        (
            lambda: hesr.inspect("a.csv", payload=1.0),
            "'mass_error', 'loaded' and 'payload' need 'torque_constants'.",
        ),
        (
            lambda: hesr.simulate(fleet),
            f"{fleet}: this file is a fleet",
        ),
    ]:
        with pytest.raises(HesrError) as caught:
            call()
        assert sentence in str(caught.value)


MOVING_JOB = """
from pathlib import Path
from typing import Any

from cosim.workflow.answer import Answer, PluginJob


class Moved(Answer):
    format = "moved-1"

    def __init__(self, path, options):
        self.path, self.options = path, options

    def summary(self):
        return "moved"

    def result(self):
        return {}


JOB = PluginJob(verb="run", key="moving", run=lambda path, **options: Moved(path, options))
"""


@pytest.mark.parametrize("output", [None, "there"])
def test_a_job_of_another_package_gets_paths(
    output: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = {"hesr.jobs": {"moving": "moving_job:JOB"}}
    monkeypatch.syspath_prepend(lay_package(tmp_path, points, modules={"moving_job": MOVING_JOB}))
    file = tmp_path / "moving.toml"
    file.write_text("moving = 1\n", encoding="utf-8")
    answer: Any = hesr.run(str(file), output=output)
    assert answer.path == file
    assert answer.options["output"] == (output and Path(output))
    assert answer.options["measured"] == []
    assert not answer.options["platform"]
