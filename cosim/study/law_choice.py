"""Choice of the recommended laws of a run."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from cosim.study.verdict import describe_choice
from hesr_model.audit.certificate import has_proof
from hesr_model.fitting.calibration import recalibrate_band
from hesr_model.fitting.estimator import estimator, select_laws
from hesr_model.fitting.fit import fit_models
from hesr_model.fitting.left_out import judge_laws
from hesr_model.friction.band import find_rest_speed
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel, can_share_fmu, mix_models
from hesr_model.inference.choice import CHOOSE, LawChoice, choose_laws
from hesr_model.inference.folds import split_into_folds
from hesr_model.inference.left_out import LeftOutErrors
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.choice import identify_without
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import motion_records
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Stages, silent


def choose_from_models(models: Mapping[str, FrictionModel], errors: LeftOutErrors) -> LawChoice:
    """Return the choice among fitted models by their errors on left-out rows."""

    @cache
    def is_proven(law_name: str, j: int) -> bool:
        return has_proof(models[law_name].laws[j])

    def can_join(law_name: str, other: str) -> bool:
        return can_share_fmu(models[law_name], models[other])

    # A law that can be fitted without each fold may still fail on all rows.
    fitted = {name: values for name, values in errors.errors.items() if name in models}
    return choose_laws(replace(errors, errors=fitted), is_proven=is_proven, can_join=can_join)


def fit_chosen_laws(
    motions: Sequence[Motion],
    robot: Robot,
    body: RigidBody,
    *,
    identifies_body: bool,
    laws: Sequence[str] = (),
    seed: int = 0,
    provenance: Mapping[str, Any] | None = None,
    progress: Stages = silent,
) -> tuple[FrictionModel, LawChoice]:
    """Fit laws, choose by left-out rows, and return the chosen model.

    Parameters
    ----------
    motions : smoothed logs.
    body : rigid body of all of them.
    identifies_body : whether the body was identified from these motions, so that each fold needs
        one of its own.
    laws : names of the laws; by default the proposed ones.
    """
    folds = split_into_folds(motions)
    bodies = [body] * len(folds)
    if identifies_body:
        bodies = [identify_without(fold, robot, body) for fold in folds]

    def can_fit(law_name: str) -> bool:
        needs = estimator(law_name).needs
        return all(getattr(robot.description, need) is not None for need in needs)

    errors = judge_laws(
        list(filter(can_fit, laws or select_laws("proposed"))),
        motions,
        robot,
        folds,
        bodies,
        seed=seed,
        progress=partial(progress, "judging laws on left-out rows"),
    )
    records_by_log = [motion_records(motion, robot, body) for motion in motions]
    records = [list(joint_records) for joint_records in zip(*records_by_log, strict=True)]
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
    chosen = [add_left_out_errors(models[law_name], errors) for law_name in choice.laws]
    model = chosen[0]
    if len(set(choice.laws)) > 1:
        model = mix_models(chosen)
    source = {**model.provenance, CHOOSE: list(describe_choice(choice))}
    return replace(model, provenance=source), choice


def add_left_out_errors(model: FrictionModel, errors: LeftOutErrors) -> FrictionModel:
    """Return a model with its errors on left-out rows, if all joints have them, and their bands."""
    if model.law not in errors.laws:
        return replace(model, left_out_rmse=())
    laws = tuple(_recalibrate_law(law, model.law, errors, j) for j, law in enumerate(model.laws))
    rmse = tuple(errors.rmse(model.law, j) for j in range(len(model.joints)))
    if not np.all(np.isfinite(rmse)):
        rmse = ()
    return replace(model, laws=laws, left_out_rmse=rmse)


def _recalibrate_law(law: FrictionLaw, law_name: str, errors: LeftOutErrors, j: int) -> FrictionLaw:
    """Return a joint's law with the band of its errors on left-out rows."""
    if law.band is None or not errors.fold_counts(j):
        return law
    judged_rows = errors.judged_rows(j)

    def select_rows(signals: Sequence[Array]) -> Array:
        pairs = zip(signals, judged_rows, strict=True)
        return np.concatenate([log_signals[is_judged, j] for log_signals, is_judged in pairs])

    band = recalibrate_band(
        law.band,
        select_rows(errors.dq),
        select_rows(errors.tau_load),
        select_rows(errors.errors[law_name]),
        rest_speed=find_rest_speed(law.form.steady_speed),
    )
    return replace(law, band=band)
