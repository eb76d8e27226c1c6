"""Verdict of a run: the recommended FMU, its weaknesses, and helpful data."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.report.tables.table import join_law_titles, title
from cosim.report.tables.table import joints as short_names
from cosim.study.forecast import Forecast
from cosim.study.scores import (
    RECORDED,
    Comparison,
    LawScores,
    Unseparated,
    find_unseparated,
)
from cosim.study.study import LEFT_OUT
from fmu_src.friction.predictions import Records
from hesr_model.audit.properties import Properties, combine_results
from hesr_model.forward.output_error import RefinementResult
from hesr_model.friction.inputs import TAU_LOAD
from hesr_model.friction.model import MIXED, FrictionModel
from hesr_model.friction.trained_range import TrainedRange, find_excess
from hesr_model.inference.choice import CONSTANT, NONE, PLAIN, JointChoice, LawChoice
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import find_resting_speed, transform_all_records
from hesr_model.robots.description import statements
from hesr_model.support.text import count_noun
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
_FASTER = "the test is faster than the training logs; record faster motion."
_HEAVIER = "the load of the test exceeds the training logs; record larger loads."
_RESTING = "hardly any standstill in the training logs; record rests."
_CONSTANT_LOAD = (
    "the load hardly changes; record a log with a payload to model load-dependent friction."
)
_ADVICE = (_FASTER, _HEAVIER, _RESTING, _CONSTANT_LOAD)  # in the order of the verdict


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
        best = min(errors, key=errors.__getitem__)
        improved = [law_name for law_name, refinement in refined.items() if refinement.ratio < 1.0]
        return cls(law=best, fmu=f"fmus/{best}.fmu", errors=errors, refined=tuple(improved))

    def sentence(self, feed_forward: str) -> str:
        """Return the recommendation, next to that for feed-forward."""
        ratio = self.errors[self.law] / self.errors.get(feed_forward, self.errors[self.law])
        compared = ""
        if ratio < 1.0:
            compared = f", {ratio:.2f} times that of {title(feed_forward)}"
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
        sentences = [
            f"Recommended: {self.fmu} ({join_law_titles(self.laws)}), for feed-forward: {self.why}"
        ]
        if self.simulation:
            sentences.append(self.simulation.sentence(self.law))
        if self.choice:
            sentences += describe_choice(self.choice)
        sentences += [*self.constants, *self.limits]
        if self.has_test:
            joint_names = short_names(len(self.unexplained))
            shares = zip(joint_names, self.unexplained.values(), strict=True)
            shares_text = ", ".join(f"{joint} {share:.0f} %" for joint, share in shares)
            sentences.append(f"Unexplained friction on '{self.test}': {shares_text}.")
        sentences += [*self.weak, *self.improve]
        if self.planned:
            sentences.append(self.planned)
        return tuple(sentences)


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
    law_scores = comparison.combine_scores(laws)
    shares = comparison.unexplained_shares(law_scores.rmse)
    percent = {joint: 100.0 * share for joint, share in zip(comparison.joints, shares, strict=True)}
    joints = tuple(find_separations(comparison, laws))
    planned = ""
    if expected:
        named_joints = zip(comparison.joints, joints, strict=True)
        detectable_ratios = {
            name: separation.detectable[1]
            for name, separation in named_joints
            if separation.detectable
        }
        planned = expected.sentence(models, detectable_ratios)
    checks = combine_results(recommended, properties, laws)
    weaknesses = _list_weaknesses(law_scores, percent, checks)
    first_model = models[laws[0]]
    improvements = list(
        _list_improvements(first_model, trained_records, tested_records, gear_ratio=gear_ratio)
    )
    if may_refine:
        improvements += _suggest_refinement(trained_records, refined)
    limits: Iterable[str] = ()
    if test != LEFT_OUT:
        limits = describe_limits(f"'{test}'", joints)
    return Verdict(
        law=recommended,
        planned=planned,
        fmu=f"fmus/{recommended}.fmu",
        test=test,
        why=state_rule(choice),
        unexplained=percent,
        weak=tuple(weaknesses),
        improve=tuple(improvements),
        simulation=ForSimulation.from_refined(refined or {}),
        joints=joints,
        choice=choice,
        limits=tuple(limits),
        constants=tuple(statements(first_model.provenance)),
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
        joint_choices = [joint_choice for _, joint_choice in members]
        yield f"{joint_names}: {_describe_class(choice, joint_choices)}"
    if any(joint_choice.reason != "short" for joint_choice in choice.joints):
        yield (
            f"Laws are judged on {choice.fold_count} parts of the logs, {_format_seconds(choice)} "
            "in all, each left out in turn, and fitted on all of them."
        )


def _describe_class(choice: LawChoice, members: Sequence[JointChoice]) -> str:
    """Return the sentence of joints that differ only in their figures."""
    first = members[0]
    if first.reason in ("short", "unexplained", "exploded"):
        return _describe_exception(choice, members)
    law_title = title(first.law_name)
    plain_title = title(PLAIN)
    figures = _format_ratios(members)
    if first.known == "law":
        return f"{law_title}, {figures} of the error of {plain_title} on {_ROWS}."
    if first.reason == "better":
        return f"{law_title}, better than {title(choice.base)} on {_ROWS} by two standard errors."
    if first.law_name == PLAIN:
        return f"{law_title}; the best other law is not better on {_ROWS} by two standard errors."
    use = "it is used nevertheless"
    if len(choice.joints) > 1:
        use = "the law of all joints"
    if is_worse(first):
        return f"{law_title} has {figures} of the error of {plain_title}; {use}."
    return f"the {_ROWS} do not tell {law_title} from {plain_title}, {figures}; {use}."


def _describe_exception(choice: LawChoice, members: Sequence[JointChoice]) -> str:
    """Return the sentence of joints whose law is not that with the lowest error."""
    first = members[0]
    law_title = title(first.law_name)
    if first.reason == "short":
        role = ", the law of all joints,"
        if all(joint_choice.reason == "short" for joint_choice in choice.joints):
            role = ""
        return f"the motion does not tell laws apart; {law_title}{role} is used."
    if first.reason == "unexplained":
        prediction = f"{title(first.replaced)} does not predict better"
        if first.replaced in (CONSTANT, NONE):
            prediction = "no law predicts clearly better"
        return (
            f"{prediction} than a constant; no friction model is recommended. Record motion that "
            "reverses at several speeds."
        )
    worst = max(joint_choice.worst_fold or 0.0 for joint_choice in members)
    return (
        f"{title(first.replaced)} explodes on {_ROWS} ({worst:.2g} times the error of "
        f"{title(PLAIN)}); {law_title} is used."
    )


def is_worse(joint_choice: JointChoice) -> bool:
    """Return whether the interval of a joint's law lies above Coulomb + viscous friction."""
    return joint_choice.low is not None and joint_choice.low > 1.0


