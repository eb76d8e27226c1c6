"""The interface of a release: public Python names, keys of files, variables of FMUs."""

import inspect
from collections.abc import Iterator, Mapping
from typing import Any, get_args

from pydantic import BaseModel

import hesr
from cosim.study.study import Study
from cosim.systems.system import SystemSpec
from fmu_src import model_file
from fmu_src.friction.friction_fmu import _component
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.robot import RobotDescription

FILES: Mapping[str, type[BaseModel]] = {
    "robot file": RobotDescription,
    "study": Study,
    "system": SystemSpec,
}


def interface() -> list[str]:
    """Return one line for each name that users may depend on."""
    lines = [f"hesr.{line}" for name in dir(hesr) for line in _python(name, getattr(hesr, name))]
    for title, model in FILES.items():
        lines += [f"{title}: {key}" for key in _keys(model, "", ())]
    table = _component(FrictionModel.read(model_file("uf850-table1"))).table
    lines += [f"friction FMU: {v.name} {v.role} {v.unit}" for v in table.variables]
    return sorted(set(lines))


def _python(name: str, value: Any) -> Iterator[str]:
    if not (inspect.isclass(value) or inspect.isfunction(value)):
        return
    yield name
    if not inspect.isclass(value):
        yield from (f"{name}({p})" for p in inspect.signature(value).parameters)
        return
    for own, member in vars(value).items():
        if own.startswith("_"):
            continue
        yield f"{name}.{own}"
        function = getattr(member, "__func__", member)
        if inspect.isfunction(function):
            yield from (f"{name}.{own}({p})" for p in inspect.signature(function).parameters)


def _keys(model: type[BaseModel], before: str, above: tuple[Any, ...]) -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield f"{before}{name}"
        for kind in _models(field.annotation):
            if kind not in above:
                yield from _keys(kind, f"{before}{name}.", (*above, model))


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)
