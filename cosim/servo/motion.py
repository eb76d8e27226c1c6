"""Motion of the whole robot along the commands of a log, by the plant that is exported."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fmu_src.export.toolchain import HOST
from fmu_src.plant.plant_fmu import export_plant
from fmu_src.plant.servo_plant import find_servo_plant
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.servo import compute_commands
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Progress, silent


def predict_motion(model: FrictionModel, robot: Robot, log: Log) -> Array:
    """Return the positions (N, n) [rad; m] of a log without gaps, from its commands alone.

    Raises ExportError if nothing fixes the size of torques, SimulationError if the plant fails.
    """
    with scratch_folder() as folder:
        return run_plant(export_servo_plant(model, robot, folder / "plant.fmu", bare=True), log)


def export_servo_plant(
    model: FrictionModel,
    robot: Robot,
    path: Path,
    *,
    platforms: Sequence[str] = HOST,
    progress: Progress = silent,
    bare: bool = False,
) -> Path:
    """Write the plant of a robot with the servos of a model that was fitted to commands."""
    plant_body, servo = find_servo_plant(model, robot)
    return export_plant(
        model,
        path,
        plant_body=plant_body,
        servo=servo,
        platforms=platforms,
        progress=progress,
        bare=bare,
    )


def run_plant(fmu: Path, log: Log) -> Array:
    """Return the positions (N, n) that an exported plant reaches along the commands of a log."""
    positions, speeds = compute_commands(log)
    joints = range(1, log.q.shape[1] + 1)
    starts = {f"q_start[{number}]": float(log.q[0, number - 1]) for number in joints}
    speed_names = [f"dq_cmd[{number}]" for number in joints]
    position_names = [f"q_cmd[{number}]" for number in joints]
    rows = np.hstack([speeds, positions])
    start_times = log.t[:-1] - log.t[0]
    with FmuInstance(fmu, name="plant") as instance:
        inputs = instance.buffer(speed_names + position_names)
        outputs = instance.buffer([f"q[{number}]" for number in joints])
        inputs.values[:] = rows[0]
        instance.initialise(start=starts, inputs=inputs)
        first_row = outputs.read().copy()
        later_rows = step_rows(instance, inputs, outputs, start_times, np.diff(log.t), rows[:-1])
    return np.vstack([first_row, later_rows])
