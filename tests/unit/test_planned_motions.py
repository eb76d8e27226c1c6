"""Planned motions of random robots: no limit is exceeded and nothing touches, checked densely."""

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from hesr.extras.excite.motion import PlannedMotion, compute_pulses
from hesr.extras.excite.planner import Clearance, Guard, MotionSettings, Planner
from hesr_model.errors import FitError, RobotError
from hesr_model.motions.limits import MotionLimits
from hesr_model.robots.robot import Robot

LIMITS = {"position": ((-2.0, 2.0),) * 3, "velocity": (2.0,) * 3}
DENSE = 7  # instants per setpoint, prime to those of the planner


class Arm:
    """A random chain of capsules, its URDF, and its own kinematics."""

    def __init__(self, rng: np.random.Generator, folder: Path) -> None:
        self.n = int(rng.integers(2, 7))
        self.slides = rng.uniform(size=self.n) < 0.1
        self.offsets = rng.uniform(-0.35, 0.35, (self.n, 3))
        self.offsets[0] = [0.0, 0.0, rng.uniform(0.3, 0.6)]
        self.axes = np.eye(3)[rng.integers(0, 3, self.n)]
        self.com = rng.uniform(-0.15, 0.15, (self.n, 3))
        self.masses = rng.uniform(0.3, 6.0, self.n)
        reach = rng.uniform(0.6, 3.0, self.n)
        self.speed = rng.uniform(0.5, 3.0, self.n)
        self.effort = rng.uniform(20.0, 400.0, self.n)
        inertia = 0.02
        parts = ['<robot name="r"><link name="l0"/>']
        for k in range(self.n):
            parts += [
                f'<link name="l{k + 1}"><inertial><origin xyz="{_text(self.com[k])}"/>'
                f'<mass value="{self.masses[k]:.17g}"/><inertia ixx="{inertia}" iyy="{inertia}" '
                f'izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
                f'<joint name="j{k + 1}" type="{"prismatic" if self.slides[k] else "revolute"}">'
                f'<parent link="l{k}"/><child link="l{k + 1}"/>'
                f'<origin xyz="{_text(self.offsets[k])}"/><axis xyz="{_text(self.axes[k])}"/>'
                f'<limit lower="{-reach[k]:.17g}" upper="{reach[k]:.17g}" '
                f'velocity="{self.speed[k]:.17g}" effort="{self.effort[k]:.17g}"/></joint>'
            ]
        self.urdf = folder / "r.urdf"
        self.urdf.write_text("".join([*parts, "</robot>"]), encoding="utf-8")
        ends = [*self.offsets, 2.0 * self.com[-1]]
        self.radius = 0.04 * sum(np.linalg.norm(end) for end in ends)
        self.reach = reach

    def capsules(self, q: np.ndarray) -> np.ndarray:
        """Return the ends (n + 1, 2, 3) of the capsules' axes."""
        turn, place, found = np.eye(3), np.zeros(3), []
        for k in range(self.n):
            joint = place + turn @ self.offsets[k]
            found.append((place, joint))
            if self.slides[k]:
                joint = joint + turn @ self.axes[k] * q[k]
            else:
                turn = turn @ _rotation(self.axes[k], q[k])
            place = joint
        return np.array([*found, (place, place + turn @ (2.0 * self.com[-1]))])

    def distances(self, q: np.ndarray, floor: float) -> np.ndarray:
        """Return distances of all pairs of links without a common joint, and from the floor."""
        ends = self.capsules(q)
        pairs = [(a, b) for a, b in combinations(range(self.n + 1), 2) if b - a > 1]
        between = [_apart(ends[a], ends[b]) - 2.0 * self.radius for a, b in pairs]
        return np.array([*between, *(ends[:, :, 2].min(axis=1) - self.radius - floor)])


def _text(values: np.ndarray) -> str:
    return " ".join(f"{x:.17g}" for x in values)


def _rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """Return the distance of two segments: the minimum over one of a piecewise quadratic."""
    u, v, w = one[1] - one[0], other[1] - other[0], one[0] - other[0]
    a, b, c, d, e = u @ u, u @ v, v @ v, u @ w, v @ w
    best = np.inf
    bases = [0.0, 1.0]
    if a * c - b * b > 1e-14:
        bases.append((b * e - c * d) / (a * c - b * b))
    bases += [-d / a, (b - d) / a] if a > 1e-14 else []
    for s in np.clip(bases, 0.0, 1.0):
        t = np.clip((b * s + e) / c, 0.0, 1.0) if c > 1e-14 else 0.0
        best = min(best, float(np.linalg.norm(w + s * u - t * v)))
    return best


