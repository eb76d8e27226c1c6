"""The science of HESR: logs, rigid bodies, friction laws and how they are fitted.

The names that a notebook needs stand here; the modules hold the rest. From logs to the friction
torque of a motion that no fit has seen (`docs/tutorial.ipynb` is the long form)::

    from pathlib import Path

    from fmu_src import export_fmu
    from hesr_model import RobotDescription, RobotLog, RobotModel, fit, friction_records, identify

    robot = RobotModel(RobotDescription.read(Path("robot.toml")))
    excitation, sweep, test = (
        RobotLog.read(Path(f"{name}.csv"), robot.description)
        for name in ("excitation", "sweep", "test")
    )
    body = identify([excitation], robot)
    model = fit("lugre", friction_records(sweep, robot, body))
    tau_f = model.predict(friction_records(test, robot, body))  # (N, n) [N.m]
    export_fmu(model, Path("Friction.fmu"))

Every name is imported when it is first used, so `import hesr_model` takes no time.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hesr_model.artifacts import read_model, read_rigid_body, write_model, write_rigid_body
    from hesr_model.errors import HesrError
    from hesr_model.friction.fitting.fit import fit
    from hesr_model.friction.model import FrictionModel
    from hesr_model.friction.registry import registry
    from hesr_model.logs.robot_log import RobotLog
    from hesr_model.rigid_body.identification import RigidBody, identify
    from hesr_model.rigid_body.residual import FrictionRecord, friction_records
    from hesr_model.robots.robot import RobotDescription, RobotModel

__all__ = [
    "FrictionModel",
    "FrictionRecord",
    "HesrError",
    "RigidBody",
    "RobotDescription",
    "RobotLog",
    "RobotModel",
    "fit",
    "friction_records",
    "identify",
    "read_model",
    "read_rigid_body",
    "registry",
    "write_model",
    "write_rigid_body",
]

_HOMES = {
    "FrictionModel": "friction.model",
    "FrictionRecord": "rigid_body.residual",
    "HesrError": "errors",
    "RigidBody": "rigid_body.identification",
    "RobotDescription": "robots.robot",
    "RobotLog": "logs.robot_log",
    "RobotModel": "robots.robot",
    "fit": "friction.fitting.fit",
    "friction_records": "rigid_body.residual",
    "identify": "rigid_body.identification",
    "read_model": "artifacts",
    "read_rigid_body": "artifacts",
    "registry": "friction.registry",
    "write_model": "artifacts",
    "write_rigid_body": "artifacts",
}

if not TYPE_CHECKING:  # a checker knows the names above, and shall find others missing

    def __getattr__(name: str) -> object:
        """Import a public name where it is first used (PEP 562)."""
        if name not in _HOMES:
            raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
        value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
