"""Plant FMUs of small robots, and how to run them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fmu_src.export.package import Content, write_fmu
from fmu_src.plant.plant_fmu import PlantBody, ServoGains, content
from fmu_src.run.fmu import FmuInstance
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.stribeck import Stribeck
from hesr_model.robots.robot import Robot

Array = np.ndarray


def stribeck() -> FrictionLaw:
    """A law that jumps at rest."""
    values = {"F_c": 4.0, "F_s": 5.0, "v_s": 0.1, "sigma_2": 3.0, "tau_0": 0.1}
    return FrictionLaw(name="stribeck", form=Stribeck.core({}), values=values)


def content_of(
    robot: Robot,
    laws: Sequence[FrictionLaw],
    *,
    servo: ServoGains | None = None,
    tool: bool = False,
) -> Content:
    """Return the plant of a robot with the masses of its model file."""
    model = FrictionModel(
        law="by_hand",
        robot=robot.name,
        joints=robot.joints,
        laws=tuple(laws),
        sample_time=0.005,
        sliding=robot.slides if any(robot.slides) else (),
        coupling=robot.description.coupling,
    )
    return content(model, PlantBody.from_robot(robot), servo=servo, tool=tool, bare=True)


def plant(robot: Robot, laws: Sequence[FrictionLaw], folder: Path) -> Path:
    """Write that plant."""
    return write_fmu(content_of(robot, laws), folder / "Plant.fmu")


class Run:
    """A plant under torques (K, n), each held over a step.

    Attributes
    ----------
    q, dq, ddq, tau_friction : (K + 1, n) at the start and at the end of every step.
    """

    def __init__(
        self, fmu: Path, tau: Array, *, step: float, start: Mapping[str, float] | None = None
    ) -> None:
        joints = range(1, tau.shape[1] + 1)
        stems = ("q", "dq", "ddq", "tau_friction")
        rows = np.empty((len(tau) + 1, len(stems) * tau.shape[1]))
        first = {f"tau[{i}]": value for i, value in zip(joints, tau[0], strict=True)}
        with FmuInstance(fmu) as component:
            component.initialise(start={**first, **(start or {})})
            inputs = component.buffer([f"tau[{i}]" for i in joints])
            outputs = component.buffer([f"{stem}[{i}]" for stem in stems for i in joints])
            rows[0] = outputs.read()
            for k, torque in enumerate(tau):
                inputs.values[:] = torque
                inputs.write()
                component.step(k * step, step)
                rows[k + 1] = outputs.read()
        self.q, self.dq, self.ddq, self.tau_friction = np.split(rows, len(stems), axis=1)


def at(robot: Robot, q: Array, dq: Array | None = None) -> dict[str, float]:
    """Start values of a motion."""
    speeds = np.zeros(robot.n) if dq is None else dq
    numbers = range(1, robot.n + 1)
    found = {f"q_start[{i}]": float(x) for i, x in zip(numbers, q, strict=True)}
    return found | {f"dq_start[{i}]": float(x) for i, x in zip(numbers, speeds, strict=True)}


def open_stops(robot: Robot) -> dict[str, float]:
    """Start values without limits."""
    numbers = range(1, robot.n + 1)
    return {
        f"q_{side}[{i}]": sign * 1e6
        for i in numbers
        for side, sign in (("min", -1.0), ("max", 1.0))
    }