def checked(seed: int, folder: Path) -> str:
    """Plan a motion of a random robot and check it; return what became of it."""
    rng = np.random.default_rng(seed)
    arm = Arm(rng, folder)
    robot = Robot(arm.urdf)
    floor = float(rng.uniform(-0.6, 0.0))
    settings = MotionSettings(
        planes=((0.0, 0.0, 1.0, floor),),
        seed=seed,
        margin=float(rng.uniform(0.0, 0.2)),
        sample_rate=float(rng.choice([100.0, 125.0, 200.0])),
        friction=tuple(rng.uniform(0.0, 8.0, robot.n).tolist()),
        limits=MotionLimits(acceleration=tuple((arm.speed * rng.uniform(0.7, 3.0)).tolist())),
        harmonics=3,
        starts=1,
    )
    purpose = str(rng.choice(["friction", "test", "body"], p=[0.6, 0.35, 0.05]))
    time = float(rng.uniform(20.0, 45.0))
    try:
        guard = Guard(robot, settings)
        motion = Planner(guard, settings).plan(purpose, time)
    except FitError as error:
        text = str(error)
        assert any(f"'{joint}'" in text for joint in robot.joints) or " too " in text, text
        return "refused"
    stated = guard.stated_limits
    count = DENSE * (len(motion.rows) - 1) + 1
    assert motion.duration == pytest.approx(time, abs=0.51 / motion.rate)
    q, dq, ddq = motion.sample(np.linspace(0.0, motion.duration, count))
    kept = 1.0 - 0.5 * settings.margin
    assert np.all(q >= stated.lower - 1e-6)
    assert np.all(q <= stated.upper + 1e-6)
    assert np.all(np.abs(dq) <= kept * stated.velocity + 1e-6)
    assert np.all(np.abs(ddq) <= kept * stated.acceleration + 1e-6)
    model = pin.buildModelFromUrdf(str(arm.urdf))
    data = model.createData()
    some = slice(None, None, 5)
    tau = np.array(
        [pin.rnea(model, data, *row) for row in zip(q[some], dq[some], ddq[some], strict=True)]
    )
    assert np.all(np.abs(tau) + settings.friction <= kept * stated.torque + 1e-6)
    random = rng.uniform(-arm.reach, arm.reach, (300, arm.n))
    usual = np.mean([arm.distances(pose, floor) < 0.03 for pose in random], axis=0)
    way = np.cumsum(np.abs(np.diff(q, axis=0, prepend=q[:1])).sum(axis=1))
    _, rows = np.unique(np.floor(way / 0.004), return_index=True)
    least = np.min(
        [arm.distances(pose, floor) for pose in q[rows[:: max(1, len(rows) // 1500)]]], axis=0
    )
    assert np.all(least[usual < 0.9] > 0.0)
    return "planned"


@pytest.mark.parametrize(
    "seeds",
    [range(3), pytest.param(range(1000), marks=[pytest.mark.soak, pytest.mark.timeout(0)])],
    ids=["few", "many"],
)
def test_no_limit_is_exceeded(seeds: range, tmp_path: Path) -> None:
    found = [checked(seed, tmp_path) for seed in seeds]
    assert found.count("planned") >= 0.6 * len(found)


def test_motions_start_and_end_at_rest_with_continuous_acceleration(tmp_path: Path) -> None:
    robot = Robot(Arm(np.random.default_rng(1), tmp_path).urdf)
    settings = MotionSettings(friction=(0.0,) * robot.n, harmonics=3, starts=1)
    planner = Planner(Guard(robot, settings), settings)
    for purpose in ("friction", "test", "body"):
        motion = planner.plan(purpose, 40.0)
        t, q, dq, ddq = motion.setpoints()
        assert t[0] == 0.0
        assert t[-1] == 40.0
        for row in (0, -1):
            np.testing.assert_array_equal(q[row], planner.start)
            np.testing.assert_array_equal([dq[row], ddq[row]], 0.0)
        inside = motion.sample(t[[0, -1]])
        np.testing.assert_allclose([inside[1], inside[2]], 0.0, atol=1e-9)
        left, right = motion.sample(t[1:-1] - 1e-7)[2], motion.sample(t[1:-1] + 1e-7)[2]
        np.testing.assert_allclose(left, right, atol=1e-3)
        np.testing.assert_allclose(
            np.gradient(q, t, axis=0)[2:-2],
            dq[2:-2],
            atol=0.02 * planner.guard.limits.velocity.max(),
        )


def test_pulses_travel_speed_times_ramp_and_hold() -> None:
    program = [(0.5, 0.2, 1.0, 0.3), (-0.2, 0.1, 0.0, 0.0)]
    t = np.linspace(0.0, 2.0, 2001)
    way = compute_pulses(program, t)
    assert way[0] == 0.0
    assert way[1550] == pytest.approx(0.5 * 1.2)  # at rest after the first
    assert way[-1] == pytest.approx(0.5 * 1.2 - 0.2 * 0.1)
    speed = np.gradient(way, t)
    assert speed.max() == pytest.approx(0.5, abs=1e-6)
    assert np.abs(np.gradient(speed, t)).max() == pytest.approx(1.5 * 0.5 / 0.2, rel=1e-2)


def test_strokes_reach_every_speed_in_both_directions_in_two_poses(arm_model: Robot) -> None:
    settings = MotionSettings(limits=MotionLimits.model_validate(LIMITS))
    planner = Planner(Guard(arm_model, settings), settings)
    motion = planner.plan("friction", 60.0)
    t, q, dq, _ = motion.setpoints()
    (_, first, last), (_, again, end) = motion.parts
    still = np.zeros((1, 3))
    gravity = [
        planner.guard.torque(q[[round(at * motion.rate)]], still, still)[0] for at in (first, again)
    ]
    assert np.abs(gravity[0] - gravity[1]).max() > 0.2 * np.abs(gravity).max()
    for low, high in ((first, last), (again, end)):
        rows = (t >= low) & (t < high)
        for joint in range(3):
            for sign in (1.0, -1.0):
                speeds = sign * dq[rows, joint] / planner.guard.stated_limits.velocity[joint]
                found = {int(k) for k in np.floor(np.log2(speeds[speeds > 0.05] / 0.05))}
                assert {0, 1, 2} <= found
            assert np.mean(dq[rows, joint] == 0.0) < 0.4


def plan(robot: Robot, purpose: str = "friction", time: float = 60.0, **more: Any) -> PlannedMotion:
    limits = LIMITS | more.pop("limits", {})
    settings = MotionSettings.model_validate({"limits": limits, **more})
    guard = Guard(robot, settings)
    return Planner(guard, settings).plan(purpose, time)


def test_impossible_requests_name_joint_and_limit(arm_model: Robot) -> None:
    joint = arm_model.joints[1]
    with pytest.raises(FitError, match=rf"'{joint}' needs a torque of .* for friction"):
        plan(arm_model, limits={"torque": (1e3, 1e-3, 1e3)})
    with pytest.raises(FitError, match="too short for strokes in two"):
        plan(arm_model, time=5.0)
    with pytest.raises(FitError, match="no start pose is free"):
        plan(arm_model, "body", planes=[(0.0, 0.0, 1.0, 50.0)])
    with pytest.raises(RobotError, match="key 'start' has 1 entries"):
        plan(arm_model, start=(0.0,))
    with pytest.raises(FitError, match=rf"joint '{arm_model.joints[0]}' needs a") as refused:
        plan(arm_model, start=(9.0, 0.0, 0.0))
    assert str(refused.value).count("position") == 2
    with pytest.raises(FitError, match=r"comes too near to 'plane 1'"):
        plan(arm_model, planes=[(0.0, 0.0, 1.0, 50.0)])


def test_geometry_of_the_model_is_used_where_it_can_be_read(tmp_path: Path) -> None:
    link = (
        '<link name="{}"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" '
        'ixz="0" iyz="0"/></inertial><collision><origin xyz="0 0 .25"/><geometry>{}</geometry>'
        "</collision></link>"
    )
    joint = (
        '<joint name="j{0}" type="revolute"><parent link="l{1}"/><child link="l{0}"/>'
        '<origin xyz="0 0 .5"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="2" '
        'effort="90"/></joint>'
    )
    box = '<box size=".1 .1 .4"/>'
    for shape, exact in ((box, True), ('<mesh filename="none.stl"/>', False)):
        text = "".join(link.format(f"l{k}", box if k < 2 else shape) for k in range(3))
        path = tmp_path / f"{exact}.urdf"
        path.write_text(f'<robot name="r">{text}{joint.format(1, 0)}{joint.format(2, 1)}</robot>')
        robot = Robot(path)
        found = Clearance(robot, planes=[(1.0, 0.0, 0.0, -0.4)], margin=0.01, radius=None)
        assert found.exact is exact
        assert found.contact(np.array([[0.0, 0.0], [0.2, 0.1]])) is None
        contact = found.contact(np.array([[0.0, 0.0], [-1.2, 0.0]]))  # leans through the wall
        assert contact is not None
        assert (contact[0], contact[2]) == (1, "plane 1")
        folded = found.contact(np.array([[-3.0, -2.4]]))  # the second link back to the base
        assert folded is not None
