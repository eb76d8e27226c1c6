"""Servo, friction and scale from commands and positions: draws of joints whose truth is known.

`pytest -m soak tests/benchmarks/test_servo_draws.py -s` prints all figures; DRAWS divides the
numbers of draws by a factor, as in DRAWS=5.
"""

import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hobby_servo import HobbyServo, draw_current, draw_hobby_servo
from industrial_joint import IndustrialJoint, draw_industrial_joint
from position_arm import FRICTION, JOINTS, KP, LATENCY, PositionArm, draw_position_arm, write_arm
from scipy.special import ndtri

from cosim.servo.choice import choose_from_commands
from cosim.servo.engine import FINE_SUBSTEP, JointEngine
from cosim.servo.model import fit_from_commands
from cosim.servo.motion import predict_motion
from cosim.servo.record import read_servo_records
from hesr_model.errors import FitError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot
from hesr_model.robots.servo_description import ServoDescription

Array = np.ndarray

SHARE = float(os.environ.get("DRAWS", "1"))
SPEEDS = np.linspace(0.05, 2.5, 50)  # of the compared friction curves [rad/s]
ROUNDING = 1.0 / np.sqrt(12.0)  # standard deviation of a rounding, in steps
BODY_ERROR = 0.2
MOST_ERROR = 0.2  # of friction that may be wrong without a sentence
LEAST_COVERAGE = 0.85
WIDEST = 3.0  # half width of an interval over the error that 68 % of draws keep

pytestmark = [pytest.mark.soak, pytest.mark.timeout(0)]


@dataclass(frozen=True, kw_only=True)
class Reported:
    """A number that a fit reports, with the half width of its 95 % interval, and its truth."""

    name: str
    value: float
    half_width: float
    truth: float

    @property
    def error(self) -> float:
        """Relative error."""
        return self.value / self.truth - 1.0

    @property
    def relative_width(self) -> float:
        """Half width over the truth."""
        return self.half_width / self.truth

    @property
    def holds_truth(self) -> bool:
        """Whether the interval holds the truth."""
        return abs(self.value - self.truth) <= self.half_width


def say(*lines: str) -> None:
    """Print lines of a table."""
    sys.stdout.write("\n".join(["", *lines, ""]))
    sys.stdout.flush()


def count_draws(number: int) -> int:
    """Return the number of draws of this run."""
    return max(round(number / SHARE), 1)


def compute_friction(values: Mapping[str, float], speeds: Array) -> Array:
    """Return the friction of Coulomb, Stribeck and viscous terms at positive speeds."""
    friction = values["F_c"] + values["sigma_2"] * speeds
    if "F_s" in values:
        fall = np.exp(-((speeds / values["v_s"]) ** 2))
        friction = friction + (values["F_s"] - values["F_c"]) * fall
    return np.asarray(friction)


def compare_curves(found: Mapping[str, float], truth: Mapping[str, float]) -> Array:
    """Return the relative errors (S,) of a friction curve at all speeds."""
    true_curve = compute_friction(truth, SPEEDS)
    return np.asarray(np.abs(compute_friction(found, SPEEDS) / true_curve - 1.0))


def list_reported(model: FrictionModel, truth: Mapping[str, float]) -> list[Reported]:
    """Return what the fit of one joint reports with an interval and whose truth is known."""
    [fitted] = model.servos
    [law] = model.laws
    reported = [
        Reported(
            name=name,
            value=float(getattr(fitted.servo, name)),
            half_width=half_width,
            truth=truth[name],
        )
        for name, half_width in fitted.intervals.items()
        if name in truth
    ]
    reported += [
        Reported(name=name, value=law.values[name], half_width=1.96 * error, truth=truth[name])
        for name, error in law.standard_errors.items()
    ]
    return reported


def find_truth_of_lever(draw: HobbyServo) -> dict[str, float]:
    """Return all values that a fit may report."""
    return {
        "kp": draw.servo.kp[0],
        "armature": draw.armature,
        "latency": draw.servo.latency,
        "body_factor": 1.0,
        **draw.law.values,
    }


