"""Twins whose model file has wrong masses: the chosen rigid body on another motion.

Masses and centres of mass are 10 to 40 % off, logs last 5 to 30 s, and many excite little. Friction
is of Stribeck with load, which the Coulomb and viscous friction of the choice does not describe.
"""

from dataclasses import dataclass

import numpy as np

from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion, smooth_logs
from hesr_model.rigid_body.choice import KINDS, choose_body, fit_friction, identify_kind
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

RATE = 100.0  # [Hz]
TEST_SECONDS = 20.0


@dataclass(frozen=True, kw_only=True)
class Draw:
    """Ratios of errors on another motion to those of the given model file."""

    seconds: float
    harmonics: int
    amplitude: float  # share of the reach
    kind: str
    ratio: float  # of the chosen body
    ratios: dict[str, float]  # of every kind


def draw_body(robot: Robot, rng: np.random.Generator) -> Array:
    """Return true parameters: masses and centres are 10 to 40 % off those of the model file."""
    parameters = robot.nominal_parameters.copy()
    for link in range(robot.links):
        ten = slice(10 * link, 10 * (link + 1))
        scale = 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.4)
        parameters[ten] *= scale
        parameters[10 * link + 1 : 10 * link + 4] *= 1.0 + rng.uniform(-0.1, 0.1)
    rotors = slice(10 * robot.links, robot.inertial)
    parameters[rotors] *= rng.uniform(0.6, 1.4, robot.inertial - 10 * robot.links)
    return parameters


def make_log(
    robot: Robot,
    parameters: Array,
    friction: Array,
    rng: np.random.Generator,
    *,
    seconds: float,
    harmonics: int,
    amplitude: float,
) -> Motion:
    """Return the smoothed log of a Fourier motion."""
    t = np.arange(round(seconds * RATE)) / RATE
    lower, upper, speed = robot.reach
    q, dq, ddq = np.zeros((3, len(t), robot.n))
    period = rng.uniform(4.0, 10.0)
    for harmonic in range(1, harmonics + 1):
        w = 2.0 * np.pi * harmonic / period
        size = rng.normal(0.0, 1.0, robot.n) / harmonic
        angle = w * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, robot.n)
        q += size * np.sin(angle)
        dq += size * w * np.cos(angle)
        ddq -= size * w**2 * np.sin(angle)
    # Within a share of the reach and of the highest speed.
    half = np.minimum(0.5 * (upper - lower), np.pi / 2)
    scale = amplitude * np.minimum(
        half / np.abs(q).max(axis=0), 0.8 * speed / np.abs(dq).max(axis=0)
    )
    q, dq, ddq = q * scale, dq * scale, ddq * scale
    q += 0.5 * (lower + upper) + rng.uniform(-0.3, 0.3, robot.n) * half
    load = robot.torque(parameters, q, dq, ddq)
    coulomb, stribeck, viscous, load_share = friction
    level = coulomb + stribeck * np.exp(-((dq / 0.1) ** 2)) + load_share * np.abs(load)
    tau = load + level * np.tanh(dq / 0.01) + viscous * np.sign(dq) * np.abs(dq) ** 0.7
    tau += 0.03 * np.std(load, axis=0) * rng.standard_normal(tau.shape)
    q_measured = q + 2e-5 * rng.standard_normal(q.shape)
    log = Log(name="log", t=t, q=q_measured, dq=None, tau=tau, robot=robot.description)
    return smooth_logs([log], robot)[0]


def compute_errors(robot: Robot, body: RigidBody, training: Motion, test: Motion) -> Array:
    """Return the RMSE (n,) on a test motion, with Coulomb and viscous friction of the training."""
    coulomb, viscous, offset = fit_friction(body, [training], robot).T
    friction = coulomb * np.sign(test.dq) + viscous * test.dq + offset
    error = test.tau - body.torque(robot, test) - friction
    return np.sqrt(np.mean(error**2, axis=0))


def try_draw(robot: Robot, seed: int) -> Draw:
    """Return what the choice gives with one wrong model file."""
    rng = np.random.default_rng(seed)
    parameters = draw_body(robot, rng)
    size = np.std(robot.torque(parameters, *rng.uniform(-1.0, 1.0, (3, 200, robot.n))), axis=0)
    friction = np.stack(
        [
            rng.uniform(low, high, robot.n) * size
            for low, high in ((0.1, 0.5), (0.0, 0.2), (0.05, 0.3))
        ]
        + [rng.uniform(0.0, 0.08, robot.n)]
    )
    seconds = float(rng.uniform(5.0, 30.0))
    harmonics = int(rng.integers(1, 6))
    amplitude = float(rng.uniform(0.1, 0.6))
    training = make_log(
        robot, parameters, friction, rng, seconds=seconds, harmonics=harmonics, amplitude=amplitude
    )
    test = make_log(
        robot, parameters, friction, rng, seconds=TEST_SECONDS, harmonics=5, amplitude=0.5
    )
    choice = choose_body([training], robot)
    errors = {
        kind: compute_errors(
            robot, identify_kind([training], robot, kind, warns=False), training, test
        )
        for kind in KINDS
    }
    ratios = {
        kind: float(np.exp(np.mean(np.log(errors[kind] / errors["nominal"])))) for kind in KINDS
    }
    return Draw(
        seconds=seconds,
        harmonics=harmonics,
        amplitude=amplitude,
        kind=choice.kind,
        ratio=ratios[choice.kind],
        ratios=ratios,
    )