def _format_seconds(choice: LawChoice) -> str:
    if choice.seconds >= 10.0:
        return f"{choice.seconds:.0f} s"
    return f"{choice.seconds:.2g} s"


def _format_ratios(members: Sequence[JointChoice]) -> str:
    """Return the ratio of one joint with its interval, or the range of the ratios of several."""
    if len(members) == 1:
        return f"{members[0].ratio:.2f} ({members[0].low:.2f} to {members[0].high:.2f})"
    ratios = [joint_choice.ratio for joint_choice in members if joint_choice.ratio is not None]
    return _format_range(f"{min(ratios):.2f}", f"{max(ratios):.2f}")


def _format_range(lowest: str, highest: str) -> str:
    """Return the range of two formatted figures, or one of them if they look equal."""
    if lowest == highest:
        return lowest
    return f"{lowest} to {highest}"


def find_separations(comparison: Comparison, laws: Sequence[str]) -> Iterator[Separation]:
    """Yield the statements of a test about the law of each joint."""
    if not comparison.leading:
        return
    for j, law_name in enumerate(laws):
        unseparated = find_unseparated(comparison, law_name, j)
        if unseparated is None:
            unseparated = Unseparated(
                laws=(), better=(), detectable=None, seconds=comparison.seconds[j]
            )
        yield Separation(
            law=law_name,
            best=comparison.leading[j][0],
            tied=unseparated.laws,
            better=unseparated.better,
            detectable=unseparated.detectable,
            seconds=unseparated.seconds,
        )


def format_excess_percent(low: float, high: float) -> str:
    """Return a range of ratios as percentages above 1; all above double are one class."""
    first = f"{100 * (low - 1):.0f}"
    last = f"{100 * (high - 1):.0f}"
    if low > 2.0:
        return "more than 100 %"
    if high > 2.0:
        return f"{first} to more than 100 %"
    return f"{_format_range(first, last)} %"


def _format_count(low: int, high: int) -> str:
    """Return a range of numbers of laws."""
    if low == high:
        return count_noun(low, "law")
    return f"{low} to {high} laws"


def describe_limits(test: str, joints: Sequence[Separation]) -> Iterator[str]:
    """Yield sentences on the limits of a test of each joint's law."""
    separations = dict(zip(short_names(len(joints)), joints, strict=True))
    undecided_joints = {}
    tied_joints = {}
    for name, separation in separations.items():
        if separation.tied and separation.detectable is None:
            undecided_joints[name] = separation
        elif separation.tied:
            tied_joints[name] = separation
    yield from _describe_incomparable(test, undecided_joints, joint_count=len(joints))
    if tied_joints:
        counts = [len(separation.tied) for separation in tied_joints.values()]
        ratios: list[float] = []
        for separation in tied_joints.values():
            ratios += separation.detectable or ()
        yield (
            f"{test} does not separate it from {_format_count(min(counts), max(counts))} on "
            f"{', '.join(tied_joints)}; it would show "
            f"{format_excess_percent(min(ratios), max(ratios))}."
        )
    for name, separation in separations.items():
        if separation.better:
            titles = ", ".join(map(title, separation.better[:_MAX_LISTED_LAWS]))
            yield f"On {name} {test} shows {titles} to be better."
    yield from _suggest_tests(tied_joints, joint_count=len(joints))


