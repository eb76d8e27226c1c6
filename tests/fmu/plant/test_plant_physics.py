"""Energy, sticking, stability and accuracy of plants."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest
import sympy
from plant_robots import UF850, coupled, ur_like
from plant_runs import Run, at, open_stops, plant

from fmu_src.plant.plant_fmu import STIFFNESS
from fmu_src.run.fmu import FmuInstance
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.laws.lugre import LuGre, LuGrePassive
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import Transmission

POSTURE = np.array([0.3, -0.8, 1.2, 0.4, 0.5, 0.1])
DRIFT = 1e-3  # of the exchanged energy
CREEP = 1e-6  # rad in 60 s
RISE = 1e-7  # of the exchanged energy

Array = np.ndarray


def frictionless() -> FrictionLaw:
    form = LawForm(coefficients=(), memory=(), output=sympy.Integer(0))
    return FrictionLaw(name="by_hand", form=form, values={})


def gravity(robot: Robot, q: Array) -> Array:
    _, bias = robot.dynamics(robot.nominal_parameters, q[None], np.zeros((1, robot.n)))
    return bias[0]


def kinetic(robot: Robot, run: Run) -> Array:
    mass, _ = robot.dynamics(robot.nominal_parameters, run.q, run.dq)
    return 0.5 * np.einsum("ki,kij,kj->k", run.dq, mass, run.dq)


def test_an_arm_without_friction_keeps_its_energy(tmp_path: Path) -> None:
    """The kinetic energy changes by the work of gravity along the path."""
    robot = Robot(UF850)
    fmu = plant(robot, [frictionless()] * robot.n, tmp_path)
    start = at(robot, np.array([0.3, 0.5, -1.2]), np.array([0.5, -0.2, 0.4]))
    run = Run(fmu, np.zeros((10_000, 3)), step=1e-3, start=start | open_stops(robot))
    energy = kinetic(robot, run)
    _, load = robot.dynamics(robot.nominal_parameters, run.q, np.zeros_like(run.q))
    middle = 0.5 * (load[1:] + load[:-1]) * np.diff(run.q, axis=0)
    whole = energy[1:] + np.cumsum(middle.sum(axis=1))
    exchanged = np.abs(np.diff(energy)).sum()
    assert exchanged > 100.0
    assert np.ptp(whole) < DRIFT * exchanged


def lugre(sigma_0: float, f_c: float, sigma_2: float) -> FrictionLaw:
    """LuGre of the registry with a static friction 10 % above the Coulomb friction."""
    values = {"sigma_0": sigma_0, "sigma_1": 3e-3 * sigma_0, "sigma_2": sigma_2, "F_c": f_c,
              "F_s": 1.1 * f_c, "v_s": 0.05, "tau_0": 0.0}  # fmt: skip
    return FrictionLaw(name="lugre", form=LuGre.core({}), values=values)


SLIDING = np.array([[12.0, 15.0], [12.0, 15.0], [8.0, 10.0], [3.0, 4.0], [3.0, 4.0], [3.0, 4.0]])
"""Coulomb and viscous friction of six joints [N.m, N.m.s/rad]."""


def test_sliding_bristles_are_of_second_order(tmp_path: Path) -> None:
    """Six joints under LuGre for 1.5 s at about 0.5 rad/s, from the steady state."""
    robot = Robot(ur_like(tmp_path))
    fmu = plant(robot, [lugre(1e5, *row) for row in SLIDING], tmp_path)
    weightless = {f"gravity[{k}]": 0.0 for k in (1, 2, 3)} | open_stops(robot)
    start = at(robot, POSTURE, np.full(6, 0.5)) | weightless
    waves = np.sin(2.0 * 0.01 * np.arange(150)[:, None] + np.arange(6))
    tau = SLIDING[:, 0] + 0.5 * SLIDING[:, 1] * (1.0 + 0.3 * waves)
    ends = []
    for substep in (2e-3, 1e-3, 2e-5):
        run = Run(fmu, tau, step=0.01, start=start | {"substep": substep})
        assert np.min(run.dq) > 0.1
        ends.append(run.q[-1])
    coarse, fine = (np.max(np.abs(end - ends[2])) for end in ends[:2])
    assert fine < 1e-5
    assert 3.5 < coarse / fine < 4.5


def test_laws_evaluated_at_once_give_what_each_gives(tmp_path: Path) -> None:
    """A joint with another form of the same law forces the evaluation one by one."""
    robot, law = Robot(ur_like(tmp_path)), lugre(1e4, 5.0, 4.0)
    spare = Coefficient(name="spare", unit="N.m.s/rad", description="more viscous friction")
    form = replace(
        law.form,
        coefficients=(*law.form.coefficients, spare),
        output=law.form.output + spare.symbol * DQ,
    )
    other = replace(law, form=form, values=law.values | {"spare": 0.0})
    tau = gravity(robot, POSTURE) + 15.0 * np.sin(0.02 * np.arange(300)[:, None] + np.arange(6))
    found = []
    for name, laws in {"alike": [law] * 6, "mixed": [*[law] * 5, other]}.items():
        home = tmp_path / name
        home.mkdir()
        run = Run(plant(robot, laws, home), tau, step=0.001, start=at(robot, POSTURE))
        found.append(run.q)
    assert np.ptp(found[0], axis=0).max() > 0.01
    np.testing.assert_allclose(*found, atol=1e-9)


@pytest.mark.parametrize("name", ["parfam_s", "gms"])
def test_laws_with_stops_hold_an_arm(name: str, fitted, tmp_path: Path) -> None:
    robot = Robot(ur_like(tmp_path))
    fmu = plant(robot, [fitted[name]] * robot.n, tmp_path)
    tau = np.tile(gravity(robot, POSTURE) + 0.5, (8000, 1))
    run = Run(fmu, tau, step=0.01, start=at(robot, POSTURE))
    assert np.max(np.abs(run.q[2000:] - run.q[2000])) < CREEP


def test_bristles_hold_an_arm_against_gravity(make_law, tmp_path: Path) -> None:
    robot = Robot(ur_like(tmp_path))
    bristle = make_law("lugre")
    bristle = replace(bristle, values=bristle.values | {"sigma_0": 2e4, "sigma_1": 2e3})
    fmu = plant(robot, [bristle] * robot.n, tmp_path)
    push = np.array([0.0, 3.0, -3.0, 2.0, 1.0, 1.0])
    tau = np.tile(gravity(robot, POSTURE) + push, (8000, 1))
    run = Run(fmu, tau, step=0.01, start=at(robot, POSTURE))
    settled = run.q[2000]
    assert np.max(np.abs(settled - POSTURE)) > 1e-5  # the bristles carry something
    assert np.max(np.abs(run.q[2000:] - settled)) < CREEP


def test_lightly_damped_bristles_come_to_rest(tmp_path: Path) -> None:
    """With 1 % damping at inner steps of 1 ms, within 20 s."""
    robot = Robot(ur_like(tmp_path))
    mass, _ = robot.dynamics(robot.nominal_parameters, POSTURE[None], np.zeros((1, 6)))
    stiffness, laws = 2e4, []
    for inertia in np.diag(mass[0]):
        law = lugre(stiffness, 5.0, 0.0)
        damping = 0.02 * np.sqrt(stiffness * inertia)
        laws.append(replace(law, values=law.values | {"sigma_1": damping}))
    push = np.array([0.0, 3.0, -3.0, 2.0, 1.0, 1.0])
    tau = np.tile(gravity(robot, POSTURE) + push, (4000, 1))
    start = at(robot, POSTURE) | open_stops(robot)
    run = Run(plant(robot, laws, tmp_path), tau, step=0.01, start=start)
    assert np.ptp(run.q[:500], axis=0).max() > 5e-4
    assert np.ptp(run.q[2000:], axis=0).max() < CREEP


def test_passive_bristles_add_no_energy(tmp_path: Path) -> None:
    """A falling arm without input: the energy of arm and bristles only decreases."""
    path = ur_like(tmp_path)
    robot, model = Robot(path), pinocchio.buildModelFromUrdf(str(path))
    values = {"sigma_0": 5e4, "sigma_1": 2.0, "s_2": 0.5, "F_c": 2.0, "F_s": 4.0, "v_s": 0.3,
              "tau_0": 0.0}  # fmt: skip
    law = FrictionLaw(name="lugre_passive", form=LuGrePassive.core({}), values=values)
    start = at(robot, POSTURE, np.array([0.5, -0.3, 0.4, 0.2, 0.1, 0.3])) | open_stops(robot)
    names = [f"{name}[{i}]" for name in ("q", "dq", "z") for i in range(1, 7)]
    with FmuInstance(plant(robot, [law] * 6, tmp_path)) as arm:
        arm.initialise(start=start | {f"tau[{i}]": 0.0 for i in range(1, 7)})
        outputs = arm.buffer(names)
        rows = [outputs.read().copy()]
        for k in range(4000):
            arm.step(1e-3 * k, 1e-3)
            rows.append(outputs.read().copy())
    data, energy, kinetic_energy = model.createData(), [], []
    for q, dq, z in (np.split(row, 3) for row in rows):
        kinetic_energy.append(pinocchio.computeKineticEnergy(model, data, q, dq))
        stored = pinocchio.computePotentialEnergy(model, data, q) + 0.5 * 5e4 * z @ z
        energy.append(kinetic_energy[-1] + stored)
    exchanged = np.abs(np.diff(kinetic_energy)).sum()
    rise = np.max(np.array(energy) - np.minimum.accumulate(energy))
    assert exchanged > 100.0
    assert energy[0] - energy[-1] > 50.0
    assert rise <= RISE * exchanged


def test_a_law_with_a_jump_holds_exactly(make_law, tmp_path: Path) -> None:
    robot = Robot(ur_like(tmp_path))
    fmu = plant(robot, [make_law("viscous")] * robot.n, tmp_path)
    tau = np.tile(gravity(robot, POSTURE) + 2.0, (200, 1))
    run = Run(fmu, tau, step=0.01, start=at(robot, POSTURE))
    np.testing.assert_array_equal(run.q[1:], np.tile(POSTURE, (200, 1)))
    np.testing.assert_allclose(run.tau_friction[1:], 2.0, atol=1e-9)


@pytest.mark.parametrize("name", ["stribeck", "lugre", "mlp_h"])
def test_steps_of_10_ms_are_stable(name: str, fitted, tmp_path: Path) -> None:
    robot = Robot(ur_like(tmp_path))
    fmu = plant(robot, [fitted[name]] * robot.n, tmp_path)
    t = 0.01 * np.arange(300)
    tau = gravity(robot, POSTURE) + np.outer(np.sin(2.0 * t), [15.0, 20.0, 15.0, 8.0, 8.0, 8.0])
    found = [
        Run(
            fmu,
            np.repeat(tau, more, axis=0),
            step=0.01 / more,
            start=at(robot, POSTURE) | {"substep": 0.01 / more} | open_stops(robot),
        )
        for more in (1, 20)
    ]
    coarse, fine = (np.max(np.abs(run.dq), axis=0) for run in found)
    assert np.all(coarse < 2.0 * fine + 0.1)


def test_smooth_sliding_is_of_second_order(make_law, tmp_path: Path) -> None:
    robot = Robot(ur_like(tmp_path))
    fmu = plant(robot, [make_law("bare")] * robot.n, tmp_path)
    start = at(robot, POSTURE, np.full(6, 0.8)) | open_stops(robot)
    tau = gravity(robot, POSTURE) + np.array([15.0, 20.0, 32.0, 11.0, 14.0, 14.0])
    ends = []
    for step in (2e-3, 1e-3, 5e-5):
        rows = np.tile(tau, (round(0.3 / step), 1))
        ends.append(Run(fmu, rows, step=step, start=start | {"substep": step}).q[-1])
    coarse, fine = (np.max(np.abs(end - ends[2])) for end in ends[:2])
    assert fine < 1e-5
    assert 3.5 < coarse / fine < 4.5


def test_coupled_motors_hold_and_release(make_law, tmp_path: Path) -> None:
    """Friction acts at the motors: the torque on joint 5 includes that of motor 6."""
    robot = Robot(coupled(tmp_path))
    fmu = plant(robot, [make_law("viscous")] * robot.n, tmp_path)
    forward = robot.description.coupling.forward
    push = np.array([1.0, 2.0, -2.0, 1.0, 1.5, -1.0])
    tau = np.tile(gravity(robot, POSTURE) + forward.T @ push, (100, 1))
    run = Run(fmu, tau, step=0.01, start=at(robot, POSTURE))
    assert np.max(np.abs(run.q - POSTURE)) < 1e-12
    np.testing.assert_allclose(run.tau_friction[-1], forward.T @ push, atol=1e-9)


def test_stops_keep_a_falling_arm_within_its_limits(make_law, tmp_path: Path) -> None:
    robot = Robot(ur_like(tmp_path))
    fmu = plant(robot, [make_law("bare")] * robot.n, tmp_path)
    stops = {f"q_min[{i}]": q - 0.3 for i, q in enumerate(POSTURE, start=1)}
    stops |= {f"q_max[{i}]": q + 0.3 for i, q in enumerate(POSTURE, start=1)}
    run = Run(fmu, np.zeros((3000, 6)), step=0.002, start=at(robot, POSTURE) | stops)
    _, load = robot.dynamics(robot.nominal_parameters, run.q, np.zeros_like(run.q))
    sag = np.max(np.linalg.norm(load, axis=1)) / STIFFNESS
    deepest = sag + np.sqrt(sag**2 + 2.0 * np.max(kinetic(robot, run)) / STIFFNESS)
    beyond = np.max(np.abs(run.q - POSTURE), axis=1) - 0.3
    assert np.max(beyond) < deepest  # the springs store no more than the energy of the fall
    assert 0.0 < beyond[-1] < sag
    assert np.max(np.abs(run.dq[-1])) < 0.01


@pytest.mark.ci
def test_stops_do_not_act_on_coupled_motors(make_law, tmp_path: Path) -> None:
    """The second motor's angle is not that of the second joint."""
    matrix = np.diag([101.0, 101.0, 101.0, 80.0, 80.0, 80.0])
    matrix[1, 0] = 101.0
    transmission = Transmission(matrix=tuple(map(tuple, matrix.tolist())))
    robot = Robot(coupled(tmp_path).model_copy(update={"transmission": transmission}))
    fmu = plant(robot, [make_law("viscous")] * robot.n, tmp_path)
    push = np.array([20.0, 20.0, 0.0, 0.0, 0.0, 0.0])
    tau = np.tile(gravity(robot, POSTURE) + push, (200, 1))
    start = at(robot, POSTURE) | open_stops(robot)
    stops = {f"q_{end}[{i}]": POSTURE[i - 1] for i in (1, 2) for end in ("min", "max")}
    free, stopped = (Run(fmu, tau, step=0.005, start=start | more) for more in ({}, stops))
    assert abs(free.q[-1, 1] - POSTURE[1]) > 0.1
    np.testing.assert_array_equal(stopped.q, free.q)


