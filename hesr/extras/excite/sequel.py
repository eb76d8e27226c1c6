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
    Mix(steady=0.94, nested=0.05, rests=0.01, low=0.3, reason="fast motion"),
    Mix(low=0.03, reason="slow and fast motion"),
    Mix(steady=0.7, nested=0.25, reason="reversals within reversals"),
    Mix(steady=0.8, nested=0.08, rests=0.12, reason="rests and slow break-away"),
)
_MAX_LAWS = 3  # recommended, and tied with it
_RELATIVE_STEP = 1e-4  # relative step of a coefficient
_SPEED_BINS = np.geomspace(0.003, 1.0, 9)  # speeds over the limit
_MIN_SEEN_TIME = 0.3  # [s] at a speed that show it

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
        return np.concatenate([tau - predict(law, **rows) for tau, rows in pairs])

    @cached_property
    def _variance(self) -> float:
        """Mean square error [N^2.m^2] of the first law."""
        return float(np.mean(self.residual(next(iter(self.laws.values()))) ** 2))

    def score(self, new_rows: Rows) -> float:
        """Return what rows would resolve: log widths, difference of laws, and unseen speeds."""
        ratios = [
            ratio
            for law in self.laws.values()
            for ratio in self.predict_shrinkage(law, new_rows).values()
        ]
        gain = -np.mean(np.log(ratios or [1.0]))
        torques = [predict(law, **new_rows) for law in self.laws.values()]
        law_difference = np.mean(
            [np.mean((tau_predicted - torques[0]) ** 2) for tau_predicted in torques]
        )
        law_difference /= self._variance
        newly_seen = (self._measure_times(self.logs) < _MIN_SEEN_TIME) & (
            self._measure_times([new_rows]) >= _MIN_SEEN_TIME
        )
        return float(gain + 0.25 * np.log1p(law_difference) + np.mean(newly_seen))

    def predict_shrinkage(self, law: FrictionLaw, new_rows: Rows) -> dict[str, float]:
        """Return the standard error of each coefficient with further rows, over today's.

        Noise and misfit per row remain those of the covariance.
        """
        if law.covariance is None:
            return {}
        slopes = self._compute_slopes(law)
        new_slopes = _compute_slopes(law, new_rows)
        information = slopes.T @ slopes
        scale = np.maximum(np.linalg.norm(slopes, axis=0), 1e-150)
        normal_matrices = [
            matrix / np.outer(scale, scale)
            for matrix in (information, information + new_slopes.T @ new_slopes)
        ]
        present_variance, expected_variance = (
            np.diag(np.linalg.pinv(matrix, rcond=1e-10, hermitian=True))
            for matrix in normal_matrices
        )
        ratios = np.sqrt(
            np.clip(expected_variance / np.maximum(present_variance, 1e-300), 1e-12, 1.0)
        )
        return dict(zip(law.covariance.names, ratios.tolist(), strict=True))

    def predict_ratios(self, law: FrictionLaw, new_rows: Rows) -> dict[str, float]:
        """Return the ratios of `predict_shrinkage` as a fit with further rows would state them.

        The law misses the new motion at least as it misses the logs, and at most also by its
        difference from the best law. The result is the geometric mean of both cases.
        """
        pairs = [(self.residual(known_law), known_law) for known_law in self.laws.values()]
        best_residual, best_law = min(pairs, key=lambda pair: np.linalg.norm(pair[0]))
        ratios = self.predict_shrinkage(law, new_rows)
        if not ratios or best_law is law:
            return ratios
        residual = self.residual(law)
        slopes = self._compute_slopes(law)
        names = list(ratios)
        blocks = blocks_of_time(np.zeros(len(residual), dtype=int))
        present_errors = covariance_of_fit(names, slopes, residual, blocks).standard_errors
        law_difference = predict(best_law, **new_rows) - predict(law, **new_rows)
        residuals = np.concatenate(
            [
                residual,
                np.resize([*best_residual, *best_residual[::-1]], len(law_difference))
                + law_difference,
            ]
        )
        all_slopes = np.concatenate([slopes, _compute_slopes(law, new_rows)])
        scale = np.maximum(np.linalg.norm(all_slopes, axis=0), 1e-150)
        residuals -= all_slopes @ (
            np.linalg.lstsq(all_slopes / scale, residuals, rcond=1e-6)[0] / scale
        )
        labels = np.repeat([0, 1], [len(residual), len(law_difference)])
        expected_errors = covariance_of_fit(names, all_slopes, residuals, labels).standard_errors
        largest_ratios = expected_errors / np.maximum(present_errors, 1e-300)
        return {
            name: float(np.sqrt(ratio * max(ratio, largest_ratio)))
            for (name, ratio), largest_ratio in zip(ratios.items(), largest_ratios, strict=True)
        }

    def _compute_slopes(self, law: FrictionLaw) -> Array:
        return np.concatenate([_compute_slopes(law, rows) for rows in self.logs])

    def _measure_times(self, logs: Sequence[Rows]) -> Array:
        """Return the time [s] at each speed, forwards and backwards."""
        times = np.zeros((2, len(_SPEED_BINS) - 1))
        for rows in logs:
            step = float(np.median(np.diff(rows["t"])))
            for time, sign in zip(times, (1.0, -1.0), strict=True):
                time += step * np.histogram(sign * rows["dq"] / self.speed, _SPEED_BINS)[0]
        return times


def _compute_slopes(law: FrictionLaw, rows: Rows) -> Array:
    """Return the torque's derivatives (N, P) by the coefficients of the covariance."""
    columns = []
    for name in law.covariance.names if law.covariance else ():
        coefficient = law.values[name]
        step = _RELATIVE_STEP * max(abs(law.values[name]), 1e-6)
        upper_torque, lower_torque = (
            predict(replace(law, values={**law.values, name: value}), **rows)
            for value in (coefficient + step, coefficient - step)
        )
        columns.append((upper_torque - lower_torque) / (2.0 * step))
    return np.stack(columns, axis=1)


