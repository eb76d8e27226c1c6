"""Ten seeds of the start points: a fit on the twin's sweep finds the same law.

It takes about a minute per law and is therefore a benchmark.
"""

import numpy as np
import pytest

from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.records import predict_record, rmse
from hesr_model.rigid_body.friction_record import FrictionRecord

SEEDS = range(10)
Records = dict[str, list[FrictionRecord]]


def error(law: FrictionLaw, record: FrictionRecord) -> float:
    return rmse(predict_record(law, record) - record.tau)


@pytest.mark.parametrize("joint", range(3), ids=lambda joint: f"J{joint + 1}")
@pytest.mark.parametrize("law", ["parfam_h", "parfam_hx"])
def test_the_fit_does_not_depend_on_the_seed(records: Records, law: str, joint: int) -> None:
    """Nine of ten within 1 % of the best in training; at most 3 % spread in the Fourier test."""
    sweep, fourier = records["sweep"][joint], records["fourier_test"][joint]
    laws = [fit_joint(law, [sweep], seed=seed) for seed in SEEDS]
    training = np.array([error(found, sweep) for found in laws])
    unseen = np.array([error(found, fourier) for found in laws])
    assert np.sum(training <= 1.01 * training.min()) >= 9, training
    assert unseen.max() <= 1.03 * unseen.min(), unseen
