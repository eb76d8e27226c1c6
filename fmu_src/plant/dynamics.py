"""dynamics.h: mass matrix and bias of one robot as straight-line C.

Newton-Euler and composite bodies in link frames whose joint axis is z. Everything that a turn about
(or a slide along) a joint's axis leaves unchanged is moved to its parent, so that 7 (or 4) of the
ten parameters of a link remain; `table` gives them as a linear map of the robot's parameters.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmu_src.export.interface import literal
from fmu_src.plant.expressions import Expression, Expressions
from hesr_model.robots.model_file import JointFrame
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

# Deviation of a direction cosine from 0 or 1 that is the rounding of an angle.
_ROUNDING_TOLERANCE = 5e-12
_ENTRY_TOLERANCE = 1e-15  # entries of `table` below this count as zero
_TENSOR = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])  # of xx, xy, yy, xz, yz, zz
_ENTRIES = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)  # rows and columns of these
_MASS = 0
_FIRST_MOMENTS = slice(1, 4)
_INERTIA = slice(4, 10)


@dataclass(frozen=True)
class _Link:
    """A link in its frame with the joint axis z; rotation and translation are to the parent's."""

    parent: int
    prismatic: bool
    rotation: Array
    translation: Array


def _align_links(tree: Sequence[JointFrame]) -> tuple[list[_Link], list[Array]]:
    """Return the links in turned frames, and the rotations from those to the robot's frames."""
    turns = [_to_axis(joint.axis) for joint in tree]
    links = []
    for joint, turn in zip(tree, turns, strict=True):
        parent_turn = np.eye(3)
        if joint.parent >= 0:
            parent_turn = turns[joint.parent]
        rotation = _round_exact(parent_turn.T @ joint.rotation @ turn)
        translation = parent_turn.T @ joint.translation
        links.append(_Link(joint.parent, joint.prismatic, rotation, translation))
    return links, turns