def gather_knowledge(results: Results, guard: Guard) -> list[Knowledge]:
    """Return what results know of each joint; raise ConfigError if they lack what is needed."""
    verdict = results.verdict
    models = results.models
    folder = results.folder
    logs = [log for log in results.run.logs if "training" in log.roles and log.trace]
    if results.run.joints != guard.robot.joints or verdict is None or not logs:
        raise ConfigError(f"{folder}: these are not results of this version for this robot.")
    if any(model.coupling for model in models.values()):
        raise ConfigError(f"{folder}: motions after results need joints without coupling.")
    traces = [{name: x.astype(float) for name, x in results.torques(log).items()} for log in logs]
    joint_knowledge = []
    for number, (law_name, joint_verdict) in enumerate(
        zip(results.recommended, verdict.joints, strict=True), 1
    ):
        names = dict.fromkeys((law_name, joint_verdict.best, *joint_verdict.tied))
        columns = {"t": "t", "dq": f"dq{number}", "q": f"q{number}", "tau_load": f"tau_rb{number}"}
        if f"tau_load{number}" in traces[0]:
            columns["tau_load"] = f"tau_load{number}"
        joint_knowledge.append(
            Knowledge(
                laws={
                    name: models[name].laws[number - 1]
                    for name in list(names)[:_MAX_LAWS]
                    if name in models
                },
                logs=[
                    {name: trace[column] for name, column in columns.items()} for trace in traces
                ],
                torques=[trace[f"tau{number}"] - trace[f"tau_rb{number}"] for trace in traces],
                speed=float(guard.stated_limits.velocity[number - 1]),
            )
        )
    return joint_knowledge


def build_joint_rows(motion: PlannedMotion, guard: Guard) -> list[Rows]:
    """Return the rows of each joint along a motion."""
    t, q, dq, ddq = motion.setpoints()
    tau_load = guard.torque(q, dq, ddq)
    joint_indices = range(guard.robot.n)
    return [
        {"t": t, "dq": dq[:, j], "q": q[:, j], "tau_load": tau_load[:, j]} for j in joint_indices
    ]


def plan_sequel(
    planner: Planner, folder: Path, time: float
) -> tuple[dict[str, PlannedMotion], Forecast, list[str]]:
    """Plan motions of `time` [s] in total after results: for friction, and a test if it helps.

    Returns motions by purpose, the expected findings of the next run, and sentences.
    """
    results = Results.read(folder)
    guard = planner.guard
    joint_knowledge = gather_knowledge(results, guard)
    joints = guard.robot.joints
    assert results.verdict is not None
    has_ties = any(joint_verdict.tied for joint_verdict in results.verdict.joints)
    test_time = 0.4 * time if has_ties and 0.4 * time >= comparison.MIN_SECONDS else 0.0
    candidates = []
    for mix in MIXES:
        motion = next(planner.strokes(time - test_time, [mix] * len(joints)))
        candidates.append((mix, build_joint_rows(motion, guard)))
    scores = [
        [knowledge.score(rows[j]) for _, rows in candidates]
        for j, knowledge in enumerate(joint_knowledge)
    ]
    best_mixes = [MIXES[int(np.argmax(joint_scores))] for joint_scores in scores]
    motions = {"friction": planner.friction(time - test_time, best_mixes)}
    if test_time:
        motions["test"] = planner.plan("test", test_time)
    widths: dict[str, dict[str, dict[str, float]]] = {}
    detectable = {}
    lines = []
    for j, (knowledge, rows) in enumerate(
        zip(joint_knowledge, build_joint_rows(motions["friction"], guard), strict=True)
    ):
        line = f"{joints[j]}: {best_mixes[j].reason}"
        for law_name, law in knowledge.laws.items():
            present_errors = law.standard_errors
            ratios = knowledge.predict_ratios(law, rows)
            expected_errors = {
                n: error * ratios[n] for n, error in present_errors.items() if n in ratios
            }
            widths.setdefault(law_name, {})[joints[j]] = expected_errors
            if expected_errors and law_name == next(iter(knowledge.laws)):
                n = max(
                    expected_errors,
                    key=lambda n: present_errors[n] / max(abs(law.values[n]), 1e-300),
                )
                line += (
                    f", {n} of {law_name} from +-{present_errors[n]:.2g} to "
                    f"+-{expected_errors[n]:.2g}"
                )
        if test_time and (detected_before := results.verdict.joints[j].detectable):
            detectable[joints[j]] = _predict_detectable(results, j, detected_before[1], test_time)
            line += f", differences of {100 * (detectable[joints[j]] - 1):.0f} % between laws"
        lines.append(f"{line}.")
    return motions, Forecast(widths=widths, detectable=detectable), lines


def _predict_detectable(results: Results, j: int, present_ratio: float, seconds: float) -> float:
    """Return the smallest ratio of errors that a test of the same kind of `seconds` would show."""
    assert results.verdict is not None
    test = results.verdict.test
    tested_seconds = sum(log.duration for log in results.run.logs if test in log.roles)
    comparison_count = max(1, len(results.comparisons[test].detectable[j]))

    def detectable_error(time: float) -> float:
        degrees = time / comparison.SECONDS_PER_DEGREE
        level = (
            comparison.SIGNIFICANCE
            / comparison.calibration(comparison_count, degrees)
            / comparison_count
        )
        return float(comparison.detection_factor(degrees, level) / np.sqrt(time))

    return float(present_ratio ** (detectable_error(seconds) / detectable_error(tested_seconds)))
