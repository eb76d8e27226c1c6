"""Plant FMU: a robot with friction in its joints; torque in, motion out."""

import logging
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path

import numpy as np
import sympy

from fmu_src.blocks.block import places, vector
from fmu_src.equations.header import SOLVER_OF_ALL, Joint, equations_header, prepared_size
from fmu_src.export.description3 import Terminal
from fmu_src.export.interface import Interface, Variable
from fmu_src.export.package import Content, Version, check_request, read_c_source, write_fmu
from fmu_src.export.toolchain import HOST
from fmu_src.friction.embedded_model import embed_model
from fmu_src.friction.friction_component import (
    build_joints,
    dependencies,
    discretisation,
    find_added_coordinates,
    find_joint_signals,
    law_variables,
    make_inputs_initial,
    scales,
    start_mode,
    to_sliding,
)
from fmu_src.friction.friction_fmu import describe_fmu, describe_origin
from fmu_src.friction.validity import require_exportable
from fmu_src.pages.friction_page import drive_html, model_title
from fmu_src.plant.dynamics import change_header, dynamics_header, tool_header
from fmu_src.plant.servo import PlantServo, PositionServo, ServoGains, find_places
from fmu_src.run.reference_results import Stimuli, waves
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import TAU_LOAD, TORQUE
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import LINK_PARAMETERS, Robot
from hesr_model.robots.transmission import Coupling
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Progress, silent
from hesr_model.units import unit_of_joint

SUBSTEP = 1e-3  # default of the longest inner step [s]
STIFFNESS = 1e4
DAMPING = 1e2  # defaults of the stops [N.m/rad, N.m.s/rad]
_UNLIMITED = 1e6  # limit of a joint without stops [rad or m]
_POSTURES = 100  # random postures in the check of the mass matrix
_NO_TORQUE = 1e-12  # torque of a joint that carries none, in place of zero [N.m]
_log = logging.getLogger(__name__)

_JOINTS = Terminal(
    name="joints",
    kind="hesr.joints",
    description="all joints: torques in, motion out",
    members={name: (name, "inflow" if name == "tau" else "signal") for name in ("tau", "q", "dq")},
)
_UNITS = ("kg", *["kg.m"] * 3, *["kg.m2"] * 6)


@dataclass(frozen=True, kw_only=True)
class PlantBody:
    """A robot and its parameters (P,), ordered as `robot.parameter_names`."""

    robot: Robot
    parameters: Array

    @classmethod
    def from_robot(cls, robot: Robot, body: RigidBody | None = None) -> "PlantBody":
        """Return a robot with identified parameters, by default those of its model file.

        Raises RobotError if the body belongs to another robot, ExportError if a mass matrix is not
        positive definite.
        """
        if body is None:
            source = robot.description.model.name
            parameters = robot.nominal_parameters
        else:
            source = "the rigid body"
            parameters = body.parameters_for(robot)
        plant_body = cls(robot=robot, parameters=parameters)
        plant_body.require_inertia(source)
        return plant_body

    def require_inertia(self, source: str) -> None:
        """Raise ExportError if the mass matrix is not positive definite at random postures."""
        lower, upper, _ = self.robot.reach
        q = np.random.default_rng(0).uniform(lower, upper, (_POSTURES, self.robot.n))
        mass, _ = self.robot.dynamics(self.parameters, q, np.zeros_like(q))
        lowest = np.linalg.eigvalsh(mass)[:, 0]
        if not np.all(lowest > 0.0):
            raise ExportError(
                f"{source} gives the mass matrix of '{self.robot.name}' the eigenvalue "
                f"{np.min(lowest):.2g} kg.m2, where a plant needs positive ones; use a model file "
                'with inertias, or identify the body with body = "physical".'
            )

    @cached_property
    def rotors(self) -> Array:
        """Rotor inertias (n,)."""
        identified = self.parameters[10 * self.robot.links : self.robot.inertial]
        if len(identified):
            return identified
        return self.robot.rotor_nominal

    @property
    def key(self) -> dict[str, object]:
        """Everything that determines the FMU, as JSON data."""
        tunable = [*self.parameters.tolist(), *self.rotors.tolist(), *self.robot.gravity.tolist()]
        limits = [bound.tolist() for bound in self.robot.limits]
        return {"dynamics.h": dynamics_header(self.robot), "numbers": tunable, "limits": limits}


