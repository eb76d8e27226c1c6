"""A hydraulic cylinder: from pressures in a CSV to the FMU of its friction."""

import re
from pathlib import Path

import numpy as np
import pytest

import hesr
from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import SimulationError
from hesr_model.forward.simulation import cut_windows
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.laws.lugre import LuGreLoad
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot

AREAS = 1.96e-3, 1.35e-3  # [m2]
MEAN_AREA = 0.5 * sum(AREAS)
MASS = 80.0  # [kg]
STRETCH = 3e-5  # [m] of the seals before they slide
TRUTH = {
    "sigma_0": 60.0 / STRETCH, "sigma_1": 300.0, "sigma_2": 350.0, "F_c": 60.0, "F_s": 90.0,
    "v_s": 0.02, "tau_0": 0.0, "mu": 0.03 / 60.0,
}  # fmt: skip
"""A Stribeck curve whose level grows with the load."""
RATE, SECONDS = 500.0, 60.0
CYLINDER = {"pressures": ["p_a", "p_b"], "areas": list(AREAS), "unit": "bar"}


def motion(seed: int) -> tuple[np.ndarray, ...]:
    """Slow and quick strokes: t [s], position [m], velocity [m/s], acceleration [m/s2]."""
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    w, size = 2 * np.pi * np.array([0.03, 0.17, 0.83]), np.array([0.12, 0.05, 0.04])
    phase = w * t[:, None] + np.random.default_rng(seed).uniform(0, 2 * np.pi, 3)
    parts = np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase)
    return t, *(part @ size for part in parts)


def write_log(path: Path, seed: int) -> Path:
    """Simulate a cylinder with a changing pressure on its rod side; encoder of 1 um."""
    t, x, v, a = motion(seed)
    law = FrictionLaw(name="lugre_load", form=LuGreLoad.core({}), values=TRUTH)
    rng = np.random.default_rng(seed)
    back = 1e5 * (20.0 + 15.0 * np.sin(2 * np.pi * 0.05 * t + rng.uniform(0, 6)))
    force = MASS * a
    for _ in range(30):  # the friction depends on the pressure that overcomes it
        drive = (force + AREAS[1] * back) / AREAS[0]
        force = MASS * a + predict(law, t=t, dq=v, q=x, tau_load=MEAN_AREA * (drive - back))
    noise = rng.normal(0.0, 500.0, (2, len(t)))
    columns = [t, np.round(x, 6), (drive + noise[0]) / 1e5, (back + noise[1]) / 1e5]
    head = "time,position,p_a,p_b"
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=head, comments="")
    return path


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two logs and the robot file that `inspect` has completed."""
    folder = tmp_path_factory.mktemp("cylinder")
    logs = [write_log(folder / f"{name}.csv", seed) for seed, name in enumerate("ab")]
    own = folder / "axis"
    hesr.new(own, bench="sliding", inertia=MASS, log={"cylinder": CYLINDER})
    robot = own / "robot.toml"
    found = hesr.inspect(logs, robot=robot, write=robot, study=own / "study.toml")
    assert not found.findings
    return folder


def test_the_log_has_force_and_load(bench: Path) -> None:
    log = hesr.Log.read(bench / "a.csv", bench / "axis" / "robot.toml")
    p_a, p_b = 1e5 * np.loadtxt(bench / "a.csv", delimiter=",", skiprows=1)[:, 2:].T
    np.testing.assert_allclose(log.tau[:, 0], AREAS[0] * p_a - AREAS[1] * p_b)
    np.testing.assert_allclose(log.load[:, 0], MEAN_AREA * (p_a - p_b))
    assert log.rows(slice(5)).load.shape == (5, 1)


def test_coefficients_are_found(bench: Path, tmp_path: Path) -> None:
    robot = bench / "axis" / "robot.toml"
    model = hesr.fit(bench / "a.csv", robot=robot, law="lugre_load")
    found = model.laws[0].values
    known = {name: TRUTH[name] for name in ("sigma_2", "F_c", "F_s", "mu")}
    assert {name: found[name] for name in known} == pytest.approx(known, rel=0.05)
    with FmuInstance(hesr.export(model, tmp_path / "Cylinder.fmu", platform=["linux64"])) as fmu:
        fmu.initialise(start={"dq[1]": 0.2, "tau_load[1]": 2000.0})
        for k in range(100):
            fmu.step(k / RATE, 1 / RATE)
        [force] = fmu.get(["tau[1]"])
    assert force == pytest.approx(60.0 + 0.03 * 2000.0 + 350.0 * 0.2, rel=0.05)


def test_the_load_is_no_input_of_a_simulation(bench: Path) -> None:
    robot = Robot(bench / "axis" / "robot.toml")
    log = hesr.Log.read(bench / "a.csv", robot)
    records = friction_records(log, robot, identify([log], robot))
    sentence = "log 'a': the load"
    with pytest.raises(SimulationError, match=re.escape(sentence)):
        cut_windows([records], 0.2)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"areas": [0.0, 1e-3]}, "greater than 0"),
        ({"unit": "psi"}, "Input should be 'Pa', 'kPa', 'bar' or 'MPa'"),
        ({"areas": [[1e-3, 1e-3]] * 2}, "'log.cylinder.areas' of robot 'axis' has 2 entries"),
    ],
)
def test_bad_cylinders_are_refused(wrong, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(hesr.HesrError, match=re.escape(sentence)):
        hesr.new(tmp_path / "axis", bench="sliding", log={"cylinder": CYLINDER | wrong})


def test_a_missing_column_is_named(bench: Path, tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    text = (bench / "axis" / "robot.toml").read_text().replace('"p_b"', '"p_c"')
    robot.write_text(text.replace("bench.urdf", str(bench / "axis" / "bench.urdf")))
    with pytest.raises(hesr.HesrError, match=r"a\.csv: column 'p_c' is missing"):
        hesr.Log.read(bench / "a.csv", robot)


@pytest.mark.ci
def test_the_study_runs(bench: Path) -> None:
    results = hesr.run(
        bench / "axis" / "study.toml",
        output=bench / "results",
        platform=["linux64"],
        quick=True,
    )
    assert (bench / "results" / "report.html").is_file()
    trace = next((bench / "results" / "traces").glob("torques_*.npz"))
    assert "tau_load1" in np.load(trace)
    assert results
