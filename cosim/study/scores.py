"""Scores of friction predictions."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from fmu_src.friction.predictions import Records, predict_model
from hesr_model.errors import ConfigError
from hesr_model.fitting.estimator import select_laws
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.model import FrictionModel, compute_band
from hesr_model.friction.records import BandScore, Score, score, score_band, time_band
from hesr_model.inference.comparison import (
    MIN_SECONDS,
    ErrorRatio,
    LawErrors,
    law_errors,
)
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array
from hesr_model.support.frames import html_table, pandas_frame
from hesr_model.support.progress import Progress, report_progress, silent

LogRecords = Mapping[str, Sequence[Sequence[FrictionRecord]]]  # by log, [part][joint]
Predictions = Mapping[str, Mapping[str, Sequence[Sequence[Array]]]]
"""Torques (N,) [N.m] by test set and law, [joint][log]."""

MEASURES = ("rmse", "rmse_reversal", "rmse_moving", "r2")

REFERENCE = "lugre"
"""Reference of ratios if a class of inputs has none of its own; else the first law, no baseline."""
BASELINE = "stribeck"  # law without memory, for comparison
MEASURED_START = " + start"  # row-name suffix: initial state estimated from measured torque
Errors = Mapping[str, Mapping[str, Sequence[float]]]  # RMSE by test set, law, joint [N.m]
ORACLE = "true friction"
"""Row of the twin's own friction; its error is noise and the error of the rigid body."""
RECORDED = 1.1  # ratio of errors that a recommended test would find


@dataclass(frozen=True, kw_only=True)
class Ratios:
    """Ratios of each other law to its reference, one per joint."""

    reference: str  # fallback
    laws: Mapping[str, tuple[ErrorRatio, ...]]  # adjusted by Holm over the laws of a joint
    references: Mapping[str, str] = field(default_factory=dict)  # in earlier versions
    by_joint: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # references of laws

    @property
    def fair(self) -> bool:
        """Whether each law has a reference of the same inputs or fewer."""
        return bool(self.references or self.by_joint)

    def find_reference(self, law_name: str, j: int) -> str:
        """Return the reference of a law on a joint."""
        if law_name in self.by_joint:
            return self.by_joint[law_name][j]
        return self.references.get(law_name, self.reference)


