"""Planner of safe motions for the body, for friction, and for tests; limits between setpoints."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import itemgetter
from typing import Any

import numpy as np
from pydantic import Field

from hesr.extras.excite.motion import PlannedMotion, Pulse, compute_chirp, compute_pulses, plan_move
from hesr_model.errors import FitError, RobotError
from hesr_model.motions.excitation import ExcitationSettings, design, random_motions
from hesr_model.motions.limits import Limits, MotionLimits, Positive
from hesr_model.motions.trajectories import Trajectory
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Progress, silent

Plane = tuple[float, float, float, float]  # unit normal n and offset d [m]: n x >= d is free

_POSE_COUNT = 400
_ALWAYS_TOUCHING_SHARE = 0.95  # random poses; links that touch in this share are not checked
_CAPSULE_RADIUS_RATIO = 0.04  # default radius of a capsule over the length of the arm


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
        self._pin, self._pin_model, self._pin_data, self._configurations = robot.kinematics
        self.exact = robot.geometry is not None
        self._geometry: Any = robot.geometry or self._build_capsules(robot, radius)
        self._link_object_count = self._geometry.ngeoms
        self._add_planes(planes)
        parent_joints = [int(body.parentJoint) for body in self._geometry.geometryObjects]
        pairs = self._list_pairs(parent_joints)
        self._set_pairs(pairs, margin)
        touching_shares = self._measure_touching_shares(robot)
        checked_pairs = []
        for pair, touching_share in zip(pairs, touching_shares, strict=True):
            a, b = pair
            # Only links before the second joint may stand on a plane.
            may_touch = b < self._link_object_count or parent_joints[a] <= 1
            if not (may_touch and touching_share > _ALWAYS_TOUCHING_SHARE):
                checked_pairs.append(pair)
        self._set_pairs(checked_pairs, margin)

    def contact(self, q: Array) -> tuple[int, str, str] | None:
        """Return row and names of the first two bodies nearer than the margin on a path (N, n)."""
        for row, state in enumerate(self._configurations(q)):
            touching = self._test_contacts(state, first=True)
            if any(touching):
                pair = self._geometry.collisionPairs[touching.index(True)]
                names = [body.name for body in self._geometry.geometryObjects]
                return row, names[pair.first], names[pair.second]
        return None

    def _add_planes(self, planes: Sequence[Plane]) -> None:
        """Append the planes to the geometry, fixed to the world."""
        pin = self._pin
        for number, (*normal, offset) in enumerate(planes, start=1):
            wall = pin.coal.Halfspace(np.array(normal), offset)
            placement = pin.SE3.Identity()
            self._geometry.addGeometryObject(
                pin.GeometryObject(f"plane {number}", 0, placement, wall)
            )

    def _list_pairs(self, parent_joints: Sequence[int]) -> list[tuple[int, int]]:
        """Return pairs of links without a common joint, and of links and planes."""
        parents = list(self._pin_model.parents)
        pairs = []
        for b, joint_b in enumerate(parent_joints):
            is_plane = b >= self._link_object_count
            for a, joint_a in enumerate(parent_joints[: min(b, self._link_object_count)]):
                are_neighbours = joint_b == parents[joint_a] or joint_a == parents[joint_b]
                if joint_a != joint_b and (is_plane or not are_neighbours):
                    pairs.append((a, b))
        return pairs

    def _measure_touching_shares(self, robot: Robot) -> Array:
        """Return the share of random poses in which each pair touches."""
        lower, upper, _ = robot.reach
        poses = np.random.default_rng(0).uniform(lower, upper, (_POSE_COUNT, robot.n))
        contacts = [self._test_contacts(state) for state in self._configurations(poses)]
        return np.asarray(np.sum(contacts, axis=0) / _POSE_COUNT)

    def _test_contacts(self, state: Array, *, first: bool = False) -> list[bool]:
        self._pin.computeCollisions(
            self._pin_model, self._pin_data, self._geometry, self._collision_data, state, first
        )
        return [bool(result.isCollision()) for result in self._collision_data.collisionResults]

    def _set_pairs(self, pairs: Sequence[tuple[int, int]], margin: float) -> None:
        self._geometry.removeAllCollisionPairs()
        for pair in pairs:
            self._geometry.addCollisionPair(self._pin.CollisionPair(*pair))
        self._collision_data: Any = self._geometry.createData()
        for request in self._collision_data.collisionRequests:
            request.security_margin = margin

    def _build_capsules(self, robot: Robot, radius: float | None) -> Any:
        pin = self._pin
        geometry = self._pin.GeometryModel()
        tree = robot.tree
        ends = [(frame.parent + 1, frame.name, frame.translation) for frame in tree]
        tips = set(range(len(tree))) - {frame.parent for frame in tree}
        ends += [(k + 1, f"{tree[k].name} (end)", 2.0 * robot.bodies[k][1]) for k in tips]
        lengths = [float(np.linalg.norm(end)) for _, _, end in ends]
        capsule_radius = radius or max(_CAPSULE_RADIUS_RATIO * sum(lengths), 1e-3)
        for (joint_id, name, end), length in zip(ends, lengths, strict=True):
            rotation = np.eye(3)
            if length:  # the direction of a point is undefined
                rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end).matrix()
            placement = pin.SE3(rotation, 0.5 * end)
            shape = pin.coal.Capsule(capsule_radius, length)
            geometry.addGeometryObject(
                pin.GeometryObject(f"link to {name}", joint_id, placement, shape)
            )
        return geometry


_CHECKS_PER_SETPOINT = 3  # instants checked per setpoint
_CONTACT_STEP = 0.01  # [rad or m] summed motion of all joints between checks for contacts
_ROUNDING_TOLERANCE = 1e-9
_FRICTION_SHARE = 0.2  # default friction over the torque limit


class MotionSettings(ExcitationSettings):
    """Settings of planned motions."""

    start: tuple[float, ...] | None = None  # (n,) [rad or m]; near the middle of the ranges
    planes: tuple[Plane, ...] = ()  # floor and walls
    clearance: float = Field(default=0.03, ge=0)  # smallest distance between bodies [m]
    radius: Positive | None = None  # of the capsules around links without geometry [m]
    friction: tuple[float, ...] | None = None  # (n,) [N.m or N]; 20 % of the torque limit
    margin: float = Field(default=0.05, ge=0, lt=1)  # free share of all limits but position


class Guard:
    """Limits of a robot's motions: `stated_limits`, and less margins and friction; contacts.

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
        self.stated_limits = Limits.from_settings(robot, settings.limits)
        default_friction = np.where(
            np.isfinite(self.stated_limits.torque), _FRICTION_SHARE * self.stated_limits.torque, 0.0
        )
        self.friction = np.array(settings.friction or default_friction)
        usable_share = 1.0 - settings.margin
        self.limits = replace(
            self.stated_limits,
            velocity=usable_share * self.stated_limits.velocity,
            acceleration=usable_share * self.stated_limits.acceleration,
            torque=usable_share * self.stated_limits.torque - self.friction,
        )
        self.clearance = Clearance(
            robot, planes=settings.planes, margin=settings.clearance, radius=settings.radius
        )

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) [N.m] of the model file's rigid body."""
        return self.robot.torque(self.robot.nominal_parameters, q, dq, ddq)

    def find_fault(self, motion: Trajectory, rate: float) -> str:
        """Return the joint and the limit it exceeds, or bodies that touch; empty if safe."""
        t = np.linspace(
            0.0, motion.duration, _CHECKS_PER_SETPOINT * round(motion.duration * rate) + 1
        )
        q, dq, ddq = motion.sample(t)
        return self._find_exceeded_limit(q, dq, ddq) or self._find_contact(t, q)

    def _find_exceeded_limit(self, q: Array, dq: Array, ddq: Array) -> str:
        """Return the first limit that samples (N, n) exceed, with its joint; empty if none."""
        limits = self.limits
        # Torques are checked at setpoints, the others also between them.
        tau = self.torque(
            q[::_CHECKS_PER_SETPOINT], dq[::_CHECKS_PER_SETPOINT], ddq[::_CHECKS_PER_SETPOINT]
        )
        for quantity, samples, lower, upper in (
            ("position", q, limits.lower, limits.upper),
            ("velocity", dq, -limits.velocity, limits.velocity),
            ("acceleration", ddq, -limits.acceleration, limits.acceleration),
            ("torque", tau, -limits.torque, limits.torque),
        ):
            excess = np.maximum(lower - samples.min(axis=0), samples.max(axis=0) - upper)
            is_exceeded = excess > _ROUNDING_TOLERANCE * np.maximum(1.0, np.abs(upper))
            if not np.any(is_exceeded):
                continue
            j = int(np.argmax(is_exceeded))
            fault = (
                f"joint '{self.robot.joints[j]}' needs a {quantity} of {excess[j]:.3g} beyond "
                f"limits.{quantity} less its margin, {lower[j]:.4g} to {upper[j]:.4g}"
            )
            if quantity == "torque":
                fault += f" with {self.friction[j]:.3g} for friction"
            return fault
        return ""

    def _find_contact(self, t: Array, q: Array) -> str:
        """Return the first bodies that come too near along positions (N, n); empty if none."""
        travel = np.cumsum(np.abs(np.diff(q, axis=0, prepend=q[:1])).sum(axis=1))
        _, rows = np.unique(np.floor(travel / _CONTACT_STEP), return_index=True)
        contact = self.clearance.contact(q[rows])
        if contact is None:
            return ""
        row, body, other_body = contact
        return f"'{body}' comes too near to '{other_body}' at {t[rows[row]]:.1f} s"


