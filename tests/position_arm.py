"""A six-joint arm under proportional servos, simulated by MuJoCo with tight friction.

The chain has the sizes of a small industrial arm. The robot file may state other masses.
"""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot

Array = np.ndarray

JOINTS = 6
RATE = 100.0  # of the logs [Hz]
STEP = 2.5e-4  # of the simulation [s]
LATENCY = 0.012  # [s]
KP = np.array([900.0, 1200.0, 600.0, 150.0, 100.0, 60.0])
DAMPING = np.array([70.0, 90.0, 35.0, 5.0, 3.0, 1.2])
FRICTION = np.array([8.0, 10.0, 5.0, 1.5, 1.0, 0.6])
ARMATURE = np.array([0.8, 0.9, 0.5, 0.08, 0.05, 0.03])
_MASSES = np.array([3.7, 8.4, 2.3, 1.2, 1.2, 0.5])
_AXES = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0")
_PLACES = ("0 0 0.16", "0 0.13 0", "0 -0.12 0.42", "0 0 0.39", "0 0.09 0", "0 0 0.09")
_CENTRES = ("0 0 0", "0 0 0.21", "0 0 0.19", "0 0.02 0", "0 0 0.02", "0.03 0 0.05")
_SIZES = (0.05, 0.12, 0.1, 0.04, 0.04, 0.03)  # radii of gyration [m]
# Friction that hardly creeps: see solreffriction in MuJoCo's manual.
_TIGHT = 'solreffriction="0.0005 1" solimpfriction="0.9999 0.9999 0.001"'


@dataclass(frozen=True, kw_only=True)
class PositionArm:
    """Robot with the stated masses, and its logs with and without steps of the encoder."""

    robot: Robot
    logs: tuple[Log, ...]
    exact: tuple[Array, ...]


def write_chain(mass_factors: Array) -> str:
    """Return the MJCF of the chain; masses and inertias are multiplied."""
    opening, closing = "", ""
    for j in range(JOINTS):
        mass = _MASSES[j] * mass_factors[j]
        inertia = mass * _SIZES[j] ** 2
        opening += (
            f'<body name="link{j + 1}" pos="{_PLACES[j]}"><joint name="joint{j + 1}" '
            f'axis="{_AXES[j]}" damping="{DAMPING[j]}" frictionloss="{FRICTION[j]}" '
            f'armature="{ARMATURE[j]}" {_TIGHT}/><inertial pos="{_CENTRES[j]}" mass="{mass:.9g}" '
            f'diaginertia="{inertia:.9g} {inertia:.9g} {0.8 * inertia:.9g}"/>'
        )
        closing += "</body>"
    actuators = "".join(f'<position joint="joint{j + 1}" kp="{KP[j]}"/>' for j in range(JOINTS))
    return (
        f'<mujoco model="arm"><option timestep="{STEP}" integrator="implicitfast" '
        f'iterations="100" tolerance="1e-12"/><worldbody>{opening}{closing}</worldbody>'
        f"<actuator>{actuators}</actuator></mujoco>"
    )


def write_arm(folder: Path, mass_factors: Array) -> Path:
    """Write model and robot file of the arm with other masses."""
    (folder / "arm.xml").write_text(write_chain(mass_factors))
    joints = ", ".join(f'"joint{j + 1}"' for j in range(JOINTS))
    file = folder / "robot.toml"
    file.write_text(
        f'name = "arm"\nmodel = "arm.xml"\njoints = [{joints}]\n[log.columns]\ndq = ""\n'
    )
    return file


def draw_motion(generator: np.random.Generator, t: Array) -> Array:
    """Return commands (N, 6) of sines that begin at rest."""
    commands = np.zeros((len(t), JOINTS))
    for j in range(JOINTS):
        for _ in range(4):
            rate = 2.0 * np.pi * generator.uniform(0.05, 0.5)
            size = generator.uniform(0.1, 0.35)
            commands[:, j] += size * np.sin(rate * t + generator.uniform(0.0, 6.0))
    begun = np.clip(t / 2.0, 0.0, 1.0)
    share = begun**2 * (3.0 - 2.0 * begun)
    return np.asarray(share[:, None] * commands)


def simulate_arm(q_cmd: Array) -> Array:
    """Return the positions (N, 6) of the arm along late commands, each held for a row."""
    model = mujoco.MjModel.from_xml_string(write_chain(np.ones(JOINTS)))
    data = mujoco.MjData(model)
    steps_per_row = round(1.0 / RATE / STEP)
    late_steps = round(LATENCY / STEP)
    q = np.zeros_like(q_cmd)
    for k in range((len(q_cmd) - 1) * steps_per_row):
        row = max(k - late_steps, 0) // steps_per_row
        data.ctrl[:] = q_cmd[row]
        mujoco.mj_step(model, data)
        if (k + 1) % steps_per_row == 0:
            q[(k + 1) // steps_per_row] = data.qpos
    return q


def draw_position_arm(
    folder: Path, seed: int, *, motions: int = 4, seconds: float = 15.0, bits: int = 12
) -> PositionArm:
    """Simulate motions of the arm; its robot file has the true masses."""
    generator = np.random.default_rng(seed)
    robot = Robot(write_arm(folder, np.ones(JOINTS)))
    t = np.arange(int(seconds * RATE) + 1) / RATE
    step = 2.0 * np.pi / 2**bits
    logs, exact = [], []
    for number in range(motions):
        q_cmd = draw_motion(generator, t)
        q = simulate_arm(q_cmd)
        rounded = step * np.round(q / step)
        logs.append(Log(t=t, q=rounded, q_cmd=q_cmd, robot=robot, name=f"motion{number + 1}"))
        exact.append(q)
    return PositionArm(robot=robot, logs=tuple(logs), exact=tuple(exact))
