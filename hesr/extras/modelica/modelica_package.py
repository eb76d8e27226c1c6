"""Modelica export of a friction model; its pages are plain ASCII HTML for old browsers."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.friction.friction_component import is_exposed, nominal
from fmu_src.friction.reference import UNKNOWN_SPEED, reference_motion
from fmu_src.friction.validity import require_exportable
from fmu_src.pages import datasheet
from fmu_src.pages.datasheet import figure, spell_interval
from fmu_src.pages.friction_page import model_title, title, training
from fmu_src.pages.html import code_templates, render_template
from hesr.extras.modelica.printer import FUNCTIONS, Equations, name_start_value, print_equations
from hesr_model.audit.audit import Audit
from hesr_model.equations.functions import sgn
from hesr_model.equations.memory import DT
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import INPUT_UNITS, INPUTS, TAU_LOAD
from hesr_model.friction.law import FrictionLaw, LawForm, coefficient_lines
from hesr_model.friction.law import equations as equations_with_numbers
from hesr_model.friction.model import FrictionModel
from hesr_model.support.files import written_whole

_KEYWORDS = """
    algorithm and annotation block break class connect connector constant constrainedby der
    discrete each else elseif elsewhen encapsulated end enumeration equation expandable extends
    external false final flow for function if import impure in initial inner input loop model not
    operator or outer output package parameter partial protected public pure record redeclare
    replaceable return stream then true type when while within
    time Real Integer Boolean String