def find_truth_of_joint(draw: IndustrialJoint) -> dict[str, float]:
    """Return all values that a fit may report."""
    return {
        "kp": draw.kp,
        "ki": draw.ki,
        "kd": draw.kd,
        "armature": draw.armature,
        "latency": draw.latency,
        **draw.law.values,
    }


def fit_draw(draw: HobbyServo | IndustrialJoint, law_name: str) -> FrictionModel:
    """Return the law and the servo of the log of a draw."""
    log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot)
    return fit_from_commands([log], draw.robot, law_name, workers=1)


def make_folder(parent: Path, *parts: object) -> Path:
    """Return a new folder for a draw."""
    folder = parent / "_".join(map(str, parts))
    folder.mkdir()
    return folder


def require_sound_intervals(title: str, draws: list[list[Reported]]) -> None:
    """Print and assert how many intervals hold the truth, and that none is far too wide."""
    lines = [f"{title}: 95 % intervals over {len(draws)} draws"]
    failures = []
    names = sorted({reported.name for numbers in draws for reported in numbers})
    for name in names:
        numbers = [reported for draw in draws for reported in draw if reported.name == name]
        coverage = float(np.mean([number.holds_truth for number in numbers]))
        error = float(np.quantile([abs(number.error) for number in numbers], 0.68))
        width = float(np.median([number.relative_width for number in numbers]))
        lines.append(
            f"{name:14}: {len(numbers)} reported, {coverage:.0%} hold; 68 % error {error:.2%}, "
            f"half width {width:.2%}, ratio {width / error:.1f}"
        )
        if coverage < LEAST_COVERAGE or width > WIDEST * error:
            failures.append(name)
    say(*lines)
    assert failures == []


@pytest.fixture(scope="module", params=["coulomb_viscous", "stribeck"])
def known_levers(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[HobbyServo], list[FrictionModel]]:
    """Draw hobby servos with a lever of known mass, and fit the true law to each."""
    parent = tmp_path_factory.mktemp("levers")
    draws, models = [], []
    for seed in range(count_draws(40)):
        draw = draw_hobby_servo(
            make_folder(parent, seed),
            seed,
            law_name=request.param,
            extra="[scale]\nbody_error = 0.0",
        )
        draws.append(draw)
        models.append(fit_draw(draw, request.param))
    return draws, models


def test_hobby_servos_are_found(known_levers) -> None:
    pairs = list(zip(*known_levers, strict=True))[: count_draws(20)]
    curves, gains, latencies, residuals, lines = [], [], [], [], []
    for seed, (draw, model) in enumerate(pairs):
        [fitted] = model.servos
        curves.append(compare_curves(model.laws[0].values, draw.law.values))
        gains.append(abs(fitted.servo.kp / draw.servo.kp[0] - 1.0))
        latencies.append(1e3 * abs(fitted.servo.latency - draw.servo.latency))
        residuals.append(fitted.position_rmse / (2.0 * np.pi / 4096 * ROUNDING))
        lines.append(
            f"{seed:3} at {1.0 / draw.t[1]:3.0f} Hz: curve {np.median(curves[-1]):.2%}, gain "
            f"{gains[-1]:.2%}, delay {latencies[-1]:.3f} ms, error {residuals[-1]:.2f} roundings"
        )
    say(
        f"hobby servo, {known_levers[1][0].law}",
        *lines,
        f"curve: median {np.median(curves):.2%}, 90 % {np.quantile(curves, 0.9):.2%}; "
        f"gain median {np.median(gains):.2%}, 90 % {np.quantile(gains, 0.9):.2%}; "
        f"delay at most {max(latencies):.3f} ms; largest error {max(residuals):.2f}",
    )
    assert np.median(curves) <= 0.01
    assert np.quantile(curves, 0.9) <= 0.02
    assert np.median(gains) <= 0.005
    assert max(latencies) <= 0.5
    assert max(residuals) <= 1.3