@dataclass(frozen=True, kw_only=True)
class LawScores:
    """Errors of a law, one per joint; None without rows of that kind.

    Attributes
    ----------
    rmse : RMSE of the friction over all rows [N.m].
    rmse_reversal : within 0.1 s of velocity reversals [N.m].
    rmse_moving : while moving [N.m].
    r2 : coefficient of determination.
    rmse_rest : at rest [N.m]; empty in results of earlier versions.
    """

    rmse: tuple[float, ...]
    rmse_reversal: tuple[float | None, ...]
    rmse_moving: tuple[float | None, ...]
    r2: tuple[float | None, ...]
    rmse_rest: tuple[float | None, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Unseparated:
    """Statements of a test about a law on a joint: laws not separated from it, and better laws.

    The test would show errors of `detectable` times those of the law: the smallest and the largest
    such ratio of the laws not separated, or of all if there are none; None if the test is short or
    its logs are too few.
    """

    laws: tuple[str, ...]
    better: tuple[str, ...]  # significantly (Holm)
    detectable: tuple[float, float] | None
    seconds: float  # [s] test that finds `RECORDED`, for the median law


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Scores of several laws on the same logs.

    Predictions use a causal velocity. What is said of the separation of laws holds for other logs
    of the kind with several logs, else on this log.

    Attributes
    ----------
    joints : names.
    tau_std : standard deviation of the friction by joint [N.m].
    laws : errors by law.
    ratios : errors over those of references.
    leading : by joint the law with the lowest error and all not significantly worse (Holm).
    per_log : nuisances that were fitted to each test log; None if the study has none.
    bands : coverage of the 95 % bands, by law and joint.
    detectable : by joint the smallest ratio that would show each other law to be worse, if any.
    seconds : by joint the length [s] of a test that finds `RECORDED`, for the median law.
    zero_phase : RMSE by law and joint [N.m] with the velocity of the fits, without lag.
    unseparated : by joint what the test says of each law; empty in earlier versions.
    log_count : number of logs; 0 in earlier versions.
    """

    joints: tuple[str, ...]
    tau_std: tuple[float, ...]
    laws: Mapping[str, LawScores]
    ratios: Ratios
    leading: tuple[tuple[str, ...], ...] = ()
    per_log: tuple[str, ...] | None = None
    bands: Mapping[str, tuple[BandScore, ...]] = field(default_factory=dict)
    detectable: tuple[Mapping[str, float], ...] = ()
    seconds: tuple[float, ...] = ()
    zero_phase: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    unseparated: tuple[Mapping[str, Unseparated], ...] = ()
    log_count: int = 0

    @property
    def too_short(self) -> tuple[bool, ...]:
        """Whether the logs are too short to find any law worse, by joint."""
        pairs = zip(self.leading, self.detectable, strict=True)
        return tuple(len(leading) > 1 and not ratios for leading, ratios in pairs)

    def combine_scores(self, laws: Sequence[str]) -> LawScores:
        """Return the errors of a law per joint."""
        scores = {}
        for measure in MEASURES:
            columns = [getattr(self.laws[law_name], measure) for law_name in laws]
            scores[measure] = tuple(column[j] for j, column in enumerate(columns))
        return LawScores(**scores)

    def unexplained_shares(self, errors: Sequence[float]) -> tuple[float, ...]:
        """Return errors by joint over the standard deviation of its friction."""
        return tuple(e / max(std, 1e-300) for e, std in zip(errors, self.tau_std, strict=True))

    def size(self, law_name: str) -> float:
        """Return the unexplained share of friction, averaged over joints."""
        return fmean(self.unexplained_shares(self.laws[law_name].rmse))

    def to_pandas(self) -> Any:
        """Return a DataFrame of all measures [N.m; `r2` has none] by law and joint."""
        columns: dict[str, list[Any]] = {name: [] for name in ("law", "joint", *MEASURES)}
        for law_name, law_scores in self.laws.items():
            for j, joint in enumerate(self.joints):
                columns["law"].append(law_name)
                columns["joint"].append(joint)
                for measure in MEASURES:
                    columns[measure].append(getattr(law_scores, measure)[j])
        return pandas_frame(columns).set_index(["law", "joint"])

    def _repr_html_(self) -> str:
        rows = ((law_name, *law_scores.rmse) for law_name, law_scores in self.laws.items())
        spread = ("(standard deviation)", *self.tau_std)
        return html_table(
            "RMSE of the predicted friction [N.m]", ("law", *self.joints), (spread, *rows)
        )


def find_unseparated(comparison: Comparison, law_name: str, j: int) -> Unseparated | None:
    """Return the statements of a test about a law on a joint, counted from 0; None if unknown.

    The verdict's sentence and the table of separations both use this.
    """
    if j < len(comparison.unseparated) and law_name in comparison.unseparated[j]:
        return comparison.unseparated[j][law_name]
    # Earlier versions, and short tests of a law alone, know only the law with the lowest error.
    if j >= len(comparison.leading) or comparison.leading[j][0] != law_name:
        return None
    tied = comparison.leading[j][1:]
    detectable = comparison.detectable[j]
    ratios = [detectable[name] for name in tied if name in detectable]
    if not ratios:
        ratios = list(detectable.values())
    return Unseparated(
        laws=tied,
        better=(),
        detectable=(min(ratios), max(ratios)) if ratios else None,
        seconds=comparison.seconds[j],
    )


def transpose_records(records: Sequence[Sequence[FrictionRecord]]) -> list[list[FrictionRecord]]:
    """Transpose records [log][joint] to [joint][log]."""
    return [list(joint_records) for joint_records in zip(*records, strict=True)]


def make_causal(records: Records) -> list[list[FrictionRecord]]:
    """Return records with the velocity that a user of an FMU has."""
    return list(map(_make_each_causal, records))


def _make_each_causal(records: Iterable[FrictionRecord]) -> list[FrictionRecord]:
    return [record.causal for record in records]


def select_records(names: Iterable[str], records: LogRecords) -> list[list[FrictionRecord]]:
    """Return the records of the named logs, [joint][part]."""
    parts: list[Sequence[FrictionRecord]] = []
    for name in names:
        parts += records[name]
    return transpose_records(parts)


def compare(
    records: Records,
    predictions: Mapping[str, Sequence[Sequence[Array]]],
    inputs: Mapping[str, str] | None = None,
    models: Mapping[str, FrictionModel] | None = None,
    zero_phase: Mapping[str, Sequence[Sequence[Array]]] | None = None,
) -> Comparison:
    """Score predictions [law][joint][log], (N,) [N.m] each, on records [joint][log].

    The `inputs` of each law decide the references. Bands of `models` are also scored, and
    predictions of a `zero_phase` velocity.
    """
    inputs = inputs or {}
    models = models or {}
    scores = _score_laws(records, predictions)
    zero_phase_scores = _score_laws(records, zero_phase or {})
    fallback = _choose_fallback(predictions)
    ranked = list(filter(is_usable, predictions))
    on_joints = []
    for j, joint_records in enumerate(records):
        error_table = _joint_errors(joint_records, predictions, j, ranked)
        references = {
            law_name: _choose_reference(law_name, j, scores, inputs, models, fallback)
            for law_name in scores
        }
        on_joints.append(
            _JointComparison(
                references=references,
                ratios=_error_ratios(error_table, references),
                separation=_separate_laws(error_table, ranked) if ranked else None,
            )
        )
    ratios = _collect_ratios(on_joints, list(scores), fallback, has_own_references=bool(inputs))
    separations = [joint.separation for joint in on_joints if joint.separation is not None]
    return Comparison(
        joints=tuple(joint_records[0].joint for joint_records in records),
        tau_std=tuple(score.tau_std for score in scores[fallback]),
        laws={law_name: _law_scores(joint_scores) for law_name, joint_scores in scores.items()},
        ratios=ratios,
        leading=tuple(separation.leading for separation in separations),
        bands=_band_scores(models, records, predictions),
        detectable=tuple(separation.detectable for separation in separations),
        seconds=tuple(separation.laws[separation.leading[0]].seconds for separation in separations),
        unseparated=tuple(separation.laws for separation in separations),
        log_count=len({record.log for record in records[0]}),
        zero_phase={
            law_name: _law_scores(joint_scores).rmse
            for law_name, joint_scores in zero_phase_scores.items()
        },
    )


def is_usable(law_name: str) -> bool:
    """Return whether users can run the law of a row: they know neither friction nor torque."""
    return law_name != ORACLE and not law_name.endswith(MEASURED_START)


def _score_laws(
    records: Records, predictions: Mapping[str, Sequence[Sequence[Array]]]
) -> dict[str, list[Score]]:
    """Score the torques [joint][log] of each law on each joint."""
    scores = {}
    for law_name, torques in predictions.items():
        scores[law_name] = [
            score(joint_records, joint_torques)
            for joint_records, joint_torques in zip(records, torques, strict=True)
        ]
    return scores


@dataclass(frozen=True, kw_only=True)
class _Separation:
    """Separation of the laws of one joint by a test.

    Attributes
    ----------
    laws : statements about each law.
    leading : the law with the lowest error, then those not separated from it.
    detectable : smallest ratios of errors that the test can detect, by law.
    """

    laws: dict[str, Unseparated]
    leading: tuple[str, ...]
    detectable: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class _JointComparison:
    """Comparison of the laws on one joint.

    Attributes
    ----------
    references : reference of each law; that of a reference may be itself.
    ratios : ratio of each law to its reference, without laws that are their own reference.
    separation : laws that the test separates; None if no law is ranked.
    """

    references: Mapping[str, str]
    ratios: Mapping[str, ErrorRatio]
    separation: _Separation | None


def _separate_laws(error_table: LawErrors, ranked: Sequence[str]) -> _Separation:
    """Compare each law of a joint with all others."""
    laws = {law_name: _compare_to_rivals(error_table, law_name, ranked) for law_name in ranked}
    best = min(ranked, key=lambda law_name: _find_log_rmse(error_table, law_name))
    return _Separation(
        laws=laws,
        leading=(best, *laws[best].laws),
        detectable=_detect_worse(error_table, best, ranked),
    )


def _collect_ratios(
    on_joints: Sequence[_JointComparison],
    law_names: Sequence[str],
    fallback: str,
    *,
    has_own_references: bool,
) -> Ratios:
    """Return the ratios to references by law and joint; a reference has 1 to itself."""
    itself = ErrorRatio(value=1.0, low=1.0, high=1.0, p=1.0)
    ratios_by_law = {}
    references_by_law = {}
    for law_name in law_names:
        if any(law_name in joint.ratios for joint in on_joints):
            ratios_by_law[law_name] = tuple(
                joint.ratios.get(law_name, itself) for joint in on_joints
            )
            references_by_law[law_name] = tuple(joint.references[law_name] for joint in on_joints)
    return Ratios(
        reference=fallback,
        laws=ratios_by_law,
        by_joint=references_by_law if has_own_references else {},
    )


def _choose_fallback(laws: Iterable[str]) -> str:
    """Return `REFERENCE`, else the first law other than a baseline, else the first law."""
    law_names = list(laws)
    if REFERENCE in law_names:
        return REFERENCE
    baselines = select_laws("baseline")
    models = [law_name for law_name in law_names if law_name not in baselines]
    return (models or law_names)[0]


def _law_scores(joint_scores: Sequence[Score]) -> LawScores:
    """Return the scores of a law on each joint as its errors per joint."""
    return LawScores(
        rmse=tuple(score.rmse for score in joint_scores),
        rmse_reversal=tuple(score.rmse_reversal for score in joint_scores),
        rmse_moving=tuple(score.rmse_moving for score in joint_scores),
        r2=tuple(score.r2 for score in joint_scores),
        rmse_rest=tuple(score.rmse_rest for score in joint_scores),
    )


def _joint_errors(
    joint_records: Sequence[FrictionRecord],
    predictions: Mapping[str, Sequence[Sequence[Array]]],
    j: int,
    ranked: Sequence[str],
) -> LawErrors:
    """Return the errors of all laws on the logs of one joint."""
    errors = {}
    for law_name, torques in predictions.items():
        errors[law_name] = [
            tau - record.tau for record, tau in zip(joint_records, torques[j], strict=True)
        ]
    periods = [float(np.median(np.diff(record.t))) for record in joint_records]
    return law_errors(errors, periods, ranked, [record.log for record in joint_records])


def _error_ratios(error_table: LawErrors, references: Mapping[str, str]) -> dict[str, ErrorRatio]:
    compared_laws = [law_name for law_name in error_table.laws if references[law_name] != law_name]
    ratios = {reference: error_table.ratios(reference) for reference in set(references.values())}
    law_ratios = {law_name: ratios[references[law_name]][law_name] for law_name in compared_laws}
    return {
        law_name: replace(ratio, detectable=None)
        for law_name, ratio in error_table.adjust(law_ratios).items()
    }


def _find_log_rmse(error_table: LawErrors, law_name: str) -> float:
    return float(error_table.log_rmse[error_table.laws.index(law_name)])


def _compare_to_rivals(error_table: LawErrors, law_name: str, ranked: Sequence[str]) -> Unseparated:
    """Return the laws that a test does not separate from a law, and those that are better."""
    # One family per joint; one over all would have little power.
    rivals = [rival for rival in ranked if rival != law_name]
    if not rivals or error_table.too_short:
        return Unseparated(laws=tuple(rivals), better=(), detectable=None, seconds=MIN_SECONDS)
    ratios = error_table.ratios(law_name, len(rivals))
    rival_ratios = error_table.adjust({rival: ratios[rival] for rival in rivals})
    alike = [rival for rival in rivals if rival_ratios[rival].verdict == "alike"]
    better = [rival for rival in rivals if rival_ratios[rival].verdict == "better"]
    candidates = [(rival_ratios[rival].detectable, rival) for rival in alike or rivals]
    by_detectable = sorted((ratio, rival) for ratio, rival in candidates if ratio is not None)
    middle_rival = rivals[0]
    detectable = None
    if by_detectable:
        # The time grows with the detectable ratio, so that the middle law has the median time.
        _, middle_rival = by_detectable[len(by_detectable) // 2]
        detectable = (by_detectable[0][0], by_detectable[-1][0])
    return Unseparated(
        laws=tuple(alike),
        better=tuple(better),
        detectable=detectable,
        seconds=error_table.required_seconds(middle_rival, law_name, RECORDED, len(rivals)),
    )


def _detect_worse(error_table: LawErrors, best: str, ranked: Sequence[str]) -> dict[str, float]:
    """Return the smallest ratio that would show each other law to be worse; none if too short."""
    ratios = error_table.ratios(best, max(1, len(ranked) - 1))
    return {
        law_name: ratio.detectable
        for law_name, ratio in ratios.items()
        if law_name in ranked and ratio.detectable is not None
    }


def _band_scores(
    models: Mapping[str, FrictionModel],
    records: Records,
    predictions: Mapping[str, Sequence[Sequence[Array]]],
) -> dict[str, tuple[BandScore, ...]]:
    """Return the coverage by the bands of models that have one, by law and joint."""
    scores = {}
    motions = [_stack_motion(log_records) for log_records in zip(*records, strict=True)]
    for law_name, model in models.items():
        if not model.banded:
            continue
        torques = predictions[law_name]
        bands = []
        for motion, log_torques in zip(motions, zip(*torques, strict=True), strict=True):
            band = compute_band(
                model,
                t=motion.t,
                dq=motion.dq,
                q=motion.q,
                tau_load=motion.tau_load,
                torque=np.column_stack(log_torques),
            )
            bands.append(band)
        joint_scores = []
        for j, joint_records in enumerate(records):
            joint_bands = [(lower[:, j], upper[:, j]) for lower, upper in bands]
            joint_scores.append(score_band(joint_records, torques[j], joint_bands))
        scores[law_name] = tuple(joint_scores)
    return scores


class _Motion(NamedTuple):
    """Motion of all joints in one log: t (N,), and (N, n) of each other quantity."""

    t: Array
    dq: Array
    q: Array
    tau_load: Array


def _stack_motion(log_records: Sequence[FrictionRecord]) -> _Motion:
    """Return the motion of a log with the velocity that a user of an FMU has."""
    causal_records = _make_each_causal(log_records)
    return _Motion(
        t=log_records[0].t,
        dq=np.column_stack([record.dq for record in causal_records]),
        q=np.column_stack([record.q for record in causal_records]),
        tau_load=np.column_stack([record.tau_load for record in causal_records]),
    )


def _choose_reference(
    law_name: str,
    j: int,
    scores: Mapping[str, Sequence[Score]],
    inputs: Mapping[str, str],
    models: Mapping[str, FrictionModel],
    fallback: str,
) -> str:
    """Return the strongest classic law on a joint without further inputs.

    It has the lowest error on left-out training logs, or on the test if that is unknown.
    """
    if law_name not in inputs:
        return fallback
    law_inputs = set(inputs[law_name].split(", "))

    def find_error(row: str) -> float:
        model = models.get(row.removesuffix(MEASURED_START))
        if model is None or not model.left_out_rmse:
            return scores[row][j].rmse
        # Of a coupled joint that of its own motor: no test error chooses a reference.
        return model.left_out_rmse[j]

    classic = [
        row
        for row in scores
        if _is_classic(row, models) and set(inputs.get(row, "v").split(", ")) <= law_inputs
    ]
    with_start = []
    if law_name.endswith(MEASURED_START):
        with_start = [row for row in classic if row.endswith(MEASURED_START)]
    return min(with_start or classic, key=find_error, default=fallback)


def _is_classic(row: str, models: Mapping[str, FrictionModel]) -> bool:
    """Return whether a row's law, or that of a variant, is one of the literature."""
    law_name = row.removesuffix(MEASURED_START)
    names = {law_name}
    if law_name in models:
        names = {law.name for law in models[law_name].laws}
    return names <= set(select_laws("classic"))


def select_window(
    records: Records, torques: Sequence[Sequence[Array]], start: float, stop: float
) -> tuple[list[list[FrictionRecord]], list[list[Array]]]:
    """Return the rows of records and torques [joint][log] with start <= t < stop [s] in each log.

    Raises ConfigError if no log has such rows.
    """
    window_records = []
    window_torques = []
    for joint_records, joint_torques in zip(records, torques, strict=True):
        is_inside = [time_band(record.t - record.t[0], start, stop) for record in joint_records]
        log_indices = [k for k, mask in enumerate(is_inside) if np.count_nonzero(mask) > 1]
        if not log_indices:
            longest = max(float(record.t[-1] - record.t[0]) for record in joint_records)
            raise ConfigError(
                f"the band from {start:g} to {stop:g} s is empty; the longest log of its test set "
                f"lasts {longest:.3g} s."
            )
        window_records.append([joint_records[k].rows(is_inside[k]) for k in log_indices])
        window_torques.append([joint_torques[k][is_inside[k]] for k in log_indices])
    return window_records, window_torques


def name_inputs(model: FrictionModel) -> str:
    """Return the inputs that a model uses on any joint; the velocity if it uses none."""
    inputs_by_law = [law.form.inputs for law in model.laws]
    names = []
    for symbol, name in zip(INPUTS, ("v", "q", "load"), strict=True):
        if any(symbol in law_inputs for law_inputs in inputs_by_law):
            names.append(name)

    # A constant torque competes with the laws that need no more than every FMU gets.
    return ", ".join(names or ["v"])


def table_rows(models: Mapping[str, FrictionModel]) -> dict[str, tuple[str, bool]]:
    """Return the model of each row of a table, and whether it starts from measured torques."""
    rows = {}
    for name, model in models.items():
        rows[name] = (name, False)
        if any(law.start_samples for law in model.laws):
            rows[f"{name}{MEASURED_START}"] = (name, True)
    return rows


def input_classes(models: Mapping[str, FrictionModel]) -> dict[str, str]:
    """Return the inputs of each row of a table; only rows with equal inputs compare fairly."""
    classes = {}
    for row, (name, with_start) in table_rows(models).items():
        classes[row] = name_inputs(models[name])
        if with_start:
            classes[row] += ", start"
    return classes


def predict_models(
    models: Mapping[str, FrictionModel], records: Records, progress: Progress = silent
) -> dict[str, list[list[Array]]]:
    """Return the torques (N,) [N.m] by row of `table_rows`, joint and log."""
    rows = table_rows(models)
    return {
        row: predict_model(models[name], records, measured_start=with_start)
        for row, (name, with_start) in report_progress(rows.items(), progress, lambda row: row[0])
    }
