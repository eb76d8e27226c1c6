"""The referee between a guess and a statement: what checks assume is tried before it is said.

A check states nothing by itself. It offers hypotheses: what is assumed, and the trials that could
contradict it. A trial is a race against a free alternative (the file as it is, another sign, no
model, a constant) by the squared errors of predictions on left-out rows, or a statistic with its
standard error and the range in which it would be sound. A hypothesis is stated only if

(a) the data can tell: what it changes exceeds the uncertainty of each trial,
(b) it wins each trial by more than that uncertainty, and
(c) it creates no new contradiction.

One that loses a trial is dropped. One that leads by no more than its uncertainty is undecided:
"cannot tell, because ..; record ..". Counts of rows that need no inference have no trials.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from hesr_model.findings import Finding, Severity
from hesr_model.fitting.joint_rows import non_negative_least_squares
from hesr_model.inference.folds import FOLD_COUNT, mask_rows
from hesr_model.support.arrays import Array, Mask
from hesr_model.support.text import format_settings

MATERIAL_GAIN = 0.1  # share of the squared errors that a statement must explain
CURE_GAIN = 0.5  # and one that changes the robot file, which other faults could imitate
_BLOCKS = 20  # of time, whose scatter is the uncertainty of a race; 4 in each fold
# Blocks measure the scatter of errors; standard errors of a fit assume a model of their noise.
_RACE_ERRORS = 3.0
_STATISTIC_ERRORS = 5.0
_MAX_SETTINGS_LENGTH = 300  # characters of lines that a sentence quotes

TrialOutcome = Literal["won", "lost", "open"]


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A coefficient and its standard error, corrected for autocorrelation."""

    value: float
    error: float

    @property
    def t(self) -> float:
        """The coefficient in standard errors."""
        return self.value / max(self.error, 1e-300)


@dataclass(frozen=True, kw_only=True, eq=False)
class Race:
    """A hypothesis against an alternative that costs nothing, on rows that formed neither.

    Attributes
    ----------
    rival : the alternative in words.
    rival_squares, squares : (N,) squared errors of the alternative and of the hypothesis, in the
        order of time.
    min_gain : share of the alternative's squares that the hypothesis must explain.
    """

    rival: str
    rival_squares: Array
    squares: Array
    min_gain: float = MATERIAL_GAIN

    @cached_property
    def gain(self) -> Estimate:
        """Explained share of the alternative's squares, with its error from blocks of time."""
        total = max(float(np.sum(self.rival_squares)), 1e-300)
        count = min(_BLOCKS, len(self.squares))
        edges = np.linspace(0, len(self.squares), count + 1).astype(int)[:-1]
        block_rivals = np.add.reduceat(self.rival_squares, edges) / total
        block_gains = block_rivals - np.add.reduceat(self.squares, edges) / total
        value = float(block_gains.sum())
        # The share is a ratio of sums: blocks that hold more squares may gain more.
        scatter = block_gains - value * block_rivals
        error = float(np.sqrt(np.sum(scatter**2) * count / max(count - 1, 1)))
        return Estimate(value=value, error=error)

    @property
    def outcome(self) -> TrialOutcome:
        """Whether the hypothesis wins, loses, or leads within its uncertainty."""
        if not self.gain.value > self.min_gain:
            return "lost"
        if self.gain.value > _RACE_ERRORS * self.gain.error:
            return "won"
        return "open"

    @property
    def doubt(self) -> str:
        """Why the race decides nothing."""
        return (
            f"it explains {100 * self.gain.value:.0f} % more than {self.rival}, with an "
            f"uncertainty of {100 * _RACE_ERRORS * self.gain.error:.0f} %"
        )


@dataclass(frozen=True, kw_only=True)
class Statistic:
    """A ratio that the hypothesis says lies outside a sound range.

    Attributes
    ----------
    name : what the ratio is, in words.
    estimate : the ratio and its standard error.
    low, high : the range in which there is nothing to say.
    errors : standard errors by which it must lie outside.
    """

    name: str
    estimate: Estimate
    low: float = -np.inf
    high: float = np.inf
    errors: float = _STATISTIC_ERRORS

    @property
    def outcome(self) -> TrialOutcome:
        """Whether the ratio lies outside the range, inside it, or too close to its end."""
        excess = max(self.low - self.estimate.value, self.estimate.value - self.high)
        if not excess > 0.0:
            return "lost"
        if excess > self.errors * self.estimate.error:
            return "won"
        return "open"

    @property
    def doubt(self) -> str:
        """Why the statistic decides nothing."""
        half_interval = self.errors * self.estimate.error
        return f"{self.name} is {self.estimate.value:.2g} (+- {half_interval:.1g})"


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """What a check assumes, and what could contradict it; no number in it has a unit.

    Attributes
    ----------
    check : name of the finding, which `--accept` takes.
    joint : the joint it is about; empty for all.
    observation, remedy : what is said if it is stated.
    trials : races and statistics, all of which it must win; none for counts of rows.
    contradictions : what it would contradict that is sound without it, in words.
    record : what a log must contain to decide it.
    changes : values by key of the robot file that mend it.
    """

    check: str
    joint: str
    observation: str
    remedy: str
    severity: Severity = "error"
    trials: tuple[Race | Statistic, ...] = ()
    contradictions: tuple[str, ...] = ()
    record: str = ""
    changes: Mapping[str, Any] = field(default_factory=dict)
    further_joints: tuple[str, ...] = ()
    logs: tuple[str, ...] = ()

    @cached_property
    def outcome(self) -> TrialOutcome:
        """Whether the hypothesis is stated, dropped or undecided."""
        outcomes = {trial.outcome for trial in self.trials}
        if "lost" in outcomes:
            return "lost"
        if "open" in outcomes or self.contradictions:
            return "open"
        return "won"


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """What can be stated, and what cannot be told."""

    findings: tuple[Finding, ...] = ()
    undecided: tuple[Finding, ...] = ()


