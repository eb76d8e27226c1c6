"""Excitation design: Fourier motions with a well-conditioned rigid-body regressor (III-B)."""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field, field_validator
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from hesr_model.errors import FitError
from hesr_model.motions.excitation_search import Search
from hesr_model.motions.limits import Limits, MotionLimits, Positive, peak_torque
from hesr_model.motions.trajectories import Fourier, one_period
from hesr_model.rigid_body.identification import LEAST_PEAK
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.config import Config
from hesr_model.support.progress import Progress, counted, silent

_SAMPLES = 400
"""Samples per period; with 100 or more the condition number of W_b changes by a per cent."""

_COARSE, _FINE = 1e2, 1e4  # weights of exceeded limits, in the first descents and the last one
_COARSE_STEPS, _FINE_STEPS = 100, 300

_USUAL_RATE = 200.0
_LARGE = 100.0  # size of a random motion before it is shrunk, relative to the joint's speed


class ExcitationSettings(Config):
    """Settings of the designed motion.

    A motion needs two `harmonics`. `period` is the range [s]. The `sample_rate` [Hz] is by default
    that of the logs, or 200.
    """

    harmonics: int = Field(default=10, ge=2)
    period: tuple[Positive, Positive] = (10.0, 30.0)
    periods: int = Field(default=1, ge=1)
    starts: int = Field(default=4, ge=1)
    seed: int = Field(default=0, ge=0)
    sample_rate: Positive | None = None
    limits: MotionLimits = MotionLimits()

    @field_validator("period")
    @classmethod
    def _shortest_first(cls, period: tuple[float, float]) -> tuple[float, float]:
        if period[0] > period[1]:
            raise ValueError("the shortest period must come first")
        return period


@dataclass(frozen=True, kw_only=True, eq=False)
class Excitation:
    """Designed motion, at rest at both ends, for a robot.

    `condition` is that of W_b, `sample_rate` [Hz] that of the setpoints, and `peak_torque` (n,)
    [N.m] the largest of the model file's rigid body, without friction.
    """

    motion: Fourier
    condition: float
    sample_rate: float
    limits: Limits
    peak_torque: Array

    def setpoints(self) -> tuple[Array, Array, Array, Array]:
        """Return times (N,) [s] and q, dq, ddq (N, n) [rad, rad/s, rad/s2]."""
        t = np.arange(round(self.motion.duration * self.sample_rate) + 1) / self.sample_rate
        return t, *self.motion.sample(t)


def condition(model: Robot, base: tuple[int, ...], motion: Fourier) -> float:
    """Return the condition number of W_b: `base` columns over one period, in SI, unscaled.

    Time reversal leaves W_b unchanged, because rigid-body torque is even in velocity.
    """
    t = np.linspace(0.0, motion.period, _SAMPLES, endpoint=False)
    columns = model.regressor(*motion.sample(t))[:, :, list(base)]
    return float(np.linalg.cond(columns.reshape(-1, columns.shape[2])))


def design(
    model: Robot, settings: ExcitationSettings | None = None, *, progress: Progress = silent
) -> Excitation:
    """Design the motion with the smallest `condition` within limits.

    L-BFGS-B descends a smooth bound of the condition number from random motions; the best one is
    refined. Raises RobotError if the limits do not fit the robot, FitError if they admit no motion.
    """
    settings = settings or ExcitationSettings()
    rate = settings.sample_rate or model.description.log.sample_rate or _USUAL_RATE
    limits = Limits.of(model, settings.limits)
    rest = limits.rest(model)
    search = Search(
        model=model, limits=limits, harmonics=settings.harmonics, period=settings.period
    )
    with threadpool_limits(1):
        starts = random_motions(model, settings, settings.starts, settings.seed)
        rough = [
            _descend(search, start, rest, _COARSE, _COARSE_STEPS)
            for start in counted(starts, progress)
        ]
        best = min(rough, key=lambda motion: condition(model, search.base, motion))
        period = round(best.period * rate) / rate
        search = replace(search, period=(period, period))
        motion = replace(_descend(search, best, rest, _FINE, _FINE_STEPS), period=period)
    _, dq, _ = one_period(motion)
    for joint, peak in zip(model.description.joints, np.abs(dq).max(axis=0), strict=True):
        if not peak > LEAST_PEAK:
            raise FitError(
                f"robot '{model.description.name}': the limits allow joint '{joint}' at most "
                f"{peak:.2g} rad/s; widen them, identification needs {LEAST_PEAK:g} rad/s."
            )
    return Excitation(
        motion=replace(motion, periods=settings.periods),
        condition=condition(model, search.base, motion),
        sample_rate=rate,
        limits=limits,
        peak_torque=peak_torque(model, motion),
    )


def _descend(search: Search, motion: Fourier, rest: Array, weight: float, steps: int) -> Fourier:
    found = minimize(
        search.value_and_gradient,
        search.pack(motion),
        args=(weight,),
        jac=True,
        method="L-BFGS-B",
        bounds=search.bounds,
        options={"maxiter": steps},
    )
    return search.limits.shrink(search.unpack(found.x), search.model, rest)


def random_motions(
    model: Robot, settings: ExcitationSettings, count: int, seed: int
) -> list[Fourier]:
    """Draw random motions as large as the limits allow, as references for `design`."""
    limits = Limits.of(model, settings.limits)
    rest = limits.rest(model)
    rng = np.random.default_rng(seed)
    shape, motions = (2, model.n, settings.harmonics), []
    for _ in range(count):
        a, b = _LARGE * limits.velocity[:, None] * rng.standard_normal(shape)
        offset, period = rng.uniform(limits.lower, limits.upper), rng.uniform(*settings.period)
        motion = Fourier.from_rest(a, b, offset=offset, period=period)
        motions.append(limits.shrink(motion, model, rest))
    return motions
