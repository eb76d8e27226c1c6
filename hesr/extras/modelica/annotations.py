"""Documentation of a Modelica package: equations, provenance and audit.

Browsers in modelling tools are often old: plain HTML in ASCII, without style or MathML.
"""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fmu_src.friction.friction_component import exposed
from fmu_src.friction.reference import UNKNOWN_SPEED
from fmu_src.pages import datasheet
from fmu_src.pages.datasheet import figure, spelled
from fmu_src.pages.friction_page import title, training
from fmu_src.pages.html import rendered
from hesr_model.audit.audit import Audit
from hesr_model.friction.equation import coefficient_lines
from hesr_model.friction.equation import equations as equations_with_numbers
from hesr_model.friction.inputs import INPUT_UNITS
from hesr_model.friction.model import FrictionModel

TEMPLATES = Path(__file__).parent / "templates"


def package_html(
    model: FrictionModel, joints: Sequence[Mapping[str, Any]], audits: Sequence[Audit], refused: str
) -> str:
    """Return the documentation of the package; without audits, `refused` is the reason."""
    return _page(
        "modelica.html.j2",
        model=model,
        joints=joints,
        version=version("hesr"),
        euler=any(law.discretisation == "euler" for law in model.laws),
        jumps=[joint["name"] for joint in joints if joint["jumps"]],
        training=training(model.provenance),
        speed=UNKNOWN_SPEED,
        audit=datasheet.audit_rows(audits),
        refused=refused,
    )


def joint_html(model: FrictionModel, index: int, audit: Audit | None) -> str:
    """Return the documentation of the law of joint `index`, from 0."""
    law = model.laws[index]
    seen = model.trained[index] if model.trained else None
    return _page(
        "modelica_joint.html.j2",
        joint=model.joints[index],
        title=title(law, ""),
        numbers=equations_with_numbers(law) if exposed(law) else [],
        intervals=coefficient_lines(law) if law.standard_errors else [],
        start_samples=law.start_samples,
        seen=[
            f"{name} {spelled(getattr(seen, name))} {unit}"
            for name, unit in (INPUT_UNITS if seen else {}).items()
        ],
        rmse=figure(model.training_rmse[index], 3) if model.training_rmse else None,
        verdict=datasheet.verdict(audit, known=bool(model.trained)) if audit else "",
    )


def _page(template: str, **values: Any) -> str:
    page = rendered(template, (TEMPLATES,), **values)
    return f"<html>\n{page}</html>".encode("ascii", "xmlcharrefreplace").decode("ascii")
