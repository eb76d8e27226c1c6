"""The next measurement: the motion that resolves most of what the results of a run leave open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cosim.report.results import Results
from cosim.study.forecast import Forecast
from hesr.extras.excite.motion import PlannedMotion
from hesr.extras.excite.planner import Guard, Mix, Planner
from hesr_model.errors import ConfigError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.inference import comparison
from hesr_model.inference.covariance import blocks_of_time, covariance_of_fit
from hesr_model.support.arrays import Array

MIXES = (
    Mix(),
    Mix(steady=0.94, nested=0.05, rests=0.01, low=0.3, why="fast motion"),
    Mix(low=0.03, why="slow and fast motion"),
    Mix(steady=0.7, nested=0.25, why="reversals within reversals"),
    Mix(steady=0.8, nested=0.08, rests=0.12, why="rests and slow break-away"),
)
_LAWS = 3  # recommended, and tied with it
_STEP = 1e-4  # relative step of a coefficient
_BINS = np.geomspace(0.003, 1.0, 9)
_SEEN = 0.3  # speeds over the limit; [s] that show one

Rows = Mapping[str, Any]  # t [s], dq [rad/s], q [rad], tau_load [N.m] of a log, (N,) each


@dataclass(frozen=True, kw_only=True)
class Knowledge:
    """What a run knows of a joint: its law and those tied with it, and the logs of its training."""

    laws: Mapping[str, FrictionLaw]
    logs: Sequence[Rows]
    torques: Sequence[Array]  # measured friction of the logs [N.m]
    speed: float  # limit [rad/s]

    def residual(self, law: FrictionLaw) -> Array:
        """Return measured minus predicted torque [N.m] over all logs."""
        pairs = zip(self.torques, self.logs, strict=True)
        return np.concatenate([torque - predict(law, **rows) for torque, rows in pairs])

    @cached_property
    def _variance(self) -> float:
        """Mean square error [N^2.m^2] of the first law."""
        return float(np.mean(self.residual(next(iter(self.laws.values()))) ** 2))

    def score(self, new: Rows) -> float:
        """Return what rows would resolve: log widths, difference of laws, and unseen speeds."""
        ratios = [r for law in self.laws.values() for r in self.shrinking(law, new).values()]
        gained = -np.mean(np.log(ratios or [1.0]))
        torques = [predict(law, **new) for law in self.laws.values()]
        apart = np.mean([np.mean((torque - torques[0]) ** 2) for torque in torques])
        apart /= self._variance
        unseen = (self._times(self.logs) < _SEEN) & (self._times([new]) >= _SEEN)
        return float(gained + 0.25 * np.log1p(apart) + np.mean(unseen))

    def shrinking(self, law: FrictionLaw, new: Rows) -> dict[str, float]:
        """Return the standard error of each coefficient with further rows, over today's.

        Noise and misfit per row remain those of the covariance.
        """
        if law.covariance is None:
            return {}
        slopes = self._slopes(law)
        more = _slopes(law, new)
        before = slopes.T @ slopes
        size = np.maximum(np.linalg.norm(slopes, axis=0), 1e-150)
        both = [x / np.outer(size, size) for x in (before, before + more.T @ more)]
        now, then = (np.diag(np.linalg.pinv(x, rcond=1e-10, hermitian=True)) for x in both)
        ratios = np.sqrt(np.clip(then / np.maximum(now, 1e-300), 1e-12, 1.0))
        return dict(zip(law.covariance.names, ratios.tolist(), strict=True))

    def expected(self, law: FrictionLaw, new: Rows) -> dict[str, float]:
        """Return the expected ratios of `shrinking` as a fit with further rows would state them.

        The law misses the new motion at least as it misses the logs, and at most also by its
        difference from the best law. The result is the geometric mean of both cases.
        """
        pairs = [(self.residual(one), one) for one in self.laws.values()]
        least, best = min(pairs, key=lambda pair: np.linalg.norm(pair[0]))
        ratios = self.shrinking(law, new)
        if not ratios or best is law:
            return ratios
        own = self.residual(law)
        slopes = self._slopes(law)
        names = list(ratios)
        blocks = blocks_of_time(np.zeros(len(own), dtype=int))
        now = covariance_of_fit(names, slopes, own, blocks).standard_errors
        apart = predict(best, **new) - predict(law, **new)
        missed = np.concatenate([own, np.resize([*least, *least[::-1]], len(apart)) + apart])
        both = np.concatenate([slopes, _slopes(law, new)])
        size = np.maximum(np.linalg.norm(both, axis=0), 1e-150)
        missed -= both @ (np.linalg.lstsq(both / size, missed, rcond=1e-6)[0] / size)
        labels = np.repeat([0, 1], [len(own), len(apart)])
        then = covariance_of_fit(names, both, missed, labels).standard_errors
        most = then / np.maximum(now, 1e-300)
        return {
            name: float(np.sqrt(ratio * max(ratio, top)))
            for (name, ratio), top in zip(ratios.items(), most, strict=True)
        }

    def _slopes(self, law: FrictionLaw) -> Array:
        return np.concatenate([_slopes(law, rows) for rows in self.logs])

    def _times(self, logs: Sequence[Rows]) -> Array:
        """Return the time [s] at each speed, forwards and backwards."""
        times = np.zeros((2, len(_BINS) - 1))
        for rows in logs:
            step = float(np.median(np.diff(rows["t"])))
            for time, sign in zip(times, (1.0, -1.0), strict=True):
                time += step * np.histogram(sign * rows["dq"] / self.speed, _BINS)[0]
        return times


def _slopes(law: FrictionLaw, rows: Rows) -> Array:
    """Return the torque's derivatives (N, P) by the coefficients of the covariance."""
    columns = []
    for name in law.covariance.names if law.covariance else ():
        value = law.values[name]
        step = _STEP * max(abs(law.values[name]), 1e-6)
        up, down = (
            predict(replace(law, values={**law.values, name: x}), **rows)
            for x in (value + step, value - step)
        )
        columns.append((up - down) / (2.0 * step))
    return np.stack(columns, axis=1)


