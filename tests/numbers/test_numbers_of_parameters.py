"""Steps in the fits of bodies, torque constants and payloads, and in their simulation."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from joint_data import law as made
from unchanged import Unchanged

from hesr_model.errors import FitError
from hesr_model.forward import output_error
from hesr_model.forward.simulation import Simulator, cut_windows, position_errors, to_single_window
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import LawStepper
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body import physical, torque_constants
from hesr_model.rigid_body.identification import RigidBody, identify_motions
from hesr_model.rigid_body.least_squares import Block, estimate_covariance, solve
from hesr_model.rigid_body.observations import match_motions
from hesr_model.rigid_body.residual import motion_records
from hesr_model.robots.robot import Robot

MakeMotion = Callable[..., Motion]

LAW = made(
    "lugre", {}, sigma_0=600.0, sigma_1=0.5, sigma_2=1.0, F_c=1.0, F_s=1.6, v_s=0.15, tau_0=0.05
)


# --- least squares ----------------------------------------------------------------------------


@pytest.mark.parametrize("condition", [100.0, 990.0, 1010.0, 1e5])
def test_least_squares_with_a_ridge_if_needed(condition: float, unchanged: Unchanged) -> None:
    rng = np.random.default_rng(1)
    blocks = []
    for k, size in enumerate((0.3, 2.0)):
        q = np.linalg.qr(rng.normal(size=(60, 3)))[0] * [1.0, 0.3, 1.0 / condition]
        target = q @ [1.0, -2.0, 40.0] + 0.02 * size * rng.normal(size=60)
        blocks.append(Block(matrix=q, target=target, samples=np.arange(60) + 30 * k))
    found = solve(blocks, scale=np.ones(3), weighted=True)
    labels = np.repeat(np.arange(3), 30)
    assert (found.ridge > 0.0) == (condition > 1000.0)
    unchanged(
        {
            "found": found,
            "plain": solve(blocks, scale=np.array([1.0, 2.0, 0.1]), weighted=False),
            "covariance": estimate_covariance(blocks, found, labels).matrix,
        },
        rtol=1e-5,
    )


# --- bodies that can exist --------------------------------------------------------------------

LINKS = {
    "plain": [2.0, 0.2, -0.1, 0.3, 0.2, 0.01, 0.25, -0.02, 0.005, 0.15],
    "point": [2.0, 0.2, -0.1, 0.3, 0.05, 0.01, 0.065, -0.03, 0.015, 0.025],
    "none": [0.0] * 10,
    "impossible": [1.0, 0.0, 0.0, 0.0, 0.3, 0.0, 0.01, 0.0, 0.0, 0.01],
}


@pytest.mark.parametrize("name", LINKS)
def test_search_start_of_a_link(name: str, unchanged: Unchanged) -> None:
    start = physical._start_inertia(np.array(LINKS[name]))
    unchanged({"start": start, "factor": physical._upper_factor(start)})
    assert np.linalg.eigvalsh(start).min() > 0.0


def test_coordinates_of_bodies(arm_model: Robot, unchanged: Unchanged) -> None:
    chart = physical._Chart.from_robot(arm_model)
    x = chart.start + 0.3 * np.random.default_rng(0).normal(size=len(chart.start))
    slopes = chart.slopes(x)
    rotors = arm_model.nominal_parameters[10 * arm_model.links : arm_model.inertial]
    unchanged({"start": chart.start, "pull": chart.pull, "rotors": rotors,
               "parameters": chart.parameters(x), "slopes": slopes[::3].tolist()})  # fmt: skip
    for k in range(len(x)):
        step = 1e-6 * np.eye(len(x))[k]
        difference = (chart.parameters(x + step) - chart.parameters(x - step)) / 2e-6
        np.testing.assert_allclose(slopes[:, k], difference, atol=1e-7)
    unknown = SimpleNamespace(
        nominal_parameters=np.array([*LINKS["plain"], 0.0]),
        links=1,
        inertial=11,
        parameter_names=("",) * 11,
    )
    of = physical._Chart.from_robot(unknown)
    assert of.start.tolist() == [0.0] * 10 + [1.0]
    assert of.pull.tolist() == [0.2] * 10 + [1e-4]


def test_weights_of_joints() -> None:
    blocks = [Block(matrix=np.ones((n, 1)), target=np.ones(n)) for n in (10, 30)]
    found = physical._compute_weights(blocks, np.array([2.0, 1e-9]), True)
    np.testing.assert_allclose(found, [0.5, 1.0 / 2e-6])
    found = physical._compute_weights(blocks, np.array([2.0, 1.0]), False)
    np.testing.assert_allclose(found, 1.0 / np.sqrt(70.0 / 40.0))


# --- torque constants -------------------------------------------------------------------------


def test_uncertainty_of_a_model_file() -> None:
    links = [
        [4.0, 0.8, 0.0, 0.0, 0.5, 0.0, -0.7, 0.0, 0.0, 0.1],  # the lever arm is 0.2 m
        [2.0, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],  # at the least lever arm of 0.05 m
        [0.001, 0.0, 0.0, 4e-4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],  # a thousandth of the heaviest
    ]
    nominal = np.array([*np.ravel(links), 0.1, 0.2, 0.3])
    model = SimpleNamespace(nominal_parameters=nominal, links=3, inertial=33)
    found = torque_constants._prior_deviations(model, 0.1)
    expected = [
        [0.4, *[0.08] * 3, *[2.1] * 6],
        [0.2, *[0.01] * 3, *[0.015] * 6],
        [4e-4, *[4e-5] * 3, *[1.2e-4] * 6],
    ]
    np.testing.assert_allclose(found[:30].reshape(3, 10), expected, rtol=1e-12)
    assert found[30:].tolist() == [3.0] * 3
    empty = SimpleNamespace(nominal_parameters=np.zeros(11), links=1, inertial=11)
    light = torque_constants._prior_deviations(empty, 0.1)
    np.testing.assert_allclose(light[[0, 1, 4]], [1e-7, 5e-9, 7.5e-9], rtol=1e-12)


@pytest.mark.parametrize("error", [0.0, 1.0, -0.1])
def test_a_declared_error_is_relative(error: float, arm_model: Robot) -> None:
    with pytest.raises(FitError, match="expected a share"):
        torque_constants.torque_constants([], arm_model, [1.0] * 3, mass_error=error)


def test_a_constant_is_determined_up_to_a_fifth() -> None:
    one = torque_constants.TorqueConstant(
        joint="j1", value=12.345678, error=1.2345, determined=True
    )
    assert one.sentence == "joint 'j1': 12.35 +- 1.2 N.m/A."
    assert torque_constants._MAX_RELATIVE_ERROR == 0.2


def test_a_point_has_the_inertia_of_its_place() -> None:
    found = torque_constants.point_payload(2.0, (0.1, 0.2, 0.3))
    expected = [2.0, 0.2, 0.4, 0.6, 0.26, -0.04, 0.2, -0.06, -0.12, 0.1]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_steps_of_a_constant(
    arm_model: Robot, make_motion: MakeMotion, unchanged: Unchanged
) -> None:
    """A joint with two kinds of logs; its starts, residuals and slopes are recorded."""
    motion = make_motion(seconds=4.0, friction=0.5)
    noise = 0.2 * np.random.default_rng(0).normal(size=motion.tau.shape)
    logs = [replace(motion, tau=motion.tau * 1.2 + noise)]
    every = tuple(range(len(arm_model.parameter_names)))
    columns = torque_constants.friction_columns(arm_model, torque_constants.base_columns(arm_model))
    blocks = torque_constants.stack_blocks(logs, arm_model, every, columns)
    payload = torque_constants.point_payload(2.0, (0.05, 0.0, 0.1))
    weight = np.zeros(len(every))
    weight[[k for k in range(30) if k % 10 < 4]] = 1.0
    found = {}
    for name, kinds in (("one", [np.zeros(10)]), ("two", [np.zeros(10), payload])):
        problem = torque_constants._Problem.from_blocks(
            [(blocks[1], carried) for carried in kinds],
            arm_model,
            weight,
            torque_constants._prior_deviations(arm_model, 0.1),
        )
        start = problem._find_start()
        scales = [2.0, 3.0][: len(kinds)]
        left = problem._residuals(start + 0.01, scales)
        slopes = problem._slopes(start + 0.01, scales)
        found[name] = {
            "known": problem.trusted_torque, "start": start, "solved": problem.solve(),
            # Rows of a factor are not unique, but their products are.
            "gram": (slopes.T @ slopes)[::5].tolist(), "moment": slopes.T @ left,
            "left": float(left @ left),
            "lengths": [rows.length for rows in problem.load_cases],
            "counts": [rows.count for rows in problem.load_cases],
        }  # fmt: skip
    unchanged(found, rtol=1e-4, atol=1e-6)


# --- a motion and its reverse -----------------------------------------------------------------


def test_a_motion_is_matched_with_its_reverse(
    make_motion: MakeMotion, unchanged: Unchanged
) -> None:
    forward, backward = (make_motion(seconds=4.0, reverse=way, friction=1.0) for way in (0, 1))
    late = replace(backward, t=backward.t[:-20], **{
        name: getattr(backward, name)[20:] for name in ("q", "dq", "ddq", "tau", "q_raw")
    })  # fmt: skip

    def pair(back: Motion) -> dict[str, Motion]:
        return dict(zip(("forward", "backward"), match_motions(forward, back), strict=True))

    unchanged({"pair": pair(late), "whole": pair(backward)})


# --- simulation -------------------------------------------------------------------------------


@pytest.fixture
def friction(arm_model: Robot) -> FrictionModel:
    seen = TrainedRange(sample_time=0.005, dq=(-2, 2), q=(-2, 2), tau_load=(-30, 30), tau=(-5, 5))
    laws = tuple(
        replace(LAW, values=LAW.values | {"F_c": f, "tau_0": 0.0 if f > 1.0 else 0.05})
        for f in (1.0, 1.2, 0.4)
    )
    return FrictionModel(
        law="lugre",
        robot="arm",
        joints=arm_model.description.joints,
        laws=laws,
        sample_time=0.005,
        trained=(seen,) * 3,
        training_rmse=(0.1,) * 3,
    )


@pytest.fixture
def motion(make_motion: MakeMotion) -> Motion:
    made = make_motion(name="run", seconds=3.0, friction=1.0)
    noise = np.random.default_rng(2).normal(size=made.tau.shape)
    return replace(made, tau=made.tau + 0.1 * noise)


@pytest.fixture
def body(motion: Motion, arm_model: Robot) -> RigidBody:
    return identify_motions([motion], arm_model)


@pytest.mark.parametrize("as_plant", [False, True])
def test_a_simulation(
    as_plant: bool,
    motion: Motion,
    arm_model: Robot,
    friction: FrictionModel,
    body: RigidBody,
    unchanged: Unchanged,
) -> None:
    records = motion_records(motion, arm_model, body)
    windows = cut_windows([records], 0.3)
    simulator = Simulator(
        robot=arm_model, parameters=body.parameters, model=friction, as_plant=as_plant
    )
    found = simulator.run(windows)
    unchanged({
        "found": found[:, ::7].tolist(), "errors": position_errors(found, windows),
        "places": [row for _, row in windows.places],
        "states": windows.compute_states(friction, delay=3),
        "whole": len(to_single_window(records).t[0]),
    }, rtol=1e-5)  # fmt: skip
    lost = found.copy()
    lost[0, -1, 1] = np.nan
    assert [e is None for e in position_errors(lost, windows)] == [False, True, False]


def test_costs_of_an_output_error(
    motion: Motion,
    arm_model: Robot,
    friction: FrictionModel,
    body: RigidBody,
    unchanged: Unchanged,
) -> None:
    logs = [motion_records(motion, arm_model, body)]
    sets = [cut_windows(logs, output_error.SHORT_WINDOW)]
    problem = output_error._Problem(arm_model, body, friction, [motion], logs, sets, with_body=True)
    theta = 0.05 * np.random.default_rng(0).normal(size=(3, problem.size))
    residuals, slopes = problem.linearise(theta[0])
    # Coefficients of 0 have no relative change.
    assert problem.size == len(problem.columns) + sum(
        value != 0.0 for law in friction.laws for value in law.values.values()
    )
    change = problem._limit_change(np.full(problem.size, 0.6))
    away = problem.build_refinement(change, problem.position_sizes, problem.position_sizes)
    assert away.ratio <= 1.0
    unchanged({
        "size": problem.size, "costs": problem.compute_costs(theta),
        "residuals": residuals, "slopes": slopes[::211].tolist(),
        "position": problem.position_sizes[0], "torque": problem._torque_sizes,
        "moved": [law.values for law in problem._change_friction(theta[1]).laws],
        "body": problem._change_body(theta[1]).parameters, "away": away.ratio,
    }, rtol=1e-3, atol=1e-6)  # fmt: skip


def test_trials_of_an_output_error() -> None:
    of = output_error
    assert (of.SHORT_WINDOW, of.MAX_TORQUE_RATIO, of._DIFFERENCE_STEP, of._TORQUE_WEIGHT) == (
        0.5,
        1.02,
        1e-3,
        0.5,
    )
    assert (of._MAX_CHANGE, of._START_SPREAD, of._MIN_GAIN) == (0.7, 0.15, 1e-3)
    assert of._DAMPING == (1e-3, 1e-2, 1e-1, 1.0, 1e1)
    assert of._STEP_SHARES == (1.0, 0.75, 0.5, 0.35, 0.25, 0.15)


@pytest.mark.parametrize("how", ["exact", "euler"])
def test_steps_of_many_motions(how: str, unchanged: Unchanged) -> None:
    of = replace(LAW, discretisation=how)
    rng = np.random.default_rng(0)
    dt, dq, q, load = np.full(6, 1e-3), *rng.normal(size=(3, 6))
    x = 0.001 * rng.normal(size=(1, 6))
    alone, after = LawStepper(of)(dt, dq, q, load, x)
    values = np.repeat(np.array(list(of.values.values()))[:, None], 6, axis=1) * (1 + 0.1 * dq)
    each, states = LawStepper(of, values)(dt, dq, q, load, x)
    unchanged({"alone": alone, "after": after, "each": each, "states": states})