def find_possible_body(robot: Robot, body: RigidBody | None) -> PlantBody:
    """Return a robot for a plant; of base parameters, the closest that bodies can have."""
    from hesr_model.rigid_body.physical import find_nearest, is_possible  # slow to import

    if body is None:
        return PlantBody.from_robot(robot)
    identified = body.parameters_for(robot)
    if is_possible(robot, identified):
        return PlantBody.from_robot(robot, body)
    parameters, error, largest = find_nearest(robot, identified)
    worst = int(np.argmax(error / np.maximum(largest, _NO_TORQUE)))
    _log.warning(
        "The rigid body has base parameters; the plant has the closest ones that bodies can have. "
        "Their torque differs by up to %.2g N.m on %s, %.1f %% of its largest, at random states.",
        error[worst],
        robot.joints[worst],
        100.0 * error[worst] / largest[worst],
    )
    plant_body = PlantBody(robot=robot, parameters=parameters)
    plant_body.require_inertia("the rigid body")
    return plant_body


_OUTPUTS = (
    ("q", "rad", "position"),
    ("dq", "rad/s", "speed"),
    ("ddq", "rad/s2", "acceleration, in co-simulation over the last inner step"),
    ("tau_friction", "N.m", "friction torque, in co-simulation over the last inner step"),
    (TAU_LOAD.name, "N.m", "torque that the rigid bodies need"),
    ("tau_stop", "N.m", "torque of the stops at the limits of the joint"),
)
_SERVO_OUTPUTS = (("tau_motor", "N.m", "torque of the motor: servo, compensated gravity, and tau"),)
_TOOL_OUTPUTS = (
    (
        "tool_position",
        "m",
        "position of the last joint's frame in axes of the base",
        ("x", "y", "z"),
    ),
    (
        "tool_rotation",
        "1",
        "rotation of the last joint's frame",
        tuple(f"row {i // 3 + 1} column {i % 3 + 1}" for i in range(9)),
    ),
)
_START = ("q_start", "dq_start")
_INTEGRAL_OF = {"dq": "q", "ddq": "dq"}


def _inputs(servo: PlantServo | None) -> dict[str, tuple[str, str]]:
    if servo is None:
        return {"tau": ("N.m", "torque of the motor")}
    return {"tau": ("N.m", "torque of the motor in addition to the servo's"), **servo.inputs()}


def _memory(joints: Sequence[Joint], links: int, servo: PlantServo | None) -> int:
    """Return the number of doubles in the own memory of plant.c."""
    rows, lanes = prepared_size(joints)
    count = 1 + 3 * len(joints) + 10 * links + rows * lanes
    if servo is not None:
        count += servo.count_memory(len(joints))
    return count


def _parameters(plant_body: PlantBody) -> Iterator[Variable]:
    robot = plant_body.robot
    lower, upper, _ = robot.limits
    bounded = np.isfinite(upper - lower)
    lower = np.where(bounded, lower, -_UNLIMITED)
    upper = np.where(bounded, upper, _UNLIMITED)
    has_zero = (lower <= 0.0) & (upper >= 0.0)
    initial = np.where(has_zero, 0.0, 0.5 * (lower + upper))
    ones = np.ones(robot.n)
    yield from vector("q_start", "fixed", "rad", "initial position", initial)
    yield from vector("dq_start", "fixed", "rad/s", "initial speed", 0.0 * ones)
    yield from vector("q_min", "fixed", "rad", "position of the lower stop", lower)
    yield from vector("q_max", "fixed", "rad", "position of the upper stop", upper)
    text = "of the stops"
    yield from vector("stop_stiffness", "fixed", "N.m/rad", f"stiffness {text}", STIFFNESS * ones)
    yield from vector("stop_damping", "fixed", "N.m.s/rad", f"damping {text}", DAMPING * ones)


