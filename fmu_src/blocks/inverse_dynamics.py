"""InverseDynamics FMU: rigid-body torque of a motion, from identified parameters."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fmu_src.blocks.block import content, places, vector
from fmu_src.export.interface import Interface, Variable, literal
from fmu_src.export.package import Content, read_c_source
from fmu_src.pages.block_page import BlockPage
from hesr_model.robots.robot import LINK_PARAMETERS, Robot

_SPRINGS = {True: "stiffness of the spring", False: "amplitude of the spring's torque"}
_UNITS = ("kg", *["kg.m"] * 3, *["kg.m2"] * 6)

_PAGE = BlockPage(
    equations=(
        "tau = M(q) ddq + C(q, dq) dq + g(q) + rotors(ddq) + springs(q)",
        "rotors(ddq)[i] = Ir[i] ddq[i]; with a transmission each motor turns with several joints",
        "springs(q)[i] = k q[i] for a spring, k cos(h q[i]) or k sin(h q[i]) for a balancer",
    ),
    notes=(
        "M, C and g are those of the tree of links, computed by the recursive Newton-Euler "
        "algorithm. Friction is not included.",
        "m is the mass of a link, mx, my and mz are its first moments, Ixx to Izz its inertia, "
        "about the origin of its joint's frame. Ir is the inertia of a rotor as seen at the joint. "
        "Identified base parameters give the right torque even if single values are not those of "
        "the link.",
        "A loop uses this FMU twice. The first instance receives the desired motion and gives "
        "tau_rb. The second one receives the measured position with dq = ddq = 0 and gives the "
        "torque of gravity alone, tau_g of the controller.",
    ),
)


def inverse_dynamics(
    robot: Robot, parameters: NDArray[np.float64], *, step: float = 0.005
) -> Content:
    """Return the InverseDynamics FMU; parameters (P,) are ordered as `robot.parameter_names`."""
    n = robot.n
    zeros = np.zeros(n)
    input_names: list[str] = []
    for name in ("q", "dq", "ddq"):
        input_names += [f"{name}[{i}]" for i in range(1, n + 1)]
    parameter_variables = list(_parameters(robot, parameters))
    dependencies = [*input_names, *(variable.name for variable in parameter_variables)]
    interface = Interface(
        variables=(
            *vector("q", "input", "rad", "position", zeros),
            *vector("dq", "input", "rad/s", "velocity", zeros),
            *vector("ddq", "input", "rad/s2", "acceleration", zeros),
            *vector("tau", "output", "N.m", "rigid-body torque", zeros, dependencies),
            *parameter_variables,
        ),
        directional_derivatives=False,
    )
    first = {"POSITION": "q", "VELOCITY": "dq", "ACCELERATION": "ddq", "TORQUE": "tau"}
    first |= {"PARAMETERS": "link[1].m", "ROTORS": "link[1].Ir"}
    return content(
        interface,
        name="InverseDynamics",
        text="Rigid-body torque of a motion, by the recursive Newton-Euler algorithm.",
        sources={
            "inverse_dynamics.c": read_c_source("inverse_dynamics.c"),
            "places.h": places(interface, "PLACES_H", first, JOINTS=n, LINKS=robot.links),
            "tree.h": _tree(robot),
        },
        step=step,
        page=_PAGE,
        owner=robot.description.owner,
    )


def _parameters(robot: Robot, parameters: NDArray[np.float64]) -> Iterator[Variable]:
    """Yield the parameters of links, rotors, springs and balancers."""
    for i, joint in enumerate(robot.tree, start=1):
        values = parameters[10 * (i - 1) : 10 * i]
        for name, unit, value in zip(LINK_PARAMETERS, _UNITS, values, strict=True):
            text = f"{name} of link {i}, {joint.name}"
            yield Variable(f"link[{i}].{name}", "tunable", text, unit=unit, start=value)
    rotors = parameters[10 * robot.links : robot.inertial]
    if not len(rotors):
        rotors = np.zeros(robot.n)
    for i, value in enumerate(rotors, start=1):
        text = f"rotor inertia of joint {i}"
        yield Variable(f"link[{i}].Ir", "tunable", text, unit="kg.m2", start=value)
    for term, value in zip(robot.springs, parameters[robot.inertial :], strict=True):
        name = f"spring[{term.joint + 1}].{term.name}"
        text = f"{_SPRINGS[term.linear]} of joint {term.joint + 1}"
        yield Variable(name, "tunable", text, unit=term.unit, start=value)


def _tree(robot: Robot) -> str:
    """Return tree.h."""
    rows = []
    motor_coupling = robot.description.motors
    motor_angles = np.eye(robot.n)
    if motor_coupling is not None:
        motor_angles = motor_coupling.forward
    gravity_x, gravity_y, gravity_z = map(literal, robot.gravity.tolist())
    for joint in robot.tree:
        numbers = map(_numbers, (joint.rotation.ravel(), joint.translation, joint.axis))
        rows.append(f"    {{{joint.parent}, {int(joint.prismatic)}, {', '.join(numbers)}}},")
    terms = [
        f"    {{{t.joint}, {int(t.linear)}, {int(t.sine)}, {t.harmonic}}}," for t in robot.springs
    ]
    slopes, offsets = robot.follow or (np.eye(robot.n), np.zeros(robot.n))
    return _TREE.format(
        sprung=len(terms),
        terms="\n".join(terms or ["    {0, 0, 0, 0},"]),
        follows=int(robot.follow is not None),
        slopes="\n".join(f"    {_numbers(row)}," for row in slopes),
        offsets=_numbers(offsets),
        rows="\n".join(rows),
        coupled=int(motor_coupling is not None),
        motors="\n".join(f"    {_numbers(row)}," for row in motor_angles),
        x=gravity_x,
        y=gravity_y,
        z=gravity_z,
    )


def _numbers(values: Sequence[float] | NDArray[np.float64]) -> str:
    return f"{{{', '.join(literal(float(v)) for v in values)}}}"


_TREE = """\
/* Generated: the kinematic tree. */
#ifndef TREE_H
#define TREE_H

#include "places.h"

/* In the frame of the base [m/s2]. */
#define GRAVITY_X {x}
#define GRAVITY_Y {y}
#define GRAVITY_Z {z}

typedef struct {{
    int parent;            /* -1 for the base */
    int prismatic;         /* else revolute */
    double rotation[9];    /* of its frame in its parent's at zero position, by rows */
    double translation[3]; /* [m] */
    double axis[3];        /* unit vector in its own frame */
}} Joint;

static const Joint joints[LINKS] = {{
{rows}
}};

/* Positions of the links' joints over those of the robot, q = slopes q_robot + offsets, if some
 * FOLLOW others. */
enum {{ FOLLOW = {follows} }};
static const double slopes[LINKS][JOINTS] = {{
{slopes}
}};
static const double offsets[LINKS] = {offsets};

/* Motor angles per joint angles, divided by gear ratios; used if COUPLED. */
enum {{ COUPLED = {coupled} }};
static const double motors[JOINTS][JOINTS] = {{
{motors}
}};

/* Springs and balancers; their parameters follow those of the rotors. */
typedef struct {{
    int joint;
    int linear;   /* torque over the position */
    int sine;     /* else cosine */
    int harmonic; /* of the angle */
}} Spring;

enum {{ TERMS = {sprung} }};
static const Spring springs[] = {{
{terms}
}};

#endif
"""
