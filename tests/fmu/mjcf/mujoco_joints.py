"""MuJoCo with the friction of an MJCF, its joints driven along a motion."""

from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import mujoco
import numpy as np

from fmu_src.friction.reference import ReferenceMotion, reference_files
from hesr_model.friction.model import FrictionModel

ROBOT = """\
<mujoco model="joints">
  <option timestep="{step}" gravity="0 0 0"><flag contact="disable" eulerdamp="disable"/></option>
  <worldbody>{bodies}</worldbody>
  <include file="{friction}"/>
</mujoco>
"""
BODY = '<body><joint name="{joint}" axis="0 0 1" armature="0.6"/><geom size="0.1" mass="1"/></body>'


class Joints:
    """Hinges, each with its own body, with only the included friction."""

    def __init__(self, joints: Sequence[str], friction: Path, step: float) -> None:
        robot = friction.with_name("robot.xml")
        bodies = "".join(BODY.format(joint=joint) for joint in joints)
        robot.write_text(ROBOT.format(step=step, bodies=bodies, friction=friction.name))
        self.model = mujoco.MjModel.from_xml_path(str(robot))
        self.data = mujoco.MjData(self.model)

    def hold(self, q: np.ndarray, dq: np.ndarray) -> None:
        """Relax the bristles over a step with this velocity."""
        self._move(q, dq)
        mujoco.mj_step(self.model, self.data)

    def torque(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Friction torque at this position and velocity, positive against motion."""
        self._move(q, dq)
        mujoco.mj_forward(self.model, self.data)
        return -(self.data.qfrc_actuator + self.data.qfrc_passive)

    def _move(self, q: np.ndarray, dq: np.ndarray) -> None:
        self.data.qpos[:], self.data.qvel[:] = q, dq


def reference(model: FrictionModel) -> tuple[ReferenceMotion, np.ndarray]:
    """The reference motion in an FMU of the model, and its torques."""
    files = reference_files(model, "x")

    def rows(name: str) -> np.ndarray:
        text = files[f"extra/co_simulation/x_{name}.csv"].decode()
        return np.loadtxt(StringIO(text), delimiter=",", skiprows=1)

    t, inputs = rows("in")[:, 0], rows("in")[:, 1:]
    dq, q, tau_load = np.split(inputs, 3, axis=1)
    return ReferenceMotion(t=t, dq=dq, q=q, tau_load=tau_load), rows("ref")[:, 1:]
