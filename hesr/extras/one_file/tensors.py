"""Tensor export for PyTorch or JAX."""

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from fmu_src.friction.validity import discretisation_of, require_exportable
from fmu_src.pages.html import code_templates
from hesr.extras.one_file.reference import TEMPLATES, write_beside
from hesr.extras.one_file.tensor_printer import begin_function, law_function
from hesr_model.errors import ExportError
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel

Library = Literal["torch", "jax"]

_TITLES: Mapping[Library, str] = {"torch": "PyTorch", "jax": "JAX"}


def export_torch(model: FrictionModel, path: Path) -> Path:
    """Write `tensor_code` for PyTorch, and its test data next to it."""
    return _export(model, path, "torch")


def export_jax(model: FrictionModel, path: Path) -> Path:
    """Write `tensor_code` for JAX, and its test data next to it."""
    return _export(model, path, "jax")


def _export(model: FrictionModel, path: Path, library: Library) -> Path:
    if path.suffix != ".py":
        raise ExportError(f"{path}: a file for {_TITLES[library]} ends in .py.")
    return write_beside(path, tensor_code(model, library), model)


def tensor_code(model: FrictionModel, library: Library) -> str:
    """Return the text of a Python file that needs only PyTorch or JAX.

    It steps batches of robots with their hidden states, all joints of one form together.
    """
    require_exportable(model, "a file of tensors")
    discretisation = discretisation_of(model)
    groups: dict[LawForm, list[int]] = {}
    for i, law in enumerate(model.laws):
        groups.setdefault(law.form, []).append(i)
    laws = [
        _law(f"_law_{n}", form, joints, [model.laws[i] for i in joints])
        for n, (form, joints) in enumerate(groups.items(), start=1)
    ]
    template = code_templates(TEMPLATES).get_template(f"law_{library}.py.j2")
    rendered: str = template.render(
        title=_text(f"Friction of {model.robot} by {model.law}"),
        library=_TITLES[library],
        version=version("hesr"),
        joints=tuple(model.joints),
        slides=any(model.slides),
        sample_time=model.sample_time,
        euler=discretisation == "euler",
        laws=laws,
    )
    return rendered


def _law(name: str, form: LawForm, joints: list[int], laws: list[FrictionLaw]) -> dict[str, Any]:
    return {
        "name": name,
        "function": law_function(form, name),
        "begin": begin_function(form, f"{name}_begin"),
        "joints": tuple(joints),
        "values": {c.name: tuple(law.values[c.name] for law in laws) for c in form.coefficients},
        "units": {c.name: c.unit for c in form.coefficients},
        "starts": {m.name: tuple(law.start[i] for law in laws) for i, m in enumerate(form.memory)},
    }


def _text(text: str) -> str:
    return text.replace("\\", "/").replace('"', "'")
