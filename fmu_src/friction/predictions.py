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
    return [[torque[:, j] for torque in torques] for j in range(len(records))]


def predict_fmu(fmu: Path, records: Records, *, measured_start: bool = False) -> list[list[Array]]:
    """Return the torque (N,) [N.m] of an FMU by joint and log, replayed in FMPy.

    With `measured_start` the model inside the FMU estimates the initial state.
    """
    from fmu_src.friction.embedded_model import read_embedded_model
    from fmu_src.friction.friction_component import GIVEN, START_MODE, place
    from fmu_src.friction.replay import replay

    model = read_embedded_model(fmu) if measured_start else None
    torques = []
    for log_records in zip(*records, strict=True):
        start: dict[str, float] = {}
        if model is not None and len(model.laws) == len(log_records):
            coordinate_records = transform_records(
                [replace(r, coupling=model.coupling) for r in log_records]
            )
            start[START_MODE] = GIVEN
            for i, (law, record) in enumerate(
                zip(model.laws, coordinate_records, strict=True), start=1
            ):
                initial_inputs = (float(getattr(record, u)[0]) for u in ("dq", "q", "tau_load"))
                estimated = law.start_samples > 0
                values = (
                    record_start(law, record) if estimated else first_states(law, *initial_inputs)
                )
                start |= dict(zip(place(law, i).starts, values, strict=True))
        dq, q, tau_load = (
            np.column_stack([getattr(r, u) for r in log_records]) for u in ("dq", "q", "tau_load")
        )
        temperatures = [r.temperature for r in log_records if r.temperature is not None]
        temperature = (
            np.column_stack(temperatures) if len(temperatures) == len(log_records) else None
        )
        torques.append(
            replay(fmu, log_records[0].t, dq, q, tau_load, start=start, temperature=temperature)
        )
    return [[torque[:, j] for torque in torques] for j in range(len(records))]