def knowledge(results: Results, guard: Guard) -> list[Knowledge]:
    """Return what results know of each joint; raise ConfigError if they lack what is needed."""
    verdict = results.verdict
    models = results.models
    folder = results.folder
    logs = [log for log in results.run.logs if "training" in log.roles and log.trace]
    if results.run.joints != guard.robot.joints or verdict is None or not logs:
        raise ConfigError(f"{folder}: these are not results of this version for this robot.")
    if any(model.coupling for model in models.values()):
        raise ConfigError(f"{folder}: motions after results need joints without coupling.")
    traces = [{n: x.astype(float) for n, x in results.torques(log).items()} for log in logs]
    found = []
    for j, (law, of_joint) in enumerate(zip(results.recommended, verdict.joints, strict=True), 1):
        names = dict.fromkeys((law, of_joint.best, *of_joint.tied))
        columns = {"t": "t", "dq": f"dq{j}", "q": f"q{j}", "tau_load": f"tau_rb{j}"}
        if f"tau_load{j}" in traces[0]:
            columns["tau_load"] = f"tau_load{j}"
        found.append(
            Knowledge(
                laws={n: models[n].laws[j - 1] for n in list(names)[:_LAWS] if n in models},
                logs=[{n: trace[c] for n, c in columns.items()} for trace in traces],
                torques=[trace[f"tau{j}"] - trace[f"tau_rb{j}"] for trace in traces],
                speed=float(guard.stated.velocity[j - 1]),
            )
        )
    return found


def rows_of(motion: PlannedMotion, guard: Guard) -> list[Rows]:
    """Return the rows of each joint along a motion."""
    t, q, dq, ddq = motion.setpoints()
    load = guard.torque(q, dq, ddq)
    each = range(guard.robot.n)
    return [{"t": t, "dq": dq[:, j], "q": q[:, j], "tau_load": load[:, j]} for j in each]


def plan_sequel(
    planner: Planner, folder: Path, time: float
) -> tuple[dict[str, PlannedMotion], Forecast, list[str]]:
    """Plan motions of `time` [s] in total after results: for friction, and a test if it helps.

    Returns motions by purpose, the expected findings of the next run, and sentences.
    """
    results = Results.read(folder)
    guard = planner.guard
    known = knowledge(results, guard)
    joints = guard.robot.joints
    assert results.verdict is not None
    open_ = any(joint.tied for joint in results.verdict.joints)
    tested = 0.4 * time if open_ and 0.4 * time >= comparison.LEAST_SECONDS else 0.0
    candidates = []
    for mix in MIXES:
        motion = next(planner.strokes(time - tested, [mix] * len(joints)))
        candidates.append((mix, rows_of(motion, guard)))
    scores = [[joint.score(rows[j]) for _, rows in candidates] for j, joint in enumerate(known)]
    best = [MIXES[int(np.argmax(of_joint))] for of_joint in scores]
    motions = {"friction": planner.friction(time - tested, best)}
    if tested:
        motions["test"] = planner.plan("test", tested)
    widths: dict[str, dict[str, dict[str, float]]] = {}
    shown = {}
    lines = []
    for j, (joint, rows) in enumerate(zip(known, rows_of(motions["friction"], guard), strict=True)):
        line = f"{joints[j]}: {best[j].why}"
        for name, law in joint.laws.items():
            now = law.standard_errors
            ratios = joint.expected(law, rows)
            then = {n: error * ratios[n] for n, error in now.items() if n in ratios}
            widths.setdefault(name, {})[joints[j]] = then
            if then and name == next(iter(joint.laws)):
                n = max(then, key=lambda n: now[n] / max(abs(law.values[n]), 1e-300))
                line += f", {n} of {name} from +-{now[n]:.2g} to +-{then[n]:.2g}"
        if tested and (was := results.verdict.joints[j].detectable):
            shown[joints[j]] = _detectable(results, j, was[1], tested)
            line += f", differences of {100 * (shown[joints[j]] - 1):.0f} % between laws"
        lines.append(f"{line}.")
    return motions, Forecast(widths=widths, detectable=shown), lines


def _detectable(results: Results, joint: int, ratio: float, seconds: float) -> float:
    """Return the smallest ratio of errors that a test of the same kind of `seconds` would show."""
    assert results.verdict is not None
    test = results.verdict.test
    before = sum(log.duration for log in results.run.logs if test in log.roles)
    count = max(1, len(results.comparisons[test].detectable[joint]))

    def error(time: float) -> float:
        degrees = time / comparison.SECONDS_PER_DEGREE
        level = comparison.SIGNIFICANCE / comparison.calibration(count, degrees) / count
        return float(comparison.detection_factor(degrees, level) / np.sqrt(time))

    return float(ratio ** (error(seconds) / error(before)))
