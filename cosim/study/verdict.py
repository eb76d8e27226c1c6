"""A run in words: which FMU to take and why, what it leaves unexplained, and what would help."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cosim.report.tables.table import joints as short_names
from cosim.report.tables.table import title
from cosim.study.scores import ORACLE, Comparison, Records
from hesr_model.audit.expectations import EXPECTATIONS
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import outside
from hesr_model.logs.phases import MOVING
from hesr_model.rigid_body.residual import all_at_friction
from hesr_model.support.typed_json import from_json, read_json, to_json, write_json

if TYPE_CHECKING:
    from hesr_model.audit.properties import Properties

VERDICT, VERDICT_FORMAT = "verdict.json", "hesr-verdict-1"

_MUCH = 25.0
"""[%] Of friction: who leaves more has not understood the joint."""
_AT_REVERSALS = 1.5
"""Times the error over all rows from which on reversals are where a law is weak."""
_BEYOND = 0.02
"""Share of test rows outside the trained speeds that is worth a word."""
_RESTS = 0.02
"""Share of training rows at rest below which stiction was hardly seen."""
_LOADED = 0.5
"""Of the size of friction: where the load varies by less, its effect on friction is not seen."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What a run comes to.

    Attributes
    ----------
    law : whose FMU to take.
    fmu : its file, relative to the folder of results.
    test : the test set by which it was chosen.
    why : in a sentence.
    unexplained : by joint, its error over the size of friction there [%].
    weak : where it is weak, a sentence each.
    improve : what would improve it, a sentence each.
    """

    law: str
    fmu: str
    test: str
    why: str
    unexplained: Mapping[str, float]
    weak: tuple[str, ...]
    improve: tuple[str, ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in words."""
        shares = zip(short_names(len(self.unexplained)), self.unexplained.values(), strict=True)
        left = ", ".join(f"{joint} {share:.0f} %" for joint, share in shares)
        return (
            f"Take {self.fmu} ({title(self.law)}): {self.why}",
            f"Of friction it leaves unexplained on '{self.test}': {left}.",
            *self.weak,
            *self.improve,
        )


def verdict(
    comparisons: Mapping[str, Comparison],
    models: Mapping[str, FrictionModel],
    trained: Records,
    tested: Records,
    properties: "Mapping[str, Properties]",
    *,
    gear_ratio: bool,
) -> Verdict:
    """Judge a run by its first test set.

    Of the laws that no other one beats on as many joints, beyond chance among all comparisons, the
    one is taken that has most properties of friction, then the least error.

    Parameters
    ----------
    comparisons : of every test set, the first one first.
    models : the laws.
    trained, tested : records [joint][log] of the training logs and of the first test set.
    properties : what the battery found; empty where it was not run.
    gear_ratio : whether the robot file gives it.
    """
    test, scores = next(iter(comparisons.items()))
    names = [law for law in scores.laws if law != ORACLE]
    leads = {law: sum(law in of_joint for of_joint in scores.leading) for law in names}
    most = max(leads.values())
    equals = [law for law in names if leads[law] == most]
    had = {law: properties[law].passed for law in equals if law in properties}
    error = {law: _relative(scores, law) for law in names}
    law = min(equals, key=lambda name: (-had.get(name, 0), error[name]))
    own = scores.laws[law]
    percent = {
        joint: 100.0 * rmse / std
        for joint, rmse, std in zip(scores.joints, own.rmse, scores.tau_std, strict=True)
    }
    return Verdict(
        law=law,
        fmu=f"fmus/{law}.fmu",
        test=test,
        why=_why(law, most, [name for name in equals if name != law], len(scores.joints), had),
        unexplained=percent,
        weak=tuple(_weak(scores, law, percent, properties)),
        improve=tuple(_improve(models[law], trained, tested, gear_ratio=gear_ratio)),
    )


def _relative(scores: Comparison, law: str) -> float:
    ratios = np.divide(scores.laws[law].rmse, np.maximum(scores.tau_std, 1e-300))
    return float(np.mean(ratios))


def _why(law: str, most: int, equals: Sequence[str], joints: int, had: Mapping[str, int]) -> str:
    on = f"on {most} of {joints} joints"
    if not equals:
        return f"{on} no other law is better beyond chance, which holds for none of the others."
    others = ", ".join(map(title, equals))
    reason = (
        f"it has more of the properties of friction ({had[law]} of {len(EXPECTATIONS)})"
        if law in had and had[law] > max((had.get(name, 0) for name in equals), default=0)
        else "its error is the least"
    )
    return f"{on} no law is better beyond chance, as holds for {others}, too; {reason}."


def _weak(
    scores: Comparison,
    law: str,
    percent: Mapping[str, float],
    properties: "Mapping[str, Properties]",
) -> Iterable[str]:
    short, own = short_names(len(scores.joints)), scores.laws[law]
    much = [name for name, share in zip(short, percent.values(), strict=True) if share > _MUCH]
    if much:
        yield f"It explains {', '.join(much)} badly: more than {_MUCH:g} % of friction is left."
    pairs = zip(short, own.rmse_reversal, own.rmse, strict=True)
    turning = [name for name, at, over in pairs if at is not None and at > _AT_REVERSALS * over]
    if turning:
        yield f"It is weak at reversals of {', '.join(turning)}."
    if law in properties:
        lacking = [
            expectation.title
            for key, expectation in EXPECTATIONS.items()
            if any(joint.findings[key].verdict == "fail" for joint in properties[law].joints)
        ]
        if lacking:
            yield f"On some joint it does not behave as friction does: {', '.join(lacking)}."


def _improve(
    model: FrictionModel, trained: Records, tested: Records, *, gear_ratio: bool
) -> Iterable[str]:
    trained, tested = all_at_friction(trained), all_at_friction(tested)
    short = short_names(len(trained))
    faster, resting, loaded = [], [], []
    for name, seen, learnt, new in zip(short, model.trained, trained, tested, strict=True):
        beyond = outside(seen, new).get("dq")
        if beyond is not None and beyond.rows > _BEYOND:
            faster.append(name)
        dq, load, tau = (
            np.concatenate([getattr(r, what) for r in learnt]) for what in ("dq", "tau_load", "tau")
        )
        if np.mean(np.abs(dq) < MOVING) < _RESTS:
            resting.append(name)
        if np.std(load) < _LOADED * np.std(tau):
            loaded.append(name)
    if faster:
        yield f"Faster training logs would help on {', '.join(faster)}: the test goes beyond them."
    if resting:
        yield f"Training logs with rests would help on {', '.join(resting)}, which hardly rest."
    if loaded:
        yield (
            f"A log with a payload would tell how friction rises with the load on "
            f"{', '.join(loaded)}, where the load hardly varies."
        )
    if not gear_ratio:
        yield "With 'gear_ratio' in the robot file, laws with motor ripple could be fitted."


def write_verdict(folder: Path, found: Verdict) -> None:
    """Write a verdict into a folder of results."""
    write_json(folder / VERDICT, {"format": VERDICT_FORMAT, **to_json(found)})


def read_verdict(folder: Path) -> Verdict | None:
    """Read it back; None where results of earlier versions have none.

    Raises
    ------
    ArtifactError
        If the file is damaged.
    """
    path = folder / VERDICT
    if not path.is_file():
        return None
    return from_json(Verdict, read_json(path, VERDICT_FORMAT), path, "the verdict of a run")
