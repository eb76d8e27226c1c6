"""Rows of the tracking study: their values and resuming after an interrupt."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.loop import loops
from cosim.loop.closed_loop import Scheme, StandIn
from cosim.loop.excite import record_motions
from cosim.loop.loops import (
    StudyLoop,
    assemble,
    build,
    build_example,
    motions,
    require_reachable,
)
from cosim.loop.motions import Motions
from cosim.loop.run import check_masters
from cosim.loop.traces import Tracked
from cosim.study.study import Study
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec, write_system
from fmu_src import export_fmu, model_file
from fmu_src.arm.native import export_mjcf
from fmu_src.arm.plant import Plant
from fmu_src.arm.table import SignalTable
from fmu_src.arm.truth import true_friction
from hesr.extras.studies.robustness import CYCLING, FACTORS, run_overcompensation, run_sweeps
from hesr_model.errors import ConfigError
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder
from hesr_model.support.typed_files import from_json, to_json

UF850 = models_folder() / "uf850"
WIDE = np.tile([-10.0, 10.0], (3, 1))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(RobotDescription.read(UF850 / "robot.toml"))


@pytest.fixture(scope="module")
def body(robot: Robot) -> RigidBody:
    """Rigid body and laws from the excitation of the default study."""
    plant = Plant.read(UF850 / "plant.toml")
    found = Motions.read(models_folder() / "studies" / "uf850_motions.toml")
    sweep = tuple(m for m in found.motions if m.name == "excitation")
    logs = [r.log for r in record_motions(found.model_copy(update={"motions": sweep}), plant)]
    return identify(logs[:1], robot, reversed_logs=logs[1:])


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory, robot: Robot, body: RigidBody) -> StudyLoop:
    """The default study's loop with Table I as its only law, on two short motions."""
    folder = tmp_path_factory.mktemp("loop")
    plant = Plant.read(UF850 / "plant.toml")
    settings = Study.read(models_folder() / "studies" / "default.toml").tracking
    assert settings
    settings = settings.model_copy(
        update={"seeds": (11, 12), "duration": 3.0, "sources": ("parfam_h",), "drift": 6.0,
                "peak_velocity": (0.6, 0.5, 0.6)}
    )  # fmt: skip
    export_mjcf(plant.model, folder / "Arm.fmu", table=UF850 / "arm.toml")
    law = export_fmu(FrictionModel.read(model_file("uf850-table1")), folder / "parfam_h.fmu")
    truth = true_friction(plant.model, plant.joints, sample_time=0.005)
    build(folder, robot, body, plant, true_model=truth)
    return assemble(folder, robot, tracking=settings, friction={"parfam_h": law}, plant=plant)


def by_name(rows: list[Tracked]) -> dict[tuple[str, str], Tracked]:
    return {(row.scheme.name, row.law): row for row in rows}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"offset": (0.0, 0.3, 0.0)},
            r"seed 11 takes joint3 .*-4\.224 to 0\.061 rad",
        ),
        ({"offset": (0.0, 0.3)}, "tracking: key 'offset' has 2 entries"),
    ],
)
def test_infeasible_motions_are_refused(
    change: dict[str, tuple[float, ...]], sentence: str, loop: StudyLoop, robot: Robot
) -> None:
    with pytest.raises(ConfigError, match=sentence):
        require_reachable(loop.tracking.model_copy(update=change), robot)


def test_every_law_is_tracked_in_every_scheme(loop: StudyLoop) -> None:
    rows = list(loop.rows())
    names = [(row.scheme.name, row.law) for row in rows]
    assert len(set(names)) == len(names)
    for scheme in ("torque_error", "servo_inversion"):
        for more in ("", ", Kx = 5"):
            for law in (StandIn.BODY_ONLY, "parfam_h", StandIn.ORACLE):
                assert (scheme + more, law) in names
        for source in ("measured", "filtered"):
            assert (f"{scheme}, friction of {source} velocity", "parfam_h") in names
    assert ("none", StandIn.VELOCITY_ONLY) in names


def test_knowing_the_truth_tracks_best(loop: StudyLoop) -> None:
    found = by_name(
        replace(loop, limits=WIDE).track(
            loop.rows(), motions(loop.tracking), 3.0, "tracking", workers=2
        )
    )
    assert all(row.rmse.shape == (2, 3) and not row.failures for row in found.values())
    oracle = found["servo_inversion", StandIn.ORACLE].mean
    assert np.all(oracle < 0.05 * found["servo_inversion", StandIn.BODY_ONLY].mean)
    assert np.all(oracle < 0.5e-3)
    outer = found["servo_inversion, Kx = 5", StandIn.BODY_ONLY].mean
    assert np.all(outer < found["servo_inversion", StandIn.BODY_ONLY].mean)


def test_the_result_does_not_depend_on_the_number_of_processes(loop: StudyLoop) -> None:
    rows = [loop.row("parfam_h", Scheme(compensation="servo_inversion"))]
    one, two = (
        loop.track(rows * 2, motions(loop.tracking), 1.0, "tracking", workers=n) for n in (1, 2)
    )
    assert list(map(to_json, one)) == list(map(to_json, two))


class InterruptedForTestError(Exception):
    pass


