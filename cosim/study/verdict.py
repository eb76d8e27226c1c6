"""Verdict of a run: the recommended FMU, its weaknesses, and helpful data."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.report.tables.table import join_law_titles, title
from cosim.report.tables.table import joints as short_names
from cosim.study.forecast import Forecast
from cosim.study.scores import RECORDED, Comparison, LawScores, find_unseparated
from cosim.study.study import LEFT_OUT
from fmu_src.friction.predictions import Records
from hesr_model.audit.properties import Properties, combine_results
from hesr_model.forward.output_error import RefinementResult
from hesr_model.friction.inputs import TAU_LOAD
from hesr_model.friction.model import MIXED, FrictionModel
from hesr_model.friction.trained_range import find_excess
from hesr_model.inference.choice import CONSTANT, NONE, PLAIN, JointChoice, LawChoice
from hesr_model.rigid_body.residual import find_resting_speed, transform_all_records
from hesr_model.robots.description import statements
from hesr_model.support.typed_files import from_json, read_json, to_json, write_json

VERDICT = "verdict.json"
VERDICT_FORMAT = "hesr-verdict-1"

_ROWS = LEFT_OUT
_MAX_LISTED_LAWS = 3
_MAX_SECONDS = 3600.0  # of a test that anyone would record
_MAX_UNEXPLAINED = 25.0  # [%] of friction unexplained
_MAX_REVERSAL_RATIO = 1.5  # error near reversals over that of all rows
_MAX_UNTRAINED_SHARE = 0.02  # share of test rows outside the trained speeds
_MIN_REST_SHARE = 0.02  # share of training rows at rest that shows stiction
_MIN_LOAD_SPREAD = 0.5  # spread of the load over that of friction


@dataclass(frozen=True, kw_only=True)
class Separation:
    """Laws that a test does not separate from that of a joint (`tied`), and those `better`.

    The test would find errors of `detectable` times that of the law: the smallest and the largest
    such ratio of the tied laws, None for a short test. `best` has the lowest error.
    """

    best: str
    tied: tuple[str, ...]
    detectable: tuple[float, float] | None
    seconds: float  # [s] test that would find `RECORDED`
    law: str = ""  # recommended; empty in earlier versions
    better: tuple[str, ...] = ()  # significantly


@dataclass(frozen=True, kw_only=True)
class ForSimulation:
    """Law for simulation, by its position errors on left-out windows of the training logs."""

    law: str
    fmu: str  # path in the folder of results
    errors: Mapping[str, float]  # geometric mean by law [rad; m]
    refined: tuple[str, ...]  # laws that output error improved

    @classmethod
    def from_refined(cls, refined: Mapping[str, RefinementResult]) -> "ForSimulation | None":
        """Return the law with the lowest error; None without windows."""
        errors = {
            law_name: refinement.size
            for law_name, refinement in refined.items()
            if np.isfinite(refinement.size)
        }
        if not errors:
            return None
        law_name = min(errors, key=errors.__getitem__)
        improved = tuple(
            law_name for law_name, refinement in refined.items() if refinement.ratio < 1.0
        )
        return cls(law=law_name, fmu=f"fmus/{law_name}.fmu", errors=errors, refined=improved)

    def sentence(self, feed_forward: str) -> str:
        """Return the recommendation, next to that for feed-forward."""
        ratio = self.errors[self.law] / self.errors.get(feed_forward, self.errors[self.law])
        compared = f", {ratio:.2f} times that of {title(feed_forward)}" if ratio < 1.0 else ""
        return (
            f"Recommended for simulation: {self.fmu} ({title(self.law)}): it has the lowest "
            f"position error on left-out windows of the training logs{compared}; output error "
            f"improved {len(self.refined)} of {len(self.errors)} laws."
        )


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Verdict of a run in sentences."""

    law: str  # `MIXED` if joints have different laws
    fmu: str  # path in the folder of results
    test: str  # first test set
    why: str
    unexplained: Mapping[str, float]  # error over the size of friction by joint [%]
    weak: tuple[str, ...]
    improve: tuple[str, ...]
    joints: tuple[Separation, ...] = ()  # empty in earlier versions
    choice: LawChoice | None = None  # None in earlier versions
    limits: tuple[str, ...] = ()  # of the test
    constants: tuple[str, ...] = ()  # of the robot, with sources
    planned: str = ""  # comparison with the plan of the motion
    simulation: ForSimulation | None = None  # if the study refines by output error

    @property
    def has_test(self) -> bool:
        """Whether the run has a test set in addition to the left-out rows of the training logs."""
        return self.test != LEFT_OUT

    @property
    def laws(self) -> tuple[str, ...]:
        """Recommended law of each joint."""
        laws = tuple(joint_separation.law or self.law for joint_separation in self.joints)
        return laws or (self.law,) * len(self.unexplained)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in sentences."""
        shares = zip(short_names(len(self.unexplained)), self.unexplained.values(), strict=True)
        shares_text = ", ".join(f"{joint} {share:.0f} %" for joint, share in shares)
        return (
            f"Recommended: {self.fmu} ({join_law_titles(self.laws)}), for feed-forward: {self.why}",
            *([self.simulation.sentence(self.law)] if self.simulation else []),
            *(describe_choice(self.choice) if self.choice else []),
            *self.constants,
            *self.limits,
            *([f"Unexplained friction on '{self.test}': {shares_text}."] * self.has_test),
            *self.weak,
            *self.improve,
            *filter(None, [self.planned]),
        )


def judge_run(
    comparisons: Mapping[str, Comparison],
    models: Mapping[str, FrictionModel],
    choice: LawChoice,
    trained_records: Records,
    tested_records: Records,
    properties: Mapping[str, Properties],
    *,
    gear_ratio: bool,
    expected: Forecast | None = None,
    refined: Mapping[str, RefinementResult] | None = None,
    may_refine: bool = True,
) -> Verdict:
    """Judge a run by its choice of laws and its first test set; records are [joint][log].

    `refined` are the laws refined by output error, None if the study does not refine. A run that
    never refines has `may_refine` false.
    """
    test, comparison = next(iter(comparisons.items()))
    laws = choice.laws
    recommended = laws[0] if len(set(laws)) == 1 else MIXED
    shares = comparison.unexplained_shares(comparison.combine_scores(laws).rmse)
    percent = {joint: 100.0 * share for joint, share in zip(comparison.joints, shares, strict=True)}
    joints = tuple(find_separations(comparison, laws))
    named_joints = zip(comparison.joints, joints, strict=True)
    detectable_ratios = {
        name: joint_separation.detectable[1]
        for name, joint_separation in named_joints
        if joint_separation.detectable
    }
    return Verdict(
        law=recommended,
        planned=expected.sentence(models, detectable_ratios) if expected else "",
        fmu=f"fmus/{recommended}.fmu",
        test=test,
        why=state_rule(choice),
        unexplained=percent,
        weak=tuple(
            _list_weaknesses(
                comparison.combine_scores(laws),
                percent,
                combine_results(recommended, properties, laws),
            )
        ),
        improve=(
            *_list_improvements(
                models[laws[0]], trained_records, tested_records, gear_ratio=gear_ratio
            ),
            *(_suggest_refinement(trained_records, refined) if may_refine else ()),
        ),
        simulation=ForSimulation.from_refined(refined or {}),
        joints=joints,
        choice=choice,
        limits=() if test == LEFT_OUT else tuple(describe_limits(f"'{test}'", joints)),
        constants=tuple(statements(models[laws[0]].provenance)),
    )


def state_rule(choice: LawChoice) -> str:
    """Return why a choice was made, as the end of a sentence."""
    if all(joint_choice.reason == "short" for joint_choice in choice.joints):
        return "the logs do not tell laws apart."
    if choice.is_short:
        return f"logs of {_format_seconds(choice)} of one joint are too short to rank laws."
    if choice.guaranteed:
        return (
            f"its passivity is proven, and {title(choice.guaranteed)} is not better by a standard "
            f"error on {_ROWS}."
        )
    if all(joint_choice.reason == "base" for joint_choice in choice.joints):
        return f"it has the lowest mean error on {_ROWS}."
    return (
        f"{title(choice.base)} has the lowest mean error on {_ROWS}; exceptions are stated below."
    )


def describe_choice(choice: LawChoice) -> Iterator[str]:
    """Yield what the left-out rows say, one sentence for each class of joints."""
    names = short_names(len(choice.joints))
    classes: dict[tuple[str | bool, ...], list[tuple[str, JointChoice]]] = {}
    for name, joint_choice in zip(names, choice.joints, strict=True):
        key = (
            joint_choice.law_name,
            joint_choice.reason,
            joint_choice.known,
            joint_choice.replaced,
            is_worse(joint_choice),
        )
        classes.setdefault(key, []).append((name, joint_choice))
    for members in classes.values():
        joint_names = ", ".join(name for name, _ in members)
        yield f"{joint_names}: {_describe_class(choice, [one for _, one in members])}"
    if any(joint_choice.reason != "short" for joint_choice in choice.joints):
        yield (
            f"Laws are judged on {choice.fold_count} parts of the logs, {_format_seconds(choice)} "
            "in all, each left out in turn, and fitted on all of them."
        )


def _describe_class(choice: LawChoice, members: Sequence[JointChoice]) -> str:
    """Return the sentence of joints that differ only in their figures."""
    first = members[0]
    law_title = title(first.law_name)
    plain = title(PLAIN)
    if first.reason == "short":
        is_alone = all(joint_choice.reason == "short" for joint_choice in choice.joints)
        role = "" if is_alone else ", the law of all joints,"
        return f"the motion does not tell laws apart; {law_title}{role} is used."
    if first.reason == "unexplained":
        prediction = f"{title(first.replaced)} does not predict better"
        if first.replaced in (CONSTANT, NONE):
            prediction = "no law predicts clearly better"
        return (
            f"{prediction} than a constant; no friction model is recommended. Record motion that "
            "reverses at several speeds."
        )
    if first.reason == "exploded":
        worst = max(one.worst_fold or 0.0 for one in members)
        return (
            f"{title(first.replaced)} explodes on {_ROWS} ({worst:.2g} times the error of "
            f"{plain}); {law_title} is used."
        )
    figures = _format_ratios(members)
    if first.known == "law":
        return f"{law_title}, {figures} of the error of {plain} on {_ROWS}."
    if first.reason == "better":
        return f"{law_title}, better than {title(choice.base)} on {_ROWS} by two standard errors."
    use = "the law of all joints" if len(choice.joints) > 1 else "it is used nevertheless"
    if first.law_name == PLAIN:
        return f"{law_title}; the best other law is not better on {_ROWS} by two standard errors."
    if is_worse(first):
        return f"{law_title} has {figures} of the error of {plain}; {use}."
    return f"the {_ROWS} do not tell {law_title} from {plain}, {figures}; {use}."


def is_worse(joint_choice: JointChoice) -> bool:
    """Return whether the interval of a joint's law lies above Coulomb + viscous friction."""
    return joint_choice.low is not None and joint_choice.low > 1.0


