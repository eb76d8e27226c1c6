"""The next measurement: the motion that resolves most of what the results of a run leave open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cosim.report.results import Results
from cosim.study.forecast import Forecast
from cosim.study.results import SavedLog
from cosim.study.verdict import Separation
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
        ratios: list[float] = []
        for law in self.laws.values():
            ratios.extend(self.predict_shrinkage(law, new_rows).values())
        gain = -np.mean(np.log(ratios or [1.0]))
        torques = [predict(law, **new_rows) for law in self.laws.values()]
        law_differences = [np.mean((tau_predicted - torques[0]) ** 2) for tau_predicted in torques]
        law_difference = np.mean(law_differences) / self._variance
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
        # Slopes differ by orders of magnitude; 1e-150 keeps products of two scales above 0.
        scale = np.maximum(np.linalg.norm(slopes, axis=0), 1e-150)
        present_variance = _invert_diagonal(information, scale)
        expected_variance = _invert_diagonal(information + new_slopes.T @ new_slopes, scale)
        variance_ratios = expected_variance / np.maximum(present_variance, 1e-300)
        # More rows shrink errors; a ratio above 1 is round-off, and 0 has no logarithm.
        ratios = np.sqrt(np.clip(variance_ratios, 1e-12, 1.0))
        return dict(zip(law.covariance.names, ratios.tolist(), strict=True))

    def predict_ratios(self, law: FrictionLaw, new_rows: Rows) -> dict[str, float]:
        """Return the ratios of `predict_shrinkage` as a fit with further rows would state them.

        The law misses the new motion at least as it misses the logs, and at most also by its
        difference from the best law. The result is the geometric mean of both cases.
        """
        residuals_by_law = [
            (self.residual(known_law), known_law) for known_law in self.laws.values()
        ]
        best_residual, best_law = min(residuals_by_law, key=lambda pair: np.linalg.norm(pair[0]))
        smallest_ratios = self.predict_shrinkage(law, new_rows)
        if not smallest_ratios or best_law is law:
            return smallest_ratios
        largest_ratios = self._predict_largest_ratios(law, new_rows, best_law, best_residual)
        ratios = {}
        for (name, smallest), largest in zip(smallest_ratios.items(), largest_ratios, strict=True):
            ratios[name] = float(np.sqrt(smallest * max(smallest, largest)))
        return ratios

    def _predict_largest_ratios(
        self, law: FrictionLaw, new_rows: Rows, best_law: FrictionLaw, best_residual: Array
    ) -> Array:
        """Return ratios (P,) of standard errors if the friction of the new rows is the best law's.

        The residual of the new rows is that of the best law, there and back until they are full,
        plus the difference of the laws. A fit with all rows then removes what its slopes explain.
        """
        residual = self.residual(law)
        slopes = self._compute_slopes(law)
        assert law.covariance is not None
        names = list(law.covariance.names)
        blocks = blocks_of_time(np.zeros(len(residual), dtype=int))
        present_errors = covariance_of_fit(names, slopes, residual, blocks).standard_errors
        law_difference = predict(best_law, **new_rows) - predict(law, **new_rows)
        there_and_back = [*best_residual, *best_residual[::-1]]
        new_residual = np.resize(there_and_back, len(law_difference)) + law_difference
        residuals = np.concatenate([residual, new_residual])
        all_slopes = np.concatenate([slopes, _compute_slopes(law, new_rows)])
        scale = np.maximum(np.linalg.norm(all_slopes, axis=0), 1e-150)
        correction = np.linalg.lstsq(all_slopes / scale, residuals, rcond=1e-6)[0] / scale
        residuals -= all_slopes @ correction
        # The new motion is a block by itself: its misfit may differ from that of the logs.
        labels = np.repeat([0, 1], [len(residual), len(law_difference)])
        expected_errors = covariance_of_fit(names, all_slopes, residuals, labels).standard_errors
        return np.asarray(expected_errors / np.maximum(present_errors, 1e-300))

    def predict_errors(self, new_rows: Rows) -> dict[str, dict[str, float]]:
        """Return the standard errors that a fit with further rows would state, by law and name."""
        errors_by_law = {}
        for law_name, law in self.laws.items():
            ratios = self.predict_ratios(law, new_rows)
            errors_by_law[law_name] = {
                name: error * ratios[name]
                for name, error in law.standard_errors.items()
                if name in ratios
            }
        return errors_by_law

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


def _invert_diagonal(information: Array, scale: Array) -> Array:
    """Return the diagonal (P,) of the inverse of a matrix (P, P) scaled to similar elements."""
    normal_matrix = information / np.outer(scale, scale)
    # Directions that the rows do not show add nothing, instead of dividing by round-off.
    return np.diag(np.linalg.pinv(normal_matrix, rcond=1e-10, hermitian=True))


def _compute_slopes(law: FrictionLaw, rows: Rows) -> Array:
    """Return the torque's derivatives (N, P) by the coefficients of the covariance."""
    assert law.covariance is not None
    columns = []
    for name in law.covariance.names:
        coefficient = law.values[name]
        step = _RELATIVE_STEP * max(abs(coefficient), 1e-6)
        upper_law = replace(law, values={**law.values, name: coefficient + step})
        lower_law = replace(law, values={**law.values, name: coefficient - step})
        # Central differences: their error falls with the square of the step.
        columns.append((predict(upper_law, **rows) - predict(lower_law, **rows)) / (2.0 * step))
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
    traces = [_read_trace(results, log) for log in logs]
    columns = [_choose_columns(traces[0], j + 1) for j in range(guard.robot.n)]
    joint_knowledge = []
    recommended = zip(results.recommended, verdict.joints, strict=True)
    for j, (law_name, joint_verdict) in enumerate(recommended):
        law_names = list(dict.fromkeys((law_name, joint_verdict.best, *joint_verdict.tied)))
        knowledge = Knowledge(
            laws={name: models[name].laws[j] for name in law_names[:_MAX_LAWS] if name in models},
            logs=[_select_columns(trace, columns[j]) for trace in traces],
            torques=[trace[f"tau{j + 1}"] - trace[f"tau_rb{j + 1}"] for trace in traces],
            speed=float(guard.stated_limits.velocity[j]),
        )
        joint_knowledge.append(knowledge)
    return joint_knowledge