def test_intervals_of_hobby_servos_hold_the_truth(known_levers) -> None:
    draws, models = known_levers
    numbers = [
        list_reported(model, find_truth_of_lever(draw))
        for draw, model in zip(draws, models, strict=True)
    ]
    # The factor of a lever of known mass is 1 by definition.
    without_factor = [
        [reported for reported in of_draw if reported.name != "body_factor"] for of_draw in numbers
    ]
    require_sound_intervals(f"known lever, {models[0].law}", without_factor)


def test_intervals_hold_the_truth_where_masses_are_uncertain(tmp_path: Path) -> None:
    numbers = []
    draw_count = count_draws(40)
    # Evenly spread over the probabilities, so that chance does not decide about the widths.
    deviations = ndtri((np.arange(draw_count) + 0.5) / draw_count)
    for seed, factor in enumerate(np.exp(BODY_ERROR * deviations).tolist()):
        draw = draw_hobby_servo(make_folder(tmp_path, seed), 100 + seed, body_factor=factor)
        model = fit_draw(draw, "coulomb_viscous")
        truth = {**find_truth_of_lever(draw), "body_factor": factor}
        numbers.append(list_reported(model, truth))
    require_sound_intervals(f"masses within {BODY_ERROR:.0%}", numbers)


def test_industrial_joints_are_found(tmp_path: Path) -> None:
    curves, residuals, lines, numbers = [], [], [], []
    gains: dict[str, list[float]] = {"kp": [], "ki": [], "kd": []}
    for seed in range(count_draws(20)):
        draw = draw_industrial_joint(
            make_folder(tmp_path, seed), seed, extra="[scale]\nbody_error = 0.0"
        )
        model = fit_draw(draw, "coulomb_viscous")
        [fitted] = model.servos
        curves.append(compare_curves(model.laws[0].values, draw.law.values))
        residuals.append(fitted.position_rmse / (draw.step * ROUNDING))
        for name, errors in gains.items():
            errors.append(abs(getattr(fitted.servo, name) / getattr(draw, name) - 1.0))
        numbers.append(list_reported(model, find_truth_of_joint(draw)))
        gain_errors = ", ".join(f"{name} {errors[-1]:.2%}" for name, errors in gains.items())
        lines.append(
            f"{seed:3}: curve {np.median(curves[-1]):.2%}, {gain_errors}, error {residuals[-1]:.2f}"
        )
    medians_of_gains = {name: float(np.median(errors)) for name, errors in gains.items()}
    say(
        "industrial joint under a PID",
        *lines,
        f"curve: median {np.median(curves):.2%}, 90 % {np.quantile(curves, 0.9):.2%}; "
        f"largest error {max(residuals):.2f} roundings; gains {medians_of_gains}",
    )
    require_sound_intervals("industrial joint", numbers)
    assert np.median(curves) <= 0.01
    assert np.quantile(curves, 0.9) <= 0.05
    assert max(medians_of_gains.values()) <= 0.015
    assert max(residuals) <= 1.3


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[PositionArm, FrictionModel]:
    """Return the arm of six joints with its fit."""
    folder = tmp_path_factory.mktemp("arm")
    position_arm = draw_position_arm(folder, 0)
    model = fit_from_commands(position_arm.logs, position_arm.robot, "coulomb_viscous", workers=1)
    return position_arm, model


def test_an_arm_of_six_joints_is_found(arm) -> None:
    position_arm, model = arm
    gains = np.array([fitted.servo.kp for fitted in model.servos])
    coulomb = np.array([law.values["F_c"] for law in model.laws])
    errors = np.vstack(
        [predict_motion(model, position_arm.robot, log) - log.q for log in position_arm.logs]
    )
    coupled_rmse = np.sqrt(np.mean(errors**2, axis=0))
    own_rmse = np.array([fitted.position_rmse for fitted in model.servos])
    say(
        "arm of six joints, simulated by MuJoCo",
        f"gain {np.round(100.0 * (gains / KP - 1.0), 2)} %",
        f"Coulomb {np.round(100.0 * (coulomb / FRICTION - 1.0), 2)} %",
        f"delay {1e3 * (model.servos[0].servo.latency - LATENCY):.2f} ms",
        f"error of each joint alone {np.round(1e3 * own_rmse, 3)} mrad",
        f"error of the whole arm {np.round(1e3 * coupled_rmse, 3)} mrad",
    )
    assert np.max(np.abs(gains / KP - 1.0)) <= 0.03
    assert np.max(np.abs(coulomb / FRICTION - 1.0)) <= 0.05
    assert np.max(own_rmse) <= 0.6e-3
    assert np.max(coupled_rmse) <= 0.6e-3