def _format_seconds(choice: LawChoice) -> str:
    return f"{choice.seconds:.0f} s" if choice.seconds >= 10.0 else f"{choice.seconds:.2g} s"


def _format_ratios(members: Sequence[JointChoice]) -> str:
    """Return the ratio of one joint with its interval, or the range of the ratios of several."""
    ratios = [one.ratio for one in members if one.ratio is not None]
    if len(members) == 1:
        return f"{members[0].ratio:.2f} ({members[0].low:.2f} to {members[0].high:.2f})"
    low, high = f"{min(ratios):.2f}", f"{max(ratios):.2f}"
    return low if low == high else f"{low} to {high}"


def find_separations(comparison: Comparison, laws: Sequence[str]) -> Iterator[Separation]:
    """Yield the statements of a test about the law of each joint."""
    if not comparison.leading:
        return
    for j, law_name in enumerate(laws):
        unseparated = find_unseparated(comparison, law_name, j)
        yield Separation(
            law=law_name,
            best=comparison.leading[j][0],
            tied=unseparated.laws if unseparated else (),
            better=unseparated.better if unseparated else (),
            detectable=unseparated.detectable if unseparated else None,
            seconds=unseparated.seconds if unseparated else comparison.seconds[j],
        )


def format_excess_percent(low: float, high: float) -> str:
    """Return a range of ratios as percentages above 1; all above double are one class."""
    first = f"{100 * (low - 1):.0f}"
    last = f"{100 * (high - 1):.0f}"
    if low > 2.0:
        return "more than 100 %"
    if high > 2.0:
        return f"{first} to more than 100 %"
    return f"{first} %" if first == last else f"{first} to {last} %"


