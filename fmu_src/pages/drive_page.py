"""documentation/index.html of the FMUs of drives and plants."""

from dataclasses import replace
from typing import Any

import numpy as np

from fmu_src.export.description import Description
from fmu_src.export.interface import Interface
from fmu_src.pages import datasheet
from fmu_src.pages.datasheet import figure
from fmu_src.pages.friction_page import title
from fmu_src.pages.html import rendered
from fmu_src.pages.mathml import equations
from hesr_model.friction.inputs import TAU_LOAD
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.support.arrays import Array

_CRAWL, _LONG = 1e-9, 1e12
"""Speed [rad/s] and duration [s] of the crawling motion that reveals the torque held at rest."""
_HOLDS = 0.01  # [N.m]; less counts as zero


def to_html(
    model: FrictionModel, table: Interface, about: Description, template: str = "drive.html.j2"
) -> str:
    """Return the page as one self-contained file."""
    joints, refused = law_entries(model)
    pairs = zip(model.joints, model.laws, strict=True)
    return rendered(
        template,
        about=about,
        model=model,
        exchange=table.model_exchange,
        titles=list(dict.fromkeys(title(law) for law in model.laws)),
        substep=table.variables[table.places["substep"]].start,
        discretisation=model.laws[0].discretisation,
        loaded=[name for name, law in pairs if TAU_LOAD in law.form.inputs],
        joints=joints,
        refused=refused,
    )


def law_entries(model: FrictionModel) -> tuple[list[dict[str, Any]], str]:
    """Return a page's entry for each joint's law, and the reason for a missing audit or ""."""
    audits, refused = datasheet.audited(model)
    verdicts = [datasheet.verdict(a, known=bool(model.trained)) for a in audits]
    verdicts = verdicts or [""] * len(model.laws)
    rows = zip(model.joints, model.laws, model.slides, verdicts, strict=True)
    joints: list[dict[str, Any]] = [
        {
            "name": name,
            "equations": equations(law),
            "rest": _rest(law, slides=slides),
            "verdict": verdict,
        }
        for name, law, slides, verdict in rows
    ]
    return joints, refused


def holding_torque(law: FrictionLaw) -> float:
    """Return the largest torque [N.m] that a law holds at rest, without load.

    It is half the change of torque between steady crawling in both directions, and 0 for a law that
    forgets at rest.
    """
    return float(_sliding(law, np.array([_CRAWL]))[0])


def stopping_torque(law: FrictionLaw) -> float:
    """Return the least friction torque [N.m] over all speeds, below which no motion lasts."""
    return float(np.min(_sliding(law, np.geomspace(_CRAWL, 1.0, 200))))


def _sliding(law: FrictionLaw, speeds: Array) -> Array:
    """Return the friction torque in steady sliding at speeds [rad/s], without offset."""
    settled = replace(law, discretisation="exact")
    # The first row has no previous step.
    both = np.concatenate([[0.0], speeds, -speeds])
    tau = predict(settled, t=_LONG * np.arange(len(both)), dq=both)[1:]
    return np.asarray(0.5 * (tau[: len(speeds)] - tau[len(speeds) :]))


def _rest(law: FrictionLaw, *, slides: bool) -> str:
    effort, unit = ("force", "N") if slides else ("torque", "N.m")
    with np.errstate(all="ignore"):  # non-finite values hold nothing
        held, stopped = holding_torque(law), stopping_torque(law)
    if held > _HOLDS:
        return (
            f"At rest this law holds up to {figure(held, 3)} {unit} without load; a {effort} "
            f"below {figure(max(stopped, 0.0), 3)} {unit} lets no motion last."
        )
    return (
        "At rest this law holds nothing: it forgets where it came to rest, and the joint creeps "
        f"under any {effort}."
    )