"""
_RESERVED_WORDS = frozenset(_KEYWORDS.split())
_LIBRARIES = frozenset({"Modelica", "ModelicaServices", "Complex"})

_FREQUENCY = 0.25  # frequency of the motions in the examples and of the reference motion [Hz]

# Parameter that starts states in the steady state of the first inputs.
_STEADY_START = "steadyStart"
TEMPLATES = Path(__file__).parent / "templates"


def joint_html(model: FrictionModel, j: int, audit: Audit | None) -> str:
    """Return the documentation of the law of joint `j`, from 0."""
    law = model.laws[j]
    numbers = []
    if is_exposed(law):
        numbers = equations_with_numbers(law)
    intervals = []
    if law.standard_errors:
        intervals = coefficient_lines(law)
    trained_intervals = []
    if model.trained:
        for name, unit in INPUT_UNITS.items():
            interval = spell_interval(getattr(model.trained[j], name))
            trained_intervals.append(f"{name} {interval} {unit}")
    training_rmse = None
    if model.training_rmse:
        training_rmse = figure(model.training_rmse[j], 3)
    verdict = ""
    if audit is not None:
        verdict = datasheet.verdict(audit, is_trained=bool(model.trained))
    return _render_page(
        "modelica_joint.html.j2",
        joint=model.joints[j],
        title=title(law, ""),
        numbers=numbers,
        intervals=intervals,
        start_samples=law.start_samples,
        seen=trained_intervals,
        rmse=training_rmse,
        verdict=verdict,
    )


def _render_page(template: str, **values: Any) -> str:
    page = render_template(template, (TEMPLATES,), **values)
    return f"<html>\n{page}</html>".encode("ascii", "xmlcharrefreplace").decode("ascii")


def export_modelica(model: FrictionModel, path: Path) -> Path:
    """Write a friction model as a Modelica package NAME.mo, for the Modelica Standard Library 4.0.

    It has a block and a bearing per joint, and examples.
    """
    if path.suffix != ".mo":
        raise ExportError(f"{path}: a Modelica package ends in .mo, found '{path.suffix}'.")
    oddity = _find_oddity(path.stem, _RESERVED_WORDS | _LIBRARIES)
    if oddity:
        raise ExportError(
            f"{path}: the package name '{path.stem}' is {oddity}; start with a letter, then use "
            "letters, digits and underscores."
        )
    text = package(model, path.stem)
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return path


def package(model: FrictionModel, package_name: str) -> str:
    """Return the text of the package."""
    for joint, is_prismatic in zip(model.joints, model.slides, strict=True):
        if is_prismatic:
            raise ExportError(
                f"Modelica: joint '{joint}' is prismatic, which the package does not support; "
                "export a friction FMU."
            )
    require_exportable(model, "a Modelica package", coupled=False)
    environment = code_templates(
        TEMPLATES,
        block_start_string="<%",
        block_end_string="%>",
        variable_start_string="<<",
        variable_end_string=">>",
        comment_start_string="<#",
        comment_end_string="#>",
    )
    escapes = str.maketrans({"\\": r"\\", '"': r"\""})
    environment.filters["quoted"] = lambda text: f'"{text.translate(escapes)}"'
    laws = _name_forms(model.laws)
    forms = [_describe_form(form_name, law) for form_name, law in laws.items()]
    form_names = {law.form: form_name for form_name, law in laws.items()}
    audits, refusal = datasheet.audit_laws(model)
    joints = _describe_joints(model, form_names, audits)
    documentation = _render_page(
        "modelica.html.j2",
        model=model,
        law=model_title(model),
        joints=joints,
        version=version("hesr"),
        euler=any(law.discretisation == "euler" for law in model.laws),
        jumps=[joint["name"] for joint in joints if joint["jumps"]],
        training=training(model.provenance),
        speed=UNKNOWN_SPEED,
        audit=datasheet.audit_rows(audits),
        refused=refusal,  # the reason, without audits
    )
    return environment.get_template("modelica.mo.j2").render(
        name=package_name,
        title=f"Friction of {model.robot} by {model_title(model)}",
        forms=forms,
        joints=joints,
        frequency=_FREQUENCY,
        info=documentation,
    )


def _find_oddity(name: str, reserved: frozenset[str]) -> str:
    """Return why Modelica does not take a name; empty if it does."""
    if name in reserved:
        return "taken by Modelica"
    if not (name.isascii() and name.isidentifier()):
        return "not a valid name in Modelica"
    return ""


def _name_forms(laws: Sequence[FrictionLaw]) -> dict[str, FrictionLaw]:
    """Return the first law of each form by the name of its block, numbered if it is not unique."""
    first_laws: dict[LawForm, FrictionLaw] = {}
    for law in laws:
        first_laws.setdefault(law.form, law)
    counts = Counter(_build_block_name(law.name) for law in first_laws.values())
    laws_by_name = {}
    numbers: Counter[str] = Counter()
    for law in first_laws.values():
        name = _build_block_name(law.name)
        numbers[name] += 1
        if counts[name] > 1:
            name = f"{name}_{numbers[name]}"
        laws_by_name[name] = law
    return laws_by_name


def _build_block_name(law_name: str) -> str:
    """Return the name of a law in camel case, and with "Law" in front if Modelica needs it."""
    words = re.findall(r"[A-Za-z0-9]+", law_name)
    name = "".join(word.capitalize() for word in words)
    if not name[:1].isalpha() or name in _RESERVED_WORDS | _LIBRARIES:
        return f"Law{name}"
    return name


def _describe_form(name: str, law: FrictionLaw) -> dict[str, Any]:
    form = law.form
    equations = print_equations(form)
    _require_names(law, equations)
    steady = ""
    if equations.beginning:
        steady = _STEADY_START
    coefficients = [
        (coefficient.name, coefficient.unit, coefficient.description)
        for coefficient in form.coefficients
    ]
    start_values = [
        (name_start_value(element.name), element.unit, f"Start value of {element.name}")
        for element in form.memory
    ]
    return {
        "name": name,
        "title": f"Equations of {title(law)}",
        "parameters": [*coefficients, *start_values],
        "states": [(element.name, element.unit) for element in form.memory],
        "equations": equations,
        "steady": steady,
        "moving": f"{form.steady_speed:g}",
    }


def _require_names(law: FrictionLaw, equations: Equations) -> None:
    """Raise ExportError unless the names of a law are distinct, and Modelica takes them."""
    used_names = {quantity.name for quantity in INPUTS}
    used_names |= {"tau", _STEADY_START}
    names = [*law.values, *equations.signs]
    for element in law.form.memory:
        names += [element.name, name_start_value(element.name)]
    for name in names:
        oddity = _find_oddity(name, _RESERVED_WORDS | set(FUNCTIONS))
        if name in used_names:
            oddity = "used twice"
        if oddity:
            raise ExportError(
                f"law '{law.name}': the name '{name}' is {oddity}; use distinct names of letters, "
                "digits and underscores."
            )
        used_names.add(name)


def _describe_joints(
    model: FrictionModel, names: Mapping[LawForm, str], audits: Sequence[Audit]
) -> list[dict[str, Any]]:
    """Return the values of each joint for the template; without `audits` it has no torque."""
    motion = reference_motion(model, frequency=_FREQUENCY)
    joint_entries = []
    for j, law in enumerate(model.laws):
        audit = None
        largest_torque = 0.0
        if audits:
            audit = audits[j]
            largest_torque = audit.largest
        speed = float(np.abs(motion.dq[:, j]).max())
        has_jumps = _has_jumps(law.form)
        # The torque overcomes the friction; the inertia keeps the speed near the trained ones.
        torque = ""
        if largest_torque and not has_jumps:
            torque = f"{1.5 * largest_torque:.4g}"
        inertia = largest_torque / (2.0 * np.pi * _FREQUENCY * speed)
        entry = {
            "name": f"Joint{j + 1}",
            "label": model.joints[j],
            "title": f"Friction of {model.joints[j]}",
            "form": names[law.form],
            "modifications": _list_modifications(law),
            "info": joint_html(model, j, audit),
            "jumps": has_jumps,
            "uses_load": TAU_LOAD in law.form.inputs,
            "load": f"{motion.tau_load[:, j].mean():.4g}",
            "speed": f"{speed:.4g}",
            "torque": torque,
            "inertia": f"{inertia:.4g}",
        }
        joint_entries.append(entry)
    return joint_entries


def _has_jumps(form: LawForm) -> bool:
    """Return whether the torque or the equation of a state jumps with a sign."""
    expressions = [form.output.subs(DT, 0)]
    for element in form.memory:
        expressions += element.parts
    return any(expression.has(sgn) for expression in expressions)


def _list_modifications(law: FrictionLaw) -> list[str]:
    values = [f"{name}={value!r}" for name, value in law.values.items()]
    for element, start in zip(law.form.memory, law.start, strict=True):
        values.append(f"{name_start_value(element.name)}={start!r}")
        values.append(f"{element.name}(nominal={nominal(law, element):g})")
    return values