def test_an_interrupted_study_resumes(
    loop: StudyLoop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [
        loop.row(law, Scheme(compensation="servo_inversion"))
        for law in (StandIn.BODY_ONLY, "parfam_h", StandIn.ORACLE)
    ]

    def interrupt(_stage: str, done: int, _all: int) -> None:
        if done == 2:
            raise InterruptedForTestError

    run_of = {"motions": motions(loop.tracking), "duration": 1.0, "stage": "tracking", "workers": 1}
    whole = loop.track(rows, **run_of)
    loop = replace(loop, checkpoints=tmp_path / "checkpoints")
    with pytest.raises(InterruptedForTestError):
        replace(loop, progress=interrupt).track(rows, **run_of)
    ran = []
    run = loops._track_row
    monkeypatch.setattr(loops, "_track_row", lambda row, *a: ran.append(row.law) or run(row, *a))
    again = loop.track(rows, **run_of)
    assert ran == [StandIn.ORACLE]
    assert list(map(to_json, again)) == list(map(to_json, whole))
    # Checkpoints count only for the very same loop.
    gains = rows[0].setting.gains.model_copy(update={"latency": 0.011})
    other = replace(rows[0], setting=replace(rows[0].setting, gains=gains))
    loop.track([other], **run_of)
    assert ran == [StandIn.ORACLE, StandIn.BODY_ONLY]


def test_a_diverging_loop_is_a_result(loop: StudyLoop) -> None:
    row = loop.row("parfam_h", Scheme(compensation="servo_inversion", Kx=-20.0))
    near = np.array([[-1.0, 1.0], [-0.7, 1.3], [-2.9, -0.9]])
    loop = replace(loop, limits=near)
    (found,) = loop.track([row], motions(loop.tracking), 3.0, "tracking", workers=1)
    assert np.all(np.isnan(found.mean))
    assert "outside its limits" in found.failures[0]
    assert from_json(Tracked, to_json(found), Path("row.json"), "a row").failures == found.failures


def test_sweeps_change_the_stated_parameter(
    loop: StudyLoop, robot: Robot, body: RigidBody, tmp_path: Path
) -> None:
    short = replace(loop, tracking=loop.tracking.model_copy(update={"seeds": (11,)}))
    scheme = "servo_inversion, Kx = 5"
    row = loop.row(StandIn.ORACLE, Scheme(compensation="servo_inversion", Kx=5.0))
    (table,) = short.track([row], motions(short.tracking), loop.tracking.duration, "tracking")
    told: list[tuple[str, int, int]] = []
    short = replace(short, progress=lambda *t: told.append(t))
    sweeps = run_sweeps(short, robot, body, tmp_path, [table])
    assert told[-1] == ("robustness", len(sweeps) - 1, len(sweeps) - 1)  # not that of the table
    rows = by_name(sweeps)
    np.testing.assert_array_equal(rows[f"{scheme}: as it is", StandIn.ORACLE].rmse, table.rmse)
    plain = rows[f"{scheme}: as it is", StandIn.ORACLE].mean
    assert np.all(plain < 0.5e-3)
    loaded = rows[f"{scheme}: payload 5 kg", StandIn.ORACLE].mean
    known = rows[f"{scheme}: payload 5 kg, identified", StandIn.ORACLE].mean
    assert np.all(known[1:] < 0.3 * loaded[1:]), (known, loaded)
    assert np.all(rows[f"{scheme}: friction x 2", StandIn.ORACLE].mean > 2.0 * plain)
    for latency in (0, 20, 40):  # known to the controller
        assert np.all(rows[f"{scheme}: latency {latency} ms", StandIn.ORACLE].mean < 1e-3)
    assert not list(tmp_path.glob("*.xml"))


def test_only_feedback_of_friction_causes_limit_cycles(loop: StudyLoop) -> None:
    found = {one.scheme.name: one.factor for one in run_overcompensation(loop)}
    assert found["servo_inversion"] is None
    measured = found["servo_inversion, friction of measured velocity"]
    assert measured in FACTORS
    assert CYCLING == 10 * 2e-5  # of the encoder noise


def test_one_loop_is_written_to_its_own_file(loop: StudyLoop, tmp_path: Path) -> None:
    """The file gives the result of the study for the same law, scheme and motion."""
    path = write_system(build_example(loop), tmp_path / "closed_loop.toml")
    with Master(SystemSpec.read(path), path) as master:
        result = master.run().require_success()
    error = result.vector("trajectory.q") - result.vector("arm.q_true")
    scheme = Scheme(compensation="servo_inversion", Kx=loop.tracking.Kx)
    row = loop.row("parfam_h", scheme)
    (tracked,) = loop.track([row], motions(loop.tracking)[:1], 3.0, "tracking", workers=1)
    np.testing.assert_array_equal(np.sqrt(np.mean(error**2, axis=0)), tracked.rmse[0])


def test_the_python_and_the_native_master_agree(loop: StudyLoop) -> None:
    """The arm is a PythonFMU and, in the native master, a native FMU."""
    plant, signals = Plant.read(UF850 / "plant.toml"), SignalTable.read(UF850 / "arm.toml")
    assert check_masters(loop, plant, signals) == []
    other = signals.model_copy(update={"seed": 2})
    (finding,) = check_masters(loop, plant, other)
    assert re.search(
        r"differ by \d\.\de-\d\d of a signal's",
        finding.sentence,
    )


def test_masters_are_not_compared_for_an_arm_with_other_files(
    loop: StudyLoop, tmp_path: Path
) -> None:
    mjcf = tmp_path / "arm.xml"
    (tmp_path / "uf850.xml").write_bytes((UF850 / "uf850.xml").read_bytes())
    mjcf.write_text('<mujoco><include file="uf850.xml"/></mujoco>', encoding="utf-8")
    plant = Plant.read(UF850 / "plant.toml").model_copy(update={"model": mjcf})
    (finding,) = check_masters(loop, plant, SignalTable.read(UF850 / "arm.toml"))
    assert finding.severity == "advice"
    assert "refers to other files, which python-arm" in finding.sentence
