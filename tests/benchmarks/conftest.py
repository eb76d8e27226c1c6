"""Shared parts of the benchmarks."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cosim.study.run import run_study
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

STUDY = """
name = "sweep"
robot = "{models}/uf850/robot.toml"
laws = ["stribeck"]
[twin]
plant = "{models}/uf850/plant.toml"
motions = "{models}/studies/uf850_motions.toml"
[logs]
identification = ["excitation"]
reversed = ["excitation_reversed"]
friction = ["sweep"]
[logs.test]
fourier = ["fourier_test"]
"""


@pytest.fixture(scope="session")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a study of the twin, with its logs."""
    folder = tmp_path_factory.mktemp("records")
    study = folder / "study.toml"
    study.write_text(STUDY.format(models=models_folder()), encoding="utf-8")
    run_study(study, folder / "twin")
    return folder / "twin"


@pytest.fixture(scope="session")
def records(twin: Path) -> dict[str, list[FrictionRecord]]:
    """Friction of every joint on the sweep and on the Fourier test, by log."""
    body = RigidBody.read(twin / "rigid_body.json")
    description = RobotDescription.read(models_folder() / "uf850" / "robot.toml")
    model = Robot(description)

    def read(log: str) -> list[FrictionRecord]:
        file = twin / "logs" / f"{log}.csv"
        return friction_records(Log.read(file, description), model, body)

    return {log: read(log) for log in ("sweep", "fourier_test")}


@pytest.fixture
def tell(capsys: pytest.CaptureFixture[str]) -> Callable[[str], None]:
    """Print a line despite the capture: results without a column in the table of times."""

    def line(text: str) -> None:
        with capsys.disabled():
            sys.stdout.write(f"\n{text}\n")

    return line
