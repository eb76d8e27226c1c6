"""Motions of one joint, and the friction of known laws along them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hesr_model.fitting.estimator import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.rigid_body.friction_record import FrictionRecord

GEAR_RATIO = 101.0

HX_BRISTLE = {"linear": ["1", "dq", "h", "dh"], "units": [], "state": "bristle"}
HX_PAPER = {"linear": ["1", "dq", "h", "dh"], "units": [], "state": "paper"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """Rows of a motion: uneven time stamps, reversals, rests, a load independent of velocity."""

    t: np.ndarray
    dq: np.ndarray
    q: np.ndarray
    load: np.ndarray


def path(
    seed: int = 0,
    *,
    seconds: float = 12.0,
    peak: float = 1.0,
    rests: bool = True,
    from_rest: bool = False,
) -> Path:
    """A few harmonics with different phases per path; the joint rests at one and two thirds."""
    rng = np.random.default_rng(1000 + seed)
    t = np.cumsum(rng.uniform(0.005, 0.011, round(seconds / 0.008)))
    pause = 0.05 * t[-1] if rests else 0.0
    run = t.copy()
    rest = np.zeros(len(t), dtype=bool)
    for k in (1, 2):
        begin = k * t[-1] / 3.0
        run -= np.clip(t - begin, 0.0, pause)
        rest |= (t >= begin) & (t < begin + pause)
    rates = 2.0 * np.pi * np.array([0.11, 0.19, 0.31, 0.43])
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    weights = peak * np.array([0.4, 0.3, 0.2, 0.1])
    angle = np.outer(run, rates) + phases
    dq = np.where(rest, 0.0, np.sin(angle) @ weights)
    if from_rest:
        dq *= np.minimum((t - t[0]) / 0.2, 1.0)
    q = -np.cos(angle) @ (weights / rates)
    load = 15.0 * np.sin(1.3 * t + phases[0]) + 10.0 * np.cos(0.7 * t + phases[1])
    return Path(t=t, dq=dq, q=q, load=load)


def law(name: str, structure: Mapping[str, Any], /, **values: float) -> FrictionLaw:
    """A law of the registry with the given coefficients."""
    form = estimator(name).form(structure)
    return FrictionLaw(name=name, structure=structure, form=form, values=values)


def along(
    truth: FrictionLaw,
    way: Path,
    *,
    noise: float = 0.0,
    seed: int = 0,
    log: str = "run",
    gear_ratio: float | None = None,
    start: tuple[float, ...] | None = None,
) -> FrictionRecord:
    """Friction of a law along a motion, with white noise."""
    tau = predict(truth, t=way.t, dq=way.dq, q=way.q, tau_load=way.load, start=start)
    return FrictionRecord(
        log=log,
        joint="j1",
        t=way.t,
        dq=way.dq,
        q=way.q,
        tau_load=way.load,
        tau=tau + noise * np.random.default_rng(seed).normal(size=len(tau)),
        gear_ratio=gear_ratio,
    )


def training(truth: FrictionLaw, *, noise: float, **more: Any) -> list[FrictionRecord]:
    """Two logs for fitting."""
    return [along(truth, path(k), noise=noise, seed=k, log=f"train{k}", **more) for k in range(2)]


def unseen(truth: FrictionLaw, **more: Any) -> FrictionRecord:
    """A noise-free log of another motion."""
    return along(truth, path(7, peak=0.9), log="unseen", **more)


def error_on(fitted: FrictionLaw, record: FrictionRecord, **more: Any) -> float:
    """Root mean square error of a law on a record [N.m]."""
    predicted = predict(
        fitted, t=record.t, dq=record.dq, q=record.q, tau_load=record.tau_load, **more
    )
    return float(np.sqrt(np.mean((predicted - record.tau) ** 2)))


def with_tau(record: FrictionRecord, tau: np.ndarray) -> FrictionRecord:
    """The record with another torque."""
    return replace(record, tau=tau)