def test_wrong_masses_move_the_scale_within_its_interval(arm, tmp_path: Path) -> None:
    position_arm, right = arm
    lines = []
    right_ratios = _find_ratios(right)
    moves = []
    held = []
    for seed in range(count_draws(4)):
        generator = np.random.default_rng(seed)
        signs = generator.choice([-1.0, 1.0], JOINTS)
        robot = Robot(write_arm(make_folder(tmp_path, seed), 1.0 + BODY_ERROR * signs))
        model = fit_from_commands(position_arm.logs, robot, "coulomb_viscous", workers=1)
        gains = np.array([fitted.servo.kp for fitted in model.servos])
        widths = np.array([fitted.intervals["kp"] for fitted in model.servos])
        held.append(np.abs(gains - KP) <= widths)
        moves.append(np.abs(_find_ratios(model) / right_ratios - 1.0))
        lines.append(
            f"{seed}: gain {np.round(100.0 * (gains / KP - 1.0), 1)} %, half width "
            f"{np.round(100.0 * widths / gains, 1)} %, ratios {np.round(100.0 * moves[-1], 2)} %"
        )
    say("masses 20 % wrong", *lines)
    assert np.all(held)
    assert np.max(moves) < 0.03


def _find_ratios(model: FrictionModel) -> Array:
    """Return Coulomb friction over the gain of each joint."""
    pairs = zip(model.laws, model.servos, strict=True)
    return np.array([law.values["F_c"] / fitted.servo.kp for law, fitted in pairs])


@pytest.mark.parametrize("filter_time", [0.05, 0.2])
def test_filtered_commands_are_found_or_said(tmp_path: Path, filter_time: float) -> None:
    lines, unsaid, found = [], [], []
    for seed in range(count_draws(20)):
        draw = draw_hobby_servo(make_folder(tmp_path, seed), seed, command_filter=filter_time)
        try:
            model = fit_draw(draw, "coulomb_viscous")
        except FitError as error:
            lines.append(f"{seed:3}: {error}")
            continue
        fitted_filter = model.servos[0].servo.command_filter
        curve = compare_curves(model.laws[0].values, draw.law.values)
        said = " ".join(model.provenance["from_commands"])
        is_said = "incomplete" in said
        is_wrong = np.median(curve) > MOST_ERROR
        found.append(abs(fitted_filter / filter_time - 1.0) < 0.1)
        if is_wrong and not is_said:
            unsaid.append(seed)
        lines.append(
            f"{seed:3}: filter {1e3 * fitted_filter:.1f} ms, curve {np.median(curve):.2%}"
            f"{', said' if is_said else ''}"
        )
    say(
        f"commands filtered by {1e3 * filter_time:.0f} ms", *lines, f"found in {np.mean(found):.0%}"
    )
    assert unsaid == []
    assert np.mean(found) >= 0.9


def test_a_gain_five_times_off_is_said(tmp_path: Path) -> None:
    missing = []
    for seed in range(count_draws(10)):
        draw = draw_hobby_servo(make_folder(tmp_path, seed), seed)
        factor = 5.0 if seed % 2 else 0.2
        stated = ServoDescription(kp=factor * draw.servo.kp[0])
        robot = Robot(draw.robot.description.model_copy(update={"servo": stated}))
        model = fit_draw(replace(draw, robot=robot), "coulomb_viscous")
        assert model.servos[0].servo.kp == stated.kp
        said = " ".join(model.provenance["from_commands"])
        if "disagree by a factor" not in said:
            missing.append(seed)
    assert missing == []


