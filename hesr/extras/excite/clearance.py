"""Contacts between the links of a robot, and with planes such as floor and walls."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

Plane = tuple[float, float, float, float]  # unit normal n and offset d [m]: n x >= d is free

_POSES, _ALWAYS = 200, 0.95  # random poses; links that touch in this share are not checked
_WIDTH = 0.04  # default radius of a capsule over the length of the arm


class Clearance:
    """Contacts of links by the model's geometry, or by capsules that connect the joints.

    The geometry of a model file counts if all its meshes can be read (`exact`). Links with a common
    joint, and links that touch in nearly all poses, are not checked against each other; neither are
    planes and links before the second joint that always touch them. `margin` is the smallest
    distance [m], `radius` that of the capsules [m], by default 4 % of the arm's length.
    """

    def __init__(
        self, robot: Robot, *, planes: Sequence[Plane], margin: float, radius: float | None
    ) -> None:
        self._pin, self._model, self._data, self._configurations = robot.kinematics
        self.exact = robot.geometry is not None
        self._geometry: Any = robot.geometry or self._capsules(robot, radius)
        links = self._geometry.ngeoms
        for k, (*normal, offset) in enumerate(planes, start=1):
            wall, place = (
                self._pin.coal.Halfspace(np.array(normal), offset),
                self._pin.SE3.Identity(),
            )
            self._geometry.addGeometryObject(self._pin.GeometryObject(f"plane {k}", 0, place, wall))
        parents, of = list(self._model.parents), self._geometry.geometryObjects
        joint = [int(body.parentJoint) for body in of]
        pairs = [
            (a, b)
            for b in range(len(joint))
            for a in range(min(b, links))
            if joint[a] != joint[b]
            and (b >= links or (joint[b] != parents[joint[a]] and joint[a] != parents[joint[b]]))
        ]
        self._check(pairs, margin)
        low, high, _ = robot.reach
        poses = np.random.default_rng(0).uniform(low, high, (_POSES, robot.n))
        shares = sum(np.array(self._touching(q)) for q in self._configurations(poses)) / _POSES
        fixed = np.array([b < links or joint[a] <= 1 for a, b in pairs], dtype=bool)
        kept = ~((shares > _ALWAYS) & fixed)
        self._check([pair for pair, keep in zip(pairs, kept, strict=True) if keep], margin)

    def contact(self, q: Array) -> tuple[int, str, str] | None:
        """Return row and names of the first two bodies nearer than the margin on a path (N, n)."""
        for row, state in enumerate(self._configurations(q)):
            if any(touching := self._touching(state, first=True)):
                pair = self._geometry.collisionPairs[touching.index(True)]
                names = [body.name for body in self._geometry.geometryObjects]
                return row, names[pair.first], names[pair.second]
        return None

    def _touching(self, state: Array, *, first: bool = False) -> list[bool]:
        found = self._found
        self._pin.computeCollisions(self._model, self._data, self._geometry, found, state, first)
        return [bool(result.isCollision()) for result in found.collisionResults]

    def _check(self, pairs: Sequence[tuple[int, int]], margin: float) -> None:
        self._geometry.removeAllCollisionPairs()
        for pair in pairs:
            self._geometry.addCollisionPair(self._pin.CollisionPair(*pair))
        self._found: Any = self._geometry.createData()
        for request in self._found.collisionRequests:
            request.security_margin = margin

    def _capsules(self, robot: Robot, radius: float | None) -> Any:
        pin, found, tree = self._pin, self._pin.GeometryModel(), robot.tree
        ends = [(frame.parent + 1, frame.name, frame.translation) for frame in tree]
        tips = set(range(len(tree))) - {frame.parent for frame in tree}
        ends += [(k + 1, f"{tree[k].name} (end)", 2.0 * robot.bodies[k][1]) for k in tips]
        lengths = [float(np.linalg.norm(end)) for _, _, end in ends]
        width = radius or max(_WIDTH * sum(lengths), 1e-3)
        for (joint, name, end), size in zip(ends, lengths, strict=True):
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end)
            place = pin.SE3(turn.matrix() if size else np.eye(3), 0.5 * end)
            shape = pin.coal.Capsule(width, size)
            found.addGeometryObject(pin.GeometryObject(f"link to {name}", joint, place, shape))
        return found
