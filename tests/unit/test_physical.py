"""Physically consistent identification: every identified body can exist."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.base_parameters import dependence, sample_regressor
from hesr_model.rigid_body.identification import RigidBody, identify_motions
from hesr_model.rigid_body.physical import (
    _Chart,
    find_nearest,
    is_possible,
    link_parameters,
    pseudo_inertia,
)
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.typed_files import from_json, to_json

MakeMotion = Callable[..., Motion]


@pytest.fixture
def guessed(arm: RobotDescription, tmp_path: Path) -> Robot:
    """The arm, with wrong masses (by a third) and inertias (by more) in the model file."""
    text = arm.model.read_text(encoding="utf-8")
    for old, new in (
        ('mass="4"', 'mass="5.3"'),
        ('mass="2.5"', 'mass="1.7"'),
        ('mass="1.2"', 'mass="1.6"'),
        ("0.02 0.04 0.03 0.002", "0.04 0.05 0.06 0.002"),
        ('armature="0.4"', 'armature="0.2"'),
        ('armature="0.1"', 'armature="0.2"'),
    ):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "guessed.xml"
    path.write_text(text, encoding="utf-8")
    return Robot(arm.model_copy(update={"model": path}))


def noisy(motion: Motion, sigma: float, seed: int) -> Motion:
    noise = sigma * np.random.default_rng(seed).standard_normal(motion.tau.shape)
    return replace(motion, tau=motion.tau + noise)


def least_eigenvalues(body: RigidBody) -> np.ndarray:
    """Smallest eigenvalue of each link's pseudo-inertia, relative to its largest."""
    values = [np.linalg.eigvalsh(pseudo_inertia(p)) for p in body.parameters[:30].reshape(-1, 10)]
    return np.array([v[0] / v[-1] for v in values])


# --- the parametrisation ----------------------------------------------------------------------


def test_pseudo_inertia_matches_the_library_and_is_invertible() -> None:
    body = pin.Inertia.Random()
    parameters = np.asarray(body.toDynamicParameters())
    expected = pin.PseudoInertia.FromDynamicParameters(parameters).toMatrix()
    np.testing.assert_allclose(pseudo_inertia(parameters), expected, atol=1e-12)
    np.testing.assert_allclose(link_parameters(expected), parameters, atol=1e-12)


def test_coordinates_start_at_the_model_file(arm_model: Robot) -> None:
    chart = _Chart.from_robot(arm_model)
    np.testing.assert_allclose(chart.parameters(chart.start), arm_model.nominal_parameters)


def test_slopes_match_differences_of_the_parameters(arm_model: Robot) -> None:
    chart = _Chart.from_robot(arm_model)
    x = chart.start + 0.3 * np.random.default_rng(1).standard_normal(len(chart.start))
    slopes = chart.slopes(x)
    for k in range(len(x)):
        step = np.zeros_like(x)
        step[k] = 1e-6
        expected = (chart.parameters(x + step) - chart.parameters(x - step)) / 2e-6
        np.testing.assert_allclose(slopes[:, k], expected, atol=1e-7)


def test_links_without_mass_or_with_impossible_inertia_still_start(
    arm: RobotDescription, tmp_path: Path
) -> None:
    text = arm.model.read_text(encoding="utf-8")
    point = text.replace("0.01 0.02 0.015 0 0.001 0", "1e-9 1e-9 1e-9 0 0 0")
    path = tmp_path / "point.xml"
    path.write_text(point, encoding="utf-8")
    model = Robot(arm.model_copy(update={"model": path}))
    model.nominal_parameters[:10] = 0.0
    chart = _Chart.from_robot(model)
    started = chart.parameters(chart.start)
    assert started[0] == pytest.approx(1.0)
    for link in started[:30].reshape(-1, 10):
        assert np.linalg.eigvalsh(pseudo_inertia(link))[0] > 0
    np.testing.assert_allclose(started[20:24], model.nominal_parameters[20:24])


# --- identification ---------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["stacked", "paper"])
def test_without_noise_the_torque_is_recovered(
    method: str, guessed: Robot, arm_model: Robot, make_motion: MakeMotion
) -> None:
    forward, backward = make_motion(friction=3.0), make_motion(friction=3.0, reverse=True)
    body = identify_motions(
        [forward], guessed, method=method, reversed_motions=[backward], physical=True
    )
    other = make_motion(seconds=7.0)
    other = replace(other, q=1.2 * other.q + 0.1, dq=1.2 * other.dq, ddq=1.2 * other.ddq)
    truth = arm_model.torque(arm_model.nominal_parameters, other.q, other.dq, other.ddq)
    np.testing.assert_allclose(body.torque(guessed, other), truth, atol=2e-3)
    assert np.all(least_eigenvalues(body) > 0)
    if method == "stacked":
        np.testing.assert_allclose(body.friction, [[3.0, 1.5, 0.0]] * 3, atol=2e-3)


def test_with_enough_data_it_equals_the_free_fit(guessed: Robot, make_motion: MakeMotion) -> None:
    motions = [noisy(make_motion(friction=3.0, seconds=s), 0.3, k) for k, s in enumerate((20, 30))]
    free = identify_motions(motions, guessed)
    body = identify_motions(motions, guessed, physical=True)
    assert body.physical
    assert not free.physical
    difference = body.torque(guessed, motions[0]) - free.torque(guessed, motions[0])
    spread = np.std(motions[0].tau, axis=0)
    assert np.all(np.sqrt(np.mean(difference**2, axis=0)) < [0.05 * s for s in spread])
    np.testing.assert_allclose(body.rmse, free.rmse, rtol=0.01)


