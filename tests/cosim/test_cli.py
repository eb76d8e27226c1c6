"""All commands of the command line, end to end on a small study of the digital twin."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from small_study import Hesr, Run, contents, hesr_here, uf850

from fmu_src.export.record import MEMBER
from hesr_model.fitting.estimator import registry, select_laws
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.files import sha256
from hesr_model.support.result_folder import LIST

ROBOT = uf850("robot.toml")
MEASURES = {"rmse", "rmse_reversal", "rmse_moving", "r2"}
JOINTS = ["joint1", "joint2", "joint3"]


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture(scope="module")
def ran(study_run: Run) -> Run:
    assert study_run.answer.code == 0, study_run.answer.err
    return study_run


def options(ran: Run) -> list[object]:
    return ["--robot", ROBOT, "--rigid-body", ran.rigid_body]


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def scored(path: Path) -> Any:
    """Scores in the JSON output of `hesr test`."""
    return read(path)["result"]["prediction"]


def on(*logs: Path) -> list[object]:
    return [part for log in logs for part in ("--on", log)]


def assert_scores(data: Any, laws: set[str]) -> None:
    """The format of section 7 of the design; further columns are allowed."""
    assert data["joints"] == JOINTS
    assert len(data["tau_std"]) == 3
    assert set(data["laws"]) >= laws
    for law, scores in data["laws"].items():
        assert set(scores) >= MEASURES
        for measure in MEASURES:
            assert len(scores[measure]) == 3
        if law not in ("none", "constant"):  # they explain nothing
            assert all(0.0 < e < s for e, s in zip(scores["rmse"], data["tau_std"], strict=True))
        for r2, e, s in zip(scores["r2"], scores["rmse"], data["tau_std"], strict=True):
            assert r2 == pytest.approx(1.0 - (e / s) ** 2, rel=1e-9)


# --- run --------------------------------------------------------------------------------------


def test_run_ends_with_a_table_of_laws_and_the_list_of_fmus(ran: Run) -> None:
    out = ran.answer.out
    report = f"Report: {ran.results / 'report.html'}"
    lines = out.splitlines()
    summary = lines[: lines.index(report) + 1]
    recommended = re.match(r"Recommended: (\S+) \(", summary[0])
    assert recommended
    assert Path(recommended[1]) in (ran.results / "fmus").iterdir()
    assert len(summary) <= 25
    for text in ("Stribeck", "ParFam-H", "J1", "J2", "J3", "unseen", "[N.m]"):
        assert text in out
    body = r"base parameters of 33\b[^;]* from excitation, excitation_reversed;"
    assert re.search(body, " ".join(out.split()))
    for law in ("stribeck", "parfam_h"):
        fmu = ran.results / "fmus" / f"{law}.fmu"
        assert str(fmu) in out.replace("\n", "")  # long paths are wrapped
        assert fmu.is_file()
    assert "Traceback" not in ran.answer.err


def test_run_writes_exactly_the_expected_files(ran: Run) -> None:
    names = set(contents(ran.results))
    logs = {f"logs/{n}.csv" for n in ("excitation", "excitation_reversed", "sweep", "trial")}
    laws = {"laws/stribeck.json", "laws/parfam_h.json"}
    fmus = {"fmus/stribeck.fmu", "fmus/parfam_h.fmu"}
    assert names >= {"rigid_body.json", "evaluation.json"} | logs | laws | fmus
    # No temporary folder is left here or next to the results.
    assert {name for name in names if "/." in f"/{name}"} == {LIST}
    assert {p.name for p in ran.results.parent.iterdir()} == {
        "results",
        "study.toml",
        "motions.toml",
    }


def test_run_scores_every_law_on_every_test_set(ran: Run) -> None:
    data = read(ran.results / "evaluation.json")
    assert list(data) == ["unseen"]
    assert_scores(data["unseen"], {*select_laws("baseline"), "stribeck", "parfam_h"})


def test_run_writes_valid_fmus(ran: Run) -> None:
    for law in ("stribeck", "parfam_h"):
        assert validate_fmu(str(ran.results / "fmus" / f"{law}.fmu")) == []


def test_results_state_their_provenance(ran: Run) -> None:
    source = FrictionModel.read(ran.law("parfam_h")).provenance
    assert source["seed"] == 3
    hashes = {entry["name"]: entry["sha256"] for entry in source["files"]}
    assert hashes["sweep.csv"] == sha256(ran.log("sweep"))
    assert hashes["robot.toml"] == sha256(ROBOT)
    assert "trial.csv" not in hashes
    body = {entry["name"] for entry in read(ran.rigid_body)["provenance"]["files"]}
    assert {"excitation.csv", "excitation_reversed.csv"} <= body


@pytest.mark.ci
def test_the_same_study_gives_the_same_bytes(ran: Run, study_run_for_programs: Run) -> None:
    again = study_run_for_programs
    assert again.answer.code == 0, again.answer.err
    one, other = contents(ran.results), contents(again.results)
    assert set(one) == set(other)
    assert [name for name in one if one[name] != other[name]] == []


@pytest.mark.ci
def test_the_default_output_is_below_the_current_folder(
    ran: Run, tmp_path: Path, hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On measured logs: those written by the twin."""
    study = tmp_path / "measured.toml"
    study.write_text(
        f"""
        name = "measured"
        robot = "{ROBOT}"
        laws = ["stribeck"]
        [logs]
        identification = ["{ran.log("excitation")}"]
        [logs.test]
        unseen = ["{ran.log("trial")}"]
        """,
        encoding="utf-8",
    )
    monkeypatch.chdir(tmp_path)
    answer = hesr("run", study)
    assert answer.code == 0, answer.err
    written = set(contents(tmp_path / "results" / "measured"))
    assert {"fmus/stribeck.fmu", "laws/stribeck.json", "evaluation.json"} <= written
    assert not any(name.startswith("logs/") for name in written)


