"""C export: one C99 header without FMI, allocation or other files; its test data."""

import re
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.equations.c_functions import Functions
from fmu_src.equations.header import Joint
from fmu_src.export.interface import literal
from fmu_src.export.package import read_c_source
from fmu_src.friction.friction_component import build_joints
from fmu_src.friction.reference import ReferenceMotion, reference_motion, torques
from fmu_src.friction.validity import require_exportable
from fmu_src.pages.friction_page import model_title
from fmu_src.pages.html import code_templates
from hesr_model.errors import ExportError, SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.files import written_together

TEMPLATES = Path(__file__).parent / "templates"
_ROW_COUNT = 1000
_PERIODS = 2.5
_PHASE = 0.35
_MAX_HALVINGS = 12


def write_code_and_data(path: Path, text: str, model: FrictionModel) -> Path:
    """Write a code file and its test data (.csv); both or none."""
    contents = {path: text, path.with_suffix(".csv"): reference_rows(model)}
    with written_together(path) as provide_file:
        for file_path, content in contents.items():
            provide_file(file_path).write_text(content, encoding="utf-8", newline="\n")
    return path


def reference_rows(model: FrictionModel) -> str:
    """Return the data as CSV: t, then dq[i], q[i], tau_load[i] and tau[i] of all joints.

    Row 0 is at the start of the states, which move to each further row with its inputs held. Inputs
    are exact in single precision.
    """
    motion, tau = _find_motion(model)
    names = ["t"]
    for quantity in ("dq", "q", "tau_load", "tau"):
        names += [f"{quantity}[{j + 1}]" for j in range(len(model.joints))]
    # Adding zero turns a negative zero into a positive one.
    rows = np.column_stack([motion.t, motion.dq, motion.q, motion.tau_load, tau]) + 0.0
    lines = [_format_row(row) for row in rows.tolist()]
    return "\n".join([",".join(names), *lines, ""])


def _format_row(values: Sequence[float]) -> str:
    return ",".join(f"{value:.17g}" for value in values)


def _find_motion(model: FrictionModel) -> tuple[ReferenceMotion, np.ndarray]:
    """Return the fastest motion whose torques (N, n) are finite, halving steps until they are."""
    for halvings in range(_MAX_HALVINGS):
        step = model.sample_time / 2**halvings
        motion = reference_motion(
            model,
            frequency=_PERIODS / (_ROW_COUNT * step),
            periods=_PERIODS,
            rows=_ROW_COUNT,
            phase=_PHASE,
            lead_in=0.1 * _ROW_COUNT * step,
        )
        motion = ReferenceMotion(
            t=motion.t,
            dq=_round_to_single(motion.dq),
            q=_round_to_single(motion.q),
            tau_load=_round_to_single(motion.tau_load),
        )
        try:
            tau = torques(model, motion, "direct")
        except SimulationError:
            continue
        if np.all(np.isfinite(tau)):
            return motion, tau
    raise ExportError(
        f"friction model '{model.law}': torque is not finite at speeds up to "
        f"{np.abs(motion.dq).max():g} rad/s; no test data can be made."
    )


def _round_to_single(values: np.ndarray) -> np.ndarray:
    return np.asarray(values.astype(np.float32).astype(float))


_LANES = 8  # robots per batch step: two vectors of AVX2, one of AVX-512
_MATH_FUNCTION = re.compile(r"^(?:static inline|IN_ONE_PLACE|QUICK) \w+ (\w+)\(", re.MULTILINE)


def export_c(model: FrictionModel, path: Path) -> Path:
    """Write a friction model as the C99 header NAME.h, and its test data.

    Torques equal those of the FMU bit for bit with the same flags and mathematical library.
    """
    if path.suffix != ".h":
        raise ExportError(f"{path}: a C header ends in .h, found '{path.suffix}'.")
    if not (path.stem.isascii() and path.stem.isidentifier()):
        raise ExportError(
            f"{path}: '{path.stem}' is not a valid C name; start with a letter, then use letters, "
            "digits and underscores."
        )
    return write_code_and_data(path, header(model, path.stem), model)


def header(model: FrictionModel, name: str) -> str:
    """Return the text of the header with the prefix `name`."""
    require_exportable(model, "one C header", coupled=False)
    joints = build_joints(model)
    components = dict.fromkeys(joint.component for joint in joints)
    functions = {}
    for number, component in enumerate(components, start=1):
        functions[component] = Functions(component, f"{name}_law_{number}")
    is_euler = any(law.discretisation == "euler" for law in model.laws)
    function_texts: list[str] = []
    for law_functions in functions.values():
        function_texts += _list_functions(law_functions, is_euler=is_euler)
    law_math = read_c_source("law_math.h")
    template = code_templates(TEMPLATES).get_template("law.h.j2")
    text = template.render(
        name=name,
        title=_escape_comment(f"Friction of {model.robot} by {model_title(model)}"),
        version=version("hesr"),
        sample_time=literal(model.sample_time),
        law_math=law_math,
        functions=[
            function_text.replace("QUICK ", "static ", 1) for function_text in function_texts
        ],
        joints=_build_rows(model, joints, functions, is_euler=is_euler),
        slides=model.slides,
        lanes=_LANES,
        shared=max(len(joint.component.shared) for joint in joints),
        coefficients=sum(len(law.values) for law in model.laws),
    )
    # Names with prefixes do not collide with those of other files.
    text = re.sub(r"\bLANES\b", f"{name.upper()}_LANES", text)
    names = "|".join(_MATH_FUNCTION.findall(law_math))
    return re.sub(rf"\b({names})\(", r"law_\1(", text)


def _list_functions(law_functions: Functions, *, is_euler: bool) -> list[str]:
    """Return the C functions of a law that a header needs, in the order of the file."""
    has_memory = bool(law_functions.component.memory)
    texts = [law_functions.read(), law_functions.invariants(), law_functions.step()]
    if not is_euler:
        texts.append(law_functions.lanes())
    if has_memory:
        texts.append(law_functions.begin())
    if law_functions.jumps.expressions:
        texts.append(law_functions.switches())
    if is_euler and has_memory:
        texts.append(law_functions.rates())
    return texts


def _build_rows(
    model: FrictionModel,
    joints: Sequence[Joint],
    functions: Mapping[Any, Functions],
    *,
    is_euler: bool,
) -> list[dict[str, Any]]:
    """Return the values of each joint for the template, with the places of its first numbers."""
    rows: list[dict[str, Any]] = []
    state_count = 0
    coefficient_count = 0
    for label, law, joint in zip(model.joints, model.laws, joints, strict=True):
        law_functions = functions[joint.component]
        memory = law.form.memory
        numbers = []
        for coefficient, value in zip(law.form.coefficients, law.values.values(), strict=True):
            numbers.append((literal(value), coefficient.name, coefficient.unit))
        row = {
            "place": len(rows),
            "label": _escape_comment(label),
            "law": law_functions.name,
            "numbers": numbers,
            "shared": len(joint.component.shared),
            "starts": [literal(start) for start in law.start],
            "states": len(memory),
            "first_state": state_count,
            "first_coefficient": coefficient_count,
            "switches": len(law_functions.jumps.expressions),
            "invariants": max(len(law_functions.invariant), 1),  # C has no arrays of length 0
            "names": [element.name for element in memory],
            "euler": is_euler and bool(law.form.relaxations),
        }
        rows.append(row)
        state_count += len(memory)
        coefficient_count += len(numbers)
    return rows


def _escape_comment(text: str) -> str:
    return text.replace("*/", "* /").replace("\\", "/")