def _format_count(low: int, high: int) -> str:
    """Return a range of numbers of laws."""
    if low == high:
        return f"{low} law{'s' * (low > 1)}"
    return f"{low} to {high} laws"


def describe_limits(test: str, joints: Sequence[Separation]) -> Iterator[str]:
    """Yield sentences on the limits of a test of each joint's law."""
    joint_separations = dict(zip(short_names(len(joints)), joints, strict=True))
    undecided_joints = {
        name: joint_separation.seconds
        for name, joint_separation in joint_separations.items()
        if joint_separation.detectable is None and joint_separation.tied
    }
    short_joints = [name for name, seconds in undecided_joints.items() if seconds <= _MAX_SECONDS]
    if short_joints:
        place_text = _place(short_joints, joints)
        seconds = max(undecided_joints[name] for name in short_joints)
        yield f"{test} is too short to compare laws{place_text}; record at least {seconds:.0f} s."
    scattered_joints = [name for name in undecided_joints if name not in short_joints]
    if scattered_joints:
        place_text = _place(scattered_joints, joints)
        yield f"{test} cannot compare laws{place_text}: its logs differ too much; record more."
    tied_joints = {
        name: joint_separation
        for name, joint_separation in joint_separations.items()
        if joint_separation.detectable is not None and joint_separation.tied
    }
    if tied_joints:
        counts = [len(joint_separation.tied) for joint_separation in tied_joints.values()]
        ratios = [ratio for one in tied_joints.values() for ratio in one.detectable or ()]
        yield (
            f"{test} does not separate it from {_format_count(min(counts), max(counts))} on "
            f"{', '.join(tied_joints)}; it would show "
            f"{format_excess_percent(min(ratios), max(ratios))}."
        )
    for name, joint_separation in joint_separations.items():
        if joint_separation.better:
            titles = ", ".join(map(title, joint_separation.better[:_MAX_LISTED_LAWS]))
            yield f"On {name} {test} shows {titles} to be better."
    required_seconds = {
        name: joint_separation.seconds
        for name, joint_separation in tied_joints.items()
        if joint_separation.detectable and joint_separation.detectable[1] > RECORDED
    }
    possible_seconds = [seconds for seconds in required_seconds.values() if seconds <= _MAX_SECONDS]
    found_text = f"{100 * (RECORDED - 1):.0f} %"
    if possible_seconds:
        yield f"To find {found_text}, record tests of about {max(possible_seconds):.0f} s."
    impossible_joints = [
        name for name, seconds in required_seconds.items() if seconds > _MAX_SECONDS
    ]
    if impossible_joints:
        yield f"No test of an hour would find {found_text}{_place(impossible_joints, joints)}."