def judge(hypotheses: Iterable[Hypothesis]) -> Judgement:
    """Try hypotheses; return the findings of those that win, and the doubts of undecided ones."""
    findings = []
    undecided = []
    for hypothesis in hypotheses:
        if hypothesis.outcome == "won":
            findings.append(_state(hypothesis))
        elif hypothesis.outcome == "open":
            undecided.append(_doubt(hypothesis))
    return Judgement(findings=tuple(findings), undecided=tuple(undecided))


def state(hypotheses: Iterable[Hypothesis]) -> list[Finding]:
    """Return the findings of the hypotheses that win their trials."""
    return list(judge(hypotheses).findings)


def _state(hypothesis: Hypothesis) -> Finding:
    return Finding(
        check=hypothesis.check,
        severity=hypothesis.severity,
        joints=_name_joints(hypothesis),
        logs=hypothesis.logs,
        found=hypothesis.observation,
        remedy=_add_settings(hypothesis.remedy, hypothesis.changes),
        changes=hypothesis.changes,
    )


def _add_settings(remedy: str, changes: Mapping[str, Any]) -> str:
    """Add the lines of a robot file that make the changes, unless they are many names."""
    if not changes:
        return remedy
    settings = format_settings(changes)
    if len(settings) > _MAX_SETTINGS_LENGTH:
        settings = f"{', '.join(changes)} as an inspection proposes"
    return f"{remedy}; set {settings}"


def _doubt(hypothesis: Hypothesis) -> Finding:
    reasons = [trial.doubt for trial in hypothesis.trials if trial.outcome == "open"]
    reasons += hypothesis.contradictions
    remedy = f"cannot tell, because {'; '.join(reasons)}"
    if hypothesis.record:
        remedy += f"; record {hypothesis.record} to find out"
    return Finding(
        check=hypothesis.check,
        severity="advice",
        joints=_name_joints(hypothesis),
        logs=hypothesis.logs,
        found=f"{hypothesis.observation}",
        remedy=remedy,
    )


def _name_joints(hypothesis: Hypothesis) -> tuple[str, ...]:
    if not hypothesis.joint:
        return hypothesis.further_joints
    return (hypothesis.joint, *hypothesis.further_joints)


@dataclass(frozen=True, kw_only=True, eq=False)
class LeftOutRows:
    """Rows (N,) of logs in folds, each of which is judged by a fit to the others.

    Attributes
    ----------
    judged, trained : for each fold, masks (N,) of the rows it judges and of those it fits.
    """

    judged: tuple[Mask, ...]
    trained: tuple[Mask, ...]

    @classmethod
    def split(cls, names: Sequence[str], times: Sequence[Array]) -> "LeftOutRows":
        """Split the rows of logs `names` at `times` (N,) [s], as `inference.folds` does."""
        folds = [mask_rows(names, times, number) for number in range(FOLD_COUNT)]
        return cls(
            judged=tuple(np.concatenate(judged) for judged, _ in folds),
            trained=tuple(np.concatenate(trained) for _, trained in folds),
        )

    def predict(self, columns: Array, target: Array, *, non_negative: int = 0) -> Array:
        """Return the errors (N,) of a target that a fit of columns (N, K) to other rows predicts.

        The first `non_negative` coefficients are at least 0. A fold without enough rows to fit
        predicts 0.
        """
        errors = np.array(target, dtype=float)
        for judged, trained in zip(self.judged, self.trained, strict=True):
            if np.count_nonzero(trained) <= columns.shape[1] or not judged.any():
                continue
            coefficients, _ = non_negative_least_squares(
                columns[trained], target[trained], non_negative=non_negative
            )
            errors[judged] -= columns[judged] @ coefficients
        return errors
