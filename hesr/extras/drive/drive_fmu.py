"""Drive FMU: a friction model and its motors; torque in, speed and angle out."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import NamedTuple

import numpy as np
import sympy

from fmu_src.blocks.block import vector
from fmu_src.equations.header import SOLVER, Joint, equations_header
from fmu_src.export.description3 import Terminal
from fmu_src.export.interface import Interface, Variable
from fmu_src.export.package import Content, Version, check_request, read_c_source, write_fmu
from fmu_src.export.toolchain import HOST
from fmu_src.friction import friction_component
from fmu_src.friction.embedded_model import embed_model
from fmu_src.friction.friction_fmu import describe_fmu
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


class _Requirement(NamedTuple):
    unit: str
    text: str  # in words
    default: float
    is_met: Callable[[float], bool]


_NOT_NEGATIVE = "a number that is not negative"
_REQUIREMENTS = {
    "inertia": _Requirement("kg.m2", "a positive number", 0.0, lambda value: value > 0.0),
    "stiffness": _Requirement("N.m/rad", _NOT_NEGATIVE, 0.0, lambda value: value >= 0.0),
    "damping": _Requirement("N.m.s/rad", _NOT_NEGATIVE, 0.0, lambda value: value >= 0.0),
    "ratio": _Requirement("turns", "a number other than zero", 1.0, lambda value: value != 0.0),
}


def build_motors(
    joint_count: int,
    *,
    inertia: Sequence[float],
    stiffness: Sequence[float] | None = None,
    damping: Sequence[float] | None = None,
    ratio: Sequence[float] | None = None,
) -> Motors:
    """Return the motors of a number of joints, by default rigid and without a gear."""
    return Motors(
        inertia=_read_values("inertia", inertia, joint_count),
        stiffness=_read_values("stiffness", stiffness, joint_count),
        damping=_read_values("damping", damping, joint_count),
        ratio=_read_values("ratio", ratio, joint_count),
    )


def _read_values(name: str, numbers: Sequence[float] | None, joint_count: int) -> tuple[float, ...]:
    """Return a property of the motors of all joints; ExportError if it is impossible."""
    requirement = _REQUIREMENTS[name]
    values = (requirement.default,) * joint_count
    if numbers is not None:
        values = tuple(map(float, numbers))
    if len(values) != joint_count:
        raise ExportError(
            f"drive: '{name}' has {len(values)} values; {joint_count} are needed, one per joint."
        )
    for number, value in enumerate(values, start=1):
        if not (isfinite(value) and requirement.is_met(value)):
            raise ExportError(
                f"drive: '{name}' of joint {number} is {value:g} {requirement.unit}; expected "
                f"{requirement.text}."
            )
    return values


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
_LINK_DEPENDENCIES = (
    *("q_link[{}]", "dq_link[{}]", "q_start[{}]", "dq_start[{}]"),
    *("stiffness[{}]", "damping[{}]", "ratio[{}]"),
)
_OUTPUTS = (
    ("q", "rad", "motor angle", ("q_start[{}]",)),
    ("dq", "rad/s", "motor speed", ("dq_start[{}]",)),
    ("tau_link", "N.m", "torque on the link at the end of the last step", _LINK_DEPENDENCIES),
    ("ddq", "rad/s2", "motor acceleration over the last inner step; 0 before the first", ()),
)


def _build_interface(model: FrictionModel, joints: Sequence[Joint], motors: Motors) -> Interface:
    """Return the variables of a drive: inputs, outputs, parameters and states of the friction."""
    zeros = (0.0,) * len(model.laws)
    torque = sympy.Symbol(TORQUE, real=True)
    friction_variables: list[Variable] = []
    law_variables: list[Variable] = []
    for j, law in enumerate(model.laws):
        number = j + 1
        # The drive integrates speed and angle of the motor itself.
        sources = {
            "dq": (f"dq_start[{number}]", f"ratio[{number}]"),
            "q": (f"q_start[{number}]", f"ratio[{number}]"),
            "tau_load": friction_component.find_joint_signals("tau_load", number, model.coupling),
        }
        dependencies = friction_component.dependencies(joints[j], torque, sources)
        text = (
            f"friction torque of {model.joints[j]} over the last inner step, on its side of the "
            "gear"
        )
        friction_variables.append(
            Variable(f"tau_f[{number}]", "output", text, unit="N.m", dependencies=dependencies)
        )
        law_variables += friction_component.law_variables(law, number, joints[j], sources)
    rotary_variables: list[Variable] = []
    for name, unit, text in _INPUTS:
        rotary_variables += vector(name, "input", unit, text, zeros)
    for name, unit, text, dependency_patterns in _OUTPUTS:
        outputs = list(vector(name, "output", unit, text, zeros, dependency_patterns))
        if name == "tau_link" and model.coupling is not None:
            outputs = _couple_dependencies(model.coupling, outputs)
        rotary_variables += outputs
    rotary_variables += friction_variables
    for name, unit, text in _PARAMETERS:
        rotary_variables += vector(name, "fixed", unit, text, getattr(motors, name, zeros))
    discretisation_variable = friction_component.discretisation(
        model, "how the states of the friction are relaxed over an inner step"
    )
    rotary_variables += [
        Variable("substep", "fixed", "longest inner step", unit="s", start=SUBSTEP),
        discretisation_variable,
        friction_component.start_mode(),
        *friction_component.scales(model),
        *law_variables,
    ]
    variables = [_adapt_to_joint(variable, model.slides) for variable in rotary_variables]
    inputs = {variable.name for variable in variables if variable.role == "input"}
    # FMPy requires inputs of one shape; flange inputs are scalars, so all inputs are.
    connected = {name for name, _, _ in _INPUTS} | {"tau_link"}
    return Interface(
        variables=tuple(
            friction_component.make_inputs_initial(variable, inputs) for variable in variables
        ),
        own=1,  # STARTED of drive.c
        model_exchange=False,
        directional_derivatives=False,
        inner_steps=True,
        connected=frozenset(connected),
    )


def _adapt_to_joint(variable: Variable, slides: Sequence[bool]) -> Variable:
    index_match = re.search(r"\[(\d+)\]", variable.name)
    if index_match is None or not slides[int(index_match[1]) - 1]:
        return variable
    return friction_component.to_sliding(variable, _PRISMATIC_WORDS)


_PRISMATIC_WORDS = {
    "torque": "force",
    "angle": "position",
    "inertia": "mass",
    "flexspline": "spring",
}


def _couple_dependencies(coupling: Coupling, outputs: Sequence[Variable]) -> list[Variable]:
    """Return the torques on the links with what the torques of all their motors depend on."""
    motor_dependencies = []
    for number, variable in enumerate(outputs, start=1):
        names: list[str] = []
        for dependency in variable.dependencies:
            quantity = dependency.partition("[")[0]
            if quantity in ("q_link", "dq_link"):  # several links turn a motor
                names += friction_component.find_joint_signals(quantity, number, coupling)
            else:
                names.append(dependency)
        motor_dependencies.append(names)
    coupled_outputs = []
    for link_number, variable in enumerate(outputs, start=1):
        link_dependencies: list[str] = []
        for motor_number in friction_component.find_added_coordinates(link_number, coupling):
            link_dependencies += motor_dependencies[motor_number - 1]
        unique_dependencies = tuple(dict.fromkeys(link_dependencies))
        coupled_outputs.append(replace(variable, dependencies=unique_dependencies))
    return coupled_outputs


_VECTORS = [name for name, *_ in (*_INPUTS, *_OUTPUTS)]
_VECTORS.append("tau_f")
_VECTORS += [name for name, *_ in _PARAMETERS]
_MACRO_VARIABLES = {name.upper(): f"{name}[1]" for name in _VECTORS}
_MACRO_VARIABLES |= {name.upper(): name for name in ("substep", "discretisation", "start_mode")}

FLANGE = Terminal(
    name="flange",
    kind="org.modelica.Modelica.Mechanics.Rotational.Interfaces.Flange_b",
    description="towards the link: its angle in, the torque on it out",
    members={"phi": ("q_link", "signal"), "tau": ("tau_link", "outflow")},
)
"""Terminal of each joint, on the joint side of the gear."""

_DEFAULT_FRICTION = 10.0  # default friction torque [N.m]


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
    motors = build_motors(
        len(model.laws), inertia=inertia, stiffness=stiffness, damping=damping, ratio=ratio
    )
    fmu_content = content(model, motors, bare=bare)
    return write_fmu(fmu_content, path, platforms=platforms, progress=progress, fmi=fmi)


def content(model: FrictionModel, motors: Motors, *, bare: bool = False) -> Content:
    """Return the FMU of a drive before compilation."""
    joints = friction_component.build_joints(model, names={TORQUE: "tau_f"})
    interface = _build_interface(model, joints, motors)
    header = equations_header(
        joints, interface, _MACRO_VARIABLES, calls=SOLVER, coupling=model.coupling
    )
    about = describe_fmu(
        model,
        name=f"Drive of {model.robot} with {model_title(model)}",
        identifier=f"drive_{model.law}",
        text=f"Motors of {len(model.joints)} joints under friction: torque in, speed and angle "
        "out.",
        step_size=SUBSTEP,
    )
    source_names = ("balance.h", "coupling.h", "drive.c", "drive_step.h", "law_math.h", "root.h")
    sources = {name: read_c_source(name) for name in source_names}
    members = {}
    if not bare:
        page = drive_html(model, interface, about).encode()
        members = {"documentation/index.html": page, **embed_model(model)}
    return Content(
        table=interface,
        about=about,
        sources=sources | {"equations.h": header},
        members=members,
        stimuli=_build_stimuli(model, motors),
        terminals=(FLANGE,),
    )


def _build_stimuli(model: FrictionModel, motors: Motors) -> Stimuli:
    """Return motor torques above the largest friction, at the middle of the trained loads."""
    amplitudes = {}
    loads = {}
    for j, ratio in enumerate(motors.ratio):
        largest_friction = 0.0
        tau_load = 0.0
        if model.trained:
            largest_friction = max(map(abs, model.trained[j].tau))
            tau_load = sum(model.trained[j].tau_load) / 2.0
        amplitude = 3.0 * (largest_friction or _DEFAULT_FRICTION) / abs(ratio)
        amplitudes[f"tau_motor[{j + 1}]"] = float(f"{amplitude:.2g}")
        loads[f"tau_load[{j + 1}]"] = np.full(ROWS + 1, float(f"{tau_load:.3g}"))
    return Stimuli(step=SUBSTEP, inputs={**waves(amplitudes), **loads})
