"""Drive FMU: a friction model and its motors; torque in, speed and angle out."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

import numpy as np
import sympy

from fmu_src.blocks.block import vector
from fmu_src.equations.header import SOLVER, Joint, equations_header
from fmu_src.export.description3 import Terminal
from fmu_src.export.interface import Interface, Variable
from fmu_src.export.package import Content, Version, check_request, own_source, write_fmu
from fmu_src.export.toolchain import HOST
from fmu_src.friction import friction_component
from fmu_src.friction.embedded_model import embedding
from fmu_src.friction.friction_fmu import description_of
from fmu_src.friction.validity import require_exportable
from fmu_src.pages.friction_page import drive_html, model_title
from fmu_src.run.reference_results import ROWS, Stimuli, waves
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import TORQUE
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.transmission import Coupling
from hesr_model.support.progress import Progress, silent

SUBSTEP = 1e-3  # default of the longest inner step [s]


@dataclass(frozen=True, kw_only=True)
class Motors:
    """Motor and gear of each joint (n,)."""

    inertia: tuple[float, ...]  # of everything fixed to the rotor [kg.m2]
    stiffness: tuple[float, ...]  # of the flexspline, on the joint side [N.m/rad]; 0: rigid
    damping: tuple[float, ...]  # of the flexspline [N.m.s/rad]
    ratio: tuple[float, ...]  # turns of the motor per turn of the joint


_NEEDED: dict[str, tuple[str, str, float, Callable[[float], bool]]] = {
    "inertia": ("kg.m2", "a positive number", 0.0, lambda value: value > 0.0),
    "stiffness": ("N.m/rad", "a number that is not negative", 0.0, lambda value: value >= 0.0),
    "damping": ("N.m.s/rad", "a number that is not negative", 0.0, lambda value: value >= 0.0),
    "ratio": ("turns", "a number other than zero", 1.0, lambda value: value != 0.0),
}
"""Unit, requirement in words, default value, and test."""


def motors(
    joints: int,
    *,
    inertia: Sequence[float],
    stiffness: Sequence[float] | None = None,
    damping: Sequence[float] | None = None,
    ratio: Sequence[float] | None = None,
) -> Motors:
    """Return the motors of a number of joints, by default rigid and without a gear."""
    found = {}
    given = (inertia, stiffness, damping, ratio)
    for numbers, (name, (unit, text, usual, sound)) in zip(given, _NEEDED.items(), strict=True):
        values = (usual,) * joints if numbers is None else tuple(map(float, numbers))
        if len(values) != joints:
            raise ExportError(
                f"drive: '{name}' has {len(values)} values; {joints} are needed, one per joint."
            )
        for joint, value in enumerate(values, start=1):
            if not (isfinite(value) and sound(value)):
                raise ExportError(
                    f"drive: '{name}' of joint {joint} is {value:g} {unit}; expected {text}."
                )
        found[name] = values
    return Motors(**found)


_INPUTS = (
    ("tau_motor", "N.m", "motor torque"),
    ("q_link", "rad", "angle of the link, for the flexspline"),
    ("dq_link", "rad/s", "speed of the link, for the flexspline"),
    ("tau_load", "N.m", "load torque, for friction that depends on it"),
)
_PARAMETERS = (
    ("inertia", "kg.m2", "inertia at the motor"),
    ("stiffness", "N.m/rad", "stiffness of the flexspline; 0: none"),
    ("damping", "N.m.s/rad", "damping of the flexspline"),
    ("ratio", "1", "turns of the motor for one turn of the joint"),
    ("q_start", "rad", "initial angle of the motor"),
    ("dq_start", "rad/s", "initial speed of the motor"),
)
_AT_LINK = (
    *("q_link[{}]", "dq_link[{}]", "q_start[{}]", "dq_start[{}]"),
    *("stiffness[{}]", "damping[{}]", "ratio[{}]"),
)
_OUTPUTS = (
    ("q", "rad", "motor angle", ("q_start[{}]",)),
    ("dq", "rad/s", "motor speed", ("dq_start[{}]",)),
    ("tau_link", "N.m", "torque on the link at the end of the last step", _AT_LINK),
    ("ddq", "rad/s2", "motor acceleration over the last inner step; 0 before the first", ()),
)


def _interface(model: FrictionModel, laws: Sequence[Joint], own: Motors) -> Interface:
    zeros = (0.0,) * len(model.laws)
    torque = sympy.Symbol(TORQUE, real=True)
    friction: list[Variable] = []
    own_laws: list[Variable] = []
    for joint, (name, law, own_law) in enumerate(
        zip(model.joints, model.laws, laws, strict=True), start=1
    ):
        sources = {
            "dq": (f"dq_start[{joint}]", f"ratio[{joint}]"),
            "q": (f"q_start[{joint}]", f"ratio[{joint}]"),
            "tau_load": friction_component.mixed("tau_load", joint, model.coupling),
        }
        made_of = friction_component.dependencies(own_law, torque, sources)
        text = f"friction torque of {name} over the last inner step, on its side of the gear"
        friction.append(
            Variable(f"tau_f[{joint}]", "output", text, unit="N.m", dependencies=made_of)
        )
        own_laws += friction_component.law_variables(law, joint, own_law, sources)
    choice = friction_component.discretisation(
        model, "how the states of the friction are relaxed over an inner step"
    )
    found = [
        variable for n, unit, text in _INPUTS for variable in vector(n, "input", unit, text, zeros)
    ]
    for n, unit, text, deps in _OUTPUTS:
        found += _coupled(model.coupling, list(vector(n, "output", unit, text, zeros, deps)))
    found += friction
    for n, unit, text in _PARAMETERS:
        found += vector(n, "fixed", unit, text, getattr(own, n, zeros))
    found.append(Variable("substep", "fixed", "longest inner step", unit="s", start=SUBSTEP))
    found += [choice, friction_component.start_mode(), *friction_component.scales(model), *own_laws]
    variables = [_at_joint(variable, model.slides) for variable in found]
    inputs = {variable.name for variable in variables if variable.role == "input"}
    return Interface(
        variables=tuple(
            friction_component.of_the_last_step(variable, inputs) for variable in variables
        ),
        own=1,  # STARTED of drive.c
        model_exchange=False,
        directional_derivatives=False,
        inner_steps=True,
        # FMPy requires inputs of one shape; flange inputs are scalars, so all inputs are.
        connected=frozenset({*(name for name, _, _ in _INPUTS), "tau_link"}),
    )


def _at_joint(variable: Variable, slides: Sequence[bool]) -> Variable:
    joint = re.search(r"\[(\d+)\]", variable.name)
    if joint is None or not slides[int(joint[1]) - 1]:
        return variable
    return friction_component.sliding(variable, _WORDS)


_WORDS = {"torque": "force", "angle": "position", "inertia": "mass", "flexspline": "spring"}


def _coupled(coupling: Coupling | None, outputs: Sequence[Variable]) -> Iterator[Variable]:
    for link, variable in enumerate(outputs, start=1):
        if coupling is None or not variable.name.startswith("tau_link["):
            yield variable
            continue
        found = [
            name
            for motor in friction_component.adding(link, coupling)
            for dependency in outputs[motor - 1].dependencies
            for name in (
                friction_component.mixed(dependency.partition("[")[0], motor, coupling)
                if dependency.startswith(("q_link[", "dq_link["))
                else (dependency,)
            )
        ]
        yield replace(variable, dependencies=tuple(dict.fromkeys(found)))


_VECTORS = [*(n for n, *_ in (*_INPUTS, *_OUTPUTS)), "tau_f", *(n for n, *_ in _PARAMETERS)]
_PLACES = {name.upper(): f"{name}[1]" for name in _VECTORS}
_PLACES |= {name.upper(): name for name in ("substep", "discretisation", "start_mode")}

FLANGE = Terminal(
    name="flange",
    kind="org.modelica.Modelica.Mechanics.Rotational.Interfaces.Flange_b",
    description="towards the link: its angle in, the torque on it out",
    members={"phi": ("q_link", "signal"), "tau": ("tau_link", "outflow")},
)
"""Terminal of each joint, on the joint side of the gear."""

_UNKNOWN = 10.0  # default friction torque [N.m]


def export_drive(
    model: FrictionModel,
    path: Path,
    *,
    inertia: Sequence[float],
    stiffness: Sequence[float] | None = None,
    damping: Sequence[float] | None = None,
    ratio: Sequence[float] | None = None,
    platforms: Sequence[str] = HOST,
    progress: Progress = silent,
    fmi: Version = 2,
    bare: bool = False,
) -> Path:
    """Write a friction model with the motors of its joints as an FMU for co-simulation.

    Units are those of `Motors`, for prismatic joints kg, N/m and so on. By default gears are rigid,
    with ratio 1.
    """
    check_request(path, platforms)
    require_exportable(model, "a drive")
    own = motors(
        len(model.laws), inertia=inertia, stiffness=stiffness, damping=damping, ratio=ratio
    )
    whole = content(model, own, bare=bare)
    return write_fmu(whole, path, platforms=platforms, progress=progress, fmi=fmi)


def content(model: FrictionModel, own: Motors, *, bare: bool = False) -> Content:
    """Return the FMU of a drive before compilation."""
    joints = friction_component.joints_of(model, names={TORQUE: "tau_f"})
    interface = _interface(model, joints, own)
    header = equations_header(joints, interface, _PLACES, wanted=SOLVER, coupling=model.coupling)
    about = description_of(
        model,
        name=f"Drive of {model.robot} with {model_title(model)}",
        identifier=f"drive_{model.law}",
        text=f"Motors of {len(model.joints)} joints under friction: torque in, speed and angle "
        "out.",
        step=SUBSTEP,
    )
    names = ("balance.h", "coupling.h", "drive.c", "drive_step.h", "law_math.h", "root.h")
    sources = {name: own_source(name) for name in names}
    members = {}
    if not bare:
        page = drive_html(model, interface, about).encode()
        members = {"documentation/index.html": page, **embedding(model)}
    return Content(
        table=interface,
        about=about,
        sources=sources | {"equations.h": header},
        members=members,
        stimuli=_stimuli(model, own),
        terminals=(FLANGE,),
    )


def _stimuli(model: FrictionModel, own: Motors) -> Stimuli:
    trained = model.trained or (None,) * len(model.joints)
    sizes = {}
    loads = {}
    for i, (trained_range, ratio) in enumerate(zip(trained, own.ratio, strict=True), start=1):
        friction = max(map(abs, trained_range.tau)) if trained_range else _UNKNOWN
        sizes[f"tau_motor[{i}]"] = float(f"{3.0 * (friction or _UNKNOWN) / abs(ratio):.2g}")
        load = sum(trained_range.tau_load) / 2.0 if trained_range else 0.0
        loads[f"tau_load[{i}]"] = np.full(ROWS + 1, float(f"{load:.3g}"))
    return Stimuli(step=SUBSTEP, inputs={**waves(sizes), **loads})
