"""Conventions for setting inputs in co-simulation, and their errors.

The step from row k to row k + 1 uses the constant inputs of row k (hold, as most masters do), also
their slopes (linear), or the inputs of row k + 1 (direct, as in the replay of a log). The torque is
read after the step. `fmu_src.check.convention` runs the FMU.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.logs.signals import near_reversals
from hesr_model.robots.transmission import Coupling
from hesr_model.support.arrays import Array

SETTINGS: Mapping[str, str] = {
    "hold": "inputs of the step's beginning, held",
    "linear": "the same with their slopes",
    "direct": "inputs of the step's end",
}
"""Input conventions, the most common one first."""

SHOWN = "shown"
"""As "hold", with the torque read after setting the inputs of the next step, as some tools do."""

CONTINUOUS = "continuous"
"""Not a convention of masters: fine integration of the law with linear inputs between the rows."""


def joint_columns(name: str, rows: Array) -> dict[str, Array]:
    """Return the columns of an array (N, n) by the names of its variables in an FMU."""
    return {f"{name}[{i}]": column for i, column in enumerate(rows.T, start=1)}


@dataclass(frozen=True, kw_only=True)
class ReferenceMotion:
    """Inputs of all joints: time (N,) [s]; velocity, position and load (N, n) [rad/s, rad, N.m]."""

    t: Array
    dq: Array
    q: Array
    tau_load: Array

    def by_joint(self) -> Iterator[tuple[Array, Array, Array]]:
        """Yield (dq, q, tau_load) of each joint, each (N,) [rad/s, rad, N.m]."""
        return zip(self.dq.T, self.q.T, self.tau_load.T, strict=True)

    def columns(self) -> dict[str, Array]:
        """Return the inputs (N,) of a friction FMU by name."""
        return {
            name: column
            for symbol in INPUTS
            for name, column in joint_columns(symbol.name, getattr(self, symbol.name)).items()
        }

    def at_friction(self, coupling: Coupling | None) -> "ReferenceMotion":
        """Return the motion of the friction coordinates."""
        if coupling is None:
            return self
        return ReferenceMotion(
            t=self.t,
            dq=coupling.motion(self.dq),
            q=coupling.motion(self.q),
            tau_load=coupling.torque(self.tau_load),
        )


@dataclass(frozen=True, kw_only=True)
class Error:
    """Torque error of one joint [N.m], over all rows and within `REVERSAL_WINDOW` of reversals."""

    rmse: float
    rmse_reversal: float | None


def torques(
    model: FrictionModel, motion: "ReferenceMotion", setting: str, *, substeps: int = 20
) -> Array:
    """Return the (N, n) torque [N.m] of a model's laws, perhaps not finite, for a convention above.

    `substeps` divide the rows for `CONTINUOUS`. Raises SimulationError if the laws' discretisation
    is unstable at the steps.
    """
    own = motion.at_friction(model.coupling)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # checked by the callers
        columns = [
            _torque(law, own.t, inputs, setting, substeps)
            for law, inputs in zip(model.laws, own.by_joint(), strict=True)
        ]
        torque = np.column_stack(columns)
        return torque if model.coupling is None else model.coupling.at_joints(torque)


def errors(motion: "ReferenceMotion", torque: Array, truth: Array) -> tuple[Error, ...]:
    """Return the torque error of each joint against the truth, both (N, n) [N.m]."""
    found = []
    for dq, difference in zip(motion.dq.T, (torque - truth).T, strict=True):
        near = near_reversals(motion.t, dq)
        found.append(
            Error(
                rmse=rmse(difference),
                rmse_reversal=rmse(difference[near]) if np.any(near) else None,
            )
        )
    return tuple(found)


def _torque(
    law: FrictionLaw, t: Array, inputs: Sequence[Array], setting: str, substeps: int
) -> Array:
    if setting == "direct":
        return _predicted(law, t, inputs)
    if setting in ("hold", SHOWN):
        held = [np.concatenate([u[:1], u[:-1]]) for u in inputs]
        return _predicted(law, t, held, inputs if setting == SHOWN else None)
    if setting == "linear":
        return _read_at_rows(law, t, inputs, 1)
    return _read_at_rows(replace(law, discretisation="exact"), t, inputs, substeps)


def _read_at_rows(law: FrictionLaw, t: Array, inputs: Sequence[Array], substeps: int) -> Array:
    ends = np.arange(1, substeps + 1) / substeps

    def between(row: Array, share: Array) -> Array:
        inner = row[:-1, None] * (1.0 - share) + row[1:, None] * share
        return np.concatenate([row[:1], inner.ravel()])

    held, shown = ([between(u, share) for u in inputs] for share in (ends - 0.5 / substeps, ends))
    return _predicted(law, between(t, ends), held, shown)[::substeps]


def _predicted(
    law: FrictionLaw, t: Array, inputs: Sequence[Array], shown: Sequence[Array] | None = None
) -> Array:
    dq, q, tau_load = inputs
    return predict(law, t=t, dq=dq, q=q, tau_load=tau_load, shown=shown)
