"""Test data of a code file: inputs and torques."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fmu_src.friction.reference import reference_motion
from fmu_src.friction.settings import ReferenceMotion, torques
from hesr_model.errors import ExportError, SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.files import written_together

TEMPLATES = Path(__file__).parent / "templates"
_ROWS = 1000
_PERIODS = 2.5
_PHASE = 0.35
_HALVINGS = 12


def write_beside(path: Path, text: str, model: FrictionModel) -> Path:
    """Write a code file and its test data (.csv); both or none."""
    rows = reference_rows(model)
    with written_together(path) as file:
        for own, content in ((path, text), (path.with_suffix(".csv"), rows)):
            file(own).write_text(content, encoding="utf-8", newline="\n")
    return path


def reference_rows(model: FrictionModel) -> str:
    """Return the data as CSV: t, then dq[i], q[i], tau_load[i] and tau[i] of all joints.

    Row 0 is at the start of the states, which move to each further row with its inputs held. Inputs
    are exact in single precision.
    """
    motion, torque = _motion(model)
    joints = range(1, len(model.joints) + 1)
    names = ["t", *(f"{name}[{i}]" for name in ("dq", "q", "tau_load", "tau") for i in joints)]
    columns = np.column_stack([motion.t, motion.dq, motion.q, motion.tau_load, torque])
    # Adding zero turns a negative zero into a positive one.
    lines = [",".join(f"{value + 0.0:.17g}" for value in row) for row in columns.tolist()]
    return "\n".join([",".join(names), *lines, ""])


def _motion(model: FrictionModel) -> tuple[ReferenceMotion, np.ndarray]:
    for halved in range(_HALVINGS):
        step = model.sample_time / 2**halved
        motion = reference_motion(
            model,
            frequency=_PERIODS / (_ROWS * step),
            periods=_PERIODS,
            rows=_ROWS,
            phase=_PHASE,
            lead_in=0.1 * _ROWS * step,
        )
        inputs: Mapping[str, np.ndarray] = {
            name: getattr(motion, name).astype(np.float32).astype(float)
            for name in ("dq", "q", "tau_load")
        }
        motion = ReferenceMotion(t=motion.t, **inputs)
        try:
            torque = torques(model, motion, "direct")
        except SimulationError:
            continue
        if np.all(np.isfinite(torque)):
            return motion, torque
    raise ExportError(
        f"friction model '{model.law}': torque is not finite at speeds up to "
        f"{np.abs(motion.dq).max():g} rad/s; no test data can be made."
    )
