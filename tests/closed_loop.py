"""The closed loop of the UF850, as a system of FMUs and without FMI."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.closed_loop import Fmus, Gains, Scheme, Setting, system
from cosim.monolithic import Loop
from cosim.system import SystemSpec
from fmu_src import export_fmu
from fmu_src.arm.native import arm
from fmu_src.arm.plant import Plant
from fmu_src.arm.signals import signals_of
from fmu_src.blocks.controller import controller
from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.blocks.trajectory import start_values, trajectory
from fmu_src.blocks.velocity import velocity
from fmu_src.package import write_fmu
from hesr_model.files import models_folder
from hesr_model.friction.model import FrictionModel
from hesr_model.robot import RobotDescription, RobotModel
from hesr_model.trajectories import random_fourier

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
    """The FMUs of a loop and what they are made of."""

    fmus: Fmus
    robot: RobotModel
    plant: Plant
    friction: FrictionModel

    def loop(self, scheme: Scheme, **more: Any) -> Loop:
        """The loop without FMI."""
        data = {"motion": MOTION, "gains": GAINS, "step": STEP, "stop": 10.0, "rest": 0.05}
        return Loop(
            plant=self.plant,
            robot=self.robot,
            parameters=self.robot.nominal_parameters,
            friction=self.friction,
            scheme=scheme,
            **data | more,
        )

    def system(self, loop: Loop, **more: Any) -> SystemSpec:
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
        spec = system(setting, duration=loop.stop, motion=motion)
        return spec.model_copy(update={"observe": OBSERVED} | more)


def build(folder: Path, friction: FrictionModel) -> Bench:
    """Build the FMUs."""
    robot = RobotModel(RobotDescription.read(UF850 / "robot.toml"))
    model = UF850 / "uf850.xml"
    signals = signals_of(model, UF850 / "arm.toml")
    contents = {
        "Arm": arm(signals, name="UF850", source=model.read_bytes()),
        "Trajectory": trajectory(robot.n),
        "InverseDynamics": inverse_dynamics(robot, robot.nominal_parameters),
        "Controller": controller(robot.n),
        "Velocity": velocity(robot.n),
    }
    made = {name: write_fmu(c, folder / f"{name}.fmu") for name, c in contents.items()}
    return Bench(
        fmus=Fmus(
            arm=made["Arm"],
            trajectory=made["Trajectory"],
            body=made["InverseDynamics"],
            friction=export_fmu(friction, folder / "Friction.fmu"),
            controller=made["Controller"],
            velocity=made["Velocity"],
        ),
        robot=robot,
        plant=Plant.read(UF850 / "plant.toml"),
        friction=friction,
    )
