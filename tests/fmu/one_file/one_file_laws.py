"""A robot whose joints have all laws, and its FMU, as reference for code files."""

import sys
from pathlib import Path

import numpy as np
import pytest

from fmu_src.run.fmu import FmuInstance
from hesr_model.fitting import estimator
from hesr_model.friction.law import FrictionLaw

STEP = 0.005


def maxwell_slip() -> FrictionLaw:
    """Ten stops, from another package."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parents[2] / "contract"))
        patch.setattr(estimator, "_REGISTRY", dict(estimator._REGISTRY))
        sys.modules.pop("maxwell_slip", None)
        from maxwell_slip import MaxwellSlip

    forces = {f"F_{i}": 1.0 + 0.1 * i for i in range(1, 11)}
    return FrictionLaw(
        name="maxwell_slip", form=MaxwellSlip.form({}), values=forces | {"sigma_2": 3, "tau_0": 0.2}
    )


def inputs(joints: int, seconds: float = 10.0) -> tuple[np.ndarray, ...]:
    """(N, n) velocity, position and load in single precision: rests, reversals, slow and fast
    motion."""
    t = STEP * np.arange(round(seconds / STEP))[:, None]
    phase = 0.3 + 0.4 * np.arange(joints)
    q = np.sin(2.0 * t + phase) + 0.2 * np.sin(9.0 * t)
    dq = 2.0 * np.cos(2.0 * t + phase) + 1.8 * np.cos(9.0 * t)
    dq[200:260] = 0.0
    dq[300:320] = 1e-6
    rows = (dq, q, 20.0 * np.sin(t + phase))
    return tuple(row.astype(np.float32).astype(float) for row in rows)


def first_torques_of(fmu: Path, row: tuple[np.ndarray, ...]) -> np.ndarray:
    """(n,) first torque of an FMU with the first inputs of a row."""
    joints = range(1, len(row[0]) + 1)
    names = [f"{name}[{i}]" for name in ("dq", "q", "tau_load") for i in joints]
    with FmuInstance(fmu) as component:
        component.enter_initialisation()
        component.set(dict(zip(names, np.concatenate(row).tolist(), strict=True)))
        component.exit_initialisation()
        return np.array(component.get([f"tau[{i}]" for i in joints]))


def torques_of(fmu: Path, rows: tuple[np.ndarray, ...], step: float = STEP) -> np.ndarray:
    """(N, n) torque of an FMU stepped with the inputs of each row."""
    joints = range(1, rows[0].shape[1] + 1)
    names = [f"{name}[{i}]" for name in ("dq", "q", "tau_load") for i in joints]
    outputs = [f"tau[{i}]" for i in joints]
    found = []
    with FmuInstance(fmu) as component:
        component.initialise()
        for k, row in enumerate(np.column_stack(rows).tolist()):
            component.set(dict(zip(names, row, strict=True)))
            component.step(k * step, step)
            found.append(list(component.get(outputs)))
    return np.array(found)
