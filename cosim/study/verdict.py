"""Verdict of a run: the recommended FMU, its weaknesses, and helpful data."""

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

_MUCH = 25.0  # [%] of friction unexplained
_AT_REVERSALS = 1.5  # error near reversals over that of all rows
_BEYOND = 0.02  # share of test rows outside the trained speeds
_RESTS = 0.02  # share of training rows at rest that shows stiction
_LOADED = 0.5  # spread of the load over that of friction


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Verdict of a run in sentences."""

    law: str
    fmu: str  # path in the folder of results
    test: str  # deciding test set
    why: str
    unexplained: Mapping[str, float]  # error over the size of friction by joint [%]
    weak: tuple[str, ...]
    improve: tuple[str, ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in sentences."""
        shares = zip(short_names(len(self.unexplained)), self.unexplained.values(), strict=True)
        left = ", ".join(f"{joint} {share:.0f} %" for joint, share in shares)
        return (
            f"Recommended: {self.fmu} ({title(self.law)}): {self.why}",
            f"Unexplained friction on '{self.test}': {left}.",
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
    """Judge a run by its first test set; records are [joint][log].

    Candidates are the laws that lead on most joints, where no other law is significantly better.
    The law that passes most physics checks is taken, then the one with the lowest error.
    """
    test, scores = next(iter(comparisons.items()))
    names = [law for law in scores.laws if law != ORACLE]
    leads = {law: sum(law in of_joint for of_joint in scores.leading) for law in names}
    most = max(leads.values())
    candidates = [law for law in names if leads[law] == most]
    passed = {law: properties[law].passed for law in candidates if law in properties}
    error = {law: _relative(scores, law) for law in names}
    law = min(candidates, key=lambda name: (-passed.get(name, 0), error[name]))
    percent = {
        joint: 100.0 * rmse / std
        for joint, rmse, std in zip(
            scores.joints, scores.laws[law].rmse, scores.tau_std, strict=True
        )
    }
    equals = [name for name in candidates if name != law]
    return Verdict(
        law=law,
        fmu=f"fmus/{law}.fmu",
        test=test,
        why=_why(law, f"on {most} of {len(scores.joints)} joints", equals, passed),
        unexplained=percent,
        weak=tuple(_weak(scores, law, percent, properties)),
        improve=tuple(_improve(models[law], trained, tested, gear_ratio=gear_ratio)),
    )


def _relative(scores: Comparison, law: str) -> float:
    ratios = np.divide(scores.laws[law].rmse, np.maximum(scores.tau_std, 1e-300))
    return float(np.mean(ratios))


def _why(law: str, on: str, equals: Sequence[str], passed: Mapping[str, int]) -> str:
    if not equals:
        return f"{on} no other law is significantly better, and each other law is on fewer."
    others = ", ".join(map(title, equals))
    reason = (
        f"it passes more physics checks ({passed[law]} of {len(EXPECTATIONS)})"
        if law in passed and passed[law] > max((passed.get(name, 0) for name in equals), default=0)
        else "it has the lowest error"
    )
    return f"{on} no law is significantly better (tied with {others}); {reason}."


def _weak(
    scores: Comparison,
    law: str,
    percent: Mapping[str, float],
    properties: "Mapping[str, Properties]",
) -> Iterable[str]:
    short, own = short_names(len(scores.joints)), scores.laws[law]
    much = [name for name, share in zip(short, percent.values(), strict=True) if share > _MUCH]
    if much:
        yield f"Poorly modelled: {', '.join(much)} (more than {_MUCH:g} % of friction unexplained)."
    pairs = zip(short, own.rmse_reversal, own.rmse, strict=True)
    turning = [name for name, at, over in pairs if at is not None and at > _AT_REVERSALS * over]
    if turning:
        yield f"Large errors near reversals: {', '.join(turning)}."
    failed = [
        expectation.title
        for key, expectation in EXPECTATIONS.items()
        if law in properties
        and any(joint.findings[key].verdict == "fail" for joint in properties[law].joints)
    ]
    if failed:
        yield f"Physics checks it fails on at least one joint: {', '.join(failed)}."


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
    advice = {
        "the test is faster than the training logs; record faster motion.": faster,
        "hardly any standstill in the training logs; record rests.": resting,
        "the load hardly changes; record a log with a payload to model load-dependent "
        "friction.": loaded,
    }
    for sentence, names in advice.items():
        if names:
            yield f"{', '.join(names)}: {sentence}"
    if not gear_ratio:
        yield "Add gear_ratio to the robot file to also fit motor ripple."


def write_verdict(folder: Path, found: Verdict) -> None:
    """Write a verdict into a folder of results."""
    write_json(folder / VERDICT, {"format": VERDICT_FORMAT, **to_json(found)})


def read_verdict(folder: Path) -> Verdict | None:
    """Read a verdict; results of earlier versions have none."""
    path = folder / VERDICT
    if not path.is_file():
        return None
    return from_json(Verdict, read_json(path, VERDICT_FORMAT), path, "the verdict of a run")