def _read_trace(results: Results, log: SavedLog) -> dict[str, Array]:
    """Return the columns of a log in double precision."""
    return {name: column.astype(float) for name, column in results.torques(log).items()}


def _choose_columns(trace: Mapping[str, Array], number: int) -> dict[str, str]:
    """Return the columns of the inputs of a joint's law; joints count from 1."""
    load_column = f"tau_load{number}"
    if load_column not in trace:  # the load is the torque of the rigid body
        load_column = f"tau_rb{number}"
    return {"t": "t", "dq": f"dq{number}", "q": f"q{number}", "tau_load": load_column}


def _select_columns(trace: Mapping[str, Array], columns: Mapping[str, str]) -> Rows:
    return {name: trace[column] for name, column in columns.items()}


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
    assert results.verdict is not None
    verdicts = results.verdict.joints
    test_time = _choose_test_time(verdicts, time)
    best_mixes = _choose_mixes(planner, joint_knowledge, time - test_time)
    motions = {"friction": planner.friction(time - test_time, best_mixes)}
    if test_time:
        motions["test"] = planner.plan("test", test_time)
    joint_rows = build_joint_rows(motions["friction"], guard)
    widths: dict[str, dict[str, dict[str, float]]] = {}
    detectable = {}
    lines = []
    for j, joint in enumerate(guard.robot.joints):
        knowledge = joint_knowledge[j]
        expected_errors = knowledge.predict_errors(joint_rows[j])
        for law_name, law_errors in expected_errors.items():
            widths.setdefault(law_name, {})[joint] = law_errors
        line = f"{joint}: {best_mixes[j].reason}"
        line += _describe_expected_error(knowledge, expected_errors)
        detected_before = verdicts[j].detectable
        if test_time and detected_before is not None:
            detectable[joint] = _predict_detectable(results, j, detected_before[1], test_time)
            line += f", differences of {100 * (detectable[joint] - 1):.0f} % between laws"
        lines.append(f"{line}.")
    return motions, Forecast(widths=widths, detectable=detectable), lines


def _choose_test_time(verdicts: Sequence[Separation], time: float) -> float:
    """Return the part of `time` [s] for a test: none without ties, or if too short to end them."""
    test_time = 0.4 * time
    has_ties = any(joint_verdict.tied for joint_verdict in verdicts)
    if has_ties and test_time >= comparison.MIN_SECONDS:
        return test_time
    return 0.0


def _choose_mixes(planner: Planner, joint_knowledge: Sequence[Knowledge], time: float) -> list[Mix]:
    """Return the mix of each joint whose strokes of `time` [s] would resolve most."""
    mix_rows = []
    for mix in MIXES:
        motion = next(planner.strokes(time, [mix] * len(joint_knowledge)))
        mix_rows.append(build_joint_rows(motion, planner.guard))
    best_mixes = []
    for j, knowledge in enumerate(joint_knowledge):
        scores = [knowledge.score(joint_rows[j]) for joint_rows in mix_rows]
        best_mixes.append(MIXES[int(np.argmax(scores))])
    return best_mixes


def _describe_expected_error(
    knowledge: Knowledge, expected_errors: Mapping[str, Mapping[str, float]]
) -> str:
    """Say how the least certain coefficient of the first law will shrink; empty if unknown."""
    law_name = next(iter(knowledge.laws))
    law = knowledge.laws[law_name]
    if not expected_errors[law_name]:
        return ""
    present_errors = law.standard_errors

    def relative_error(name: str) -> float:
        return present_errors[name] / max(abs(law.values[name]), 1e-300)

    name = max(expected_errors[law_name], key=relative_error)
    return (
        f", {name} of {law_name} from +-{present_errors[name]:.2g} to "
        f"+-{expected_errors[law_name][name]:.2g}"
    )


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
