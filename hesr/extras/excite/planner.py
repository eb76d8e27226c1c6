"""Planner of safe motions for the body, for friction, and for tests; limits between setpoints."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import Any

import numpy as np
from pydantic import Field

from hesr.extras.excite.motion import PlannedMotion, Pulse, faded_chirp, moved, pulses
from hesr_model.errors import FitError, RobotError
from hesr_model.motions.excitation import ExcitationSettings, design, random_motions
from hesr_model.motions.limits import Limits, MotionLimits, Positive
from hesr_model.motions.trajectories import Trajectory
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Progress, silent

Plane = tuple[float, float, float, float]  # unit normal n and offset d [m]: n x >= d is free

_POSES = 400
_ALWAYS = 0.95  # random poses; links that touch in this share are not checked
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
        pin = self._pin
        links = self._geometry.ngeoms
        for k, (*normal, offset) in enumerate(planes, start=1):
            wall = pin.coal.Halfspace(np.array(normal), offset)
            place = pin.SE3.Identity()
            self._geometry.addGeometryObject(pin.GeometryObject(f"plane {k}", 0, place, wall))
        parents = list(self._model.parents)
        of = self._geometry.geometryObjects
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
            touching = self._touching(state, first=True)
            if any(touching):
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
        pin = self._pin
        found = self._pin.GeometryModel()
        tree = robot.tree
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


_BETWEEN = 3  # instants checked per setpoint
_STEP = 0.01  # [rad or m] summed motion of all joints between checks for contacts
_ROUNDING = 1e-9
_ALLOWED = 0.2  # default friction over the torque limit


class MotionSettings(ExcitationSettings):
    """Settings of planned motions."""

    start: tuple[float, ...] | None = None  # (n,) [rad or m]; near the middle of the ranges
    planes: tuple[Plane, ...] = ()  # floor and walls
    clearance: float = Field(default=0.03, ge=0)  # smallest distance between bodies [m]
    radius: Positive | None = None  # of the capsules around links without geometry [m]
    friction: tuple[float, ...] | None = None  # (n,) [N.m or N]; 20 % of the torque limit
    margin: float = Field(default=0.05, ge=0, lt=1)  # free share of all limits but position


class Guard:
    """Limits of a robot's motions: `stated`, and less margins and friction; contacts.

    Raises RobotError if a list of the settings has not one entry per joint.
    """

    def __init__(self, robot: Robot, settings: MotionSettings) -> None:
        for key in ("start", "friction"):
            entries = getattr(settings, key) or (0.0,) * robot.n
            if len(entries) != robot.n:
                raise RobotError(
                    f"key '{key}' has {len(entries)} entries; the {robot.n} joints of robot "
                    f"'{robot.name}' need one each."
                )
        self.robot = robot
        self.stated = Limits.of(robot, settings.limits)
        share = np.where(np.isfinite(self.stated.torque), _ALLOWED * self.stated.torque, 0.0)
        self.friction = np.array(settings.friction or share)
        kept = 1.0 - settings.margin
        self.limits = replace(
            self.stated,
            velocity=kept * self.stated.velocity,
            acceleration=kept * self.stated.acceleration,
            torque=kept * self.stated.torque - self.friction,
        )
        self.clearance = Clearance(
            robot, planes=settings.planes, margin=settings.clearance, radius=settings.radius
        )

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) [N.m] of the model file's rigid body."""
        return self.robot.torque(self.robot.nominal_parameters, q, dq, ddq)

    def fault(self, motion: Trajectory, rate: float) -> str:
        """Return the joint and the limit it exceeds, or bodies that touch; empty if safe."""
        t = np.linspace(0.0, motion.duration, _BETWEEN * round(motion.duration * rate) + 1)
        q, dq, ddq = motion.sample(t)
        limits = self.limits
        tau = self.torque(*(x[::_BETWEEN] for x in (q, dq, ddq)))
        for what, value, low, high in (
            ("position", q, limits.lower, limits.upper),
            ("velocity", dq, -limits.velocity, limits.velocity),
            ("acceleration", ddq, -limits.acceleration, limits.acceleration),
            ("torque", tau, -limits.torque, limits.torque),
        ):
            excess = np.maximum(low - value.min(axis=0), value.max(axis=0) - high)
            if np.any(over := excess > _ROUNDING * np.maximum(1.0, np.abs(high))):
                j = int(np.argmax(over))
                allowed = f" with {self.friction[j]:.3g} for friction" * (what == "torque")
                return (
                    f"joint '{self.robot.joints[j]}' needs a {what} of {excess[j]:.3g} beyond "
                    f"limits.{what} less its margin, {low[j]:.4g} to {high[j]:.4g}{allowed}"
                )
        way = np.cumsum(np.abs(np.diff(q, axis=0, prepend=q[:1])).sum(axis=1))
        _, rows = np.unique(np.floor(way / _STEP), return_index=True)
        found = self.clearance.contact(q[rows])
        if found:
            return f"'{found[1]}' comes too near to '{found[2]}' at {t[rows[found[0]]]:.1f} s"
        return ""


