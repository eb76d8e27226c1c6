"""Fixtures of the recorded-number tests."""

from collections.abc import Callable

import numpy as np
import pytest
from joint_data import along, law, path
from pytest_regressions.num_regression import NumericRegressionFixture
from unchanged import Unchanged, leaves

from hesr_model.fitting.joint_rows import JointRows
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.friction_record import FrictionRecord

TRUTH = law(
    "lugre_load",
    {},
    sigma_0=600.0,
    sigma_1=1.0,
    sigma_2=4.0,
    F_c=8.0,
    F_s=11.0,
    v_s=0.1,
    tau_0=0.5,
    mu=0.02,
)


@pytest.fixture
def unchanged(num_regression: NumericRegressionFixture) -> Unchanged:
    """Compare numbers with those recorded for the test."""

    def check(of: object, *, rtol: float = 1e-6, atol: float = 1e-9) -> None:
        found = {name: np.asarray(value) for name, value in leaves(of) if len(value)}
        num_regression.check(found, default_tolerance={"rtol": rtol, "atol": atol})

    return check


@pytest.fixture(scope="session")
def records() -> list[FrictionRecord]:
    """Two noisy logs of LuGre with load."""
    return [
        along(TRUTH, path(k, seconds=5.0 + k), noise=0.3, seed=k, log=str(k), gear_ratio=101.0)
        for k in range(2)
    ]


@pytest.fixture(scope="session")
def exact(records: list[FrictionRecord]) -> HysteresisFeatures:
    """Features of the records with exact discretisation."""
    return HysteresisFeatures(
        rows=JointRows.from_records(records, coefficients=11), discretisation="exact"
    )


@pytest.fixture
def log(make_motion: Callable[..., Motion]) -> Log:
    """A log of three joints with friction and noisy torques."""
    motion = make_motion(name="run", friction=0.8)
    noise = np.random.default_rng(0).normal(0.0, 0.05, motion.tau.shape)
    return Log(name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau + noise)
