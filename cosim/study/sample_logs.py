"""Simulated sample logs of any robot."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hesr_model.errors import RobotError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.laws.lugre import LuGre
from hesr_model.logs.noise import standard_normal
from hesr_model.logs.robot_log import Log
from hesr_model.motions.excitation import ExcitationSettings, condition, random_motions
from hesr_model.motions.limits import RANGE_MARGIN, MotionLimits
from hesr_model.motions.trajectories import Fourier
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.files import sha256

RATE = 200.0  # [Hz]

_MARK = "SAMPLES.sha256"
"""SHA-256 list next to the sample logs; a replaced log no longer matches it."""

_PERIOD = 20.0  # [s]
_HARMONICS = 5
_CANDIDATES = 8  # random motions; the best conditioned one is for training
_FINER = 10  # steps of simulated friction per sample
_NO_LIMIT = 1e12  # [N.m] because effort limits of model files are often invented

# Shares of the joint's largest rigid-body torque, at least that of the robot / 20.
_COULOMB = 0.15
_VISCOUS = 0.15
_TORQUE_NOISE = 0.005
_STATIC = 1.3  # ratio to Coulomb friction
_STRIBECK = 0.05  # share of the peak velocity
_DEFLECTION = 1e-3  # share of the travel
_POSITION_NOISE = 5e-6
_VELOCITY_NOISE = 5e-4  # shares of travel and peak velocity


def sample_logs(robot: Robot) -> tuple[Log, Log]:
    """Simulate two random Fourier motions of 20 s, for training and test.

    The torque is that of the model file's rigid body, LuGre friction (eq. 1-3) and noise.
    """
    settings = sample_settings(robot)
    base = base_columns(robot)
    candidates = random_motions(robot, settings, _CANDIDATES, 0)
    training = min(candidates, key=lambda motion: condition(robot, base, motion))
    (test,) = random_motions(robot, settings, 1, 1)
    laws = plausible_friction(robot, training)
    return (
        simulate_log(robot, training, laws, name="sample_training", seed=1),
        simulate_log(robot, test, laws, name="sample_test", seed=2),
    )


def sample_settings(robot: Robot, period: float = _PERIOD) -> ExcitationSettings:
    """Return the settings of sample motions with a period [s]."""
    lower, upper, speed = robot.reach
    margin = RANGE_MARGIN * (upper - lower)
    ranges = zip((lower + margin).tolist(), (upper - margin).tolist(), strict=True)
    return ExcitationSettings(
        harmonics=_HARMONICS,
        period=(period, period),
        sample_rate=RATE,
        limits=MotionLimits(
            position=tuple(ranges), velocity=tuple(speed.tolist()), torque=(_NO_LIMIT,) * robot.n
        ),
    )


def mark_samples(files: Sequence[Path]) -> None:
    """Mark log files as samples, which no report calls measured."""
    lines = [f"{sha256(file)}  {file.name}\n" for file in files]
    (files[0].parent / _MARK).write_text("".join(lines), encoding="utf-8")


def is_sample(file: Path) -> bool:
    """Whether a log file is an unchanged sample log."""
    mark = file.parent / _MARK
    return mark.is_file() and sha256(file) in mark.read_text(encoding="utf-8")


def plausible_friction(robot: Robot, motion: Fourier) -> list[FrictionLaw]:
    """Return LuGre laws scaled by the torques of a motion; raise RobotError for a joint at rest."""
    q, dq, ddq = motion.sample(np.arange(round(_PERIOD * RATE)) / RATE)
    speed = np.abs(dq).max(axis=0)
    travel = np.ptp(q, axis=0)
    for joint, peak in zip(robot.description.joints, speed, strict=True):
        if not peak > 0.0:
            raise RobotError(
                f"robot '{robot.description.name}': the limits of joint '{joint}' allow no motion; "
                "leave the joint out.",
                code="robot.no_motion",
                key=joint,
            )
    return [
        FrictionLaw(
            name=LuGre.name,
            form=LuGre.form({}),
            values={
                "sigma_0": _COULOMB * level / (_DEFLECTION * reach),
                "sigma_1": 0.0,
                "sigma_2": _VISCOUS * level / peak,
                "F_c": _COULOMB * level,
                "F_s": _STATIC * _COULOMB * level,
                "v_s": _STRIBECK * peak,
                "tau_0": 0.0,
            },
        )
        for level, peak, reach in zip(_levels(robot, q, dq, ddq), speed, travel, strict=True)
    ]


def _levels(robot: Robot, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the size of the torques (n,) [N.m]; 1 for a model without masses."""
    peaks = np.abs(robot.torque(robot.nominal_parameters, q, dq, ddq)).max(axis=0)
    levels: Array = np.maximum(peaks, peaks.max() / 20.0)
    return np.where(levels > 0.0, levels, 1.0)


def simulate_log(
    robot: Robot,
    motion: Fourier,
    laws: Sequence[FrictionLaw],
    *,
    name: str,
    seed: int,
    seconds: float = _PERIOD,
) -> Log:
    """Simulate the log of a motion with friction and noise."""
    fine_times = np.arange(round(seconds * RATE) * _FINER + 1) / (RATE * _FINER)
    velocity = motion.sample(fine_times)[1]
    friction = np.column_stack(
        [
            predict(law, t=fine_times, dq=v)[::_FINER]
            for law, v in zip(laws, velocity.T, strict=True)
        ]
    )
    t = fine_times[::_FINER]
    q, dq, ddq = motion.sample(t)
    tau = robot.torque(robot.nominal_parameters, q, dq, ddq) + friction
    levels = np.array([law.values["F_c"] for law in laws]) / _COULOMB
    streams = np.arange(3 * robot.n)
    rows = np.arange(len(t))
    noise = standard_normal(seed, streams[None, :], rows[:, None]).reshape(len(t), 3, robot.n)
    return Log(
        name=name,
        t=t,
        q=q + _POSITION_NOISE * np.ptp(q, axis=0) * noise[:, 0],
        dq=dq + _VELOCITY_NOISE * np.abs(dq).max(axis=0) * noise[:, 1],
        tau=tau + _TORQUE_NOISE * levels * noise[:, 2],
    )