def _describe_incomparable(
    test: str, separations: Mapping[str, Separation], *, joint_count: int
) -> Iterator[str]:
    """Yield what to record for joints on which a test cannot compare laws."""
    short_joints = {
        name: separation.seconds
        for name, separation in separations.items()
        if separation.seconds <= _MAX_SECONDS
    }
    if short_joints:
        place_text = _place(short_joints, joint_count)
        seconds = max(short_joints.values())
        yield f"{test} is too short to compare laws{place_text}; record at least {seconds:.0f} s."
    scattered_joints = [name for name in separations if name not in short_joints]
    if scattered_joints:
        place_text = _place(scattered_joints, joint_count)
        yield f"{test} cannot compare laws{place_text}: its logs differ too much; record more."


def _suggest_tests(separations: Mapping[str, Separation], *, joint_count: int) -> Iterator[str]:
    """Yield how long tests must be that would find `RECORDED` on joints with tied laws."""
    found_text = f"{100 * (RECORDED - 1):.0f} %"
    possible_seconds = []
    impossible_joints = []
    for name, separation in separations.items():
        if separation.detectable and separation.detectable[1] > RECORDED:
            if separation.seconds <= _MAX_SECONDS:
                possible_seconds.append(separation.seconds)
            else:
                impossible_joints.append(name)
    if possible_seconds:
        yield f"To find {found_text}, record tests of about {max(possible_seconds):.0f} s."
    if impossible_joints:
        yield f"No test of an hour would find {found_text}{_place(impossible_joints, joint_count)}."


def _place(names: Collection[str], joint_count: int) -> str:
    """Return the joints of a statement, nothing if it holds for all."""
    if len(names) == joint_count:
        return ""
    return f" on {', '.join(names)}"


def _list_weaknesses(
    law_scores: LawScores, percent: Mapping[str, float], checks: Properties | None
) -> Iterable[str]:
    """Yield where the recommended laws are poor: joints, reversals, and physics checks."""
    poor_joints = []
    reversal_joints = []
    joint_names = short_names(len(percent))
    for j, (name, share) in enumerate(zip(joint_names, percent.values(), strict=True)):
        if share > _MAX_UNEXPLAINED:
            poor_joints.append(name)
        reversal_error = law_scores.rmse_reversal[j]
        if reversal_error is None:
            continue
        if reversal_error > _MAX_REVERSAL_RATIO * law_scores.rmse[j]:
            reversal_joints.append(name)
    if poor_joints:
        yield (
            f"Poorly modelled: {', '.join(poor_joints)} (more than {_MAX_UNEXPLAINED:g} % of "
            "friction unexplained)."
        )
    if reversal_joints:
        yield f"Large errors near reversals: {', '.join(reversal_joints)}."
    if checks and (failed := checks.failed):
        yield f"Physics checks it fails on at least one joint: {', '.join(failed)}."


def _list_improvements(
    model: FrictionModel, trained_records: Records, tested_records: Records, *, gear_ratio: bool
) -> Iterable[str]:
    """Yield what to record or to state for a better model."""
    joints_by_advice: dict[str, list[str]] = {sentence: [] for sentence in _ADVICE}
    joints = zip(
        short_names(len(trained_records)),
        model.laws,
        model.trained,
        transform_all_records(trained_records),
        transform_all_records(tested_records),
        strict=True,
    )
    for name, law, trained_range, joint_records, tested_joint_records in joints:
        has_load = TAU_LOAD in law.form.inputs
        for sentence in (
            *_advise_beyond_training(trained_range, tested_joint_records, has_load=has_load),
            *_advise_on_training(joint_records),
        ):
            joints_by_advice[sentence].append(name)
    for sentence, names in joints_by_advice.items():
        if names:
            yield f"{', '.join(names)}: {sentence}"
    if not gear_ratio and not all(model.slides):  # ripple follows the turns of a motor
        yield "Add gear_ratio to the robot file to also fit motor ripple."


def _advise_beyond_training(
    trained_range: TrainedRange, tested_records: Sequence[FrictionRecord], *, has_load: bool
) -> Iterator[str]:
    """Yield advice on inputs of a joint's law that the test takes beyond the training logs."""
    excesses = find_excess(trained_range, tested_records)
    if "dq" in excesses and excesses["dq"].rows > _MAX_UNTRAINED_SHARE:
        yield _FASTER
    if has_load and "tau_load" in excesses and excesses["tau_load"].rows > _MAX_UNTRAINED_SHARE:
        yield _HEAVIER


def _advise_on_training(joint_records: Sequence[FrictionRecord]) -> Iterator[str]:
    """Yield advice on what the training logs of a joint lack."""
    dq = np.concatenate([record.dq for record in joint_records])
    tau = np.concatenate([record.tau for record in joint_records])
    tau_load = np.concatenate([record.tau_load for record in joint_records])
    if np.mean(np.abs(dq) < find_resting_speed(joint_records)) < _MIN_REST_SHARE:
        yield _RESTING
    if np.std(tau_load) < _MIN_LOAD_SPREAD * np.std(tau):
        yield _CONSTANT_LOAD


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
