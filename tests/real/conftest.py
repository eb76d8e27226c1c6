"""Measured logs of a UR10e, stored next to the repository and not part of it."""

from pathlib import Path

import pytest
from ur10e_logs import DATA, IDENTIFICATION, TEST

from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription


@pytest.fixture(scope="session")
def ur10e_data() -> Path:
    if not DATA.is_dir():
        pytest.skip(f"the measured UR10e logs are not next to the repository, in {DATA}")
    return DATA


@pytest.fixture(scope="session")
def ur10e(ur10e_data: Path) -> RobotDescription:
    return RobotDescription.read(Path(__file__).with_name("ur10e.toml"))


@pytest.fixture(scope="session")
def ur10e_model(ur10e: RobotDescription) -> Robot:
    return Robot(ur10e)


@pytest.fixture(scope="session")
def id_logs(ur10e_data: Path, ur10e: RobotDescription) -> list[Log]:
    return [Log.read(ur10e_data / f"{name}.csv", ur10e) for name in IDENTIFICATION]


@pytest.fixture(scope="session")
def unseen_logs(ur10e_data: Path, ur10e: RobotDescription) -> list[Log]:
    return [Log.read(ur10e_data / f"{name}.csv", ur10e) for name in TEST]
