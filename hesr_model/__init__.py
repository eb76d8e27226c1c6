"""The science of HESR: logs, rigid bodies, friction laws and their fits.

Names for notebooks; `docs/tutorial.ipynb` is the long form of::

    from pathlib import Path

    from fmu_src import export_fmu
    from hesr_model import Log, Robot, fit, friction_records, identify

    robot = Robot("robot.toml")
    excitation, sweep, test = (
        Log.read(f"{name}.csv", robot) for name in ("excitation", "sweep", "test")
    )
    body = identify([excitation], robot)
    model = fit("lugre", friction_records(sweep, robot, body))
    tau_f = model.predict(friction_records(test, robot, body))  # (N, n) [N.m]
    export_fmu(model, Path("Friction.fmu"))

Names are imported on first use, so `import hesr_model` takes no time.
"""

from typing import TYPE_CHECKING

from hesr_model.support.lazy import lazy

if TYPE_CHECKING:
    from hesr_model.errors import HesrError
    from hesr_model.fitting.fit import fit
    from hesr_model.friction.model import FrictionModel
    from hesr_model.friction.registry import registry
    from hesr_model.logs.robot_log import Log
    from hesr_model.rigid_body.identification import RigidBody, identify
    from hesr_model.rigid_body.residual import FrictionRecord, friction_records
    from hesr_model.robots.robot import Robot, RobotDescription

__all__ = [
    "FrictionModel",
    "FrictionRecord",
    "HesrError",
    "Log",
    "RigidBody",
    "Robot",
    "RobotDescription",
    "fit",
    "friction_records",
    "identify",
    "registry",
]

_HOMES = {
    "FrictionModel": "hesr_model.friction.model",
    "FrictionRecord": "hesr_model.rigid_body.residual",
    "HesrError": "hesr_model.errors",
    "RigidBody": "hesr_model.rigid_body.identification",
    "RobotDescription": "hesr_model.robots.robot",
    "Log": "hesr_model.logs.robot_log",
    "Robot": "hesr_model.robots.robot",
    "fit": "hesr_model.fitting.fit",
    "friction_records": "hesr_model.rigid_body.residual",
    "identify": "hesr_model.rigid_body.identification",
    "registry": "hesr_model.friction.registry",
}

if not TYPE_CHECKING:  # a type checker knows the names above and must find others missing
    __getattr__, __dir__ = lazy(__name__, _HOMES)
