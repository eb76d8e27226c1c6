"""Fleets: laws of each robot equal those of `hesr fit`, outliers, changes, and recovery from
errors."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from filelock import FileLock
from fleets import write_fleet
from pyarrow import parquet

import hesr
from fmu_src.friction.replay import replay
from hesr.cli import main
from hesr.extras.fleet.deviation import Trend
from hesr.extras.fleet.result import BODY, JointResult, RobotResult
from hesr.extras.fleet.robot import process_robot, read_result
from hesr.extras.fleet.run import compare_robots, find_changes, run_fleet, write_types
from hesr.extras.fleet.study import FleetStudy, find_members
from hesr.extras.ssp.parameter_set import export_ssv
from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.fitting.fit import fit
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.logs.sample import MotionSample
from hesr_model.logs.signals import smooth
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import motion_records
from hesr_model.robots.robot import Robot, RobotDescription

Shared = Callable[[str, Callable[[Path], object]], Path]
Command = Callable[..., int]


@pytest.fixture(scope="session")
def cell(shared: Shared) -> Path:
    """Two robots with five days of logs; friction of the second grows by 10 % each day."""

    def fill(folder: Path) -> None:
        file = write_fleet(folder, robots=2, logs=5, scale=lambda r, k: 1.0 + 0.1 * k * r)
        run_fleet(file, folder / "out", workers=1)

    return shared("fleet", fill)


@pytest.fixture
def copied(cell: Path, tmp_path: Path) -> Path:
    """A modifiable copy of the fleet with its results."""
    shutil.copytree(cell, tmp_path / "cell")
    return tmp_path / "cell"


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Command:
    def run(*words: object) -> int:
        monkeypatch.setattr(sys, "argv", ["hesr", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        return int(ended.value.code or 0)

    return run


def files(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def logs_of(cell: Path, robot: str) -> tuple[Robot, list[Log]]:
    description = RobotDescription.read(cell / "robot.toml")
    found = find_members(FleetStudy.read(cell / "fleet.toml"), cell / "fleet.toml")
    logs = next(one.logs for one in found if one.name == robot)
    read = [replace(Log.read(path, description), name=name) for name, path in logs]
    return Robot(description), read


# --- each robot ---------------------------------------------------------------------------------


def test_the_rigid_body_is_identified_from_all_logs(cell: Path) -> None:
    model, logs = logs_of(cell, "R0")
    found, batch = RigidBody.read(cell / "out/robots/R0/rigid_body.json"), identify(logs, model)
    scale = np.abs(batch.parameters).max()
    np.testing.assert_allclose(found.parameters, batch.parameters, rtol=1e-8, atol=1e-9 * scale)
    np.testing.assert_allclose(found.rmse, batch.rmse, rtol=1e-9)
    assert (
        found.logs == batch.logs == tuple(f"robot=R0/day=2026-01-0{k}/part-0" for k in range(1, 6))
    )


def test_laws_of_all_rows_are_those_of_hesr_fit(cell: Path) -> None:
    """Five logs of 1001 rows are fewer than the sample limit."""
    _, logs = logs_of(cell, "R1")
    folder = cell / "out" / "robots" / "R1"
    robot = cell / "robot.toml"
    fitted = hesr.fit(logs, law="stribeck", robot=robot, rigid_body=folder / "rigid_body.json")
    found = FrictionModel.read(folder / "stribeck.json")
    assert found.laws[0].values == fitted.laws[0].values
    assert found.training_rmse == fitted.training_rmse
    assert found.trained == fitted.trained


def test_laws_of_a_sample_are_those_of_hesr_fit_on_that_sample(
    copied: Path, tmp_path: Path
) -> None:
    file = copied / "fleet.toml"
    file.write_text("rows = 1500\n" + file.read_text(encoding="utf-8"), encoding="utf-8")
    study = FleetStudy.read(file)
    process_robot(find_members(study, file)[0], study, tmp_path / "R0")
    model, logs = logs_of(copied, "R0")
    body = RigidBody.read(tmp_path / "R0" / "rigid_body.json")
    sample = MotionSample(1500, 0)
    for log in logs:
        sample.add(smooth(log))
    records = [motion_records(motion, model, body) for motion in sample.motions()]
    assert 1000 < sum(len(of[0].t) for of in records) <= 1500
    found = FrictionModel.read(tmp_path / "R0" / "stribeck.json")
    assert found.laws[0].values == fit("stribeck", *records).laws[0].values
    # The rigid body and the errors are still those of all rows.
    assert body.rows == 5005
    np.testing.assert_allclose(body.parameters, identify(logs, model).parameters, rtol=1e-7)
    (one,) = read_result(tmp_path / "R0").select_law("stribeck")
    every = [motion_records(smooth(log), model, body) for log in logs]
    errors = [found.predict(of)[:, 0] - of[0].tau for of in every]
    assert one.rmse == pytest.approx(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    assert one.tau_std == pytest.approx(np.std(np.concatenate([of[0].tau for of in every])))


def test_growing_friction_is_reported_with_its_size(cell: Path) -> None:
    rows = parquet.read_table(cell / "out" / "fleet.parquet").to_pylist()
    assert [(row["robot"], row["law"], row["joint"]) for row in rows] == [
        (robot, law, joint)
        for robot in ("R0", "R1")
        for law, joint in ((BODY, ""), ("stribeck", "j1"))
    ]
    _, steady, _, growing = rows
    assert (steady["worse"], steady["changes"]) == (False, [])
    assert (growing["worse"], growing["changes"]) == (True, ["drift"])
    # From 1 to 1.4 about their mean of 1.2.
    assert growing["level_change"] == pytest.approx(0.4 / 1.2, abs=0.05)
    assert growing["level_per_day"] == pytest.approx(growing["level_change"] / 4.0)
    assert dict(growing["coefficients"])["F_c"] > dict(steady["coefficients"])["F_c"]
    assert b"joint[1].F_c" in (cell / "out" / "robots" / "R1" / "stribeck.ssv").read_bytes()
    page = (cell / "out" / "fleet.html").read_text(encoding="utf-8")
    assert "wear, damage or heat" in page
    assert "Fewer than 5 robots are not compared: arm." in page


# --- many robots --------------------------------------------------------------------------------


@pytest.mark.ci
def test_results_do_not_depend_on_workers_and_are_reused(copied: Path) -> None:
    before = files(copied / "out")
    assert run_fleet(copied / "fleet.toml", copied / "out", workers=1).reused == 2
    assert files(copied / "out") == before
    # As if killed during the second robot, with the first result written.
    (copied / "out/robots/R1/result.json").unlink()
    (copied / "out/robots/R0/result.json").write_text('{"format": "hesr-fl', encoding="utf-8")
    assert run_fleet(copied / "fleet.toml", copied / "out", workers=2).reused == 0
    assert files(copied / "out") == before


def test_a_new_day_of_logs_is_added(copied: Path, command: Command, capsys) -> None:
    logs = copied / "logs" / "robot=R0"
    shutil.copytree(logs / "day=2026-01-03", logs / "day=2026-01-09")
    assert (
        command(
            "monitor", copied / "fleet.toml", "-o", copied / "out", "--workers", 1, "--json", "-"
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out)["result"]
    assert (found["robots"], found["reused"], found["not_used"]) == (2, 1, {})
    assert [one["robot"] for one in found["changes"]] == ["R1"]
    assert read_result(copied / "out" / "robots" / "R0").logs == 6


def test_broken_logs_do_not_stop_other_robots(copied: Path, command: Command, capsys) -> None:
    logs = copied / "logs"
    (logs / "robot=R0/day=2026-01-02/part-0.parquet").write_bytes(b"PAR1 cut short")
    turned = Log.read(
        logs / "robot=R0/day=2026-01-04/part-0.parquet",
        RobotDescription.read(copied / "robot.toml"),
    )
    replace(turned, tau=-turned.tau).write(turned.path)
    (logs / "robot=R3").mkdir()
    (logs / "robot=R4" / "day=2026-01-01").mkdir(parents=True)
    (logs / "robot=R4" / "day=2026-01-01" / "log.csv").write_text("t,q1\n0,0\n", encoding="utf-8")
    assert command("monitor", copied / "fleet.toml", "-o", copied / "out", "--workers", 1) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "robot 'R3': its folders contain no log" in said
    assert "1 logs can be used" in said
    one, other, *_ = (read_result(copied / "out" / "robots" / r) for r in ("R0", "R1"))
    assert (one.logs, other.logs) == (3, 5)
    assert "part-0.parquet" in one.refused[0]
    assert "[torque-sign]" in one.refused[1]
    assert one.laws == ["stribeck"]
    rows = parquet.read_table(copied / "out" / "fleet.parquet").to_pylist()
    assert [row["robot"] for row in rows if row["failure"]] == ["R3", "R4"]


def test_unfitted_laws_are_reported(copied: Path, tmp_path: Path) -> None:
    file = copied / "fleet.toml"
    text = file.read_text(encoding="utf-8")
    both = '["lugre_load_ripple", "stribeck"]'
    file.write_text(text.replace('["stribeck"]', both), encoding="utf-8")
    study = FleetStudy.read(file)
    process_robot(find_members(study, file)[0], study, tmp_path / "R0")
    found = read_result(tmp_path / "R0")
    assert (found.laws, found.failure) == (["stribeck"], "")
    assert "law 'lugre_load_ripple' needs the key 'gear_ratio'" in found.refused[0]


def test_write_errors_are_not_attributed_to_a_robot(copied: Path) -> None:
    """Otherwise the error would be kept as its result once the disk has space again."""
    file, folder = copied / "fleet.toml", copied / "R0"
    study = FleetStudy.read(file)
    (folder / "stribeck.json").mkdir(parents=True)
    with pytest.raises(ArtifactError, match=r"stribeck\.json: cannot be written there"):
        process_robot(find_members(study, file)[0], study, folder)
    assert not (folder / "result.json").exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in folders")
def test_a_named_pipe_among_logs_does_not_block(copied: Path) -> None:
    file, folder = copied / "fleet.toml", copied / "R0"
    shutil.rmtree(copied / "logs" / "robot=R0")
    (copied / "logs" / "robot=R0").mkdir()
    os.mkfifo(copied / "logs" / "robot=R0" / "run.csv")  # it cannot be hashed either
    study = FleetStudy.read(file)
    process_robot(find_members(study, file)[0], study, folder)
    assert "run.csv: no such log file." in read_result(folder).failure


def fleet_of(count: int, seed: int = 0) -> list[RobotResult]:
    """Robots of one type with two joints and random coefficients of one distribution."""
    rng = np.random.default_rng(seed)

    def joint(name: str) -> JointResult:
        values = {"F_c": 2.0 * np.exp(0.05 * rng.standard_normal()), "tau_0": rng.normal(0.0, 0.1)}
        trends = {"level": Trend(slope=0.001, change=0.03, p=float(rng.uniform(0.01, 1.0)))}
        return JointResult(
            law="coulomb",
            joint=name,
            structure="{}",
            values=values,
            errors={"F_c": 0.01},
            rmse=float(rng.uniform(0.9, 1.1)),
            tau_std=3.0,
            trends=trends,
        )

    return [
        RobotResult(key="", robot=f"R{k:03d}", type="arm", joints=(joint("j1"), joint("j2")))
        for k in range(count)
    ]


def with_first(robots: list[RobotResult], joint: int, **new: object) -> list[RobotResult]:
    joints = list(robots[0].joints)
    joints[joint] = replace(joints[joint], **new)
    return [replace(robots[0], joints=tuple(joints)), *robots[1:]]


def test_outliers_of_a_type_are_found() -> None:
    robots = fleet_of(40)
    z, none = compare_robots(robots, 0.05)
    assert none == []
    assert set(z["R000", "coulomb", "j1"]) == {"F_c", "tau_0", "rmse"}
    odd = with_first(robots, 1, values={"F_c": 3.0, "tau_0": 0.0}, rmse=2.0)
    _, found = compare_robots(odd, 0.05)
    assert {(d.robot, d.type, d.joint, d.name) for d in found} == {
        ("R000", "arm", "j2", "rmse"), ("R000", "arm", "j2", "F_c"),
    }  # fmt: skip
    assert abs(found[0].z) >= abs(found[1].z) > 5.0
    # Another structure or another type gives no population to compare with.
    assert compare_robots(with_first(odd, 1, structure='{"terms": 2}'), 0.05)[1] == []
    assert compare_robots([replace(odd[0], type="other"), *odd[1:]], 0.05)[1] == []
    assert compare_robots(odd[:4], 0.05) == ({}, [])


def test_changes_are_reported_with_their_likely_cause() -> None:
    robots = fleet_of(20)
    assert find_changes(robots, 0.05, 0.0) == []

    def trends(**changes: float) -> dict[str, Trend]:
        return {n: Trend(slope=c / 10.0, change=c, p=1e-9) for n, c in changes.items()}

    def kinds(robots: list[RobotResult]) -> list[tuple[str, str, bool]]:
        return [(c.joint, c.kind, c.worse) for c in find_changes(robots, 0.05, 0.05)]

    one = with_first(robots, 0, trends=trends(level=0.2, offset=-0.1, error=-0.3))
    assert kinds(one) == [
        ("j1", "drift", True),
        ("j1", "shift", True),
        ("j1", "error", False),
    ]
    both = with_first(one, 1, trends=trends(level=0.3, error=0.04))
    assert kinds(both)[:2] == [("j2", "shared drift", True), ("j1", "shared drift", True)]
    less = with_first(one, 1, trends=trends(level=-0.3))
    assert ("j2", "drift", False) in kinds(less)
    assert "temperature or lubrication" in find_changes(both, 0.05, 0.05)[0].points_to


# --- one FMU for all ----------------------------------------------------------------------------


def test_one_fmu_has_a_parameter_set_per_robot(table1: FrictionModel, tmp_path: Path) -> None:
    robots = []
    for name, factor in (("A", 0.9), ("B", 1.0), ("C", 1.1)):
        laws = [
            replace(law, values={n: factor * v for n, v in law.values.items()})
            for law in table1.laws
        ]
        model = replace(table1, laws=tuple(laws))
        model.write(tmp_path / "robots" / name / "parfam_h.json")
        export_ssv(model, tmp_path / "robots" / name / "parfam_h.ssv")
        joints = tuple(
            JointResult(
                law="parfam_h",
                joint=joint,
                values=law.values,
                errors={},
                structure=json.dumps(law.structure, sort_keys=True),
            )
            for joint, law in zip(table1.joints, laws, strict=True)
        )
        robots.append(RobotResult(key="", robot=name, type="arm", joints=joints))
    study = FleetStudy.model_validate({"types": {"arm": {"robot": "r.toml", "logs": "*"}}})
    found = write_types(study, robots, tmp_path, lambda *_: None)
    fmu = tmp_path / "types" / "arm" / "parfam_h.fmu"
    assert set(found.values()) == {fmu}
    assert found["arm", "parfam_h", robots[0].structure("parfam_h")] == fmu
    root = ET.parse(tmp_path / "robots" / "A" / "parfam_h.ssv").getroot()
    assert root.get("version") == "1.0"
    start = {
        str(p.get("name")): float(p[0].get("value", "nan")) for p in root.findall(".//{*}Parameter")
    }
    model = FrictionModel.read(tmp_path / "robots" / "A" / "parfam_h.json")
    t = np.arange(200) * 0.005
    dq = 0.3 * np.sin(4.0 * t)[:, None] * np.ones(len(model.joints))
    expected = model.predict(t=t, dq=dq)
    assert np.abs(replay(fmu, t, dq, start=start) - expected).max() < 1e-9
    assert np.abs(replay(fmu, t, dq) - expected).max() > 1e-3


# --- definition of a fleet ---------------------------------------------------------------------


def study_of(folder: Path, **types: str) -> tuple[FleetStudy, Path]:
    found = {name: {"robot": "robot.toml", "logs": logs} for name, logs in types.items()}
    return FleetStudy.model_validate({"types": found}), folder / "fleet.toml"


def laid(folder: Path, *logs: str) -> None:
    for log in logs:
        (folder / log).parent.mkdir(parents=True, exist_ok=True)
        (folder / log).touch()


def test_logs_are_found_in_folders_and_partitions(tmp_path: Path) -> None:
    laid(
        tmp_path,
        "a/day=2026-01-30/robot=R1/part-0.parquet",
        "a/day=2026-02-02/robot=R1/b.csv",
        "a/day=2026-02-02/robot=R1/_SUCCESS",
        "a/day=2026-02-02/robot=R1/.b.csv.crc",
        "a/day=2026-02-02/robot=R1/readme.txt",
        "b/arm2/run_20260131_b/metadata.yaml",
        "b/arm2/run_20260131_b/x.db3",
        "b/arm2/run2.mat",
        "b/arm2/20269999.pq",
        "b/note.csv",
    )
    first, second = find_members(*study_of(tmp_path, one="a/day=*/robot=*", two="b/*"))
    assert (first.name, first.type) == ("R1", "one")
    assert [name for name, _ in first.logs] == [
        "day=2026-01-30/robot=R1/part-0",
        "day=2026-02-02/robot=R1/b",
    ]
    assert list(first.days.values()) == [0.0, 3.0]
    assert (second.name, second.type) == ("arm2", "two")
    assert second.days == {"arm2/20269999": 0.0, "arm2/run2": 1.0, "arm2/run_20260131_b": 2.0}
    (tmp_path / "b/arm2/20269999.pq").unlink()
    (tmp_path / "b/arm2/run2.mat").rename(tmp_path / "b/arm2/2026-01-30.mat")
    assert list(find_members(*study_of(tmp_path, two="b/*"))[0].days.values()) == [0.0, 1.0]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"logs/robot=*"', '"logs/rob*t"', "type 'arm': no folder matches 'logs/rob*t'."),
        *(
            (
                '"logs/robot=*"',
                f'"{bad}"',
                f"'{bad}' is not a valid pattern",
            )
            for bad in (".", "/")
        ),
        ('logs = "logs/robot=*"', "", "key 'types.arm.logs' is missing."),
        ("fmu = false", "seed = -1", "key 'seed' is -1: "),
        ("fmu = false", "laws_ = []", "unknown key 'laws_'; did you mean 'laws'"),
        ('["stribeck"]', '["stribek"]', "stribek"),
        ('"robot.toml"', '"no.toml"', "no.toml: no such file."),
        ('"logs/robot=*"', '"logs/robot=*"\naccept = ["zeros"]', "--accept is 'zeros'; the"),
        (
            '"logs/robot=*"',
            '"logs/robot=*"\n[types.b]\nrobot = "robot.toml"\nlogs = "logs/*"',
            "types 'arm' and 'b'; give each",
        ),
    ],
)
def test_invalid_fleets_are_refused(
    cell: Path, copied: Path, old: str, new: str, said: str, command: Command, capsys
) -> None:
    file = copied / "fleet.toml"
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")
    assert command("monitor", file, "-o", copied / "out") == 2
    err = capsys.readouterr().err
    assert said in err
    assert len(err.splitlines()) == 1
    assert files(copied / "out") == files(cell / "out")


def test_a_cyclic_link_is_refused(tmp_path: Path) -> None:
    """Its logs would be read until the path is too long: 41 times."""
    laid(tmp_path, "b/arm2/run2.mat", "c/arm3/run3.mat")
    (tmp_path / "b/arm2/far").symlink_to(tmp_path / "c")  # for example on another disk
    (arm,) = find_members(*study_of(tmp_path, two="b/*"))
    assert [name for name, _ in arm.logs] == ["arm2/far/arm3/run3", "arm2/run2"]
    (tmp_path / "b/arm2/loop").symlink_to("..")
    with pytest.raises(ConfigError, match="b/arm2/loop: links to a folder"):
        find_members(*study_of(tmp_path, two="b/*"))


def test_folders_of_another_fleet_are_refused(copied: Path, command: Command, capsys) -> None:
    file = copied / "fleet.toml"
    with (
        FileLock(copied / "out" / ".fleet-lock"),
        pytest.raises(ArtifactError, match="another fleet is writing here; wait"),
    ):
        run_fleet(file, copied / "out", workers=1)
    file.write_text(file.read_text(encoding="utf-8").replace('"cell"', '"hall"'), encoding="utf-8")
    assert command("monitor", file, "-o", copied / "out") == 2
    assert "holds results of another fleet; give" in capsys.readouterr().err


# --- at full size -------------------------------------------------------------------------------


_MEASURED = """
import resource, sys
from pathlib import Path
from hesr.extras.fleet.run import run_fleet
run_fleet(Path(sys.argv[1]), Path(sys.argv[2]), workers=1)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def peak(file: Path, output: Path) -> float:
    """Return the peak memory [MB] of a process that evaluates a fleet."""
    done = subprocess.run(
        [sys.executable, "-c", _MEASURED, file, output], capture_output=True, text=True, check=True
    )
    return float(done.stdout.split()[-1])


