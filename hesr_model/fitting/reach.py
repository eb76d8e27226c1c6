"""What a fitted law reaches within the speeds and loads that it was fitted to."""

from collections.abc import Sequence

import numpy as np

from hesr_model.errors import FitError, SimulationError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.units import unit_of_joint

_MAX_EXCESS = 20.0
"""Largest torque of a law over the largest measured one. Of 22 laws on 32 measured joints the
largest ratio is 6.2, a jump of bristles with damping; a law that short logs do not determine had
62."""
_ROWS = (50, 2000)  # of a motion in one direction


def require_bounded_torque(law: FrictionLaw, joint_records: Sequence[FrictionRecord]) -> None:
    """Raise FitError if a law far exceeds the measured friction within its logs.

    Terms that a log does not excite may have any coefficient. The joint moves to and fro at its
    trained speeds, under its lowest and highest trained load, which a log need not combine.
    """
    largest = max(float(np.max(np.abs(record.tau))) for record in joint_records)
    has_motion = any(len(record.t) > 1 for record in joint_records)
    if largest == 0.0 or not has_motion:
        return
    trained = TrainedRange.from_records(joint_records)
    reached = _find_largest_torque(law, trained)
    if reached > _MAX_EXCESS * largest:
        unit = unit_of_joint("N.m", is_prismatic=joint_records[0].sliding)
        raise FitError(
            f"joint '{joint_records[0].joint}': the law '{law.name}' reaches {reached:.3g} {unit} "
            f"within the speeds and loads of the logs, whose friction is at most {largest:.3g} "
            f"{unit}: its torque does not determine the law."
        )


def _find_largest_torque(law: FrictionLaw, trained: TrainedRange) -> float:
    """Return the largest torque [N.m] in motions to and fro, under both ends of the load."""
    slowest, fastest = trained.dq
    travel = trained.q[1] - trained.q[0]
    rows = np.clip(round(travel / (trained.speed * trained.sample_time)), *_ROWS)
    dq = np.repeat([fastest, slowest, fastest], int(rows))
    t = trained.sample_time * np.arange(len(dq))
    q = trained.middle + trained.sample_time * np.cumsum(dq)
    largest = 0.0
    for load in trained.tau_load:
        try:
            tau = predict(law, t=t, dq=dq, q=q, tau_load=np.full(len(t), load))
        except SimulationError:  # of a step that is too long for the law, not of its coefficients
            continue
        largest = max(largest, float(np.max(np.abs(tau))))
    return largest
