"""Motion of one joint under its servo and friction, run by the generated plant.

The plant is that of an axis without links. Its rotor has the inertia, and its spring the bias and
slope of the bias, that the joint has along the measured motion of the others; both change from row
to row of the log. So a fit runs the C that is exported.
"""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import numpy as np

from cosim.servo.record import ServoRecord
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from fmu_src.plant.servo import UNLIMITED, PositionServo
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr_model.errors import SimulationError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.servo import JointServo
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder

SUBSTEP = 2e-3  # longest inner step of a search [s]
FINE_SUBSTEP = 5e-4  # and of its end, where the discretisation must not count
_AXIS = """<robot name="axis"><link name="base"/><link name="link"/>
<joint name="axis" type="{kind}"><parent link="base"/><child link="link"/><axis xyz="0 0 1"/>
<limit lower="-1e6" upper="1e6" effort="1e6" velocity="1e6"/></joint></robot>
"""


class JointEngine:
    """The plant of one axis with one law; a context manager, for any number of runs."""

    def __init__(self, law: FrictionLaw, *, sliding: bool = False) -> None:
        self._law = law
        self._sliding = sliding
        self._cleanup = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as cleanup:
            folder = cleanup.enter_context(scratch_folder())
            fmu = _export_axis(folder, self._law, sliding=self._sliding)
            self._instance = cleanup.enter_context(FmuInstance(fmu, name="axis"))
            instance = self._instance
            self._inputs = instance.buffer(
                ["q_cmd[1]", "dq_cmd[1]", "rotor[1]", "spring[1].k", "spring[1].const"]
            )
            self._outputs = instance.buffer(["q[1]"])
            self._cleanup = cleanup.pop_all()
        return self

    def __exit__(self, *ended: object) -> None:
        self._cleanup.__exit__(None, None, None)

    def run(
        self,
        record: ServoRecord,
        servo: JointServo,
        values: Mapping[str, float],
        *,
        substep: float = SUBSTEP,
    ) -> Array:
        """Return the positions (N,) [rad; m] along the commands of a log; NaN if it fails.

        `values` are the coefficients of the law by name.
        """
        instance = self._instance
        if instance.used:
            instance.reset()
        factor = servo.body_factor
        rotor = factor * record.inertia + servo.added_factor * record.added + servo.armature
        slope = factor * record.slope
        constant = factor * record.bias - slope * record.posture
        starts = _starts(record, servo, substep) | {
            f"joint[1].{name}": value for name, value in values.items()
        }
        rows = np.column_stack([record.q_cmd, record.dq_cmd, rotor, slope, constant])
        positions = np.empty_like(record.q)
        positions[0] = record.q[0]
        try:
            self._inputs.values[:] = rows[0]
            instance.initialise(start=starts, inputs=self._inputs)
            outputs = step_rows(
                instance,
                self._inputs,
                self._outputs,
                record.t[:-1],
                np.diff(record.t),
                rows[:-1],
            )
        except SimulationError:
            return np.full_like(record.q, np.nan)
        positions[1:] = outputs[:, 0]
        return positions


def _starts(record: ServoRecord, servo: JointServo, substep: float) -> dict[str, float]:
    """Return the start values of a run; a joint that hardly moves starts at rest."""
    starts = {
        "q_start[1]": float(record.q[0]),
        "dq_start[1]": record.first_speed,
        "servo_kp[1]": servo.kp,
        "servo_ki[1]": servo.ki,
        "servo_kv[1]": servo.kd,
        "torque_limit[1]": UNLIMITED,
        "command_filter[1]": servo.command_filter,
        "speed_limit[1]": UNLIMITED,
        "latency": servo.latency,
        "substep": substep,
        "gravity[3]": 0.0,
    }
    if servo.torque_limit is not None:
        starts["torque_limit[1]"] = servo.torque_limit
    if servo.speed_limit is not None:
        starts["speed_limit[1]"] = servo.speed_limit
    return starts


def _export_axis(folder: Path, law: FrictionLaw, *, sliding: bool) -> Path:
    """Write the plant of an axis without links under a law."""
    kind = "prismatic" if sliding else "revolute"
    model_file = folder / "axis.urdf"
    model_file.write_text(_AXIS.format(kind=kind), encoding="utf-8")
    robot = Robot(
        RobotDescription(name="axis", model=model_file, joints=("axis",), springs=("axis",))
    )
    model = FrictionModel(
        law=law.name,
        robot="axis",
        joints=("axis",),
        laws=(law,),
        sliding=(True,) if sliding else (),
        sample_time=SUBSTEP,
    )
    parameters = np.zeros(len(robot.parameter_names))
    return export_plant(
        model,
        folder / "axis.fmu",
        plant_body=PlantBody(robot=robot, parameters=parameters),
        servo=PositionServo.from_stiffness((1.0,)),
        bare=True,
    )