@pytest.mark.soak
def test_memory_does_not_grow_with_the_logs(tmp_path: Path) -> None:
    found = []
    for logs in (10, 20, 40):
        (tmp_path / f"{logs}").mkdir()
        file = write_fleet(tmp_path / f"{logs}", robots=1, logs=logs, joints=6, seconds=25.0)
        found.append(peak(file, tmp_path / f"{logs}" / "out"))
    assert max(found) < 1024.0
    assert found[2] < 1.1 * found[0]


@pytest.mark.soak
def test_two_hundred_robots_are_evaluated(tmp_path: Path) -> None:
    """6 joints and 10 logs each, 10^7 rows: one robot is 30 % off, one grows by 5 % a day."""

    def scale(robot: int, log: int) -> float:
        return {17: 1.3, 23: 1.0 + 0.05 * log}.get(robot, 1.0)

    file = write_fleet(tmp_path, robots=200, logs=10, joints=6, seconds=25.0, scale=scale)
    assert peak(file, tmp_path / "out") < 1024.0
    rows = parquet.read_table(tmp_path / "out" / "fleet.parquet").to_pylist()
    assert len({row["robot"] for row in rows}) == 200
    assert sum(row["rows"] for row in rows if row["law"] == BODY) == 200 * 10 * 5001
    assert {row["robot"] for row in rows if row["worse"]} == {"R23"}
    assert "R17" in {row["robot"] for row in rows if row["deviates"]}
