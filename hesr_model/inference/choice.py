"""Choice of the law of each joint by errors on left-out rows.

One law for all joints is the base. A proven law takes its place where the errors allow. A joint
leaves the base only for a law that is better by two standard errors. The number of laws does not
enter, so that further laws do not change the choice among the others.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import stdtrit

from hesr_model.inference.folds import MIN_FOLDS
from hesr_model.inference.left_out import LeftOutErrors

NONE = "none"
CONSTANT = "constant"
PLAIN = "coulomb_viscous"
CHOOSE = "choose"
"""Name that stands for a law to be chosen among the proposed ones."""

PROVEN_LAWS = ("parfam_s", "parfam_s_v")
"""Laws that take the place of an unproven base, in this order."""

_MIN_SECONDS = 3.0  # [s] of judged rows of a joint, below which nothing is chosen for it
_MIN_SECONDS_OF_ONE = 8.0  # [s] of logs of a single joint, below which the base is `PLAIN`
_ERRORS_TO_LEAVE = 2.0  # standard errors by which a law must beat the base on a joint
_MAX_FOLD_RATIO = 1.5  # of a law's error on a fold over that of `PLAIN`

Known = Literal["law", "level", "nothing"]
Reason = Literal["base", "better", "exploded", "unexplained", "short"]


@dataclass(frozen=True, kw_only=True)
class JointChoice:
    """Law of a joint and what the left-out rows say about it.

    Attributes
    ----------
    law_name : recommended law.
    reason : rule that decided: the base of all joints, a law that is better by two standard
        errors, a fold on which the law explodes, no law that explains anything, or too few rows.
    known : whether the rows tell the law from Coulomb + viscous friction, that from a constant, or
        nothing.
    ratio, low, high : RMSE over that of Coulomb + viscous friction and its 95 % interval; None
        without judged rows.
    unexplained : RMSE over the standard deviation of the friction; None without judged rows.
    worst_fold : ratio on the worst fold of the law that exploded; None otherwise.
    replaced : law that exploded or explained nothing; empty otherwise.
    proven : whether the law's passivity is proven on this joint.
    """

    law_name: str
    reason: Reason
    known: Known
    ratio: float | None = None
    low: float | None = None
    high: float | None = None
    unexplained: float | None = None
    worst_fold: float | None = None
    replaced: str = ""
    proven: bool = False

    @property
    def is_recommended(self) -> bool:
        """Whether the law is better than no friction model."""
        return self.reason != "unexplained"


@dataclass(frozen=True, kw_only=True)
class LawChoice:
    """Recommended law of each joint."""

    base: str
    joints: tuple[JointChoice, ...]
    fold_count: int
    seconds: float  # [s] of the logs
    guaranteed: str = ""  # law that `base` replaced because its passivity is proven
    is_short: bool = False  # logs of one joint that are too short to rank laws

    @property
    def laws(self) -> tuple[str, ...]:
        """Recommended law of each joint."""
        return tuple(joint_choice.law_name for joint_choice in self.joints)


def choose_laws(
    errors: LeftOutErrors,
    *,
    is_proven: Callable[[str, int], bool],
    can_join: Callable[[str, str], bool],
) -> LawChoice:
    """Choose the law of each joint.

    Parameters
    ----------
    errors : errors of all laws on left-out rows; those of the baselines are among them.
    is_proven : whether a law's passivity is proven on a joint.
    can_join : whether one FMU can have both of two laws.
    """
    joint_indices = [j for j in range(len(errors.joints)) if _is_judged(errors, j)]
    candidates = [name for name in errors.laws if _is_finite(errors, name, joint_indices)]
    is_short = len(errors.joints) == 1 and errors.seconds < _MIN_SECONDS_OF_ONE
    base = PLAIN
    replaced = ""
    if joint_indices and not is_short:
        base_candidates = [
            name
            for name in candidates
            if can_join(PLAIN, name) or _is_calm(errors, name, joint_indices)
        ]
        base, replaced = _choose_base(errors, base_candidates, joint_indices, is_proven)
    joints = []
    for j in range(len(errors.joints)):
        if j not in joint_indices:
            unjudged = JointChoice(
                law_name=base, reason="short", known="nothing", proven=is_proven(base, j)
            )
            joints.append(unjudged)
            continue
        joint_candidates = [name for name in candidates if name == base or can_join(name, base)]
        if replaced:  # the proof is why the base was taken
            joint_candidates = [name for name in joint_candidates if is_proven(name, j)]
        joints.append(_choose_joint(errors, j, base, joint_candidates, is_proven))
    return LawChoice(
        base=base,
        joints=tuple(joints),
        fold_count=errors.fold_count,
        seconds=errors.seconds,
        guaranteed=replaced,
        is_short=is_short,
    )


def _is_judged(errors: LeftOutErrors, j: int) -> bool:
    """Return whether enough folds and rows judge a joint."""
    return errors.fold_counts(j) >= MIN_FOLDS and errors.moving_seconds(j) >= _MIN_SECONDS


def _is_finite(errors: LeftOutErrors, law_name: str, joint_indices: Sequence[int]) -> bool:
    return all(np.isfinite(errors.rmse(law_name, j)) for j in joint_indices)


def _choose_base(
    errors: LeftOutErrors,
    candidates: Sequence[str],
    joint_indices: Sequence[int],
    is_proven: Callable[[str, int], bool],
) -> tuple[str, str]:
    """Return the base law, and the law that it replaced because it is proven, if any."""

    def mean_log_ratio(law_name: str, other: str = PLAIN) -> float:
        return float(np.mean([errors.log_ratio(law_name, other, j) for j in joint_indices]))

    best = min(candidates, key=mean_log_ratio)
    joints = range(len(errors.joints))
    if all(is_proven(best, j) for j in joints):
        return best, ""
    for law_name in PROVEN_LAWS:
        if law_name not in candidates:
            continue
        is_close = mean_log_ratio(law_name, best) <= errors.mean_standard_error(
            law_name, best, joint_indices
        )
        is_fair = mean_log_ratio(law_name) <= 0.0 and _is_calm(errors, law_name, joint_indices)
        if is_close and is_fair and all(is_proven(law_name, j) for j in joints):
            return law_name, best
    return best, ""


def _choose_joint(
    errors: LeftOutErrors,
    j: int,
    base: str,
    candidates: Sequence[str],
    is_proven: Callable[[str, int], bool],
) -> JointChoice:
    """Choose the law of a joint whose rows are judged."""
    law_name = base
    reason: Reason = "base"
    replaced = ""
    worst_fold = None
    best = min(candidates, key=lambda name: errors.rmse(name, j))
    if is_better(errors, best, base, j):
        law_name = best
        reason = "better"
    worst_ratio = errors.worst_fold(law_name, PLAIN, j)
    can_replace = PLAIN in candidates  # otherwise no joint can have a law of its own
    if can_replace and worst_ratio > _MAX_FOLD_RATIO and law_name not in (CONSTANT, NONE):
        replaced = law_name
        law_name = _choose_calm_law(errors, j, candidates)
        reason = "exploded"
        worst_fold = worst_ratio
    size = errors.friction_size(j)
    if can_replace and not errors.rmse(law_name, j) < size:
        best_constant = min((CONSTANT, NONE), key=lambda name: errors.rmse(name, j))
        replaced = law_name
        law_name = best_constant
        reason = "unexplained"
    log_ratio = errors.log_ratio(law_name, PLAIN, j)
    standard_error = 0.0
    if law_name != PLAIN:
        standard_error = errors.standard_error(law_name, PLAIN, j)
    margin = float(stdtrit(errors.degrees_of_freedom(law_name, PLAIN, j), 0.975)) * standard_error
    known: Known = "nothing"
    if is_better(errors, law_name, PLAIN, j):
        known = "law"
    elif is_better(errors, law_name, CONSTANT, j) or is_better(errors, PLAIN, CONSTANT, j):
        known = "level"
    return JointChoice(
        law_name=law_name,
        reason=reason,
        known=known,
        ratio=float(np.exp(log_ratio)),
        low=float(np.exp(log_ratio - margin)),
        high=float(np.exp(log_ratio + margin)),
        unexplained=errors.rmse(law_name, j) / max(size, 1e-300),
        worst_fold=worst_fold,
        replaced=replaced,
        proven=is_proven(law_name, j),
    )


def _is_calm(errors: LeftOutErrors, law_name: str, joint_indices: Sequence[int]) -> bool:
    """Return whether a law explodes on no fold of some joints."""
    return all(errors.worst_fold(law_name, PLAIN, j) <= _MAX_FOLD_RATIO for j in joint_indices)


def _choose_calm_law(errors: LeftOutErrors, j: int, candidates: Sequence[str]) -> str:
    """Return the best of the laws that explode on no fold if it is better than `PLAIN`."""
    calm_laws = [law_name for law_name in candidates if _is_calm(errors, law_name, [j])]
    best = min(calm_laws, key=lambda law_name: errors.rmse(law_name, j), default=PLAIN)
    if is_better(errors, best, PLAIN, j):
        return best
    return PLAIN


def is_better(errors: LeftOutErrors, law_name: str, other: str, j: int) -> bool:
    """Return whether a law is better than another one on a joint by two standard errors."""
    if law_name == other:
        return False
    advantage = -errors.log_ratio(law_name, other, j)
    return advantage > _ERRORS_TO_LEAVE * errors.standard_error(law_name, other, j)