# --- single steps ------------------------------------------------------------------------------


def test_identify_gives_the_rigid_body_of_the_run(ran: Run, tmp_path: Path, hesr: Hesr) -> None:
    output = tmp_path / "new" / "rigid_body.json"
    answer = hesr(
        *("identify", ran.log("excitation"), "--robot", ROBOT, "-o", output),
        *("--reversed", ran.log("excitation_reversed")),
    )
    assert answer.code == 0, answer.err
    assert "base parameters of 33" in answer.out
    assert str(output) in answer.out
    found, expected = RigidBody.read(output), RigidBody.read(ran.rigid_body)
    np.testing.assert_array_equal(found.parameters, expected.parameters)


def test_identify_supports_the_papers_method(ran: Run, tmp_path: Path, hesr: Hesr) -> None:
    output = tmp_path / "rigid_body.json"
    answer = hesr(
        *("identify", ran.log("excitation"), "--robot", ROBOT, "-o", output, "--method", "paper"),
        *("--reversed", ran.log("excitation_reversed")),
    )
    assert answer.code == 0, answer.err
    assert RigidBody.read(output).method == "paper"


def test_fit_gives_the_law_of_the_run(ran: Run, tmp_path: Path, hesr: Hesr) -> None:
    output = tmp_path / "law.json"
    answer = hesr(
        *("fit", ran.log("sweep"), *options(ran), "--law", "stribeck", "--seed", 3, "-o", output)
    )
    assert answer.code == 0, answer.err
    assert "stribeck for joint1, joint2, joint3" in answer.out
    laws, run_laws = (FrictionModel.read(path).laws for path in (output, ran.law("stribeck")))
    for law, run_law in zip(laws, run_laws, strict=True):
        # A run scales the band by errors on left-out rows, which a single fit has not.
        assert law.band != run_law.band
        assert replace(law, band=run_law.band) == run_law


def test_prediction_agrees_with_the_fmus_of_the_run(ran: Run, tmp_path: Path, hesr: Hesr) -> None:
    scores = tmp_path / "scores.json"
    answer = hesr(
        *("test", ran.law("stribeck"), ran.law("parfam_h"), "--on", ran.log("trial")),
        *(*options(ran), "--json", scores, "--verbose"),
    )
    assert answer.code == 0, answer.err
    assert "Stribeck" in answer.out
    data, expected = scored(scores), read(ran.results / "evaluation.json")["unseen"]
    assert_scores(data, {"stribeck", "parfam_h"})
    for law in ("stribeck", "parfam_h"):
        of_law = data["laws"][law]
        for measure in MEASURES:
            np.testing.assert_allclose(of_law[measure], expected["laws"][law][measure], rtol=1e-9)


def test_prediction_pools_the_rows_of_all_logs(ran: Run, tmp_path: Path, hesr: Hesr) -> None:
    def squares(*logs: str) -> np.ndarray:
        scores = tmp_path / "scores.json"
        files = [ran.log(log) for log in logs]
        assert (
            hesr("test", ran.law("stribeck"), *on(*files), *options(ran), "--json", scores).code
            == 0
        )
        rows = sum(len(path.read_text().splitlines()) - 1 for path in files)
        return rows * np.array(scored(scores)["laws"]["stribeck"]["rmse"]) ** 2

    together = squares("trial", "sweep")
    np.testing.assert_allclose(together, squares("trial") + squares("sweep"), rtol=1e-9)


