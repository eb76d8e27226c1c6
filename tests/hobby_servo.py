"""Logs of a hobby servo that turns a lever under gravity, simulated by SciPy's solver or the plant.

The truth is a plant with a fine inner step; the positions come in steps of the encoder.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_src.plant.plant_fmu import PlantBody, export_plant
from fmu_src.plant.servo import PositionServo
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.robot import Robot

Array = np.ndarray

LEVER = """<robot name="lever"><link name="base"/><link name="lever"><inertial>
<origin xyz="0 0 {centre}"/><mass value="{mass}"/>
<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint1" type="revolute"><parent link="base"/><child link="lever"/>
<axis xyz="{axis}"/><limit lower="-3" upper="3" effort="10" velocity="20"/></joint></robot>
"""
FINE = 2.5e-4  # inner step of the truth [s]


@dataclass(frozen=True, kw_only=True)
class HobbyServo:
    """A draw: what a fit must find, and its log."""

    robot: Robot
    servo: PositionServo
    armature: float
    law: FrictionLaw
    t: Array
    q_cmd: Array
    q: Array  # in steps of the encoder
    exact: Array

    def write_log(self, path: Path) -> Path:
        """Write time, commands and positions; there is no torque and no velocity."""
        rows = np.column_stack([self.t, self.q_cmd, self.q])
        np.savetxt(path, rows, delimiter=",", header="t,q_cmd1,q1", comments="", fmt="%.9g")
        return path


def write_robot(
    folder: Path, mass: float, centre: float, extra: str = "", axis: str = "0 1 0"
) -> Path:
    """Write the URDF and the robot file of a lever."""
    (folder / "lever.urdf").write_text(LEVER.format(mass=mass, centre=-centre, axis=axis))
    file = folder / "robot.toml"
    file.write_text(
        'name = "lever"\nmodel = "lever.urdf"\njoints = ["joint1"]\n'
        f'{extra}\n[log.columns]\ndq = ""\n'
    )
    return file


def draw_commands(generator: np.random.Generator, t: Array) -> Array:
    """Return sines, then steps, of less than a radian or so."""
    command = np.zeros_like(t)
    for _ in range(4):
        rate = 2.0 * np.pi * generator.uniform(0.1, 1.2)
        command += generator.uniform(0.1, 0.5) * np.sin(rate * t + generator.uniform(0.0, 6.0))
    command *= np.clip(t / 2.0, 0.0, 1.0)
    levels = generator.uniform(-1.0, 1.0, int(t[-1]) + 1)
    stepped = levels[t.astype(int)]
    return np.where(t > 0.6 * t[-1], stepped, command)


def draw_hobby_servo(
    folder: Path,
    seed: int,
    *,
    law_name: str = "coulomb_viscous",
    rate: float | None = None,
    seconds: float = 40.0,
    bits: int = 12,
    extra: str = "",
    body_factor: float = 1.0,
    command_filter: float = 0.0,
    is_vertical: bool = False,
    added_inertia: float = 0.0,
    command_seed: int | None = None,
) -> HobbyServo:
    """Draw lever, servo, friction and commands, and simulate the log in `folder`.

    The lever of the log is heavier than that of the robot file by `body_factor`, or feels no
    gravity about a vertical axis. A disc may add inertia [kg.m2]. The commands may have a seed of
    their own, for further logs of a servo.
    """
    generator = np.random.default_rng(seed)
    chosen_rate = rate or float(generator.choice([50.0, 100.0, 200.0]))
    t = np.arange(int(seconds * chosen_rate) + 1) / chosen_rate
    q_cmd = draw_commands(generator, t)
    if command_seed is not None:
        q_cmd = draw_commands(np.random.default_rng(command_seed), t)
    axis = "0 0 1" if is_vertical else "0 1 0"
    mass = generator.uniform(0.25, 0.5)
    centre = generator.uniform(0.12, 0.2)
    true_robot = Robot(write_robot(folder, mass, centre, extra, axis))
    kp = generator.uniform(8.0, 25.0)
    coulomb = generator.uniform(0.03, 0.15)
    viscous = generator.uniform(0.3, 0.9) * kp / 18.0
    values = {"F_c": coulomb, "sigma_2": viscous, "tau_0": 0.0}
    if law_name == "stribeck":
        values |= {
            "F_s": coulomb * generator.uniform(1.2, 2.0),
            "v_s": generator.uniform(0.05, 0.3),
        }
    law = FrictionLaw(name=law_name, form=estimator(law_name).form({}), values=values)
    servo = PositionServo(
        kp=(kp,),
        ki=(0.0,),
        kd=(0.0,),
        torque_limit=(1e6,),
        command_filter=(command_filter,),
        speed_limit=(1e6,),
        latency=generator.uniform(0.005, 0.04),
    )
    armature = generator.uniform(0.005, 0.03)
    exact = simulate(folder, true_robot, servo, armature + added_inertia, law, t, q_cmd)
    robot = Robot(write_robot(folder, mass / body_factor, centre, extra, axis))
    step = 2.0 * np.pi / 2**bits
    return HobbyServo(
        robot=robot,
        servo=servo,
        armature=armature,
        law=law,
        t=t,
        q_cmd=q_cmd,
        q=step * np.round(exact / step),
        exact=exact,
    )


def simulate(
    folder: Path,
    robot: Robot,
    servo: PositionServo,
    armature: float,
    law: FrictionLaw,
    t: Array,
    q_cmd: Array,
) -> Array:
    """Return the positions (N,) of the plant with a fine inner step."""
    parameters = robot.nominal_parameters.copy()
    parameters[10 * robot.links] = armature
    model = FrictionModel(
        law=law.name, robot=robot.name, joints=robot.joints, laws=(law,), sample_time=t[1] - t[0]
    )
    fmu = export_plant(
        model,
        folder / "truth.fmu",
        plant_body=PlantBody(robot=robot, parameters=parameters),
        servo=servo,
        bare=True,
    )
    return run_along(fmu, t, q_cmd, {"substep": FINE})


def draw_current(draw: HobbyServo, seed: int, kind: str, constant: float = 1.0) -> Array:
    """Return a current without a sign (N,) [A], in steps and with noise.

    It is that of the motor, torque over `constant` [N.m/A], that of the supply (times the duty), or
    a reading that is neither.
    """
    generator = np.random.default_rng([seed, 1])
    rows = np.searchsorted(draw.t, draw.t - draw.servo.latency + 1e-9, side="right") - 1
    error = draw.q_cmd[np.maximum(rows, 0)] - draw.exact
    motor = draw.servo.kp[0] * np.abs(error) / constant
    if kind == "motor":
        size = motor
    elif kind == "supply":
        size = 0.02 + motor * np.abs(error)
    else:
        size = 0.2 + 0.1 * np.sin(3.0 * draw.t)
    noise = 0.02 * np.std(size) * generator.standard_normal(len(size))
    step = np.std(size) / 50.0
    return np.asarray(np.abs(step * np.round((size + noise) / step)))


def run_along(fmu: Path, t: Array, q_cmd: Array, starts: Mapping[str, float]) -> Array:
    """Return the positions (N,) of a plant of one joint along commands, each held for a row."""
    with FmuInstance(fmu) as instance:
        inputs = instance.buffer(["q_cmd[1]"])
        outputs = instance.buffer(["q[1]"])
        inputs.values[:] = q_cmd[0]
        instance.initialise(start=starts, inputs=inputs)
        rows = step_rows(instance, inputs, outputs, t[:-1], np.diff(t), q_cmd[:-1, None])
    return np.concatenate([[starts.get("q_start[1]", 0.0)], rows[:, 0]])