def test_the_cost_of_a_fit_is_printed(tmp_path: Path) -> None:
    draw = draw_hobby_servo(tmp_path, 0, rate=50.0, law_name="stribeck")
    started = time.process_time()
    model = fit_draw(draw, "stribeck")
    fit_seconds = time.process_time() - started
    law: FrictionLaw = model.laws[0]
    log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot)
    [[record]] = read_servo_records([log], draw.robot, draw.robot.nominal_parameters)
    with JointEngine(law) as engine:
        engine.run(record, model.servos[0].servo, law.values)
        started = time.process_time()
        for _ in range(20):
            engine.run(record, model.servos[0].servo, law.values, substep=FINE_SUBSTEP)
        run_seconds = (time.process_time() - started) / 20.0
    say(
        f"40 s at 50 Hz: {fit_seconds / draw.t[-1]:.3f} of the log's time, "
        f"{fit_seconds / run_seconds:.0f} runs with fine inner steps"
    )
    assert model.servos[0].position_rmse < model.servos[0].ideal_rmse


def test_no_size_is_claimed_about_a_vertical_axis(tmp_path: Path) -> None:
    sources = []
    for seed in range(count_draws(20)):
        draw = draw_hobby_servo(make_folder(tmp_path, seed), seed, is_vertical=True)
        sources.append(fit_draw(draw, "coulomb_viscous").servos[0].scale)
    assert sources == ["none"] * len(sources)


@pytest.mark.parametrize("kind", ["motor", "supply", "neither"])
def test_currents_without_a_sign_are_told_apart(tmp_path: Path, kind: str) -> None:
    said = {"motor": "that of the motor", "supply": "that of the supply", "neither": "not used"}
    lines, errors = [], []
    for seed in range(count_draws(20)):
        draw = draw_hobby_servo(make_folder(tmp_path, seed), seed, is_vertical=True)
        constant = 0.5 + 0.1 * seed
        size = draw_current(draw, seed, kind, constant)
        log_format = draw.robot.description.log.model_copy(
            update={"torque_per_ampere": (constant,)}
        )
        robot = Robot(draw.robot.description.model_copy(update={"log": log_format}))
        log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, current_size=size, robot=robot)
        model = fit_from_commands([log], robot, "coulomb_viscous", workers=1)
        [fitted] = model.servos
        assert said[kind] in " ".join(model.provenance["from_commands"])
        assert fitted.scale == ("current" if kind == "motor" else "none")
        if kind == "motor":
            errors.append(abs(fitted.servo.kp / draw.servo.kp[0] - 1.0))
            lines.append(f"{seed:3}: gain {errors[-1]:.2%}")
    say(f"current of the {kind}, {count_draws(20)} draws", *lines)
    assert max(errors, default=0.0) <= 0.03


@pytest.mark.parametrize("law_name", ["coulomb_viscous", "stribeck"])
def test_the_true_law_is_chosen(tmp_path: Path, law_name: str) -> None:
    lines, hits = [], []
    for seed in range(count_draws(20)):
        draw = draw_hobby_servo(make_folder(tmp_path, seed), seed, law_name=law_name)
        log = Log(t=draw.t, q=draw.q, q_cmd=draw.q_cmd, robot=draw.robot)
        model = choose_from_commands([log], draw.robot, workers=1)
        text = " ".join(model.provenance["choose"])
        hits.append(model.law == law_name or f"tie with {law_name}" in text)
        lines.append(f"{seed:3}: {model.law}; {text}")
    say(f"chosen where {law_name} is true: {np.mean(hits):.0%}", *lines)
    assert np.mean(hits) >= 0.9


def test_the_cost_of_many_fits_is_printed(tmp_path: Path) -> None:
    laws = ["coulomb_viscous", "stribeck", "bam_m1", "bam_m3", "bam_m4"]
    seconds = 0.0
    for seed in range(count_draws(12)):
        draw = draw_hobby_servo(make_folder(tmp_path, seed), seed, rate=200.0, seconds=14.0)
        started = time.process_time()
        for law_name in laws:
            fit_draw(draw, law_name)
        seconds += time.process_time() - started
    say(f"{len(laws) * count_draws(12)} fits to 14 s at 200 Hz: {seconds:.0f} CPU s")
    assert seconds > 0.0