def test_short_noisy_logs_give_possible_bodies_that_predict_better(
    guessed: Robot, arm_model: Robot, make_motion: MakeMotion
) -> None:
    other = make_motion(seconds=10.0)
    errors: dict[bool, list[np.ndarray]] = {False: [], True: []}
    for seed in range(6):
        short = noisy(make_motion(friction=3.0, seconds=2.0), 1.0, seed)
        for physical, found in errors.items():
            body = identify_motions([short], guessed, physical=physical)
            found.append(np.sqrt(np.mean((body.torque(guessed, other) - other.tau) ** 2, axis=0)))
            if physical:
                assert np.all(least_eigenvalues(body) > 0)
                assert np.all(body.parameters[30:] >= 0)
    assert np.all(np.mean(errors[True], axis=0) < np.mean(errors[False], axis=0))


def test_friction_that_one_way_motion_does_not_separate_decides_nothing(
    guessed: Robot, one_way: Motion, make_motion: MakeMotion
) -> None:
    """Friction of the first joint is that of one speed, of the second one has no offset."""
    body = identify_motions([one_way], guessed, physical=True)
    np.testing.assert_allclose(body.friction[0], [3.0 + 0.5 * 1.5, 0.0, 0.0], atol=0.02)
    np.testing.assert_allclose(body.friction[1:], [[3.0, 1.5, 0.0]] * 2, atol=0.02)
    other = make_motion(seconds=7.0)
    # The first joint never accelerates, so that its rotor stays that of the model file.
    np.testing.assert_allclose(body.torque(guessed, other)[:, 1:], other.tau[:, 1:], atol=1e-3)


def test_undetermined_parameters_stay_as_in_the_model_file(
    guessed: Robot, make_motion: MakeMotion, caplog: pytest.LogCaptureFixture
) -> None:
    motion = make_motion(friction=3.0)
    still = replace(motion, q=0 * motion.q, ddq=0 * motion.ddq)
    with caplog.at_level(logging.WARNING):
        body = identify_motions([still], guessed, physical=True)
    assert body.ridge == 0.0
    assert not caplog.records
    ratio = body.parameters[[0, 10, 20]] / guessed.nominal_parameters[[0, 10, 20]]
    assert np.all((ratio > 0.2) & (ratio < 5.0))


def test_errors_shrink_with_more_data_and_cover_the_truth(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    short, long = (
        identify_motions(
            [noisy(make_motion(friction=3.0, seconds=s), 0.5, 0)], arm_model, physical=True
        )
        for s in (5.0, 40.0)
    )
    assert np.all(long.standard_errors < short.standard_errors)
    carried = dependence(arm_model, long.base)
    error = carried @ (long.parameters - arm_model.nominal_parameters)
    assert np.all(np.abs(error) < 5 * long.standard_errors)


def test_it_survives_json_and_is_reproducible(arm_model: Robot, make_motion: MakeMotion) -> None:
    motion = noisy(make_motion(friction=3.0), 0.3, 0)
    body, again = (identify_motions([motion], arm_model, physical=True) for _ in range(2))
    np.testing.assert_array_equal(body.parameters, again.parameters)
    back = from_json(RigidBody, to_json(body), Path("x.json"), "a rigid body")
    assert back.physical
    np.testing.assert_array_equal(back.parameters, body.parameters)
    oldest = {key: value for key, value in to_json(body).items() if key != "kind"}
    assert from_json(RigidBody, oldest, Path("x.json"), "a rigid body").kind == "free"
    older = oldest | {"physical": True}
    assert from_json(RigidBody, older, Path("x.json"), "a rigid body").kind == "physical"


def test_base_parameters_become_bodies_of_the_same_torque(arm_model: Robot) -> None:
    """The least-squares solution of smallest norm has possible torques but impossible bodies."""
    rows = sample_regressor(arm_model)
    torque = rows @ arm_model.nominal_parameters
    base = np.linalg.lstsq(rows, torque, rcond=None)[0]
    assert is_possible(arm_model, arm_model.nominal_parameters)
    assert not is_possible(arm_model, base)
    found, off, largest = find_nearest(arm_model, base)
    assert is_possible(arm_model, found)
    np.testing.assert_allclose(rows @ found, torque, atol=2e-3 * np.abs(torque).max())
    assert np.all(off < 2e-3 * largest)


def test_impossible_torques_are_approximated(arm_model: Robot) -> None:
    light = arm_model.nominal_parameters.copy()
    light[arm_model.inertial - 3 : arm_model.inertial] = -0.2  # rotors
    light[10:20] *= -0.1
    assert not is_possible(arm_model, light)
    found, off, _ = find_nearest(arm_model, light)
    assert is_possible(arm_model, found)
    rows = sample_regressor(arm_model)
    expected = np.abs((rows @ (found - light)).reshape(-1, arm_model.n)).max(axis=0)
    np.testing.assert_allclose(off, expected)
    assert np.all(off > 0.1)
