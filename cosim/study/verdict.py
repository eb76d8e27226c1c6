"""Verdict of a run: the recommended FMU, its weaknesses, and helpful data."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cosim.report.tables.table import joints as short_names
from cosim.report.tables.table import title
from cosim.study.scores import RECORDED, Comparison, Records, inputs_of
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import outside
from hesr_model.logs.phases import MOVING
from hesr_model.rigid_body.residual import all_at_friction
from hesr_model.support.typed_json import from_json, read_json, to_json, write_json

if TYPE_CHECKING:
    from hesr_model.audit.properties import Properties

VERDICT, VERDICT_FORMAT = "verdict.json", "hesr-verdict-1"

CLOSE = 1.05  # ratio of errors; smaller ones are due to coefficients
_SHORT = "the test is too short to compare laws"
_MUCH = 25.0  # [%] of friction unexplained
_AT_REVERSALS = 1.5  # error near reversals over that of all rows
_BEYOND = 0.02  # share of test rows outside the trained speeds
_RESTS = 0.02  # share of training rows at rest that shows stiction
_LOADED = 0.5  # spread of the load over that of friction


@dataclass(frozen=True, kw_only=True)
class Separation:
    """Laws `tied` with the `best` on a joint, which a test cannot distinguish.

    Errors of `detectable` times the lowest would have been found, from the law with the smallest to
    that with the largest such ratio; None for a short test.
    """

    best: str
    tied: tuple[str, ...]
    detectable: tuple[float, float] | None
    seconds: float  # [s] test that would find `RECORDED`


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
    joints: tuple[Separation, ...] = ()  # empty in earlier versions
    limits: tuple[str, ...] = ()  # of the test

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in sentences."""
        shares = zip(short_names(len(self.unexplained)), self.unexplained.values(), strict=True)
        left = ", ".join(f"{joint} {share:.0f} %" for joint, share in shares)
        return (
            f"Recommended: {self.fmu} ({title(self.law)}): {self.why}",
            *self.limits,
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

    See `recommend`. For a short test, the errors on left-out training logs decide.
    """
    test, scores = next(iter(comparisons.items()))
    law, why = recommend(scores, models)
    percent = {
        joint: 100.0 * rmse / std
        for joint, rmse, std in zip(
            scores.joints, scores.laws[law].rmse, scores.tau_std, strict=True
        )
    }
    joints = tuple(separation(scores))
    return Verdict(
        law=law,
        fmu=f"fmus/{law}.fmu",
        test=test,
        why=why,
        unexplained=percent,
        weak=tuple(_weak(scores, law, percent, properties)),
        improve=tuple(_improve(models[law], trained, tested, gear_ratio=gear_ratio)),
        joints=joints,
        limits=tuple(limits(f"'{test}'", law, joints)),
    )


def separation(scores: Comparison) -> Iterator[Separation]:
    """Yield the laws that the test cannot distinguish, by joint."""
    for of_joint, detectable, seconds in zip(
        scores.leading, scores.detectable, scores.seconds, strict=True
    ):
        best, *tied = of_joint
        among = [detectable[law] for law in tied if law in detectable] or [*detectable.values()]
        yield Separation(
            best=best,
            tied=tuple(tied),
            detectable=(min(among), max(among)) if among else None,
            seconds=seconds,
        )


def recommend(scores: Comparison, models: Mapping[str, FrictionModel]) -> tuple[str, str]:
    """Return the recommended law and the rule that decided.

    It is the simplest of the laws that lead on most joints within `CLOSE` of the lowest error of
    each joint, else the one nearest to that.
    """
    names = [law for law in scores.laws if law in models]
    joints = range(len(scores.joints))
    if all(scores.too_short):
        known = [law for law in names if models[law].left_out_rmse]
        if not known:
            law = min(names, key=lambda name: _mean(scores.laws[name].rmse, scores.tau_std))
            return law, f"{_SHORT}; it has the lowest error."
        law = min(known, key=lambda name: _mean(models[name].left_out_rmse, scores.tau_std))
        return law, f"{_SHORT}; it has the lowest error on left-out training logs."
    led = {law: sum(law in scores.leading[j] for j in joints) for law in names}
    most = max(led.values())
    candidates = [law for law in names if led[law] == most]
    lowest = [scores.laws[scores.leading[j][0]].rmse[j] for j in joints]
    above = {
        law: max(
            rmse / max(least, 1e-300)
            for j, rmse, least in zip(joints, scores.laws[law].rmse, lowest, strict=True)
            if law in scores.leading[j]
        )
        for law in candidates
    }
    close = [law for law in candidates if above[law] <= CLOSE]
    within = f"within {100 * (CLOSE - 1):.0f} % of the lowest error of each joint"
    if len(candidates) == 1:
        law, rule = candidates[0], ", which holds for this law alone"
    elif not close:
        law = min(candidates, key=lambda name: above[name])
        rule = f"; of {len(candidates)} such laws its error is nearest to the lowest of each joint"
    elif len(close) == 1:
        law, rule = close[0], f"; of {len(candidates)} such laws it alone is {within}"
    else:
        law = min(close, key=lambda name: (*simplicity(models[name]), above[name]))
        inputs = inputs_of(models[law])
        rule = f"; of the {len(close)} such laws {within} it is the simplest (inputs {inputs})"
    where = f"on {most} of {len(joints)} joints no other law is significantly better"
    if most < len(joints):
        where += f"; no law leads on all joints ({_better(scores, law)})"
    return law, f"{where}{rule}."


def simplicity(model: FrictionModel) -> tuple[int, int, int]:
    """Return numbers of inputs, states and coefficients, the largest of all joints."""
    states = max(len(law.start) for law in model.laws)
    return inputs_of(model).count(",") + 1, states, max(len(law.values) for law in model.laws)


def _mean(errors: Sequence[float], sizes: Sequence[float]) -> float:
    return float(np.mean(np.divide(errors, np.maximum(sizes, 1e-300))))


def _better(scores: Comparison, law: str) -> str:
    return ", ".join(
        f"{title(leading[0])} is better on {short}"
        for short, leading in zip(short_names(len(scores.joints)), scores.leading, strict=True)
        if law not in leading
    )


def percent_above(low: float, high: float) -> str:
    """Return a range of ratios as percentages above 1."""
    first, last = f"{100 * (low - 1):.0f}", f"{100 * (high - 1):.0f}"
    return f"{first} %" if first == last else f"{first} to {last} %"


def limits(test: str, law: str, joints: Sequence[Separation]) -> Iterator[str]:
    """Yield sentences on the limits of a test of a law."""
    short = short_names(len(joints))
    if all(one.detectable is None for one in joints):
        if any(one.tied for one in joints):
            seconds = max(one.seconds for one in joints)
            yield f"{test} is too short to compare laws; record at least {seconds:.0f} s."
        return
    parts = []
    for name, one in zip(short, joints, strict=True):
        others = {one.best, *one.tied} - {law}
        if one.detectable is not None and others and law in (one.best, *one.tied):
            laws = f"{len(others)} law{'s' if len(others) > 1 else ''}"
            parts.append(f"{laws} on {name} ({percent_above(*one.detectable)})")
    if parts:
        longest = max(one.seconds for one in joints)
        yield (
            f"{test} does not separate it from {', '.join(parts)}; in brackets the smallest "
            "differences that would show."
        )
        yield f"To find {100 * (RECORDED - 1):.0f} %, record tests of about {longest:.0f} s."


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
    if law in properties and (failed := properties[law].failed):
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
