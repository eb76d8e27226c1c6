"""Drive FMUs of many laws, and how to run them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fmu_src.export.package import write_fmu
from fmu_src.run.fmu import FmuInstance
from hesr.extras.drive.drive_fmu import build_motors, content
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel

Array = np.ndarray


def model_of(laws: Mapping[str, FrictionLaw]) -> FrictionModel:
    """One joint per law."""
    return FrictionModel(
        law="by_hand",
        robot="bench",
        joints=tuple(laws),
        laws=tuple(laws.values()),
        sample_time=0.005,
    )


def drive(
    laws: Mapping[str, FrictionLaw], folder: Path, inertia: Sequence[float], **more: Sequence[float]
) -> Path:
    """Write the drive with one joint per law."""
    return write_fmu(
        content(model_of(laws), build_motors(len(laws), inertia=inertia, **more)),
        folder / "Drive.fmu",
    )


class Run:
    """A drive under torques held over each row of a grid.

    Attributes
    ----------
    q, dq, tau_f : (K, n) at the end of every step.
    """

    def __init__(
        self,
        fmu: Path,
        tau: Array,
        *,
        grid: float,
        step: float,
        substep: float | None = None,
        start: Mapping[str, float] | None = None,
    ) -> None:
        joints = range(1, tau.shape[1] + 1)
        steps = round(grid / step)
        names = [f"{name}[{i}]" for name in ("q", "dq", "tau_f") for i in joints]
        rows = np.empty((len(tau) * steps, len(names)))
        with FmuInstance(fmu) as component:
            component.initialise(
                start={"substep": step if substep is None else substep, **(start or {})}
            )
            inputs = component.buffer([f"tau_motor[{i}]" for i in joints])
            outputs = component.buffer(names)
            for k, torque in enumerate(tau):
                inputs.values[:] = torque
                inputs.write()
                for n in range(steps):
                    component.step(k * grid + n * step, step)
                    rows[k * steps + n] = outputs.read()
        self.q, self.dq, self.tau_f = np.split(rows, 3, axis=1)


def reversals(dq: Array) -> int:
    """Number of sign changes of a speed; rests in between do not count."""
    moving = np.sign(dq[dq != 0.0])
    return int(np.sum(moving[1:] != moving[:-1]))
