"""Logs of an industrial joint under a PID, simulated by the plant with a fine inner step."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hobby_servo import FINE, write_robot

from fmu_src.plant.plant_fmu import PlantBody, export_plant
from fmu_src.plant.servo import PositionServo
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.robot import Robot

Array = np.ndarray

RATE = 1000.0  # [Hz]
_TIMES = 2.0 * np.pi


@dataclass(frozen=True, kw_only=True)
class IndustrialJoint:
    """A draw: what a fit must find, and its log."""

    robot: Robot
    kp: float
    ki: float
    kd: float
    armature: float
    latency: float
    law: FrictionLaw
    t: Array
    q_cmd: Array
    q: Array  # in steps of the encoder
    step: float


def draw_industrial_joint(
    folder: Path, seed: int, *, seconds: float = 20.0, bits: int = 18, extra: str = ""
) -> IndustrialJoint:
    """Draw link, PID, friction and commands, and simulate the log in `folder`."""
    generator = np.random.default_rng(seed)
    t = np.arange(int(seconds * RATE) + 1) / RATE
    q_cmd, dq_cmd = _draw_commands(generator, t)
    mass, centre = generator.uniform(5.0, 15.0), generator.uniform(0.15, 0.4)
    servo_section = f'[servo]\nkind = "pid"\n{extra}'
    robot = Robot(write_robot(folder, mass, centre, servo_section))
    armature = generator.uniform(0.3, 2.0)
    inertia = mass * centre**2 + armature
    bandwidth = _TIMES * generator.uniform(2.0, 6.0)
    kp = inertia * bandwidth**2
    kd = 2.0 * generator.uniform(0.5, 1.0) * inertia * bandwidth
    ki = kp * bandwidth * generator.uniform(0.05, 0.2)
    latency = generator.uniform(0.001, 0.004)
    values = {
        "F_c": generator.uniform(3.0, 15.0),
        "sigma_2": generator.uniform(2.0, 12.0),
        "tau_0": 0.0,
    }
    form = estimator("coulomb_viscous").form({})
    law = FrictionLaw(name="coulomb_viscous", form=form, values=values)
    servo = PositionServo(
        kp=(kp,),
        ki=(ki,),
        kd=(kd,),
        torque_limit=(1e6,),
        command_filter=(0.0,),
        speed_limit=(1e6,),
        latency=latency,
    )
    parameters = robot.nominal_parameters.copy()
    parameters[10 * robot.links] = armature
    model = FrictionModel(
        law=law.name, robot=robot.name, joints=robot.joints, laws=(law,), sample_time=1.0 / RATE
    )
    fmu = export_plant(
        model,
        folder / "truth.fmu",
        plant_body=PlantBody(robot=robot, parameters=parameters),
        servo=servo,
        bare=True,
    )
    step = 2.0 * np.pi / 2**bits
    exact = _run(fmu, t, q_cmd, dq_cmd)
    return IndustrialJoint(
        robot=robot,
        kp=kp,
        ki=ki,
        kd=kd,
        armature=armature,
        latency=latency,
        law=law,
        t=t,
        q_cmd=q_cmd,
        q=step * np.round(exact / step),
        step=step,
    )


def _draw_commands(generator: np.random.Generator, t: Array) -> tuple[Array, Array]:
    """Return positions and speeds of sines that begin at rest."""
    position = np.zeros_like(t)
    speed = np.zeros_like(t)
    for _ in range(5):
        rate = _TIMES * generator.uniform(0.05, 0.8)
        size = generator.uniform(0.1, 0.4)
        phase = generator.uniform(0.0, _TIMES)
        position += size * np.sin(rate * t + phase)
        speed += size * rate * np.cos(rate * t + phase)
    begun = np.clip(t / 2.0, 0.0, 1.0)
    share = begun**2 * (3.0 - 2.0 * begun)
    share_rate = 6.0 * begun * (1.0 - begun) / 2.0
    return share * position, share * speed + share_rate * position


def _run(fmu: Path, t: Array, q_cmd: Array, dq_cmd: Array) -> Array:
    """Return the positions (N,) along commands, each held for a row."""
    commands = np.column_stack([q_cmd, dq_cmd])
    with FmuInstance(fmu) as instance:
        inputs = instance.buffer(["q_cmd[1]", "dq_cmd[1]"])
        outputs = instance.buffer(["q[1]"])
        inputs.values[:] = commands[0]
        instance.initialise(start={"substep": FINE}, inputs=inputs)
        rows = step_rows(instance, inputs, outputs, t[:-1], np.diff(t), commands[:-1])
    return np.concatenate([[0.0], rows[:, 0]])