def _place(names: Sequence[str], joints: Sequence[Separation]) -> str:
    """Return the joints of a statement, nothing if it holds for all."""
    return f" on {', '.join(names)}" if len(names) < len(joints) else ""


def _list_weaknesses(
    law_scores: LawScores, percent: Mapping[str, float], checks: Properties | None
) -> Iterable[str]:
    joint_names = short_names(len(percent))
    poor_joints = [
        name
        for name, share in zip(joint_names, percent.values(), strict=True)
        if share > _MAX_UNEXPLAINED
    ]
    if poor_joints:
        yield (
            f"Poorly modelled: {', '.join(poor_joints)} (more than {_MAX_UNEXPLAINED:g} % of "
            "friction unexplained)."
        )
    pairs = zip(joint_names, law_scores.rmse_reversal, law_scores.rmse, strict=True)
    reversal_joints = [
        name
        for name, reversal_error, total_error in pairs
        if reversal_error is not None and reversal_error > _MAX_REVERSAL_RATIO * total_error
    ]
    if reversal_joints:
        yield f"Large errors near reversals: {', '.join(reversal_joints)}."
    if checks and (failed := checks.failed):
        yield f"Physics checks it fails on at least one joint: {', '.join(failed)}."


def _list_improvements(
    model: FrictionModel, trained_records: Records, tested_records: Records, *, gear_ratio: bool
) -> Iterable[str]:
    joint_names = short_names(len(trained_records))
    faster = []
    heavier = []
    resting = []
    constant_load = []
    joints = zip(
        joint_names,
        model.laws,
        model.trained,
        transform_all_records(trained_records),
        transform_all_records(tested_records),
        strict=True,
    )
    for name, law, trained_range, joint_records, tested_joint_records in joints:
        excesses = {
            input_name: excess
            for input_name, excess in find_excess(trained_range, tested_joint_records).items()
            if excess.rows > _MAX_UNTRAINED_SHARE
        }
        if "dq" in excesses:
            faster.append(name)
        if "tau_load" in excesses and TAU_LOAD in law.form.inputs:
            heavier.append(name)
        dq, load, tau = (
            np.concatenate([getattr(record, quantity) for record in joint_records])
            for quantity in ("dq", "tau_load", "tau")
        )
        if np.mean(np.abs(dq) < find_resting_speed(joint_records)) < _MIN_REST_SHARE:
            resting.append(name)
        if np.std(load) < _MIN_LOAD_SPREAD * np.std(tau):
            constant_load.append(name)
    advice = {
        "the test is faster than the training logs; record faster motion.": faster,
        "the load of the test exceeds the training logs; record larger loads.": heavier,
        "hardly any standstill in the training logs; record rests.": resting,
        "the load hardly changes; record a log with a payload to model load-dependent "
        "friction.": constant_load,
    }
    for sentence, names in advice.items():
        if names:
            yield f"{', '.join(names)}: {sentence}"
    if not gear_ratio and not all(model.slides):  # ripple follows the turns of a motor
        yield "Add gear_ratio to the robot file to also fit motor ripple."


def _suggest_refinement(
    trained_records: Records, refined: Mapping[str, RefinementResult] | None
) -> Iterator[str]:
    if refined is None and len(trained_records) == 1 and trained_records[0][0].tau_body is None:
        yield 'To choose and refine a law for simulation, add refinement = "output_error".'
    if refined and ForSimulation.from_refined(refined) is None:
        yield "The training logs are too short to choose a law for simulation by left-out windows."


def write_verdict(folder: Path, verdict: Verdict) -> None:
    """Write a verdict into a folder of results."""
    write_json(folder / VERDICT, {"format": VERDICT_FORMAT, **to_json(verdict)})


def read_verdict(folder: Path) -> Verdict | None:
    """Read a verdict; results of earlier versions have none."""
    path = folder / VERDICT
    if not path.is_file():
        return None
    return from_json(Verdict, read_json(path, VERDICT_FORMAT), path, "the verdict of a run")
