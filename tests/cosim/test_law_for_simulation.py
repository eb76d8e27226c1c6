"""Output error as a stage of the fit: a sliding axis with three truths, from study to verdict."""

from dataclasses import dataclass
from pathlib import Path

import emps
import numpy as np
import pytest
from small_study import hesr_here

from cosim.study.position_errors import PositionErrors, simulate_tests
from cosim.study.scores import select_records
from cosim.study.steps import Job
from cosim.study.study import Study
from cosim.study.verdict import ForSimulation, read_verdict
from hesr_model.audit.certificate import has_proof
from hesr_model.forward.output_error import MAX_TORQUE_RATIO, RefinementResult
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot
from hesr_model.support.progress import silent

UNSEEN = {"slow": (1.7, 4.1), "slower": (1.1, 2.9), "pulses": (1.4, 3.7)}
STUDY = """
name = "axis"
robot = "robot.toml"
laws = ["stribeck", "lugre", "parfam_s"]
refinement = "output_error"
[logs]
identification = ["training.mat"]
test = { unseen = ["slow.mat", "slower.mat", "pulses.mat"] }
"""


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Laws of an axis before and after output error, and errors on unseen motions."""

    models: dict[str, FrictionModel]
    refined: dict[str, RefinementResult]
    chosen: ForSimulation
    before: PositionErrors
    after: PositionErrors


def write(folder: Path, truth: str, seconds: float) -> Path:
    robot = emps.ROBOT.replace("1000.0", "500.0")
    (folder / "robot.toml").write_text(robot, encoding="utf-8")
    (folder / "emps.xml").write_text(emps.MODEL, encoding="utf-8")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    emps.write(folder / "training.mat", seconds=seconds, truth=truth, every=2)
    for seed, (name, speeds) in enumerate(UNSEEN.items(), 1):
        emps.write(
            folder / f"{name}.mat",
            seconds=0.5 * seconds,
            pulses=name == "pulses",
            seed=seed,
            truth=truth,
            every=2,
            speeds=speeds,
        )
    return folder / "study.toml"


# Open loop of exact Coulomb friction: 0.70 mm, against 0.61 mm of the best reference.
_SHORT = pytest.mark.xfail(reason="1.14 of the best reference in open loop", strict=True)


@pytest.fixture(params=["bristles", "stops", pytest.param("coulomb", marks=_SHORT)])
def axis(request: pytest.FixtureRequest, tmp_path: Path) -> Axis:
    path = write(tmp_path, request.param, 20.0)
    job = Job(study=Study.read(path), path=path, progress=silent)
    robot = Robot(job.robot)
    logs = {name: job.read(name, file) for name, file in job.log_files(tmp_path).items()}
    body, _ = job.rigid_body(logs, robot)
    records = {name: [friction_records(log, robot, body)] for name, log in logs.items()}
    models, _ = job.fit_all(records, {})
    refined = job.refine(logs, robot, body, models)
    chosen = ForSimulation.from_refined(refined)
    assert chosen is not None
    tests = {"unseen": select_records(job.study.logs.test["unseen"], records)}
    better = {law: one.model for law, one in refined.items()}
    before, after = (simulate_tests(m, tests, robot, body)["unseen"] for m in (models, better))
    return Axis(models=models, refined=refined, chosen=chosen, before=before, after=after)


def errors(found: PositionErrors, law: str) -> np.ndarray:
    """Return the errors over windows and in open loop [m]."""
    return np.array([*(of[0] for of in found.windows[law]), found.open_loop[law][0]], dtype=float)


@pytest.mark.ci
def test_the_law_for_simulation_is_as_good_as_the_references(
    axis: Axis, request: pytest.FixtureRequest
) -> None:
    own = errors(axis.after, axis.chosen.law)
    best = np.min([errors(axis.after, law) for law in ("stribeck", "lugre")], axis=0)
    assert np.all(own <= 1.05 * best)
    if "coulomb" not in request.node.name:
        for found in (axis.before, axis.after):
            assert np.all(own <= 0.6 * errors(found, "stribeck"))
    for law, one in axis.refined.items():
        assert axis.chosen.errors[axis.chosen.law] <= one.size
        was = axis.models[law]
        if one.ratio == 1.0:
            assert one.model.laws[0].values == was.laws[0].values
            continue
        assert np.sqrt(np.mean((one.left_out / one.before) ** 2)) < 1.0
        assert one.model.training_rmse[0] <= MAX_TORQUE_RATIO * was.training_rmse[0]
        assert has_proof(one.model.laws[0]) or not has_proof(was.laws[0])
        assert one.model.laws[0].values.get("P") == was.laws[0].values.get("P")


@pytest.mark.ci
def test_a_run_names_the_purpose_of_each_law(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, hesr = write(tmp_path, "bristles", 12.0), hesr_here(capsys, monkeypatch)
    answer = hesr("run", path, "--platform", "linux64", "-o", tmp_path / "results")
    assert answer.code == 0, answer.err
    words = read_verdict(tmp_path / "results")
    assert words is not None
    assert words.simulation is not None
    assert (tmp_path / "results" / words.simulation.fmu).is_file()
    assert ", for feed-forward: " in answer.out
    assert f"Recommended for simulation: {tmp_path}" in answer.out
    assert "refinement" not in answer.out