_USUAL_RATE = 200.0
_PAIR_COUNT = 12
_MAX_SHRINKS = 12
_SHRINK_FACTOR = 0.75
_NEIGHBOUR_RANGE = 0.05  # free surroundings of the start pose over the ranges
_MAX_STROKE_SHARE = 0.3  # largest stroke over the range of a joint
_PAUSE = 0.2  # [s] at rest before a part
_MIN_HOLD = 0.4  # [s] at a constant speed
_MAX_SPEEDS = 10
_MAX_REVERSALS = 8
_MAX_RESTS = 4
_SET_DURATION = 6.0  # [s] of a set of reversals
_MIN_RAMP = 0.1  # [s] of a velocity
_MIN_AMPLITUDE_RATIO = 1.0 / 300.0  # smallest of the nested amplitudes over the largest
_BREAK_AWAY_SPEED_RATIO = 0.03  # speed after a slow break-away over the limit
_NO_LIMIT = 1e12  # [N.m] of a motion without torque limits
_FOURIER_REACH = 1.5  # [s] at full speed: how far Fourier motions go from the start pose
_MIN_STROKE_TIME = 6.0  # [s] of the strokes in a pose

Groups = list[list[Pulse]]  # strokes that return to where they began


@dataclass(frozen=True, kw_only=True)
class Mix:
    """Shares of time of steady speeds, reversals and rests; speeds over the limit; reason."""

    steady: float = 0.85
    nested: float = 0.1
    rests: float = 0.05
    low: float = 0.1
    high: float = 1.0
    reason: str = "all speeds, reversals and rests"


