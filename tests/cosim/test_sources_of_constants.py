"""Sources of torque constants: in robot files, and in everything that a run writes."""

import json
import tomllib
from pathlib import Path
from zipfile import ZipFile

import pytest
from containing import OneSentence
from small_study import Hesr, hesr_here
from test_cli_constants import ROBOT, write

from hesr_model.errors import ArtifactError, ConfigError, RobotError
from hesr_model.health.proposal import apply_constants, propose, robot_file
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.torque_constants import TorqueConstant
from hesr_model.robots.description import statements
from hesr_model.robots.robot import RobotDescription

SOURCES = 'sources = { torque_per_ampere = ["guessed", "identified", "measured"] }\n'
SAID = {
    "j1": "Torque constant of j1 guessed: tau is proportional to it.",
    "j2": "Torque constant of j2 identified from known masses.",
    "j3": "Torque constant of j3 measured.",
}
UNKNOWN = "of j1, j2, j3 of unknown"
STUDY = """
name = "bench"
robot = "robot.toml"
laws = ["stribeck"]

[logs]
identification = ["run.csv"]
friction = ["run.csv"]

[logs.test]
late = ["late"]

[logs.parts]
late = { log = "run.csv", start = 5.0 }
"""


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.mark.ci
def test_sources_are_stated_wherever_a_result_is_shown(
    hesr: Hesr, tmp_path: Path, arm_log: Log
) -> None:
    robot, _ = write(tmp_path, arm_log)
    robot.write_text(SOURCES + ROBOT, encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    results, out = tmp_path / "results", tmp_path / "run.json"
    options = ("--quick", "--platform", "linux64", "--json", out)
    answer = hesr("run", tmp_path / "study.toml", "-o", results, *options)
    assert answer.code == 0, answer.err
    with ZipFile(results / "fmus" / "stribeck.fmu") as fmu:
        page, xml = (
            fmu.read(name).decode() for name in ("documentation/index.html", "modelDescription.xml")
        )
    report = (results / "report.html").read_text("utf-8")
    verdict = json.loads(out.read_text("utf-8"))["result"]["verdict"]
    assert verdict["constants"] == [*SAID.values()]
    for said in SAID.values():
        assert said in " ".join(answer.out.split())
        assert said in page
        assert said in report.split("Weaknesses and advice")[0]
    assert SAID["j1"] in xml
    assert SAID["j2"] not in xml
    law = json.loads((results / "laws" / "stribeck.json").read_text("utf-8"))
    assert [one["source"] for one in law["provenance"]["constants"]] == [
        "guessed",
        "identified",
        "measured",
    ]


def test_constants_without_a_source_are_called_unknown(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text(ROBOT, encoding="utf-8")
    robot = RobotDescription.read(tmp_path / "robot.toml")
    assert statements(robot.constants) == [OneSentence(UNKNOWN)]
    assert statements(robot.constants, "guessed") == []
    assert statements({}) == []
    with pytest.raises(ArtifactError, match="key 'joint' is missing"):
        statements({"constants": [{"name": "torque constant"}]})


@pytest.mark.parametrize(
    ("sources", "error", "said"),
    [
        ('"a guess"', ConfigError, "sources"),
        ('["guessed", "measured"]', RobotError, "has 2 entries; its 3 joints"),
    ],
)
def test_unusable_sources_are_refused(
    tmp_path: Path, sources: str, error: type[Exception], said: str
) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(f"sources = {{ torque_per_ampere = {sources} }}\n{ROBOT}", encoding="utf-8")
    with pytest.raises(error, match=said):
        RobotDescription.read(file)


def test_proposed_constants_are_guesses_until_identified(
    tmp_path: Path, arm_log: Log, arm: RobotDescription
) -> None:
    _, log = write(tmp_path, arm_log)
    proposal = propose([log], arm, has_model=True)
    assert tomllib.loads(robot_file(proposal, log))["sources"] == {"torque_per_ampere": "guessed"}
    # The second is not determined.
    found = [
        TorqueConstant(joint=joint, value=12.34567, error=0.1, determined=joint != "j2")
        for joint in arm.joints
    ]
    told = tomllib.loads(robot_file(apply_constants(proposal, found), log))
    assert told["sources"]["torque_per_ampere"] == ["identified", "guessed", "identified"]
    guesses = proposal.description.log.torque_per_ampere
    assert guesses
    assert told["log"]["torque_per_ampere"] == [12.35, guesses[1], 12.35]
