"""Speed of plant FMUs, as a ratio to MuJoCo's step of the same chain."""

import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import mujoco
import numpy as np
import pytest

from fmu_src.arm.clock import stop_clock
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr_model.friction.law import FrictionLaw
from hesr_model.laws.lugre import LuGre
from hesr_model.robots.robot import Robot

sys.path.append(str(Path(__file__).parents[1] / "fmu" / "plant"))
from plant_robots import chain
from plant_runs import open_stops, plant

STEP, STEPS, ROUNDS = 1e-3, 10_000, 20
PART = 1000  # steps of a call from Python, which takes 10 us
AIMS = {3: 0.25, 6: 0.35, 7: 0.5}  # of MuJoCo's step; not reached yet
LEVELS = (12.0, 12.0, 8.0, 3.0, 3.0, 3.0, 3.0)  # Coulomb friction [N.m]


def lugre(level: float) -> FrictionLaw:
    values = {"sigma_0": 1e4, "sigma_1": 30.0, "sigma_2": 1.25 * level, "F_c": level,
              "F_s": 1.2 * level, "v_s": 0.05, "tau_0": 0.0}  # fmt: skip
    return FrictionLaw(name="lugre", form=LuGre.core({}), values=values)


def torques(joints: int) -> np.ndarray:
    """Torques (STEPS, n) that keep all joints in motion and reverse them."""
    t = STEP * np.arange(STEPS)[:, None]
    return 4.0 * np.array(LEVELS[:joints]) * np.sin(2 * np.pi * (0.4 + 0.1 * np.arange(joints)) * t)


def of_plant(arm: FmuInstance, tau: np.ndarray) -> np.ndarray:
    """Return the times of set, step and get [s], by part; outputs are positions and speeds."""
    joints = range(1, tau.shape[1] + 1)
    inputs = arm.buffer([f"tau[{i}]" for i in joints])
    outputs = arm.buffer([f"{name}[{i}]" for name in ("q", "dq") for i in joints])
    sizes = np.full(PART, STEP)
    parts = []
    for first in range(0, len(tau), PART):
        times = STEP * np.arange(first, first + PART)
        began = perf_counter()
        step_rows(arm, inputs, outputs, times, sizes, tau[first : first + PART])
        parts.append((perf_counter() - began) / PART)
    return np.array(parts)


def of_mujoco(model: mujoco.MjModel, tau: np.ndarray) -> np.ndarray:
    """Return the times of a step [s], by part; torques are held over a part."""
    data = mujoco.MjData(model)
    parts = []
    with stop_clock():
        for torque in tau[::PART]:
            data.qfrc_applied[:] = torque
            began = perf_counter()
            mujoco.mj_step(model, data, PART)
            parts.append((perf_counter() - began) / PART)
    return np.array(parts)


def lean(path: Path) -> mujoco.MjModel:
    """MuJoCo's model without contacts, limits and actuators; its friction is explicit damping."""
    model = mujoco.MjModel.from_xml_path(str(path))
    for name in ("CONTACT", "LIMIT", "EULERDAMP"):
        model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")
    model.opt.timestep = STEP
    model.dof_damping[:] = 1.25 * np.array(LEVELS[: model.nv])
    return model


@pytest.mark.parametrize("joints", AIMS)
def test_a_step_is_faster_than_one_of_mujoco(
    joints: int, tmp_path: Path, tell: Callable[[str], None]
) -> None:
    path = chain(tmp_path, joints)
    robot, tau, model = Robot(path), torques(joints), lean(path)
    fmu = plant(robot, [lugre(level) for level in LEVELS[:joints]], tmp_path)
    rounds = []
    with FmuInstance(fmu) as arm:
        for _ in range(ROUNDS):
            if arm.used:
                arm.reset()
            arm.initialise(start=open_stops(robot) | {f"tau[{i + 1}]": 0.0 for i in range(joints)})
            rounds.append((of_plant(arm, tau), of_mujoco(model, tau)))
    own, other = np.min(rounds, axis=0).mean(axis=1)  # parts that nothing else disturbed
    ratio = own / other
    aim = f"aim {AIMS[joints]:g}"
    tell(f"plant of {joints} joints: {1e9 * own:.0f} ns, {ratio:.2f} of MuJoCo's ({aim})")
    assert ratio < 1.0