def _to_axis(axis: Array) -> Array:
    """Return a rotation whose third column is the axis, of zeros and ones where possible."""
    z = _round_exact(axis / np.linalg.norm(axis))
    # The axis of the frame that is farthest from z: its part across z cannot vanish.
    x = np.zeros(3)
    x[int(np.argmin(np.abs(z)))] = 1.0
    x -= (x @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _round_exact(matrix: Array) -> Array:
    nearest = np.round(matrix)
    return np.where(np.abs(matrix - nearest) < _ROUNDING_TOLERANCE, nearest, matrix)


def transform_parameters(parameters: Array, rotation: Array, translation: Array) -> Array:
    """Return a body's ten parameters in another frame, given the pose of its own there."""
    m = parameters[_MASS]
    t = translation
    h = rotation @ parameters[_FIRST_MOMENTS]
    inertia = rotation @ parameters[_INERTIA][_TENSOR] @ rotation.T
    inertia = inertia + (2.0 * h @ t + m * t @ t) * np.eye(3)
    inertia -= np.outer(h, t) + np.outer(t, h) + m * np.outer(t, t)
    return np.array([m, *(h + m * t), *inertia[_ENTRIES]])


def _map_to_parent(link: _Link) -> Array:
    """Return the map (10, 10) to the part of a link's parameters that its parent can carry."""
    part = np.zeros((10, 10))
    if link.prismatic:
        part[_INERTIA, _INERTIA] = np.eye(6)
    else:  # what is symmetric about z: m, mz, and Iyy of both xx and yy
        part[0, 0] = part[3, 3] = part[4, 6] = part[6, 6] = 1.0
    return part


def table(robot: Robot) -> Array:
    """Return the map (10 L, 10 L) from the parameters of the links to those of dynamics.h."""
    links, turns = _align_links(robot.tree)
    count = len(links)
    regrouping = np.zeros((10 * count, 10 * count))
    blocks = [slice(10 * i, 10 * i + 10) for i in range(count)]
    unit = np.eye(10)
    for i, turn in enumerate(turns):
        columns = [transform_parameters(basis, turn.T, np.zeros(3)) for basis in unit]
        regrouping[blocks[i], blocks[i]] = np.column_stack(columns)
    # From the tips to the base: a link has received the parts of its children before it gives.
    for i in reversed(range(count)):
        link = links[i]
        part = _map_to_parent(link)
        if link.parent >= 0:
            columns = [
                transform_parameters(basis, link.rotation, link.translation) for basis in unit
            ]
            to_parent = np.column_stack(columns)
            regrouping[blocks[link.parent]] += to_parent @ part @ regrouping[blocks[i]]
        regrouping[blocks[i]] -= part @ regrouping[blocks[i]]
    # Round-off of entries that cancel; each one left costs a term in the binary.
    return np.where(np.abs(regrouping) < _ENTRY_TOLERANCE, 0.0, regrouping)


Vector = NDArray[np.object_]  # of expressions


def _sum(graph: Expressions, terms: Iterable[Expression]) -> Expression:
    return sum(terms, graph.constant(0.0))


def _constants(graph: Expressions, values: Array) -> Vector:
    return np.array([graph.constant(float(x)) for x in values])


def _spin(w: Vector, turn: Vector) -> Vector:
    """Return the matrix of turn x + w x (w x ..)."""
    x, y, z = w
    p, q, r = turn
    return np.array(
        [
            [-(y * y + z * z), x * y - r, x * z + q],
            [x * y + r, -(x * x + z * z), y * z - p],
            [x * z - q, y * z + p, -(x * x + y * y)],
        ]
    )


def _gyro(inertia: Vector, w: Vector, turn: Vector) -> Vector:
    """Return inertia turn + w x (inertia w), with the products of `_spin`."""
    x, y, z = w
    p, q, r = turn
    xx, xy, yy, xz, yz, zz = inertia
    (_, s01, s02), (s10, _, s12), (s20, s21, _) = _spin(w, turn)
    moment_x = xx * p + (zz - yy) * (y * z) - xy * s20 + xz * s10 + yz * (y * y - z * z)
    moment_y = yy * q + (xx - zz) * (x * z) + xy * s21 - yz * s01 + xz * (z * z - x * x)
    moment_z = zz * r + (yy - xx) * (x * y) - xz * s12 + yz * s02 + xy * (x * x - y * y)
    return np.array([moment_x, moment_y, moment_z])


class _Joint:
    """A link's joint at its symbolic position: transforms between its frame and its parent's."""

    def __init__(self, link: _Link, number: int, graph: Expressions, q: Expression) -> None:
        self.link = link
        unity = graph.constant(1.0)
        zero = graph.constant(0.0)
        if link.prismatic:
            self.cosine = unity
            self.sine = zero
        else:
            self.cosine = graph.name(f"cosine[{number}]")
            self.sine = graph.name(f"sine[{number}]")
        self.arm = _constants(graph, link.translation)
        if link.prismatic:
            self.arm = self.arm + link.rotation @ np.array([zero, zero, q])

    def axial_part(self, force: Vector, moment: Vector) -> Expression:
        """Return what the joint feels of a force and a moment in its frame."""
        axial: Expression = force[2] if self.link.prismatic else moment[2]
        return axial

    def to_parent(self, a: Vector) -> Vector:
        """Turn a vector to the parent's frame."""
        c = self.cosine
        s = self.sine
        x, y, z = a
        turned: Vector = self.link.rotation @ np.array([c * x - s * y, s * x + c * y, z])
        return turned

    def from_parent(self, a: Vector) -> Vector:
        """Turn a vector from the parent's frame."""
        c = self.cosine
        s = self.sine
        x, y, z = self.link.rotation.T @ a
        return np.array([c * x + s * y, c * y - s * x, z])

    def tensor_to_parent(self, t: Vector) -> Vector:
        """Turn a symmetric tensor to the parent's frame."""
        c = self.cosine
        s = self.sine
        xx, xy, yy, xz, yz, zz = t
        turned_xx = c * c * xx - 2.0 * (c * s) * xy + s * s * yy
        turned_xy = c * s * (xx - yy) + (c * c - s * s) * xy
        # A turn about z leaves the sum xx + yy.
        turned_yy = xx + yy - turned_xx
        turned_xz = c * xz - s * yz
        turned_yz = s * xz + c * yz
        turned = np.array([turned_xx, turned_xy, turned_yy, turned_xz, turned_yz, zz])
        half = turned[_TENSOR] @ self.link.rotation.T
        tensor: Vector = half.T @ self.link.rotation.T
        return tensor[_ENTRIES]


class _Motion(NamedTuple):
    """Motion of a link in its frame: angular velocity and acceleration; acceleration."""

    w: Vector
    turn: Vector
    a: Vector


class _Body(NamedTuple):
    """Mass, first moments (3,) and inertia (6,) about the origin of a link's frame."""

    m: Expression
    h: Vector
    inertia: Vector


class _Arm:
    """Symbolic dynamics of a robot in the coordinates of its friction, or of its joints."""

    def __init__(self, robot: Robot, *, of_joints: bool) -> None:
        self.robot = robot
        self.graph = Expressions()
        self.links, _ = _align_links(robot.tree)
        slopes, self.offsets = robot.follow or (np.eye(robot.n), np.zeros(robot.n))
        self.mixing: Array = np.eye(robot.n)
        coupling = robot.description.coupling
        if coupling is not None and not of_joints:
            self.mixing = np.asarray(np.linalg.inv(coupling.forward), dtype=float)
        self.slopes = slopes @ self.mixing
        # Parameters without an entry in the table vanish from the statements.
        used_rows = np.any(table(robot) != 0.0, axis=1)
        parameters = np.full(len(used_rows), self.graph.constant(0.0))
        for k in np.flatnonzero(used_rows):
            parameters[k] = self.graph.name(f"p[{k}]")
        self.parameters = parameters.reshape(-1, 10)
        self.joints = [
            _Joint(link, i, self.graph, self.express_motion("q", i))
            for i, link in enumerate(self.links)
        ]

    def express_motion(self, motion: str, link: int) -> Expression:
        """Return the position or speed of a link's joint."""
        names = (self.graph.name(f"{motion}[{j}]") for j in range(self.robot.n))
        terms = (x * float(f) for x, f in zip(names, self.slopes[link], strict=True))
        expression = _sum(self.graph, terms)
        if motion == "q":
            return expression + float(self.offsets[link])
        return expression

    def print_changes(self, stores: Mapping[str, Expression]) -> str:
        """Return C statements that store changes of expressions along tq, tdq, tp and so on."""
        moving = ("q[", "dq[", "p[", "rotor[", "spring[", "gravity[")
        names = {n.name for n in self.graph.nodes if n.name.startswith(moving)}
        seeds = {name: self.graph.name(f"t{name}") for name in sorted(names)}
        for i, joint in enumerate(self.joints):
            turn = self.express_motion("tq", i)
            seeds |= {f"cosine[{i}]": -joint.sine * turn, f"sine[{i}]": joint.cosine * turn}
        changes = self.graph.changes(seeds)
        return self.graph.to_c({place: changes[e.index] for place, e in stores.items()})

    def project_torque(self, links: Sequence[Expression], column: int) -> Expression:
        """Return a torque of all links' joints on a coordinate."""
        pairs = zip(links, self.slopes[:, column], strict=True)
        return _sum(self.graph, (x * float(f) for x, f in pairs))

    def project_torques(self, links: Sequence[Expression]) -> list[Expression]:
        """Return torques of all links' joints on all coordinates."""
        return [self.project_torque(links, j) for j in range(self.robot.n)]

    def torques(self, *, accelerated: bool = False) -> list[Expression]:
        """Return the torques on all coordinates, without rotors, by Newton and Euler."""
        zero = self.graph.constant(0.0)
        zeros = np.full(3, zero)
        # Gravity enters as an acceleration of the base, upwards.
        upwards = np.array([-self.graph.name(f"gravity[{k}]") for k in range(3)])
        base = _Motion(zeros, zeros, upwards)
        motions: list[_Motion] = []
        forces = []
        moments = []
        # From the base to the tips: each link moves with its parent, and about or along its axis.
        for i, joint in enumerate(self.joints):
            parent = base
            if joint.link.parent >= 0:
                parent = motions[joint.link.parent]
            motion = self._move_link(i, parent, accelerated=accelerated)
            motions.append(motion)
            m, h, inertia = self._body(i)
            forces.append(motion.a * m + _spin(motion.w, motion.turn) @ h)
            moments.append(_gyro(inertia, motion.w, motion.turn) + np.cross(h, motion.a))
        links = self._collect_torques(forces, moments) + self.spring_torques()
        return self.project_torques(links)

    def _move_link(self, link: int, parent: _Motion, *, accelerated: bool) -> _Motion:
        """Return the motion of a link in its frame, from that of its parent in the parent's."""
        joint = self.joints[link]
        zero = self.graph.constant(0.0)
        carried = _spin(parent.w, parent.turn) @ joint.arm
        w = joint.from_parent(parent.w)
        turn = joint.from_parent(parent.turn)
        a = joint.from_parent(parent.a + carried)
        dq = self.express_motion("dq", link)
        ddq = np.full(3, zero)
        if accelerated:
            ddq[2] = self.express_motion("ddq", link)
        across = np.array([w[1] * dq, -(w[0] * dq), zero])  # w x z dq
        if joint.link.prismatic:
            # Coriolis: twice w x z dq.
            return _Motion(w, turn, a + across * 2.0 + ddq)
        turn = turn + across + ddq
        return _Motion(np.array([w[0], w[1], w[2] + dq]), turn, a)

    def _collect_torques(self, forces: list[Vector], moments: list[Vector]) -> Vector:
        """Return the torques of all links' joints, from the tips to the base."""
        torques = []
        for joint in reversed(self.joints):
            force = forces.pop()
            moment = moments.pop()
            torques.append(joint.axial_part(force, moment))
            parent = joint.link.parent
            if parent >= 0:
                parent_force = joint.to_parent(force)
                forces[parent] = forces[parent] + parent_force
                moments[parent] = moments[parent] + (
                    joint.to_parent(moment) + np.cross(joint.arm, parent_force)
                )
        return np.array(torques[::-1])

    def spring_torques(self) -> Vector:
        """Return the torques of springs and balancers on all links' joints."""
        names = [joint.name for joint in self.robot.tree]
        torques = np.full(len(names), self.graph.constant(0.0))
        for number, term in enumerate(self.robot.springs):
            link = names.index(self.robot.joints[term.joint])
            c = self.joints[link].cosine
            s = self.joints[link].sine
            unity = self.graph.constant(1.0)
            zero = self.graph.constant(0.0)
            # Cosine and sine of 0, 1 and 2 times the angle.
            shapes = ((unity, zero), (c, s), (c * c - s * s, 2.0 * (s * c)))
            if term.linear:
                shape = self.express_motion("q", link)
            else:
                shape = shapes[term.harmonic][term.sine]
            torques[link] = torques[link] + self.graph.name(f"spring[{number}]") * shape
        return torques

    def _body(self, link: int) -> _Body:
        parameters = self.parameters[link]
        return _Body(parameters[_MASS], parameters[_FIRST_MOMENTS], parameters[_INERTIA])

    def mass_matrix(self) -> list[list[Expression]]:
        """Return the mass matrix of all links' joints, by composite bodies."""
        zero = self.graph.constant(0.0)
        count = len(self.links)
        bodies = [self._body(i) for i in range(count)]
        matrix = [[zero] * count for _ in range(count)]
        # From the tips to the base: `bodies[i]` has everything that joint i carries.
        for i in reversed(range(count)):
            m, h, inertia = bodies[i]
            link = self.links[i]
            # Force and moment of a unit acceleration of the joint.
            if link.prismatic:
                force = np.array([zero, zero, m])
                moment = np.array([h[1], -h[0], zero])
            else:
                force = np.array([-h[1], h[0], zero])
                moment = inertia[3:]
            ancestor = i
            while ancestor >= 0:
                joint = self.joints[ancestor]
                matrix[i][ancestor] = matrix[ancestor][i] = joint.axial_part(force, moment)
                force = joint.to_parent(force)
                moment = joint.to_parent(moment) + np.cross(joint.arm, force)
                ancestor = joint.link.parent
            if link.parent >= 0:
                bodies[link.parent] = _join_bodies(bodies[link.parent], bodies[i], self.joints[i])
        return matrix


def _join_bodies(body: _Body, child: _Body, joint: _Joint) -> _Body:
    """Return a body together with that of a child, whose joint is given."""
    t = joint.arm
    h = joint.to_parent(child.h)
    half = h + t * (child.m * 0.5)  # of both terms with t
    inner = 2.0 * (half @ t)
    shift = []
    for i, j in zip(*_ENTRIES, strict=True):
        diagonal = inner if i == j else 0.0
        shift.append(diagonal - (half[i] * t[j] + t[i] * half[j]))
    inertia = joint.tensor_to_parent(child.inertia) + shift
    return _Body(body.m + child.m, body.h + (h + t * child.m), body.inertia + inertia)


def change_header(robot: Robot) -> str:
    """Return change.h: the change of M ddq + bias along motions and parameters, ddq held."""
    arm = _Arm(robot, of_joints=False)
    ddq = [arm.graph.name(f"ddq[{j}]") for j in range(robot.n)]
    stores = {}
    for i, torque in enumerate(arm.torques(accelerated=True)):
        rotor_terms = (_rotors(arm, i, j) * a for j, a in enumerate(ddq))
        stores[f"change[{i}]"] = torque + _sum(arm.graph, rotor_terms)
    angles = _angles(arm)
    return _file("CHANGE", _CHANGE.format(angles=angles, statements=arm.print_changes(stores)))


def dynamics_header(robot: Robot, *, of_joints: bool = False, width: str = "JOINTS") -> str:
    """Return dynamics.h: the function `dynamics`, and the map to its parameters.

    With a transmission, coordinates are those of the friction unless `of_joints`. Rows of the mass
    matrix are `width` apart.
    """
    arm = _Arm(robot, of_joints=of_joints)
    torques = arm.torques()
    mass = arm.mass_matrix()
    # With the slopes G of the links' joints over the coordinates: first M G, then G^T M G.
    mass_slopes = [arm.project_torques(row) for row in mass]
    stores = {f"bias[{i}]": torque for i, torque in enumerate(torques)}
    for i in range(robot.n):
        for j in range(i + 1):
            links = arm.project_torque([row[j] for row in mass_slopes], i)
            stores[f"mass[{i}][{j}]"] = stores[f"mass[{j}][{i}]"] = links + _rotors(arm, i, j)
    entries = table(robot)
    entry_rows = []
    for i, j in np.argwhere(entries):
        entry_rows.append(f"    {{{i}, {j}, {literal(float(entries[i, j]))}}},")
    return _HEADER.format(
        links=len(arm.links),
        width=width,
        last=_find_last_link(robot),
        angles=_angles(arm),
        statements=arm.graph.to_c(stores),
        entries="\n".join(entry_rows),
    )


def _find_last_link(robot: Robot) -> int:
    """Return the link that the last joint moves."""
    return [joint.name for joint in robot.tree].index(robot.joints[-1])


def _angles(arm: _Arm) -> str:
    turning = [i for i, link in enumerate(arm.links) if not link.prismatic]
    angles = {f"angle[{i}]": arm.express_motion("q", i) for i in turning}
    return _ANGLES.format(arm.graph.to_c(angles))


_ANGLES = """\
    double angle[ANGLES] = {{0.0}}, sine[ANGLES], cosine[ANGLES]; /* whole vectors */
    {{
{}
    }}
    for (int i = 0; i < ANGLES; i++) {{
        sine[i] = even_turn(angle[i], &cosine[i]);
    }}"""


def _file(name: str, functions: str) -> str:
    head = f'/* Generated. */\n#ifndef {name}_H\n#define {name}_H\n\n#include "dynamics.h"\n\n'
    return f"{head}{functions}\n#endif\n"


def jacobian_header(robot: Robot) -> str:
    """Return jacobian.h: the Jacobian of the origin of the last joint's frame, in axes of the base.

    Its rows are those of the linear and of the angular velocity.
    """
    arm = _Arm(robot, of_joints=True)
    zero = arm.graph.constant(0.0)
    unity = arm.graph.constant(1.0)
    columns = [[zero] * 6 for _ in arm.links]
    link = _find_last_link(robot)
    tip = np.full(3, zero)  # in the frame of `link`
    while link >= 0:
        joint = arm.joints[link]
        axis = np.array([zero, zero, unity])
        if joint.link.prismatic:
            linear = axis
            angular = np.full(3, zero)
        else:
            linear = np.array([-tip[1], tip[0], zero])  # z x tip
            angular = axis
        tip = joint.arm + joint.to_parent(tip)
        ancestor = link
        while ancestor >= 0:
            linear = arm.joints[ancestor].to_parent(linear)
            angular = arm.joints[ancestor].to_parent(angular)
            ancestor = arm.links[ancestor].parent
        columns[link] = [*linear, *angular]
        link = joint.link.parent
    stores = {}
    for k in range(6):
        row = [column[k] for column in columns]
        for j in range(robot.n):
            stores[f"jacobian[{k}][{j}]"] = arm.project_torque(row, j)
    statements = arm.graph.to_c(stores)
    return _file("JACOBIAN", _JACOBIAN.format(angles=_angles(arm), statements=statements))


def tool_header(robot: Robot, place: int | None) -> str:
    """Return tool.h, which stores the pose of the last joint's frame at a place of the variables.

    Its origin and, row by row, its rotation are in axes of the base. Without a place it stores
    nothing.
    """
    if place is None:
        none = "    (void)v, (void)q;"
        changes = f"{none}\n    (void)tq;"
        return _file("TOOL", _TOOL.format(angles="", statements=none, changes=changes))
    arm = _Arm(robot, of_joints=False)
    zero = arm.graph.constant(0.0)
    link = _find_last_link(robot)
    origin = np.full(3, zero)
    _, turns = _align_links(robot.tree)
    # Rows of the turn to the robot's frame are the axes of that frame.
    axes = [_constants(arm.graph, row) for row in turns[link]]
    while link >= 0:
        joint = arm.joints[link]
        origin = joint.arm + joint.to_parent(origin)
        axes = [joint.to_parent(axis) for axis in axes]
        link = joint.link.parent
    pose = [*origin, *np.column_stack(axes).ravel()]
    stores = {f"v[{k}]": value for k, value in enumerate(pose, place)}
    statements = arm.graph.to_c(stores)
    changes = arm.print_changes(stores)
    return _file("TOOL", _TOOL.format(angles=_angles(arm), statements=statements, changes=changes))


def _rotors(arm: _Arm, i: int, j: int) -> Expression:
    """Return an entry of the rotors' mass matrix."""
    motor_angles = np.eye(arm.robot.n)
    if arm.robot.description.motors is not None:
        motor_angles = arm.robot.description.motors.forward
    turns = motor_angles @ arm.mixing
    inertia = (arm.graph.name(f"rotor[{k}]") for k in range(arm.robot.n))
    pairs = zip(inertia, _round_exact(turns[:, i] * turns[:, j]), strict=True)
    return _sum(arm.graph, (x * float(f) for x, f in pairs))


_HEADER = """\
/* Generated: mass matrix and bias of one robot, without loops over its links. */
#ifndef DYNAMICS_H
#define DYNAMICS_H

#include <math.h>

/* Number of moving links, and the one that carries the payload. */
enum {{ LINKS = {links}, LAST_LINK = {last}, ANGLES = (LINKS + 3) / 4 * 4 }};

/* Parameters p (10 a link) from masses, first moments and inertias about the joint frames: what the
 * parent can carry belongs to the parent. */
typedef struct {{
    int row, column;
    double factor;
}} Entry;

static const Entry regrouped[] = {{
{entries}
}};

/* The mass matrix, and the torque at zero acceleration. */
QUICK void dynamics(const double *__restrict p, const double *__restrict rotor,
                    const double *__restrict spring, const double *__restrict gravity,
                    const double *__restrict q, const double *__restrict dq,
                    double (*__restrict mass)[{width}], double *__restrict bias) {{
{angles}
    (void)p, (void)rotor, (void)spring, (void)gravity, (void)dq; /* a robot need not use all */
{statements}
}}

#endif
"""

_CHANGE = """\
/* Change of M ddq + bias with ddq held, along tq, tdq, tp and `seed`. */
SELDOM static void torque_change(const Component *component, const double *seed, const double *tp,
                                 const double *q, const double *dq, const double *ddq,
                                 const double *tq, const double *tdq, double *change) {{
    const double *v = component->v, *p = &component->own[TABLE], *gravity = &v[GRAVITY];
    const double *rotor = &v[ROTORS], *spring = &v[SPRINGS], *tgravity = &seed[GRAVITY];
    const double *trotor = &seed[ROTORS], *tspring = &seed[SPRINGS];
    (void)p, (void)rotor, (void)spring, (void)gravity, (void)q, (void)dq, (void)ddq;
    (void)tp, (void)trotor, (void)tspring, (void)tgravity, (void)tq, (void)tdq;
{angles}
{statements}
}}
"""

_JACOBIAN = """\
/* Jacobian of the origin of the last joint's frame, in axes of the base. */
static void flange_jacobian(const double *__restrict q, double (*__restrict jacobian)[JOINTS]) {{
{angles}
    (void)q, (void)sine, (void)cosine; /* a frame need not move with all joints */
{statements}
}}
"""

_TOOL = """\
/* Pose of the last joint's frame, in axes of the base. */
static void store_tool(double *v, const double *q) {{
{angles}
    (void)q, (void)sine, (void)cosine;
{statements}
}}

/* Store the change along tq. */
SELDOM static void change_tool(double *v, const double *q, const double *tq) {{
{angles}
    (void)q, (void)tq, (void)sine, (void)cosine;
{changes}
}}
"""
