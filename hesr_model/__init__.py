"""The science of HESR: logs, rigid bodies, friction laws and their fits.

Names for notebooks, imported on first use; `docs/tutorial.ipynb` is the long form of::

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
"""

from hesr_model.support.lazy import lazy

__getattr__, __dir__ = lazy(__name__, __file__)
__all__ = __dir__()