def inertial_parameters(plant_body: PlantBody) -> Iterator[Variable]:
    """Yield the parameters of links, rotors, springs, gravity and payload."""
    for i, joint in enumerate(plant_body.robot.tree, start=1):
        values = plant_body.parameters[10 * (i - 1) : 10 * i]
        for name, unit, value in zip(LINK_PARAMETERS, _UNITS, values, strict=True):
            text = f"{name} of link {i}, {joint.name}, in the frame of its joint"
            yield Variable(f"link[{i}].{name}", "tunable", text, unit=unit, start=float(value))
    yield from vector(
        "rotor", "tunable", "kg.m2", "rotor inertia through the gear", plant_body.rotors
    )
    springs = plant_body.parameters[plant_body.robot.inertial :]
    for term, value in zip(plant_body.robot.springs, springs, strict=True):
        number = term.joint + 1
        unit = unit_of_joint(term.unit, is_prismatic=plant_body.robot.slides[term.joint])
        text = f"{term.name} of the spring or balancer of joint {number}"
        name = f"spring[{number}].{term.name}"
        yield Variable(name, "tunable", text, unit=unit, start=float(value))
    for axis, value in enumerate(plant_body.robot.gravity, start=1):
        text = f"gravity along axis {axis} of the base"
        yield Variable(f"gravity[{axis}]", "tunable", text, unit="m/s2", start=float(value))
    yield Variable("payload.m", "tunable", "mass of the payload on the last link", unit="kg")
    for axis in (1, 2, 3):
        text = f"centre of mass of the payload along axis {axis} of the last joint's frame"
        yield Variable(f"payload.com[{axis}]", "tunable", text, unit="m")
    for name in LINK_PARAMETERS[4:]:
        text = f"inertia {name} of the payload about its centre of mass, in axes of the last joint"
        yield Variable(f"payload.{name}", "tunable", text, unit="kg.m2")


@dataclass(frozen=True, kw_only=True)
class _Signals:
    """Names of the variables that outputs and states of a plant depend on.

    Attributes
    ----------
    commands : inputs of all joints.
    positions : of all joints.
    motion : positions, then speeds of all joints.
    stops : limits of positions, and parameters of the stops.
    load : sources of the joint torques: all above and the inertial parameters.
    friction : sources of the torque of each coordinate of the friction.
    """

    commands: tuple[str, ...]
    positions: tuple[str, ...]
    motion: tuple[str, ...]
    stops: tuple[str, ...]
    load: tuple[str, ...]
    friction: tuple[tuple[str, ...], ...]


def _interface(
    model: FrictionModel, plant_body: PlantBody, servo: PlantServo | None, *, tool: bool
) -> Interface:
    """Return the variables of a plant."""
    joints = build_joints(model, names={TORQUE: "tau_friction"})
    starts = list(_parameters(plant_body))
    inertial_variables = list(inertial_parameters(plant_body))
    servo_variables = []
    if servo is not None:
        servo_variables = list(servo.parameters())
    signals = _name_signals(model, joints, servo, starts, inertial_variables)
    variables = [
        *_input_variables(servo, starts[: len(joints)]),
        *_output_variables(model, signals, servo_variables),
    ]
    if tool:
        variables += _tool_variables(signals.positions)
    variables += starts + servo_variables
    variables.append(Variable("substep", "fixed", "longest inner step", unit="s", start=SUBSTEP))
    meaning = "how the states of the friction are relaxed over an inner step"
    variables += [discretisation(model, meaning), start_mode(), *inertial_variables, *scales(model)]
    for number, (law, joint) in enumerate(zip(model.laws, joints, strict=True), start=1):
        # The load depends on the acceleration, and this on the friction itself.
        load = (*signals.load, *signals.friction[number - 1])
        variables += law_variables(law, number, joint, _find_law_sources(model, number, load))
    variables = [adapt_to_joint(variable, model.slides) for variable in variables]
    if servo is not None:
        variables = [make_inputs_initial(variable, signals.commands) for variable in variables]
    return Interface(
        variables=tuple(variables),
        own=_memory(joints, plant_body.robot.links, servo),
        model_exchange=servo is None,
        directional_derivatives=servo is None,
        inner_steps=True,
    )


def _name_signals(
    model: FrictionModel,
    joints: Sequence[Joint],
    servo: PlantServo | None,
    starts: Sequence[Variable],
    inertial_variables: Sequence[Variable],
) -> _Signals:
    """Return the names behind outputs and states, from the parameters of the plant."""
    numbers = range(1, len(joints) + 1)
    commands: list[str] = []
    for name in _inputs(servo):
        commands += [f"{name}[{i}]" for i in numbers]
    positions = tuple(f"q[{i}]" for i in numbers)
    motion = (*positions, *(f"dq[{i}]" for i in numbers))
    stops = tuple(variable.name for variable in starts if variable.name.startswith(("q_m", "stop")))
    inertial_names = (variable.name for variable in inertial_variables)
    load = (*commands, *motion, *stops, *inertial_names)
    torque = sympy.Symbol(TORQUE, real=True)
    friction = [
        dependencies(joint, torque, _find_law_sources(model, i, load))
        for i, joint in enumerate(joints, start=1)
    ]
    return _Signals(
        commands=tuple(commands),
        positions=positions,
        motion=motion,
        stops=stops,
        load=load,
        friction=tuple(friction),
    )


