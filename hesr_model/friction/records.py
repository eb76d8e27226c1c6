"""Predictions of laws for measured friction records."""

from collections.abc import Sequence

import numpy as np

from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.metrics import rmse
from hesr_model.friction.predict import estimated_start, predict
from hesr_model.friction.thermal import Thermal
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array


def record_start(law: FrictionLaw, record: FrictionRecord) -> tuple[float, ...]:
    """Return the initial states of a law for a record, estimated if the law supports that."""
    return estimated_start(law, **record.motion, tau=record.tau)


def predict_record(
    law: FrictionLaw,
    record: FrictionRecord,
    *,
    measured_start: bool = False,
    thermal: Thermal | None = None,
) -> Array:
    """Return the (N,) torque [N.m] of a law for a record, at its temperature if `thermal` is given.

    `measured_start` estimates the initial states from the first torques.
    """
    start = record_start(law, record) if measured_start and law.start_samples else None
    if thermal:
        # it imports SciPy's optimisers
        from hesr_model.friction.thermal_law import predict_thermal

        return predict_thermal(law, thermal, record, start)
    return predict(law, **record.motion, start=start)


def training_error(law: FrictionLaw, records: Sequence[FrictionRecord]) -> float:
    """Return the RMSE [N.m] of a law over all records of its joint."""
    return rmse(np.concatenate([predict_record(law, r) - r.tau for r in records]))
