"""Forward dynamics of plants against Pinocchio and MuJoCo."""

import ctypes
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
from plant_robots import robots, tree, ur_like

from fmu_src.export.package import read_c_source
from fmu_src.plant.dynamics import dynamics_header, table
from fmu_src.plant.plant_fmu import PlantBody
from hesr_model.robots.robot import Robot
from hesr_model.support.compiler import compile_c

NAMES = ("mounted MJCF", "UR", "tree", "followers", "coupled", "springs")
STATES = 50
AGREEMENT = 1e-9  # of the largest acceleration

Array = np.ndarray


class Generated:
    """The generated C of a robot, compiled."""

    def __init__(self, robot: Robot, folder: Path) -> None:
        self.robot = robot
        springs = np.random.default_rng(4).uniform(-20, 20, len(robot.springs))
        parameters = robot.nominal_parameters.copy()
        parameters[robot.inertial :] = springs
        self.body = PlantBody(robot=robot, parameters=parameters)
        (folder / "law_math.h").write_text(read_c_source("law_math.h"))
        source = folder / "dynamics.c"
        source.write_text(
            f'#include "law_math.h"\nenum {{ JOINTS = {robot.n} }};\n{dynamics_header(robot)}\n'
            "void run(const double *p, const double *rotor, const double *spring,"
            " const double *gravity, const double *q, const double *dq, double (*mass)[JOINTS],"
            " double *bias) {\n    (void)regrouped;\n"
            "    dynamics(p, rotor, spring, gravity, q, dq, mass, bias);\n}\n"
        )
        library = folder / "dynamics.so"
        compile_c(source, ("-shared", "-fPIC", "-O1", "-std=c99"), library, ("-lm",))
        self._run = ctypes.CDLL(str(library)).run

    def acceleration(self, q: Array, dq: Array, tau: Array) -> Array:
        """Return the acceleration (n,) of a state under torques, in joint coordinates."""
        n, coupling = self.robot.n, self.robot.description.coupling
        forward = np.eye(n) if coupling is None else coupling.forward
        parameters = table(self.robot) @ self.body.parameters[: 10 * self.robot.links]
        mass, bias = np.zeros((n, n)), np.zeros(n)
        springs = self.body.parameters[self.robot.inertial :]
        given = (
            parameters,
            self.body.rotors,
            springs,
            self.robot.gravity,
            forward @ q,
            forward @ dq,
        )
        arrays = [*(np.ascontiguousarray(a, dtype=float) for a in given), mass, bias]
        self._run(*(a.ctypes.data_as(ctypes.c_void_p) for a in arrays))
        whole = np.tril(mass) + np.tril(mass, -1).T
        return np.linalg.solve(forward.T @ whole @ forward, tau - forward.T @ bias)


def states(robot: Robot) -> list[tuple[Array, Array, Array]]:
    rng, n = np.random.default_rng(3), robot.n
    return [
        (rng.uniform(-3, 3, n), rng.uniform(-3, 3, n), rng.uniform(-50, 50, n))
        for _ in range(STATES)
    ]


def worst(found: Array, expected: Array) -> float:
    return float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))


@pytest.mark.parametrize("name", NAMES)
def test_accelerations_are_those_of_the_regressor(name: str, tmp_path: Path) -> None:
    robot = robots(tmp_path)[name]
    generated = Generated(robot, tmp_path)
    for q, dq, tau in states(robot):
        mass, bias = robot.dynamics(generated.body.parameters, q[None], dq[None])
        expected = np.linalg.solve(mass[0], tau - bias[0])
        assert worst(generated.acceleration(q, dq, tau), expected) < AGREEMENT


@pytest.mark.parametrize("arm", [ur_like, tree])
def test_accelerations_are_those_of_pinocchio_and_mujoco(arm, tmp_path: Path) -> None:
    path = arm(tmp_path)
    robot = Robot(path)
    generated = Generated(robot, tmp_path)
    model = pinocchio.buildModelFromUrdf(str(path))
    data = model.createData()
    other = mujoco.MjModel.from_xml_path(str(path))
    other.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    other.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    state = mujoco.MjData(other)
    order = [other.joint(name).dofadr[0] for name in robot.joints]
    own = [model.joints[model.getJointId(name)].idx_v for name in robot.joints]
    for q, dq, tau in states(robot):
        found = generated.acceleration(q, dq, tau)
        state.qpos[order], state.qvel[order], state.qfrc_applied[order] = q, dq, tau
        mujoco.mj_forward(other, state)
        assert worst(found, state.qacc[order]) < AGREEMENT
        placed = [np.empty(robot.n) for _ in range(3)]
        for array, values in zip(placed, (q, dq, tau), strict=True):
            array[own] = values
        assert worst(found, pinocchio.aba(model, data, *placed)[own]) < AGREEMENT