class Planner:
    """Plans motions from and to a `start` pose (n,) [rad] at a `rate` [Hz].

    Raises FitError if no start pose is free.
    """

    def __init__(self, guard: Guard, settings: MotionSettings) -> None:
        self.guard = guard
        self.settings = settings
        robot = guard.robot
        self.rate = settings.sample_rate or robot.description.log.sample_rate or _USUAL_RATE
        rng = np.random.default_rng(settings.seed)
        self._random_poses = rng.uniform(
            guard.limits.lower, guard.limits.upper, (_POSE_COUNT, robot.n)
        )
        if settings.start:
            self.start = np.array(settings.start)
            fault = self._find_pose_fault(self.start)
            if fault:
                raise _refuse_start(robot, fault)
        else:
            self.start = self._choose_start(rng.uniform(-1.0, 1.0, (_PAIR_COUNT, robot.n)))

    def _choose_start(self, directions: Array) -> Array:
        """Return the free pose (n,) nearest to the middle of the ranges.

        Poses near it, in `directions` (N, n) within -1 to 1, must be free as well.
        """
        lower = self.guard.limits.lower
        upper = self.guard.limits.upper
        middle = 0.5 * (lower + upper)
        distances = np.abs((self._random_poses - middle) / (upper - lower)).max(axis=1)
        neighbours = _NEIGHBOUR_RANGE * (upper - lower) * directions
        first_fault = ""
        for pose in [middle, *self._random_poses[np.argsort(distances)]]:
            fault = self._find_pose_fault(pose)
            if not fault and self.guard.clearance.contact(pose + neighbours):
                fault = "other poses near it are not"
            if not fault:
                return np.asarray(pose)
            first_fault = first_fault or fault
        raise _refuse_start(self.guard.robot, first_fault)

    def _find_pose_fault(self, pose: Array) -> str:
        """Return what forbids a rest in a pose (n,), empty if nothing does."""
        standstill = np.tile(pose, (8, 1))
        return self.guard.find_fault(self._build_motion(standstill), self.rate)

    def _build_motion(self, rows: Array, *parts: tuple[str, int, int]) -> PlannedMotion:
        timed_parts = tuple(
            (name, first / self.rate, last / self.rate) for name, first, last in parts
        )
        return PlannedMotion(rate=self.rate, rows=rows, parts=timed_parts)

    def plan(self, purpose: str, time: float, *, progress: Progress = silent) -> PlannedMotion:
        """Plan a safe motion of `time` [s]; raise FitError naming the limit that forbids it."""
        if purpose == "friction":
            return self.friction(time, [Mix()] * self.guard.robot.n)
        row_count = round(time * self.rate) + 1
        chirp = self.start[None]
        parts = []
        if purpose == "test":
            t = np.arange(round(0.4 * row_count)) / self.rate
            chirp = compute_chirp(self.start, self.guard.limits, t)
            parts.append(("chirp", 0, len(chirp)))
        random_seed = None
        if purpose != "body":
            random_seed = self.settings.seed + 1
        fourier = self._plan_fourier(row_count - len(chirp), random_seed, progress)
        parts.append(("Fourier motion", len(chirp), row_count))
        # Each piece shrinks by itself, so that a fault of one leaves the other as large as it is.
        rows = np.concatenate([self._make_safe(chirp), self._make_safe(fourier)])
        rows[[0, -1]] = self.start
        return self._choose_safe_motion([self._build_motion(rows, *parts)])

    def _make_safe(self, rows: Array) -> Array:
        """Return rows (N, n), shrunk towards the start pose until they are safe."""
        if len(rows) == 1:  # the start pose, which is safe and no motion
            return rows
        return self._choose_safe_motion([self._build_motion(rows)]).rows

    def friction(self, time: float, mixes: Sequence[Mix]) -> PlannedMotion:
        """Plan strokes of each joint in two poses; see `plan`."""
        return self._choose_safe_motion(self.strokes(time, mixes))

    def _choose_safe_motion(self, motions: Iterable[PlannedMotion]) -> PlannedMotion:
        for motion in motions:
            fault = self.guard.find_fault(motion, self.rate)
            if not fault:
                return motion
        for k in range(1, _MAX_SHRINKS):
            rows = self.start + _SHRINK_FACTOR**k * (motion.rows - self.start)
            smaller_motion = replace(motion, rows=rows)
            fault = self.guard.find_fault(smaller_motion, self.rate)
            if not fault:
                return smaller_motion
        raise FitError(f"robot '{self.guard.robot.name}': the limits allow no motion: {fault}.")

    def strokes(self, time: float, mixes: Sequence[Mix]) -> Iterator[PlannedMotion]:
        """Yield motions with strokes in two poses, the ones with different gravity first."""
        limits = self.guard.limits
        row_count = round(time * self.rate) + 1
        longest_strokes = np.minimum(
            _MAX_STROKE_SHARE * (limits.upper - limits.lower),
            1.6 * limits.velocity**2 / limits.acceleration,
        )
        pose_pairs = [*self._find_pose_pairs(longest_strokes), (self.start, self.start)]
        for number, poses in enumerate(pose_pairs):
            path = (self.start, *poses, self.start)
            moves = [plan_move(a, b, limits, self.rate) for a, b in pairwise(path)]
            pose_rows = (row_count - 1 - sum(map(len, moves))) // 2
            budget = pose_rows / self.rate - 2.0 * _PAUSE
            if budget < _MIN_STROKE_TIME:
                raise FitError(
                    f"robot '{self.guard.robot.name}': {time:g} s are too short for strokes in two "
                    f"poses; they need at least {time - 2.0 * (budget - _MIN_STROKE_TIME):.0f} s."
                )
            t = np.arange(pose_rows) / self.rate - _PAUSE
            # Shorter strokes after every third pair: another pair may be free with long ones.
            stroke_lengths = longest_strokes * _SHRINK_FACTOR ** (number // 3)
            pieces = []
            for k, pose in enumerate(poses):
                programs = [
                    self._plan_program(mix, budget, stroke_lengths[j], j, k)
                    for j, mix in enumerate(mixes)
                ]
                columns = [compute_pulses(program, t) for program in programs]
                pieces.append(pose + np.column_stack(columns))
            rows = np.vstack([self.start, moves[0], pieces[0], moves[1], pieces[1], moves[2]])
            standstill = np.tile(self.start, (row_count - len(rows), 1))
            first = 1 + len(moves[0])
            second = first + pose_rows + len(moves[1])
            parts = [("pose 1", first, first + pose_rows), ("pose 2", second, second + pose_rows)]
            yield self._build_motion(np.vstack([rows, standstill]), *parts)

    def _find_pose_pairs(self, room: Array) -> Iterator[tuple[Array, Array]]:
        """Yield free pairs of poses, far apart in gravity and near in position first."""
        guard = self.guard
        limits = self.guard.limits
        poses = np.clip([self.start, *self._random_poses], limits.lower + room, limits.upper - room)
        standstill = np.zeros_like(poses)
        gravity = guard.torque(poses, standstill, standstill)
        is_held = np.all(np.abs(gravity) <= limits.torque, axis=1)
        is_held &= [guard.clearance.contact(q[None]) is None for q in poses]
        poses, gravity = poses[is_held], gravity[is_held]
        if not len(poses):
            return
        gravity_range = 0.5 * np.ptp(gravity, axis=0)
        is_loaded = gravity_range > 1e-6 * max(1.0, float(gravity_range.max()))
        gravity_distance = (
            np.abs(gravity[:, None] - gravity)[:, :, is_loaded] / gravity_range[is_loaded]
        )
        relative_position = (poses - self.start) / (limits.upper - limits.lower)
        start_distance = np.abs(relative_position).max(axis=1)
        pose_distance = np.abs(relative_position[:, None] - relative_position).max(axis=2)
        pair_score = (
            np.minimum(gravity_distance, 1.0).sum(axis=2)
            - pose_distance
            - start_distance[:, None]
            - start_distance
        )
        for k in np.argsort(-pair_score, axis=None)[:_PAIR_COUNT]:
            a, b = np.unravel_index(k, pair_score.shape)
            yield poses[a], poses[b]

    def _plan_program(self, mix: Mix, budget: float, room: float, j: int, pose: int) -> list[Pulse]:
        """Return the strokes of a joint; joints and poses differ in order and direction."""
        limits = self.guard.limits
        joint_limits = room, 0.98 * float(limits.velocity[j]), 0.98 * float(limits.acceleration[j])
        order = np.random.default_rng([self.settings.seed, j, pose])
        placed_groups = []
        # Every stretch of time has something of each kind, so that blocks of time can be compared.
        for groups in (
            _plan_steady_strokes(mix, mix.steady * budget, *joint_limits),
            _nest_strokes(mix.nested * budget, *joint_limits),
            _plan_rests(mix.rests * budget, *joint_limits),
        ):
            order.shuffle(groups)
            phase = order.uniform()
            for k, group in enumerate(groups):
                placed_groups.append(((k + phase) / len(groups), group))
        placed_groups.sort(key=itemgetter(0))
        sign = -1.0 if (j + pose) % 2 else 1.0
        program = []
        for _, group in placed_groups:
            for speed, ramp, hold, pause in group:
                program.append((sign * speed, ramp, hold, pause))
        return program

    def _plan_fourier(self, row_count: int, seed: int | None, progress: Progress) -> Array:
        """Return `row_count` rows of the best Fourier motion, or of a random one."""
        limits = self.guard.limits
        robot = self.guard.robot
        reach = _FOURIER_REACH * limits.velocity
        lower = np.maximum(limits.lower, self.start - reach)
        upper = np.minimum(limits.upper, self.start + reach)
        period = row_count / self.rate
        motion_limits = MotionLimits(
            position=tuple(zip(lower.tolist(), upper.tolist(), strict=True)),
            velocity=tuple(limits.velocity.tolist()),
            acceleration=tuple(limits.acceleration.tolist()),
            torque=tuple(np.minimum(limits.torque, _NO_LIMIT).tolist()),
        )
        motion_settings = self.settings.model_copy(
            update={"period": (period, period), "sample_rate": self.rate, "limits": motion_limits}
        )
        if seed is None:
            motion = design(robot, motion_settings, progress=progress).motion
        else:
            (motion,) = random_motions(robot, motion_settings, 1, seed)
        q, _, _ = motion.sample(np.arange(1, row_count + 1) / self.rate)
        return np.asarray(q + self.start - motion.sample(np.zeros(1))[0])


def _refuse_start(robot: Robot, fault: str) -> FitError:
    return FitError(f"robot '{robot.name}': no start pose is free: {fault}; state 'start'.")


def _plan_steady_strokes(
    mix: Mix, time: float, room: float, speed: float, acceleration: float
) -> Groups:
    """Return strokes there and back at speeds that rise by equal factors."""
    top_speed = min(mix.high * speed, float(np.sqrt(room * acceleration / 1.5)))
    while top_speed > 1e-3 * speed:
        for speed_count in range(_MAX_SPEEDS, 1, -1):
            speeds = np.geomspace(min(mix.low * speed, 0.5 * top_speed), top_speed, speed_count)
            ramps = np.maximum(1.5 * speeds / acceleration, _MIN_RAMP)
            hold = (time - 4.0 * ramps.sum()) / (2.0 * speed_count)
            if hold < _MIN_HOLD:
                continue
            hold_times = np.clip(room / speeds - ramps, 0.0, hold)
            rows = np.column_stack([speeds, ramps, hold_times, hold - hold_times])
            rows[1::2, 0] *= -1.0
            return [[(velocity, *times), (-velocity, *times)] for velocity, *times in rows.tolist()]
        top_speed *= 0.7
    return []


def _nest_strokes(time: float, room: float, speed: float, acceleration: float) -> Groups:
    """Return sets of strokes with decreasing way, each within the one before, and one back."""
    set_count = max(1, round(time / _SET_DURATION))
    stroke_count = int(np.clip(time / set_count / 0.6, 3, _MAX_REVERSALS))
    ramp = 0.5 * time / set_count / (stroke_count + 1)
    largest = min(0.5 * room, acceleration * ramp**2 / 1.5, speed * ramp)
    amplitudes = (
        largest
        * np.geomspace(1.0, _MIN_AMPLITUDE_RATIO, stroke_count)
        * (-1.0) ** np.arange(stroke_count)
    )
    way_back = -float(amplitudes.sum())
    strokes = [(amplitude / ramp, ramp, 0.0, 0.0) for amplitude in [*amplitudes.tolist(), way_back]]
    return [strokes] * set_count


def _plan_rests(time: float, room: float, speed: float, acceleration: float) -> Groups:
    """Return rests of lengths that rise by equal factors, each after a slow break-away."""
    rest_count = int(np.clip(time / 2.0, 1, _MAX_RESTS))
    ramp = min(1.0, time / (8.0 * rest_count))
    lengths = np.geomspace(0.1, 1.0, 2 * rest_count)
    waits = ((time - 4.0 * ramp * rest_count) * lengths / lengths.sum()).tolist()
    slow_speed = min(_BREAK_AWAY_SPEED_RATIO * speed, acceleration * ramp / 1.5, room / ramp)
    pairs = zip(waits[::2], waits[1::2], strict=True)
    return [
        [(slow_speed, ramp, 0.0, short_wait), (-slow_speed, ramp, 0.0, long_wait)]
        for short_wait, long_wait in pairs
    ]
