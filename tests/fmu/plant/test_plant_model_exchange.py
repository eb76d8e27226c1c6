"""Plants in model exchange move as in co-simulation with ever shorter steps."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from plant_robots import chain
from plant_runs import at, content_of, open_stops, plant, stribeck

from fmu_src.export.package import Version, write_fmu
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from fmu_src.run.fmu import FmuInstance
from hesr_model.friction.inputs import TAU_LOAD
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.lugre import LuGre
from hesr_model.robots.robot import Robot

Array = np.ndarray

INTERVAL = 0.01  # [s]
SPEEDS = np.array([0.5, 0.4, -0.6, 0.5, -0.4, 0.6])
POSTURE = np.array([0.3, -0.8, 1.2, 0.4, 0.5, 0.1])


def solved(path: Path, start: Mapping[str, float], end: float, names: Sequence[str]) -> Array:
    """Rows of variables by a solver of variable order, without slopes of the inputs."""
    result = simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        solver="CVode",
        relative_tolerance=1e-10,
        start_values=dict(start),
        stop_time=end,
        output_interval=INTERVAL,
        output=list(names),
    )
    return np.column_stack([result[name] for name in names])


def stepped(
    path: Path, start: Mapping[str, float], end: float, names: Sequence[str], substep: float
) -> Array:
    with FmuInstance(path) as arm:
        arm.initialise(start={**start, "substep": substep})
        rows = [arm.get(list(names))]
        for k in range(round(end / INTERVAL)):
            arm.step(k * INTERVAL, INTERVAL)
            rows.append(arm.get(list(names)))
    return np.array(rows)


SLIDING = np.array([[12.0, 15.0], [12.0, 15.0], [8.0, 10.0]])
"""Coulomb and viscous friction of three joints [N.m, N.m.s/rad]."""


def sliding(robot: Robot) -> dict[str, float]:
    """Start values of joints that slide without gravity at about 0.5 rad/s."""
    start = at(robot, POSTURE[:3], np.full(3, 0.5)) | open_stops(robot)
    start |= {f"gravity[{k}]": 0.0 for k in (1, 2, 3)}
    return start | {f"tau[{i}]": f_c + 0.5 * s for i, (f_c, s) in enumerate(SLIDING, start=1)}


def bristles(f_c: float, sigma_2: float) -> FrictionLaw:
    values = {"sigma_0": 1e5, "sigma_1": 300.0, "sigma_2": sigma_2, "F_c": f_c, "F_s": 1.1 * f_c,
              "v_s": 0.05, "tau_0": 0.0}  # fmt: skip
    return FrictionLaw(name="lugre", form=LuGre.core({}), values=values)


def falling(robot: Robot) -> dict[str, float]:
    n = robot.n
    start = at(robot, POSTURE[:n], SPEEDS[:n])
    return start | {f"tau[{i}]": 6.0 * (-1.0) ** i for i in range(1, n + 1)}


@pytest.mark.parametrize("fmi", [2, pytest.param(3, marks=pytest.mark.ci)])
def test_steps_approach_the_solution_by_their_square(fmi: Version, tmp_path: Path) -> None:
    robot = Robot(chain(tmp_path, 3))
    whole = content_of(robot, [bristles(*row) for row in SLIDING])
    path = write_fmu(whole, tmp_path / "Plant.fmu", fmi=fmi)
    start, names = sliding(robot), [f"q[{i}]" for i in (1, 2, 3)]
    found = {h: stepped(path, start, 0.5, names, h) for h in (2e-3, 1e-3, 5e-4)}
    if fmi == 3:
        vectors = {n.partition("[")[0] for n in start}
        arrays = {v: [x for n, x in start.items() if n.partition("[")[0] == v] for v in vectors}
        exact = solved(path, arrays, 0.5, ["q"])
    else:
        exact = solved(path, start, 0.5, names)
    errors = [np.abs(rows - exact).max() for rows in found.values()]
    assert errors[1] < 1e-5
    assert 3.5 < errors[0] / errors[1] < 4.5
    assert 3.5 < errors[1] / errors[2] < 4.5


LAWS = ("lugre", "stribeck", "parfam_tanh")


@pytest.mark.parametrize(
    ("joints", "law"),
    [
        (1, "lugre"),
        (1, "stribeck"),
        (3, "parfam_tanh"),
        *(pytest.param(n, law, marks=pytest.mark.ci) for n in (3, 6) for law in LAWS),
    ],
)
def test_reversals_and_rests_are_those_of_short_steps(
    joints: int, law: str, make_law, tmp_path: Path
) -> None:
    robot = Robot(chain(tmp_path, joints))
    one = stribeck() if law == "stribeck" else make_law(law)
    path = plant(robot, [one] * joints, tmp_path)
    start = falling(robot)
    names = [f"{n}[{i}]" for n in ("q", "dq") for i in range(1, joints + 1)]
    exact = solved(path, start, 0.6, names)
    assert np.any(exact[:, joints:] * SPEEDS[:joints] < 0.0) or joints == 1
    coarse, fine = (
        np.abs(stepped(path, start, 0.6, names, h) - exact)[:, :joints].max() for h in (1e-3, 1e-4)
    )
    if law == "stribeck":  # model exchange rounds its jump: 4e-4 rad remain with short steps
        assert max(coarse, fine) < 6e-4
    else:
        assert fine < min(2e-3, 0.3 * coarse)


def test_friction_beyond_any_load_is_refused(load, tmp_path: Path) -> None:
    """A load L = tau - 100 - L^2 does not exist."""
    form = LawForm(coefficients=(), memory=(), output=TAU_LOAD**2 + 100)
    robot = Robot(chain(tmp_path, 1))
    fmu = load(plant(robot, [FrictionLaw(name="by_hand", form=form, values={})], tmp_path))
    c = fmu.instantiate(kind=0)
    assert fmu("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == 0
    assert fmu("EnterInitializationMode", c) == 0
    assert fmu("ExitInitializationMode", c) == 3
    assert "tau_friction[1]: no load was found" in fmu.messages[-1].text


def test_a_plant_with_a_servo_is_for_co_simulation_only(make_law, tmp_path: Path) -> None:
    robot = Robot(chain(tmp_path, 1))
    model = FrictionModel(
        law="by_hand",
        robot=robot.name,
        joints=robot.joints,
        laws=(make_law("lugre"),),
        sample_time=0.005,
    )
    body = PlantBody.from_robot(robot)
    path = export_plant(model, tmp_path / "Plant.fmu", plant_body=body, kv=[9.0], bare=True)
    about = read_model_description(str(path))
    assert about.modelExchange is None
    assert not about.coSimulation.providesDirectionalDerivative


def test_torques_balance_in_model_exchange(make_law, load, tmp_path: Path) -> None:
    """The load that friction sees is what friction and stops leave of the torque."""
    robot = Robot(chain(tmp_path, 3))
    fmu = load(plant(robot, [make_law("parfam_tanh")] * 3, tmp_path))
    joints = (1, 2, 3)
    for tau in (0.0, 30.0):
        c = fmu.continuous({f"tau[{i}]": tau for i in joints})
        stems = ("q", "dq", "ddq", "tau_load", "tau_friction", "tau_stop")
        rows = {s: np.array(fmu.get(c, *(f"{s}[{i}]" for i in joints))) for s in stems}
        needed = rows["tau_load"] + rows["tau_friction"] + rows["tau_stop"]
        np.testing.assert_allclose(needed, tau, atol=1e-10)
        mass, bias = robot.dynamics(robot.nominal_parameters, rows["q"][None], rows["dq"][None])
        np.testing.assert_allclose(mass[0] @ rows["ddq"] + bias[0], rows["tau_load"], atol=1e-9)
