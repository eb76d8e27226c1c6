"""The closed loop of the UF850, as a system of FMUs and without FMI."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from oracles.monolithic import MonolithicLoop

from cosim.loop.closed_loop import Fmus, Gains, Scheme, Setting, build_system
from cosim.systems.system import SystemSpec
from fmu_src import export_fmu
from fmu_src.arm.native import arm
from fmu_src.arm.plant import Plant
from fmu_src.arm.signals import read_signals
from fmu_src.blocks.controller import controller, velocity
from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.blocks.trajectory import start_values, trajectory
from fmu_src.export.package import write_fmu
from hesr_model.friction.model import FrictionModel
from hesr_model.motions.trajectories import random_fourier
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

UF850 = models_folder() / "uf850"
STEP = 0.005
OBSERVED = ("trajectory.q", "arm.q_true", "controller.dq_cmd")

GAINS = Gains(
    Kp=(0.0036, 0.0052, 0.0082),
    Kd=(2e-6, 3e-6, 4e-6),
    decay=4.0,
    Kv=(90.5, 150.8, 52.8),
    Ki=(905.0, 1508.0, 528.0),
    latency=0.01,
)

MOTION = random_fourier(
    seed=11,
    harmonics=5,
    period=10.0,
    peak_velocity=np.array([1.0, 0.9, 1.0]),
    offset=np.array([0.0, 0.3, -1.9]),
)


@dataclass(frozen=True, kw_only=True)
class Bench:
    """The FMUs of a loop and their models."""

    fmus: Fmus
    robot: Robot
    plant: Plant
    friction: FrictionModel

    @classmethod
    def of(cls, folder: Path, friction: FrictionModel) -> "Bench":
        """The FMUs written into a folder by `write_fmus`."""
        return cls(
            fmus=Fmus(
                arm=folder / "Arm.fmu",
                trajectory=folder / "Trajectory.fmu",
                body=folder / "InverseDynamics.fmu",
                friction=folder / "Friction.fmu",
                controller=folder / "Controller.fmu",
                velocity=folder / "Velocity.fmu",
            ),
            robot=_robot(),
            plant=Plant.read(UF850 / "plant.toml"),
            friction=friction,
        )

    def loop(self, scheme: Scheme, **more: Any) -> MonolithicLoop:
        """The loop without FMI."""
        data = {"motion": MOTION, "gains": GAINS, "step": STEP, "stop": 10.0, "rest": 0.05}
        return MonolithicLoop(
            plant=self.plant,
            robot=self.robot,
            parameters=self.robot.nominal_parameters,
            friction=self.friction,
            scheme=scheme,
            **data | more,
        )

    def system(self, loop: MonolithicLoop, **more: Any) -> SystemSpec:
        """The same loop as a system of FMUs."""
        q0 = tuple(map(float, loop.motion.sample(np.zeros(1))[0][0]))
        setting = Setting(
            fmus=self.fmus,
            scheme=loop.scheme,
            gains=loop.gains,
            step=loop.step,
            time_constant=loop.time_constant,
            arm={"q0": q0},
        )
        motion = start_values(loop.motion) | {"rest_time": loop.rest}
        spec = build_system(setting, duration=loop.stop, motion=motion)
        return spec.model_copy(update={"observe": OBSERVED} | more)


def build(folder: Path, friction: FrictionModel, platforms: Sequence[str] = ("linux64",)) -> Bench:
    """Build the FMUs."""
    write_fmus(folder, friction, platforms)
    return Bench.of(folder, friction)


def write_fmus(
    folder: Path, friction: FrictionModel, platforms: Sequence[str] = ("linux64",)
) -> None:
    """Write the FMUs of a loop."""
    robot, model = _robot(), UF850 / "uf850.xml"
    signals = read_signals(model, UF850 / "arm.toml")
    contents = {
        "Arm": arm(signals, name="UF850", source=model.read_bytes(), platforms=platforms),
        "Trajectory": trajectory(robot.n),
        "InverseDynamics": inverse_dynamics(robot, robot.nominal_parameters),
        "Controller": controller(robot.n),
        "Velocity": velocity(robot.n),
    }
    for name, content in contents.items():
        write_fmu(content, folder / f"{name}.fmu", platforms=platforms)
    export_fmu(friction, folder / "Friction.fmu", platforms=platforms)


def _robot() -> Robot:
    return Robot(RobotDescription.read(UF850 / "robot.toml"))
