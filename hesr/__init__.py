"""From a robot's log to a friction model as an FMU, with proof that it works.

Every command of `hesr` is one call, and every object one name::

    import hesr

    log = hesr.Log.read("sweep.csv", robot="robot.toml")     # or a URDF, or an MJCF
    friction = hesr.FrictionRegressor(law="lugre").fit(log)
    print(friction.equation(), friction.score(hesr.Log.read("test.csv", robot="robot.toml")))
    friction.to_fmu("Friction.fmu")

Objects   Robot, Log, RigidBody, FrictionModel, FrictionRegressor; HesrError, the base of all errors
Commands  new, inspect, run, report, results, excite, identify, fit, evaluate, audit, properties,
          arena, laws, export, check, replay, monitor, simulate,
          package

Paths are text or paths. Logs, bodies, laws and comparisons show themselves as tables in a notebook;
logs and comparisons have `to_pandas()`, logs `to_xarray()`. help(hesr.fit) says more of a name.

Every name is imported when it is first used, so that `import hesr` takes no time.
"""

from typing import TYPE_CHECKING

from hesr_model.support.lazy import lazy

if TYPE_CHECKING:
    from cosim.regressor import FrictionRegressor
    from cosim.workflow.check import check
    from cosim.workflow.commands import (
        arena,
        audit,
        evaluate,
        excite,
        export,
        inspect,
        new,
        package,
        properties,
        replay,
        report,
        results,
        run,
        simulate,
    )
    from cosim.workflow.fit import fit, laws
    from cosim.workflow.identify import identify
    from hesr.extras.adaptive.workflow import monitor
    from hesr_model.errors import HesrError
    from hesr_model.friction.model import FrictionModel
    from hesr_model.logs.robot_log import RobotLog as Log
    from hesr_model.rigid_body.identification import RigidBody
    from hesr_model.robots.robot import RobotModel as Robot

    # For checkers only: `help(hesr)` would print the whole of each name.
    __all__ = [
        "FrictionModel",
        "FrictionRegressor",
        "HesrError",
        "Log",
        "RigidBody",
        "Robot",
        "arena",
        "audit",
        "check",
        "evaluate",
        "excite",
        "export",
        "fit",
        "identify",
        "inspect",
        "laws",
        "monitor",
        "new",
        "package",
        "properties",
        "replay",
        "report",
        "results",
        "run",
        "simulate",
    ]

_COMMANDS = (
    *(
        "new",
        "inspect",
        "run",
        "report",
        "results",
        "excite",
        "evaluate",
        "audit",
    ),
    *("properties", "arena", "export", "replay"),
    "simulate",
    "package",
)
_HOMES = dict.fromkeys(_COMMANDS, "cosim.workflow.commands") | {
    "check": "cosim.workflow.check",
    "fit": "cosim.workflow.fit",
    "identify": "cosim.workflow.identify",
    "laws": "cosim.workflow.fit",
    "monitor": "hesr.extras.adaptive.workflow",
    "FrictionModel": "hesr_model.friction.model",
    "FrictionRegressor": "cosim.regressor",
    "HesrError": "hesr_model.errors",
    "Log": "hesr_model.logs.robot_log:RobotLog",
    "RigidBody": "hesr_model.rigid_body.identification",
    "Robot": "hesr_model.robots.robot:RobotModel",
}

if not TYPE_CHECKING:  # a checker knows the names above, and shall find others missing
    __getattr__, __dir__ = lazy(__name__, _HOMES)
