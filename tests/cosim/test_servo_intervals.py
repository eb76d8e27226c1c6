"""Intervals of fits to commands: blocks left out, latencies of other joints, disagreement."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.servo.interval import compute_interval
from cosim.servo.joint_fit import FitUnknown, JointFit
from cosim.servo.model import find_common_latency
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.servo import JointServo

Array = np.ndarray
NAMES = ("latency", "armature", "kd")


def linear_fit(jacobian: Array, noise: Array, blocks: Array, **changes: object) -> JointFit:
    """Return a fit by least squares of a linear problem."""
    change = np.linalg.lstsq(jacobian, -noise, rcond=None)[0]
    unknowns = [
        FitUnknown(
            name=name,
            of_law=False,
            start=1.0,
            scale=1.0,
            lower=0.0,
            upper=np.inf,
            is_logarithmic=False,
        )
        for name in NAMES[: jacobian.shape[1]]
    ]
    law = FrictionLaw(
        name="coulomb_viscous",
        form=estimator("coulomb_viscous").form({}),
        values={"F_c": 1.0, "sigma_2": 1.0, "tau_0": 0.0},
    )
    return JointFit(
        servo=JointServo(kp=1.0),
        law=law,
        unknowns=tuple(unknowns),
        values=1.0 + change,
        jacobian=jacobian,
        residual=noise + jacobian @ change,
        blocks=blocks,
        **changes,
    )


def draw_problem(seed: int) -> tuple[Array, Array, Array]:
    """Return jacobian, noise and blocks, one of which weighs more than the others."""
    generator = np.random.default_rng(seed)
    blocks = np.repeat(np.arange(12), 30)
    jacobian = generator.standard_normal((len(blocks), 3)) * [1.0, 10.0, 0.1]
    jacobian[blocks == 4, 2] *= 4.0
    noise = generator.standard_normal(12)[blocks] + generator.standard_normal(len(blocks))
    return jacobian, noise, blocks


def test_the_covariance_is_that_of_fits_without_a_block() -> None:
    jacobian, noise, blocks = draw_problem(0)
    fit = linear_fit(jacobian, noise, blocks)
    differences = []
    for number in range(12):
        kept = blocks != number
        others = linear_fit(jacobian[kept], noise[kept], blocks[kept])
        differences.append(others.values - fit.values)
    expected = np.sum([np.outer(difference, difference) for difference in differences], axis=0)
    assert compute_interval(fit).covariance == pytest.approx(expected, rel=1e-9)


def test_a_latency_of_other_joints_widens_intervals() -> None:
    jacobian, noise, blocks = draw_problem(1)
    slope = jacobian @ [0.0, 2.0, -3.0]
    narrow = compute_interval(linear_fit(jacobian, noise, blocks)).covariance
    fit = linear_fit(jacobian, noise, blocks, latency_slope=slope)
    assert compute_interval(fit).covariance == pytest.approx(narrow)
    wide = compute_interval(fit, latency_error=0.5).covariance
    expected = 0.25 * np.outer([0.0, 2.0, -3.0], [0.0, 2.0, -3.0])
    assert wide - narrow == pytest.approx(expected, abs=1e-9)


def test_joints_that_disagree_widen_their_common_latency() -> None:
    jacobian, noise, blocks = draw_problem(2)
    fit = linear_fit(jacobian, noise, blocks)
    value, error = compute_interval(fit).find("latency")
    latency, latency_error = find_common_latency([fit])
    assert latency == value
    assert latency_error == pytest.approx(error)
    later = replace(fit, values=fit.values + np.array([20.0 * error, 0.0, 0.0]))
    latency, latency_error = find_common_latency([fit, later])
    assert latency == pytest.approx(value + 10.0 * error)
    assert latency_error == pytest.approx(np.sqrt(100.0 + 0.5) * error)