def _find_law_sources(
    model: FrictionModel, coordinate: int, load: tuple[str, ...]
) -> dict[str, tuple[str, ...]]:
    """Return the variables behind each input of the law of a coordinate."""
    return {
        "dq": find_joint_signals("dq", coordinate, model.coupling),
        "q": find_joint_signals("q", coordinate, model.coupling),
        TAU_LOAD.name: load,
    }


def _input_variables(
    servo: PlantServo | None, initial_positions: Sequence[Variable]
) -> Iterator[Variable]:
    """Yield the inputs; position commands begin at the initial positions."""
    for name, (unit, text) in _inputs(servo).items():
        starts = [0.0] * len(initial_positions)
        if name == "q_cmd":
            starts = [position.start for position in initial_positions]
        yield from vector(name, "input", unit, text, starts)


def _output_variables(
    model: FrictionModel, signals: _Signals, servo_variables: Sequence[Variable]
) -> Iterator[Variable]:
    """Yield the outputs of all joints with the variables that they depend on."""
    zeros = (0.0,) * len(signals.positions)
    servo_names = (variable.name for variable in servo_variables)
    all_friction = chain.from_iterable(signals.friction)
    all_sources = (*signals.load, *servo_names, *all_friction)
    outputs: tuple[tuple[str, str, str], ...] = _OUTPUTS
    if servo_variables:
        outputs = (*_OUTPUTS, *_SERVO_OUTPUTS)
    for name, unit, text in outputs:
        for number, output in enumerate(vector(name, "output", unit, text, zeros), start=1):
            if name in ("q", "dq"):
                sources: Iterable[str] = (output.name,)
            elif name == "tau_stop":
                sources = (*signals.motion, *signals.stops)
            elif name == "tau_friction":
                coordinates = find_added_coordinates(number, model.coupling)
                sources = chain.from_iterable(signals.friction[k - 1] for k in coordinates)
            else:
                sources = all_sources
            output = replace(output, dependencies=tuple(dict.fromkeys(sources)))
            if name in _INTEGRAL_OF:
                output = replace(output, derivative_of=f"{_INTEGRAL_OF[name]}[{number}]")
            if f"{name}_start" in _START:
                output = replace(output, initial_dependencies=(f"{name}_start[{number}]",))
            yield output


def _tool_variables(positions: tuple[str, ...]) -> Iterator[Variable]:
    """Yield the pose of the last joint's frame."""
    for name, unit, text, elements in _TOOL_OUTPUTS:
        for k, element in enumerate(elements, start=1):
            description = f"{text}, {element}"
            yield Variable(f"{name}[{k}]", "output", description, unit=unit, dependencies=positions)


_WORDS = {"torque": "force", "inertia": "mass"}
_JOINT_VARIABLE = re.compile(
    r"(tau|q|dq|ddq|tau_\w+|q_\w+|dq_\w+|stop_\w+|servo_\w+|torque_limit|speed_limit|rotor)"
    r"\[(\d+)\]"
)


def adapt_to_joint(variable: Variable, slides: Sequence[bool]) -> Variable:
    """Return a variable of a turning joint, as that of a sliding one if it slides."""
    joint = _JOINT_VARIABLE.fullmatch(variable.name)
    if joint is None or not slides[int(joint[2]) - 1]:
        return variable
    return to_sliding(variable, _WORDS)


_VECTORS = ("tau", *(name for name, *_ in _OUTPUTS), *_START, "q_min", "q_max")
_PLACES = {name.upper(): f"{name}[1]" for name in _VECTORS}
_PLACES |= {"STIFFNESS": "stop_stiffness[1]", "DAMPING": "stop_damping[1]"}
_PLACES |= {"PARAMETERS": "link[1].m", "ROTORS": "rotor[1]", "GRAVITY": "gravity[1]"}
_PLACES |= {"PAYLOAD_M": "payload.m", "PAYLOAD_COM": "payload.com[1]"}
_PLACES |= {"PAYLOAD_INERTIA": "payload.Ixx"}
_PLACES |= {name.upper(): name for name in ("substep", "discretisation", "start_mode")}


