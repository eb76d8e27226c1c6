"""Arguments of workflow functions: logs, robots, bodies and laws as text, paths and objects."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.workflow.arguments import (
    build_plant_body,
    choose_unique_names,
    expand_per_joint,
    find_body,
    find_robot,
    read_checked_logs,
    read_laws,
    read_logs,
    remember_trust,
)
from fmu_src.run.trust import hash_folder, is_trusted
from hesr_model.errors import ArgumentError, ConfigError, LogError
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import identify
from hesr_model.robots.robot import Robot, RobotDescription


@pytest.fixture
def file(arm: RobotDescription, arm_log: Log) -> Path:
    path = arm.model.with_name("run.csv")
    arm_log.write(path)
    return path


def test_a_plant_has_the_given_body_or_that_of_its_model(
    arm: RobotDescription, arm_log: Log
) -> None:
    robot = Robot(arm)
    own, given = build_plant_body(arm, None), identify([arm_log], robot)
    np.testing.assert_array_equal(own.parameters, robot.nominal_parameters)
    np.testing.assert_array_equal(build_plant_body(arm, given).parameters, given.parameters)
    assert not np.array_equal(own.parameters, given.parameters)


# --- logs and robots --------------------------------------------------------------------------


def test_paths_are_read_with_the_robot_of_the_logs_next_to_them(
    arm: RobotDescription, arm_log: Log, file: Path
) -> None:
    read = Log.read(file, arm)
    for logs, robot in (([file, read], None), ([file], arm), ([file], str(arm.model))):
        found = read_logs(logs, robot)
        assert [log.path for log in found] == [file] * len(found)
        assert all(log.robot and log.robot.joints == arm.joints for log in found)
    assert read_logs([arm_log, read])[0] is arm_log
    with pytest.raises(ArgumentError, match=r"run\.csv: give 'robot' to read this log"):
        read_logs([arm_log, file])


def test_progress_counts_the_logs(arm: RobotDescription, file: Path) -> None:
    told: list[tuple[int, int]] = []
    read_logs([file, file], arm, lambda done, total: told.append((done, total)))
    assert told[0] == (0, 2)
    assert told[-1] == (2, 2)


def test_the_given_robot_precedes_that_of_the_logs(
    arm: RobotDescription, arm_log: Log, file: Path
) -> None:
    log = Log.read(file, arm)
    other = arm.model_copy(update={"name": "other"})
    assert find_robot(None, [arm_log, log]).description is arm
    assert find_robot(other, [log]).description is other
    with pytest.raises(ArgumentError, match="logs do not name their robot"):
        find_robot(None, [arm_log])


def test_files_of_a_result_are_those_of_robot_and_logs(
    arm: RobotDescription, arm_log: Log, file: Path, tmp_path: Path
) -> None:
    second = tmp_path / "second.csv"
    moved = replace(arm_log, tau=arm_log.tau * 1.01)
    moved.write(second)
    robot = tmp_path / "robot.toml"
    joints = ", ".join(f'"{joint}"' for joint in arm.joints)
    robot.write_text(f'name = "arm"\nmodel = "{arm.model.name}"\njoints = [{joints}]\n')
    read = read_checked_logs([file, second], str(robot), ())
    assert read.files == [robot, arm.model, file, second]
    assert [log.name for log in read.logs] == ["run", "second"]
    assert read.robot.description.name == "arm"
    assert read_checked_logs([file], Robot(arm), ()).files == [arm.model, file]
    assert read_checked_logs([arm_log], arm, ()).files == [arm.model]
    assert read_checked_logs([Log.read(file, arm)], None, ()).files == [arm.model, file]


def test_repeated_logs_are_refused(arm: RobotDescription, file: Path) -> None:
    with pytest.raises(LogError, match=r"run\.csv"):
        read_checked_logs([file, file], arm, ())


def test_a_rigid_body_is_read_or_identified(arm: RobotDescription, arm_log: Log) -> None:
    body = find_body(None, [arm_log], Robot(arm))
    assert body.joints == arm.joints
    assert find_body(body, (), Robot(arm)) is body
    path = arm.model.with_name("body.json")
    body.write(path)
    np.testing.assert_array_equal(find_body(str(path), (), Robot(arm)).parameters, body.parameters)


# --- laws -------------------------------------------------------------------------------------


def test_laws_are_named_by_law_built_in_name_or_file(
    table1: FrictionModel, table1_fmu: Path, tmp_path: Path
) -> None:
    other = replace(table1, law="lugre")
    path = tmp_path / "cold.json"
    table1.write(path)
    found = read_laws([other, "uf850-table1", str(path), table1_fmu])
    assert [law.name for law in found] == ["lugre", "uf850-table1", "parfam_h", "Friction"]
    assert [law.fmu for law in found] == [None, None, None, table1_fmu]
    assert found[0].model is other
    assert [law.model and law.model.law for law in found[1:]] == ["parfam_h"] * 3
    [alone] = read_laws(path)
    assert (alone.name, alone.fmu) == ("parfam_h", None)


def test_laws_of_one_name_are_distinguished_by_their_files(
    table1: FrictionModel, tmp_path: Path
) -> None:
    paths = [tmp_path / name for name in ("cold.json", "warm.json", "run/cold.json")]
    paths[2].parent.mkdir()
    for path in paths:
        table1.write(path)
    assert [law.name for law in read_laws(paths[:2])] == ["cold", "warm"]
    assert [law.name for law in read_laws(paths)] == [str(path) for path in paths]
    with pytest.raises(ConfigError, match=r"^'.*cold\.json' is given twice\.$"):
        read_laws([paths[0], paths[0], paths[1]])


def test_a_mapping_names_laws(table1: FrictionModel, table1_fmu: Path) -> None:
    first, second = read_laws({"own": table1, "theirs": table1_fmu})
    assert (first.name, first.model, first.fmu) == ("own", table1, None)
    assert (second.name, second.fmu) == ("theirs", table1_fmu)


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"neither a friction model"):
        read_laws(tmp_path / "law.txt")


def test_the_first_unique_naming_is_used() -> None:
    assert choose_unique_names([["a", "b"], ["c", "d"]], "given") == ["a", "b"]
    assert choose_unique_names([["a", "a"], ["c", "d"]], "given") == ["c", "d"]
    with pytest.raises(ConfigError, match=r"^'d' is tested twice\.$"):
        choose_unique_names([["a", "a", "a"], ["c", "d", "d"]], "tested")


def test_one_value_serves_all_joints() -> None:
    assert expand_per_joint("load", None, 3) is None
    assert expand_per_joint("load", 2, 3) == (2.0, 2.0, 2.0)
    assert expand_per_joint("load", [2.0], 3) == (2.0, 2.0, 2.0)
    assert expand_per_joint("load", [1.0, 2.0, 3.0], 3) == (1.0, 2.0, 3.0)
    assert expand_per_joint("load", [4.0], 1) == (4.0,)
    with pytest.raises(ArgumentError, match="'load': found 2 values"):
        expand_per_joint("load", [1.0, 2.0], 3)


def test_existing_fmus_are_trusted_on_request(
    table1_fmu: Path, empty_cache: Path, tmp_path: Path
) -> None:
    foreign = tmp_path / "Foreign.fmu"
    foreign.write_bytes(table1_fmu.read_bytes() + b"\0")
    missing = tmp_path / "missing.fmu"
    remember_trust([missing, foreign], trust=False)
    assert not is_trusted(foreign)
    remember_trust([missing, foreign], trust=True)
    assert is_trusted(foreign)
    assert len(list(hash_folder().iterdir())) == 1
