"""Laws on friction records: what a model predicts for a log that was measured."""

from hesr_model.friction.evaluate import Array, estimated_start, predict
from hesr_model.friction.law import FrictionLaw
from hesr_model.residual import FrictionRecord


def record_start(law: FrictionLaw, record: FrictionRecord) -> tuple[float, ...]:
    """Return the start of a law's states for a record, estimated where the law wants that."""
    return estimated_start(
        law,
        t=record.t,
        dq=record.dq,
        q=record.q,
        tau_load=record.tau_load,
        tau=record.tau,
    )


def predict_record(law: FrictionLaw, record: FrictionRecord) -> Array:
    """Return the (N,) torque [N.m] of a law for a record."""
    return predict(
        law,
        t=record.t,
        dq=record.dq,
        q=record.q,
        tau_load=record.tau_load,
        start=record_start(law, record),
    )