def test_payload_and_gravity_are_those_of_the_load_torque(make_law, tmp_path: Path) -> None:
    """A point mass as payload acts as in the last link; gravity is linear."""
    robot = Robot(ur_like(tmp_path))
    fmu = plant(robot, [frictionless()] * robot.n, tmp_path)
    names = [f"ddq[{i}]" for i in range(1, 7)]
    place, mass = np.array([0.05, -0.02, 0.1]), 2.5
    inertia = mass * (place @ place * np.eye(3) - np.outer(place, place))
    more = [mass, *(mass * place)]
    more += [inertia[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    parameters = robot.nominal_parameters.copy()
    parameters[50:60] += more
    payload = {"payload.m": mass} | {f"payload.com[{k}]": x for k, x in enumerate(place, start=1)}
    for turn in (1.0, -0.5):
        g = {f"gravity[{k}]": turn * x for k, x in enumerate(robot.gravity, start=1)}
        with FmuInstance(fmu) as arm:
            arm.initialise(start=at(robot, POSTURE) | payload | g)
            found = arm.get(names)
        inertial, bias = robot.dynamics(parameters, POSTURE[None], np.zeros((1, 6)))
        np.testing.assert_allclose(found, np.linalg.solve(inertial[0], -turn * bias[0]), rtol=1e-9)
