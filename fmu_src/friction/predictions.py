"""Predictions of friction over records, by models or FMUs."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hesr_model.errors import ArtifactError
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import first_states, record_start
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import transform_records
from hesr_model.support.arrays import Array

Records = Sequence[Sequence[FrictionRecord]]  # [joint][log]


def predict_model(
    model: FrictionModel, records: Records, *, measured_start: bool = False
) -> list[list[Array]]:
    """Return the model's torque (N,) [N.m] by joint and log.

    With `measured_start` the initial state is estimated from the first measured torques.
    """
    joints = tuple(joint_records[0].joint for joint_records in records)
    if joints != model.joints:
        raise ArtifactError(
            f"friction model '{model.law}' is for the joints {', '.join(model.joints)}; the robot "
            f"has {', '.join(joints)}."
        )
    torques = [
        model.predict(log_records, measured_start=measured_start)
        for log_records in zip(*records, strict=True)
    ]
    return [_select_joint(torques, j) for j in range(len(records))]


def _select_joint(torques: Sequence[Array], joint: int) -> list[Array]:
    """Return the columns (N,) of a joint of the torques (N, n) of each log."""
    return [torque[:, joint] for torque in torques]


def predict_fmu(fmu: Path, records: Records, *, measured_start: bool = False) -> list[list[Array]]:
    """Return the torque (N,) [N.m] of an FMU by joint and log, replayed in FMPy.

    With `measured_start` the model inside the FMU estimates the initial state.
    """
    from fmu_src.friction.embedded_model import read_embedded_model
    from fmu_src.friction.replay import replay

    model = None
    if measured_start:
        model = read_embedded_model(fmu)
    torques = []
    for log_records in zip(*records, strict=True):
        start: dict[str, float] = {}
        if model is not None and len(model.laws) == len(log_records):
            start = _estimate_start(model, log_records)
        temperatures = [r.temperature for r in log_records if r.temperature is not None]
        temperature = None
        if len(temperatures) == len(log_records):
            temperature = np.column_stack(temperatures)
        torque = replay(
            fmu,
            log_records[0].t,
            np.column_stack([record.dq for record in log_records]),
            np.column_stack([record.q for record in log_records]),
            np.column_stack([record.tau_load for record in log_records]),
            start=start,
            temperature=temperature,
        )
        torques.append(torque)
    return [_select_joint(torques, j) for j in range(len(records))]


def _estimate_start(
    model: FrictionModel, log_records: Sequence[FrictionRecord]
) -> dict[str, float]:
    """Return the start values of an FMU's states, from the first rows of a log of all joints."""
    from fmu_src.friction.friction_component import GIVEN, START_MODE, place

    coupled_records = [replace(record, coupling=model.coupling) for record in log_records]
    coordinate_records = transform_records(coupled_records)
    start = {START_MODE: GIVEN}
    for i, (law, record) in enumerate(zip(model.laws, coordinate_records, strict=True), start=1):
        if law.start_samples > 0:
            values = record_start(law, record)
        else:
            values = first_states(
                law, float(record.dq[0]), float(record.q[0]), float(record.tau_load[0])
            )
        start |= dict(zip(place(law, i).starts, values, strict=True))
    return start