@pytest.mark.ci
def test_predictions_of_one_law_are_named_after_the_model_files(
    ran: Run, tmp_path: Path, hesr: Hesr
) -> None:
    scores = tmp_path / "scores.json"
    first = ran.law("stribeck")

    def names(other: Path) -> set[str]:
        other.parent.mkdir(exist_ok=True)
        other.write_bytes(first.read_bytes())
        answer = hesr("test", first, other, *on(ran.log("trial")), *options(ran), "--json", scores)
        assert answer.code == 0, answer.err
        return set(scored(scores)["laws"])

    assert names(tmp_path / "other.json") == {"stribeck", "other"}
    # As left by two runs.
    same = tmp_path / "run2" / "stribeck.json"
    assert names(same) == {str(first), str(same)}


def test_prediction_reads_parquet(ran: Run, tmp_path: Path, hesr: Hesr) -> None:
    log = Log.read(ran.log("trial"), RobotDescription.read(ROBOT))
    log.write(tmp_path / "trial.parquet")
    results = []
    for path in (ran.log("trial"), tmp_path / "trial.parquet"):
        scores = tmp_path / "scores.json"
        answer = hesr("test", ran.law("stribeck"), *on(path), *options(ran), "--json", scores)
        assert answer.code == 0, answer.err
        results.append(scored(scores))
    assert results[0] == results[1]


def test_export_gives_the_fmu_of_the_run(ran: Run, tmp_path: Path, hesr: Hesr) -> None:
    output = tmp_path / "new" / "Friction.fmu"
    answer = hesr("export", ran.law("parfam_h"), "-o", output)
    assert answer.code == 0, answer.err
    assert str(output) in answer.out
    new, of_run = (members(fmu) for fmu in (output, ran.results / "fmus" / "parfam_h.fmu"))
    page, of_run_page = (m.pop("documentation/index.html").decode() for m in (new, of_run))
    records = [json.loads(m.pop(MEMBER)) for m in (new, of_run)]
    for record in records:
        del record["sha256"]["documentation/index.html"]
    assert records[0] == records[1]
    assert new == of_run
    assert 'id="properties"' in of_run_page  # the findings of the run are in the page of its FMU
    assert 'id="properties"' not in page


def members(fmu: Path) -> dict[str, bytes]:
    with ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_the_papers_model_is_exported_by_name_from_any_folder(
    tmp_path: Path, hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = hesr("export", "uf850-table1", "-o", "Friction.fmu")
    assert answer.code == 0, answer.err
    assert validate_fmu("Friction.fmu") == []
    assert [p.name for p in tmp_path.iterdir()] == ["Friction.fmu"]


def test_an_fmu_predicts_like_its_model(ran: Run, tmp_path: Path, hesr: Hesr) -> None:
    scores = tmp_path / "scores.json"
    fmu = ran.results / "fmus" / "parfam_h.fmu"
    answer = hesr("test", fmu, *on(ran.log("trial")), *options(ran), "--json", scores, "--verbose")
    assert answer.code == 0, answer.err
    assert "ParFam-H" in answer.out
    data, expected = scored(scores), read(ran.results / "evaluation.json")["unseen"]
    assert_scores(data, {"parfam_h"})
    for measure in MEASURES:
        np.testing.assert_allclose(
            data["laws"]["parfam_h"][measure], expected["laws"]["parfam_h"][measure], rtol=1e-12
        )


def test_laws_lists_the_registry(hesr: Hesr) -> None:
    answer = hesr("fit", "--list")
    assert answer.code == 0
    for name, entry in registry().items():
        assert name in answer.out
        assert entry.title in answer.out


def test_help_lists_every_command(hesr: Hesr) -> None:
    answer = hesr("--help")
    assert answer.code == 0
    commands = ("run", "identify", "fit", "test", "export", "check")
    for command in commands:
        assert command in answer.out
        assert hesr(command, "--help").code == 0


@pytest.mark.parametrize(
    "arguments", [["no-such-command"], ["fit"], ["run", "--no-such-option"], ["export", "x"]]
)
def test_wrong_usage_exits_with_2(hesr: Hesr, arguments: list[str]) -> None:
    answer = hesr(*arguments)
    assert answer.code == 2
    assert "Usage" in answer.err
    assert answer.out == ""