def export_plant(
    model: FrictionModel,
    path: Path,
    *,
    plant_body: PlantBody,
    kv: Sequence[float] | None = None,
    ki: Sequence[float] | None = None,
    kp: Sequence[float] | None = None,
    servo: PositionServo | None = None,
    tool: bool = False,
    platforms: Sequence[str] = HOST,
    progress: Progress = silent,
    fmi: Version = 2,
    bare: bool = False,
) -> Path:
    """Write a robot under a friction model as an FMU for co-simulation and model exchange.

    With `kv` (n,) it includes a servo with a speed command, with `kp` (n,) also a position command,
    or a `servo` that turns position errors into torque; it is then for co-simulation only. With
    `tool` it has the pose of the last joint's frame. Raises ArgumentError if a gain needs another
    one that is missing, and ExportError if the friction model belongs to another robot, or a gain
    is negative.
    """
    check_request(path, platforms)
    require_exportable(model, "a plant")
    require_fitting(model, plant_body.robot)
    cascade = ServoGains.from_gains(kv, ki, kp)
    if cascade is not None and servo is not None:
        raise ExportError("plant: 'servo' and 'kv' are two servos; give one of them.")
    return write_fmu(
        content(model, plant_body, servo=servo or cascade, tool=tool, bare=bare),
        path,
        platforms=platforms,
        progress=progress,
        fmi=fmi,
    )


def require_fitting(model: FrictionModel, robot: Robot) -> None:
    """Raise ExportError unless a model has the joints and the transmission of a robot."""
    if tuple(model.joints) != tuple(robot.joints):
        raise ExportError(
            f"the friction model has the joints {', '.join(model.joints)}, but robot "
            f"'{robot.name}' has {', '.join(robot.joints)}; give the robot of its logs."
        )
    if not np.array_equal(
        _forward_matrix(model.coupling, robot.n),
        _forward_matrix(robot.description.coupling, robot.n),
    ):
        raise ExportError(
            f"robot '{robot.name}' has another transmission matrix than the friction model; give "
            "the robot of its logs."
        )


def _forward_matrix(coupling: Coupling | None, joint_count: int) -> Array:
    """Return the matrix of a coupling, by default that of independent joints."""
    if coupling is None:
        return np.eye(joint_count)
    return coupling.forward


def content(
    model: FrictionModel,
    plant_body: PlantBody,
    *,
    servo: PlantServo | None = None,
    tool: bool = False,
    bare: bool = False,
) -> Content:
    """Return the FMU of a plant before compilation."""
    joints = build_joints(model, names={TORQUE: "tau_friction"})
    interface = _interface(model, plant_body, servo, tool=tool)
    # A robot without springs never reads theirs.
    springs = next((n for n in interface.places if n.startswith("spring[")), "gravity[1]")
    header = equations_header(
        joints,
        interface,
        _PLACES | {"SPRINGS": springs},
        calls=SOLVER_OF_ALL,
        coupling=model.coupling,
    )
    about = describe_fmu(
        model,
        name=f"Plant of {plant_body.robot.name} with {model_title(model)}",
        identifier=f"plant_{model.law}",
        text=f"Robot with {len(model.joints)} joints under friction: torque in, motion out.",
        step_size=SUBSTEP,
    )
    plant_sources = ("plant.c", "plant_flow.h", "plant_servo.h", "plant_solver.h")
    shared_sources = ("balance.h", "coupling.h", "law_math.h", "regroup.h", "root.h", "wide.h")
    sources = {name: read_c_source(name) for name in (*plant_sources, *shared_sources)}
    servo_places, servo_kinds = find_places(servo)
    sources["dynamics.h"] = dynamics_header(plant_body.robot, width="LANES")
    sources["equations.h"] = header
    sources["change.h"] = change_header(plant_body.robot)
    sources["servo.h"] = places(interface, "SERVO_H", servo_places, **servo_kinds)
    sources["tool.h"] = tool_header(plant_body.robot, interface.places.get("tool_position[1]"))
    members = {}
    if not bare:
        page = drive_html(model, interface, about, template="plant.html.j2").encode()
        members = {"documentation/index.html": page, **embed_model(model)}
    amplitudes: dict[str, float] = {}
    for name in _inputs(servo):
        amplitudes |= dict.fromkeys((f"{name}[{i}]" for i in range(1, len(joints) + 1)), 1.0)
    return Content(
        table=interface,
        about=about,
        sources=sources,
        members=members,
        stimuli=Stimuli(step=SUBSTEP, inputs=waves(amplitudes)),
        terminals=(_JOINTS,),
        origin={} if bare else describe_origin(model),
    )