_USUAL_RATE = 200.0
_PAIRS = 12
_SHRINKS = 12
_SHRINK = 0.75
_NEIGHBOURS = 0.05  # free surroundings of the start pose over the ranges
_ROOM = 0.3  # largest stroke over the range of a joint
_PAUSE = 0.2
_HOLD = 0.4  # [s] at rest before a part; least time at a constant speed
_LEVELS = 10
_NESTED = 8
_RESTS = 4  # largest numbers of speeds, reversals and rests
_SET = 6.0
_RAMP = 0.1  # [s] of a set of reversals; shortest ramp of a velocity
_FINEST = 1.0 / 300.0  # smallest of the nested amplitudes over the largest
_BREAK_AWAY = 0.03  # speed after a slow break-away over the limit
_NO_LIMIT = 1e12  # [N.m] of a motion without torque limits
_NEAR = 1.5  # [s] at full speed: how far Fourier motions go from the start pose
_SHORTEST = 6.0  # [s] of the strokes in a pose

Groups = list[list[Pulse]]  # strokes that return to where they began


@dataclass(frozen=True, kw_only=True)
class Mix:
    """Shares of time of steady speeds, reversals and rests; speeds over the limit; reason."""

    steady: float = 0.85
    nested: float = 0.1
    rests: float = 0.05
    low: float = 0.1
    high: float = 1.0
    why: str = "all speeds, reversals and rests"


