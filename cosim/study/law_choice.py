"""Choice of the recommended laws of a run, in numbers and in sentences."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from cosim.report.tables.table import joints as short_names
from cosim.report.tables.table import title
from cosim.study.scores import transpose_records
from hesr_model.audit.certificate import has_proof
from hesr_model.fitting.estimator import estimator, select_laws
from hesr_model.fitting.fit import fit_models
from hesr_model.fitting.left_out import judge_laws
from hesr_model.friction.model import FrictionModel, can_share_fmu, mix_models
from hesr_model.inference.choice import (
    CHOOSE,
    CONSTANT,
    NONE,
    PLAIN,
    Choice,
    JointChoice,
    choose_laws,
)
from hesr_model.inference.folds import split_into_folds
from hesr_model.inference.left_out import LeftOutErrors
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.choice import identify_without
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import motion_records
from hesr_model.robots.robot import Robot
from hesr_model.support.progress import Stages, silent

_ROWS = "left-out rows"


def choose_from_models(models: Mapping[str, FrictionModel], errors: LeftOutErrors) -> Choice:
    """Return the choice among fitted models by their errors on left-out rows."""

    @cache
    def is_proven(law_name: str, j: int) -> bool:
        return has_proof(models[law_name].laws[j])

    def can_join(law_name: str, other: str) -> bool:
        return can_share_fmu(models[law_name], models[other])

    # A law that can be fitted without each fold may still fail on all rows.
    fitted = {name: values for name, values in errors.errors.items() if name in models}
    return choose_laws(replace(errors, errors=fitted), is_proven=is_proven, can_join=can_join)


def state_rule(choice: Choice) -> str:
    """Return why a choice was made, as the end of a sentence."""
    if all(joint_choice.reason == "short" for joint_choice in choice.joints):
        return "the logs are too short to judge laws."
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


def describe_choice(choice: Choice) -> Iterator[str]:
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


def _describe_class(choice: Choice, members: Sequence[JointChoice]) -> str:
    """Return the sentence of joints that differ only in their figures."""
    first = members[0]
    law_title = title(first.law_name)
    plain = title(PLAIN)
    if first.reason == "short":
        is_alone = all(joint_choice.reason == "short" for joint_choice in choice.joints)
        role = "" if is_alone else ", the law of all joints,"
        return f"too little motion to judge laws; {law_title}{role} is used."
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
            f"{title(first.replaced)} explodes on a left-out part ({worst:.2g} times the error of "
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


def _format_seconds(choice: Choice) -> str:
    return f"{choice.seconds:.0f} s" if choice.seconds >= 10.0 else f"{choice.seconds:.2g} s"


def _format_ratios(members: Sequence[JointChoice]) -> str:
    """Return the ratio of one joint with its interval, or the range of the ratios of several."""
    ratios = [one.ratio for one in members if one.ratio is not None]
    if len(members) == 1:
        return f"{members[0].ratio:.2f} ({members[0].low:.2f} to {members[0].high:.2f})"
    low, high = f"{min(ratios):.2f}", f"{max(ratios):.2f}"
    return low if low == high else f"{low} to {high}"


def fit_chosen_laws(
    motions: Sequence[Motion],
    robot: Robot,
    body: RigidBody,
    *,
    identifies_body: bool,
    seed: int = 0,
    provenance: Mapping[str, Any] | None = None,
    progress: Stages = silent,
) -> tuple[FrictionModel, Choice]:
    """Fit the proposed laws, choose by left-out rows, and return the chosen model.

    Parameters
    ----------
    motions : smoothed logs.
    body : rigid body of all of them.
    identifies_body : whether the body was identified from these motions, so that each fold needs
        one of its own.
    """
    folds = split_into_folds(motions)
    bodies = [identify_without(fold, robot, body) if identifies_body else body for fold in folds]
    laws = [
        law_name
        for law_name in select_laws("proposed")
        if all(getattr(robot.description, need) is not None for need in estimator(law_name).needs)
    ]
    errors = judge_laws(
        laws,
        motions,
        robot,
        folds,
        bodies,
        seed=seed,
        progress=partial(progress, "judging laws on left-out rows"),
    )
    records = transpose_records([motion_records(motion, robot, body) for motion in motions])
    models = fit_models(
        errors.laws,
        records,
        robot=robot.name,
        seed=seed,
        provenance=provenance,
        progress=partial(progress, "fitting laws"),
        report_left_out=lambda *_: None,
    )
    choice = choose_from_models(models, errors)
    chosen = [add_left_out_rmse(models[law_name], errors) for law_name in choice.laws]
    model = chosen[0] if len(set(choice.laws)) == 1 else mix_models(chosen)
    source = {**model.provenance, CHOOSE: list(describe_choice(choice))}
    return replace(model, provenance=source), choice


def add_left_out_rmse(model: FrictionModel, errors: LeftOutErrors) -> FrictionModel:
    """Return a model with its errors on left-out rows, if all joints have them."""
    if model.law not in errors.laws:
        return replace(model, left_out_rmse=())
    rmse = tuple(errors.rmse(model.law, j) for j in range(len(model.joints)))
    return replace(model, left_out_rmse=rmse if np.all(np.isfinite(rmse)) else ())