class Planner:
    """Plans motions from and to a `start` pose (n,) [rad] at a `rate` [Hz].

    Raises FitError if no start pose is free.
    """

    def __init__(self, guard: Guard, settings: MotionSettings) -> None:
        self.guard = guard
        self.settings = settings
        robot = guard.robot
        self.rate = settings.sample_rate or robot.description.log.sample_rate or _USUAL_RATE
        low = guard.limits.lower
        high = guard.limits.upper
        rng = np.random.default_rng(settings.seed)
        self._drawn = rng.uniform(low, high, (_POSES, robot.n))
        far = np.abs((self._drawn - 0.5 * (low + high)) / (high - low)).max(axis=1)
        free = [0.5 * (low + high), *self._drawn[np.argsort(far)]]
        around = _NEIGHBOURS * (high - low) * rng.uniform(-1.0, 1.0, (_PAIRS, robot.n))
        fault = ""
        for pose in [np.array(settings.start)] if settings.start else free:
            found = guard.fault(self._motion(np.tile(pose, (8, 1))), self.rate)
            if not found and (settings.start or not guard.clearance.contact(pose + around)):
                self.start = pose
                return
            fault = fault or found or "other poses near it are not"
        raise FitError(f"robot '{robot.name}': no start pose is free: {fault}; state 'start'.")

    def _motion(self, rows: Array, *parts: tuple[str, int, int]) -> PlannedMotion:
        timed = tuple((name, a / self.rate, b / self.rate) for name, a, b in parts)
        return PlannedMotion(rate=self.rate, rows=rows, parts=timed)

    def plan(self, purpose: str, time: float, *, progress: Progress = silent) -> PlannedMotion:
        """Plan a safe motion of `time` [s]; raise FitError naming the limit that forbids it."""
        if purpose == "friction":
            return self.friction(time, [Mix()] * self.guard.robot.n)
        count = round(time * self.rate) + 1
        chirp = self.start[None]
        if purpose == "test":
            t = np.arange(round(0.4 * count)) / self.rate
            chirp = faded_chirp(self.start, self.guard.limits, t)
        of_seed = None if purpose == "body" else self.settings.seed + 1
        fourier = self._fourier(count - len(chirp), of_seed, progress)
        pieces = [self._safe([self._motion(x)]).rows if len(x) > 1 else x for x in (chirp, fourier)]
        rows = np.concatenate(pieces)
        rows[[0, -1]] = self.start
        parts = ("chirp", 0, len(chirp)), ("Fourier motion", len(chirp), count)
        return self._safe([self._motion(rows, *parts[len(chirp) == 1 :])])

    def friction(self, time: float, mixes: Sequence[Mix]) -> PlannedMotion:
        """Plan strokes of each joint in two poses; see `plan`."""
        return self._safe(self.strokes(time, mixes))

    def _safe(self, motions: Iterable[PlannedMotion]) -> PlannedMotion:
        for motion in motions:
            fault = self.guard.fault(motion, self.rate)
            if not fault:
                return motion
        for k in range(1, _SHRINKS):
            rows = self.start + _SHRINK**k * (motion.rows - self.start)
            fault = self.guard.fault(smaller := replace(motion, rows=rows), self.rate)
            if not fault:
                return smaller
        raise FitError(f"robot '{self.guard.robot.name}': the limits allow no motion: {fault}.")

    def strokes(self, time: float, mixes: Sequence[Mix]) -> Iterator[PlannedMotion]:
        """Yield motions with strokes in two poses, the ones with different gravity first."""
        limits = self.guard.limits
        count = round(time * self.rate) + 1
        full = np.minimum(
            _ROOM * (limits.upper - limits.lower), 1.6 * limits.velocity**2 / limits.acceleration
        )
        for number, poses in enumerate([*self._poses(full), (self.start, self.start)]):
            path = (self.start, *poses, self.start)
            moves = [moved(a, b, limits, self.rate) for a, b in pairwise(path)]
            each = (count - 1 - sum(map(len, moves))) // 2
            budget = each / self.rate - 2.0 * _PAUSE
            if budget < _SHORTEST:
                raise FitError(
                    f"robot '{self.guard.robot.name}': {time:g} s are too short for strokes in two "
                    f"poses; they need at least {time - 2.0 * (budget - _SHORTEST):.0f} s."
                )
            t = np.arange(each) / self.rate - _PAUSE
            room = full * _SHRINK ** (number // 3)
            pieces = [
                pose
                + np.column_stack(
                    [
                        pulses(self._program(m, budget, room[j], j, k), t)
                        for j, m in enumerate(mixes)
                    ]
                )
                for k, pose in enumerate(poses)
            ]
            rows = np.vstack([self.start, moves[0], pieces[0], moves[1], pieces[1], moves[2]])
            rest = np.tile(self.start, (count - len(rows), 1))
            first = 1 + len(moves[0])
            second = 1 + len(moves[0]) + each + len(moves[1])
            parts = ("pose 1", first, first + each), ("pose 2", second, second + each)
            yield self._motion(np.vstack([rows, rest]), *parts)

    def _poses(self, room: Array) -> Iterator[tuple[Array, Array]]:
        """Yield free pairs of poses, far apart in gravity and near in position first."""
        guard = self.guard
        limits = self.guard.limits
        drawn = np.clip([self.start, *self._drawn], limits.lower + room, limits.upper - room)
        still = np.zeros_like(drawn)
        gravity = guard.torque(drawn, still, still)
        held = np.all(np.abs(gravity) <= limits.torque, axis=1)
        held &= [guard.clearance.contact(q[None]) is None for q in drawn]
        drawn, gravity = drawn[held], gravity[held]
        if not len(drawn):
            return
        size = 0.5 * np.ptp(gravity, axis=0)
        loaded = size > 1e-6 * max(1.0, float(size.max()))
        apart = np.abs(gravity[:, None] - gravity)[:, :, loaded] / size[loaded]
        place = (drawn - self.start) / (limits.upper - limits.lower)
        near = np.abs(place).max(axis=1)
        far = np.abs(place[:, None] - place).max(axis=2)
        worth = np.minimum(apart, 1.0).sum(axis=2) - far - near[:, None] - near
        for k in np.argsort(-worth, axis=None)[:_PAIRS]:
            a, b = np.unravel_index(k, worth.shape)
            yield drawn[a], drawn[b]

    def _program(self, mix: Mix, budget: float, room: float, joint: int, pose: int) -> list[Pulse]:
        """Return the strokes of a joint; joints and poses differ in order and direction."""
        limits = self.guard.limits
        reach = room, 0.98 * float(limits.velocity[joint]), 0.98 * float(limits.acceleration[joint])
        order = np.random.default_rng([self.settings.seed, joint, pose])
        placed = []
        # Every stretch of time has something of each kind, so that blocks of time can be compared.
        for groups in (
            _steady(mix, mix.steady * budget, *reach),
            _nest_strokes(mix.nested * budget, *reach),
            _rests(mix.rests * budget, *reach),
        ):
            order.shuffle(groups)
            shift = order.uniform()
            placed += [((k + shift) / len(groups), group) for k, group in enumerate(groups)]
        sign = -1.0 if (joint + pose) % 2 else 1.0
        ordered = chain.from_iterable(group for _, group in sorted(placed, key=lambda one: one[0]))
        return [(sign * speed, ramp, hold, rest) for speed, ramp, hold, rest in ordered]

    def _fourier(self, count: int, seed: int | None, progress: Progress) -> Array:
        """Return `count` rows of the best Fourier motion, or of a random one, from the start."""
        limits = self.guard.limits
        robot = self.guard.robot
        near = _NEAR * limits.velocity
        low = np.maximum(limits.lower, self.start - near)
        high = self.start + near
        period = count / self.rate
        allowed = MotionLimits(
            position=tuple(zip(low.tolist(), np.minimum(limits.upper, high).tolist(), strict=True)),
            velocity=tuple(limits.velocity.tolist()),
            acceleration=tuple(limits.acceleration.tolist()),
            torque=tuple(np.minimum(limits.torque, _NO_LIMIT).tolist()),
        )
        given = self.settings.model_copy(
            update={"period": (period, period), "sample_rate": self.rate, "limits": allowed}
        )
        if seed is None:
            motion = design(robot, given, progress=progress).motion
        else:
            (motion,) = random_motions(robot, given, 1, seed)
        q, _, _ = motion.sample(np.arange(1, count + 1) / self.rate)
        return np.asarray(q + self.start - motion.sample(np.zeros(1))[0])


def _steady(mix: Mix, time: float, room: float, speed: float, acceleration: float) -> Groups:
    """Return strokes there and back at speeds that rise by equal factors."""
    high = min(mix.high * speed, float(np.sqrt(room * acceleration / 1.5)))
    while high > 1e-3 * speed:
        for levels in range(_LEVELS, 1, -1):
            speeds = np.geomspace(min(mix.low * speed, 0.5 * high), high, levels)
            ramps = np.maximum(1.5 * speeds / acceleration, _RAMP)
            hold = (time - 4.0 * ramps.sum()) / (2.0 * levels)
            if hold < _HOLD:
                continue
            held = np.clip(room / speeds - ramps, 0.0, hold)
            rows = np.column_stack([speeds, ramps, held, hold - held])
            rows[1::2, 0] *= -1.0
            return [[(v, *times), (-v, *times)] for v, *times in rows.tolist()]
        high *= 0.7
    return []


def _nest_strokes(time: float, room: float, speed: float, acceleration: float) -> Groups:
    """Return sets of strokes with decreasing way, each within the one before, and one back."""
    sets = max(1, round(time / _SET))
    count = int(np.clip(time / sets / 0.6, 3, _NESTED))
    ramp = 0.5 * time / sets / (count + 1)
    largest = min(0.5 * room, acceleration * ramp**2 / 1.5, speed * ramp)
    ways = largest * np.geomspace(1.0, _FINEST, count) * (-1.0) ** np.arange(count)
    return [[(way / ramp, ramp, 0.0, 0.0) for way in [*ways.tolist(), -float(ways.sum())]]] * sets


def _rests(time: float, room: float, speed: float, acceleration: float) -> Groups:
    """Return rests of lengths that rise by equal factors, each after a slow break-away."""
    count = int(np.clip(time / 2.0, 1, _RESTS))
    ramp = min(1.0, time / (8.0 * count))
    lengths = np.geomspace(0.1, 1.0, 2 * count)
    waits = ((time - 4.0 * ramp * count) * lengths / lengths.sum()).tolist()
    v = min(_BREAK_AWAY * speed, acceleration * ramp / 1.5, room / ramp)
    pairs = zip(waits[::2], waits[1::2], strict=True)
    return [[(v, ramp, 0.0, short), (-v, ramp, 0.0, long)] for short, long in pairs]
