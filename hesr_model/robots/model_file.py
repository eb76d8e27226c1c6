"""Model files of robots: URDF read by Pinocchio, MJCF compiled by MuJoCo."""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hesr_model.errors import RobotError
from hesr_model.findings import Finding, Severity, caution
from hesr_model.robots.description import RobotDescription
from hesr_model.robots.mjcf import Compiled, compile_robot, compute_urdf_torques
from hesr_model.robots.mjcf_forces import FRICTION, SPRINGS
from hesr_model.robots.model_units import doubt_units
from hesr_model.robots.urdf import find_model_doubts, position_limits, read_urdf
from hesr_model.support.arrays import Array
from hesr_model.support.ledger import list_left_over
from hesr_model.support.process import collect_errors
from hesr_model.support.text import join_few, on_one_line, sanitise

_MAX_FINGER_RANGE = 0.1  # range of fingers [m]
_FINGER_NAME = re.compile(r"finger|gripper|thumb|knuckle|jaw|(^|_)hand(_|$)", re.IGNORECASE)
_MAX_TORQUE_DIFFERENCE = 1e-6  # allowed difference from MuJoCo over the largest torque
Followers = dict[str, tuple[str, float, float]]  # by name: leader, multiplier, offset


_MAX_FORCE_SHARE = 0.05  # of the torque; a force above it is an error
_MIN_FORCE_SHARE = 0.001  # of the torque; a force below it is advice
_TINY = 1e-300  # torque of a joint without any
_FORCE_REMEDY = "remove it from the file if the robot does not have it"
_FRICTION_REMEDY = "the friction laws of its logs describe it"
_URDFDOM_ERROR = "Error:"  # begins a message of urdfdom
_LINK_CHECKS = ("massless-link", "rounded-inertia")  # which concern all joints below a link


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotModelFile:
    """A model file: Pinocchio's `pin_model` of all its joints, and what else it states.

    `rest_positions` are those of joints that do not move; `bodies_below` are the bodies between
    each joint and the base; `joints_above` are the joints between each body and the base; `bodies`
    are those that joints carry; `loops` are joints without a torque of their own, by cause.
    `gravity` is in [m/s2]; `springs` are the parameters k and const of linear springs; `doubts` are
    those about joints, `link_doubts` those about bodies, `file_doubts` those
    about the whole file. `forces` are torques by force and joint
    that the torque of the robot leaves out, `unknown_forces` why they are not known, and `torques`
    the largest torque by joint at the same states [N.m or N].
    """

    path: Path
    pin_model: Any
    gravity: tuple[float, ...]
    springs: Mapping[str, tuple[float, float]]
    rest_positions: dict[str, float]
    followers: Followers
    bodies_below: Mapping[str, frozenset[str]]
    joints_above: Mapping[str, frozenset[str]]
    bodies: Mapping[str, str]
    link_doubts: Mapping[str, Finding]
    loops: Mapping[str, frozenset[str]]
    doubts: tuple[Finding, ...]
    file_doubts: tuple[Finding, ...]
    forces: Mapping[str, Mapping[str, float]]
    unknown_forces: str
    torques: Mapping[str, float]

    def find_doubts(self, joints: Sequence[str]) -> list[Finding]:
        """Return the doubts that concern the torques or the ranges of some joints.

        The legs of a walking robot do not concern its arm.
        """
        moving_names = set(joints) | self.find_followers(joints)
        findings = [
            doubt
            for link, doubt in self.link_doubts.items()
            if self.joints_above.get(link, frozenset()) & moving_names
        ]
        for doubt in self.doubts:
            (name,) = doubt.joints
            if doubt.check in _LINK_CHECKS:
                concerned_names = self.joints_above.get(self.bodies.get(name, ""), {name})
            else:
                concerned_names = {name}
            if doubt.check == "held-joint" or moving_names & concerned_names:
                findings.append(doubt)
        return [
            *self.file_doubts,
            *findings,
            *self._doubt_loops(moving_names),
            *self._doubt_forces(moving_names),
        ]

    def find_followers(self, joints: Collection[str]) -> set[str]:
        """Return the joints that follow some of those given."""
        return {name for name, (leader, _, _) in self.followers.items() if leader in joints}

    def is_in_loop(self, name: str) -> bool:
        """Return whether a joint, or one that follows it, has no torque of its own."""
        joints = {name, *self.find_followers([name])}
        return any(not loop.isdisjoint(joints) for loop in self.loops.values())

    def _doubt_loops(self, moving_names: Collection[str]) -> Iterator[Finding]:
        """Yield a finding for each loop, whose joints rest while others move."""
        for cause, loop_joints in self.loops.items():
            if loop_joints.isdisjoint(moving_names):
                yield Finding(
                    check="loop",
                    severity="advice",
                    where=str(self.path),
                    found=f"{cause}, so {join_few(sorted(loop_joints))} rest, outside the arm",
                )

    def _doubt_forces(self, moving_names: Collection[str]) -> Iterator[Finding]:
        """Yield a finding for each force that the torques of some joints leave out."""
        if self.unknown_forces:
            yield caution(
                check="left-over",
                where=str(self.path),
                found=f"its springs, dampers and fluids are not known ({self.unknown_forces})",
            )
        # Forces that friction laws describe have another remedy.
        for is_friction in (False, True):
            worths_by_force = {
                force: self._select_worths(force, moving_names)
                for force in self.forces
                if (force in FRICTION) == is_friction
            }
            yield from self._judge_forces(worths_by_force, is_friction=is_friction)

    def _select_worths(self, force: str, moving_names: Collection[str]) -> dict[str, float]:
        """Return what the torques of some joints leave out of a force, by joint."""
        worths = {}
        for name, worth in self.forces[force].items():
            # Terms of the robot file describe the springs of joints that lead.
            is_left_out = force != SPRINGS or name in self.followers
            if is_left_out and name in moving_names and worth > 0.0:
                worths[name] = worth
        return worths

    def _judge_forces(
        self, worths_by_force: Mapping[str, Mapping[str, float]], *, is_friction: bool
    ) -> Iterator[Finding]:
        """Yield one finding with the size of each force on each joint, the largest share first."""
        concerned_names = set().union(*worths_by_force.values())
        if not concerned_names:
            return
        joints = tuple(name for name in self.torques if name in concerned_names)
        text_by_share = []
        for force, worths in worths_by_force.items():
            if worths:
                share, worst = max(
                    (worth / max(self.torques[name], _TINY), name) for name, worth in worths.items()
                )
                sizes = ", ".join(f"{worths.get(name, 0.0):.3g}" for name in joints)
                text_by_share.append((share, worst, f"{force}, worth up to {sizes} N.m"))
        text_by_share.sort(reverse=True)
        largest_share, worst, _ = text_by_share[0]
        texts = [text for _, _, text in text_by_share]
        yield Finding(
            check="left-over",
            severity="advice" if is_friction else _judge_share(largest_share),
            where=str(self.path),
            joints=joints,
            found=(
                f"its torque leaves out {list_left_over(str(self.path), texts)}, in the order of "
                f"the joints (N if they slide); the torque of '{worst}' is up to "
                f"{self.torques[worst]:.3g}"
            ),
            remedy=_FRICTION_REMEDY if is_friction else _FORCE_REMEDY,
        )

    def _select_names(self, root: str | None) -> list[str]:
        names = list(self.pin_model.names)[1:]
        if root is None:
            return names
        selected = [name for name in names if root in self.bodies_below[name]]
        if not selected:
            raise RobotError(
                f"{self.path}: 'root' is '{root}', and no body of that name carries a joint; it is "
                "the last body or link before the first joint of the arm."
            )
        return selected

    def geometry(self, description: RobotDescription) -> Any:
        """Return Pinocchio's collision geometry of the reduced model; None if it is incomplete."""
        import pinocchio as pin  # slow to import

        folders = [str(folder) for folder in self.path.resolve().parents]
        try:
            if self.path.suffix.lower() == ".xml":
                geometry = pin.buildGeomFromMJCF(self.pin_model, str(self.path), pin.COLLISION)
            else:
                geometry = pin.buildGeomFromUrdf(
                    self.pin_model, str(self.path), pin.COLLISION, package_dirs=folders
                )
        except Exception:  # of many kinds: meshes or packages are missing, or names differ
            return None
        if not geometry.ngeoms:
            return None
        return self.reduce_model(description, geometry)

    def reduce_model(self, description: RobotDescription, geometry: Any = None) -> Any:
        """Return the model, or its `geometry`, without the joints that neither move nor follow."""
        import pinocchio as pin  # slow to import

        self._require_selection(description)
        pin_model = self.pin_model
        joints = description.joints
        moving_names = set(joints) | self.find_followers(joints)
        self._require_determined(joints, moving_names)
        neutral = self._build_rest_state(description.locked)
        fixed_numbers = [
            k for k, name in enumerate(pin_model.names) if k and name not in moving_names
        ]
        if geometry is not None:
            return pin.buildReducedModel(pin_model, geometry, fixed_numbers, neutral)[1]
        if not fixed_numbers:
            reduced_model = pin_model
        else:
            reduced_model = pin.buildReducedModel(pin_model, fixed_numbers, neutral)
        moving_joints = zip(
            list(reduced_model.joints)[1:], list(reduced_model.names)[1:], strict=True
        )
        for joint, name in moving_joints:
            require_one_axis(name, joint.nv, self.path)
        return reduced_model

    def _require_selection(self, description: RobotDescription) -> None:
        """Raise RobotError unless the joints of a description are those of the model."""
        path = self.path
        joints = description.joints
        known_names = self._select_names(description.root)
        for name in (*joints, *description.locked):
            if name not in known_names:
                raise RobotError(f"{path}: has no joint '{name}'; it has {', '.join(known_names)}.")
            if name in self.followers:
                raise RobotError(
                    f"{path}: joint '{name}' follows joint '{self.followers[name][0]}', whose "
                    "torque contains its own; leave it out of 'joints' and 'locked'."
                )
        shared_names = [name for name in joints if name in description.locked]
        if shared_names:
            raise RobotError(
                f"{path}: joint '{shared_names[0]}' is in both 'joints' and 'locked'; remove it "
                "from one."
            )
        if tuple(name for name in known_names if name in joints) != joints:
            raise RobotError(
                f"{path}: the joints {', '.join(joints)} must be listed once each, "
                f"in the order of the model, {', '.join(known_names)}."
            )

    def _require_determined(self, joints: Sequence[str], moving_names: Collection[str]) -> None:
        """Raise RobotError if joints that move, or their followers, belong to a loop."""
        for cause, loop in self.loops.items():
            undetermined_names = sorted(loop.intersection(moving_names))
            if not undetermined_names:
                continue
            arm = [name for name in joints if not self.is_in_loop(name)]
            remedy = "remove the equality"
            if arm:
                remedy = f"take only joints {', '.join(arm)}"
            raise RobotError(
                f"{self.path}: {cause}, so the torque of joint '{undetermined_names[0]}' is "
                f"undetermined; {remedy}."
            )

    def _build_rest_state(self, locked: Mapping[str, float]) -> Array:
        """Return Pinocchio's configuration with joints at rest, locked ones at their positions."""
        import pinocchio as pin  # slow to import

        pin_model = self.pin_model
        positions = {**self.rest_positions, **locked}
        for name, (leader, slope, offset) in self.followers.items():
            positions[name] = slope * positions.get(leader, 0.0) + offset
        neutral: Array = pin.neutral(pin_model)
        for name, value in positions.items():
            joint = pin_model.joints[pin_model.getJointId(name)]
            require_one_axis(name, joint.nv, self.path)
            set_joint(joint, neutral, np.array(value))
        return neutral

    def follow(self, names: Sequence[str], leaders: Sequence[str]) -> tuple[Array, Array]:
        """Return G (names, leaders) and b (names,) of q = G q_leaders + b."""
        slopes = np.zeros((len(names), len(leaders)))
        offsets = np.zeros(len(names))
        for row, name in enumerate(names):
            leader, slope, offset = self.followers.get(name, (name, 1.0, 0.0))
            slopes[row, leaders.index(leader)] = slope
            offsets[row] = offset
        return slopes, offsets


def _find_reason(messages: Sequence[str]) -> str:
    """Return the first error of urdfdom, which Pinocchio's own message does not contain."""
    for text in messages:
        if text.startswith(_URDFDOM_ERROR):
            return sanitise(text.removeprefix(_URDFDOM_ERROR).strip().rstrip("."))
    return ""


def _judge_share(share: float) -> Severity:
    """Return how bad it is to leave out a force of some share of the torque."""
    if share < _MIN_FORCE_SHARE:
        return "advice"
    if share > _MAX_FORCE_SHARE:
        return "error"
    return "warning"


def dynamics_engine() -> Any:
    """Import Pinocchio; raise RobotError if one of its libraries is missing."""
    try:
        import pinocchio  # slow to import
    except ImportError as error:
        raise RobotError(
            f"Pinocchio (package 'pin') cannot be loaded: {error}; reinstall it, and add libgomp1 "
            "to the system if libgomp.so.1 is missing."
        ) from error
    return pinocchio


def load(path: Path) -> RobotModelFile:
    """Read a URDF, or an MJCF (``.xml``), and compare its torques with MuJoCo's."""
    dynamics_engine()  # a missing library is the first thing to say
    if not path.is_file():
        raise RobotError(f"{path}: no such model file.")
    compiled: Compiled = {}
    if path.suffix.lower() == ".xml":
        compiled = compile_robot(path)
    urdf = read_urdf(path, compiled.get("urdf") or path.read_bytes())
    pin_model = _parse_urdf(path, urdf.text)
    _rename_ambiguous_bodies(pin_model)
    names = set(pin_model.names)
    for name, armature in compiled.get("armature", {}).items():
        if name in names:
            pin_model.armature[pin_model.joints[pin_model.getJointId(name)].idx_v] = armature
    chains = {link: _trace_chain(link, urdf.parents) for link in urdf.parents}
    reference_torques = compiled.get("check")
    largest_torques: dict[str, float] = {}
    if reference_torques is None:
        reference_torques = compute_urdf_torques(urdf.text)
    else:
        largest_torques = _find_largest_torques(reference_torques)
    file = RobotModelFile(
        path=path,
        pin_model=pin_model,
        gravity=tuple(compiled.get("gravity", (0.0, 0.0, -9.81))),
        springs=compiled.get("springs", {}),
        rest_positions={
            name: position
            for name, position in compiled.get("rest", {}).items()
            if name in names and position
        },
        followers=_resolve_followers(path, urdf.followers, names),
        bodies_below={
            joint: frozenset(chains[link].links) - {link}
            for link, (_, joint) in urdf.parents.items()
        },
        joints_above={link: frozenset(chain.joints) for link, chain in chains.items()},
        bodies={joint: link for link, (_, joint) in urdf.parents.items()},
        link_doubts=urdf.doubts,
        loops=_find_loops(compiled, chains, names),
        doubts=tuple(find_model_doubts(path, pin_model)),
        file_doubts=(*urdf.left_over, *doubt_units(path, pin_model)),
        forces=compiled.get("forces", {}),
        unknown_forces=compiled.get("unknown_forces", ""),
        torques=largest_torques,
    )
    if reference_torques is not None:
        _require_agreement(file, reference_torques)
    return file


def _parse_urdf(path: Path, text: str) -> Any:
    """Return Pinocchio's model of a URDF; RobotError with the reason of urdfdom."""
    pin = dynamics_engine()
    try:
        with collect_errors() as messages:
            return pin.buildModelFromXML(text)
    except Exception as error:  # many kinds
        reason = _find_reason(messages) or on_one_line(error)
        raise RobotError(f"{path}: cannot be parsed as a URDF ({reason}).") from error


def _rename_ambiguous_bodies(pin_model: Any) -> None:
    """Rename bodies named as a joint, moving or fixed, with which Pinocchio reduces no model."""
    body_kind = dynamics_engine().FrameType.BODY
    joint_names = {frame.name for frame in pin_model.frames if frame.type != body_kind}
    for frame in pin_model.frames:
        if frame.type == body_kind and frame.name in joint_names:
            frame.name = f"{frame.name} (link)"


def _find_loops(
    compiled: Compiled, chains: Mapping[str, "_Chain"], moving_names: Collection[str]
) -> dict[str, frozenset[str]]:
    """Return joints whose torque a constraint shares out, by cause.

    Two bodies tied to each other close a loop over the joints between them: those above one of
    them only.
    """
    loops = {
        f"joints {join_few(dict.fromkeys(joints))} are coupled by {coupling}": frozenset(joints)
        for coupling, joints in compiled.get("couplings", {}).items()
    }
    base = _Chain([], [])
    for first, second in compiled.get("loops", ()):
        joints_above_first = set(chains.get(first, base).joints)
        joints_above_second = set(chains.get(second, base).joints)
        tied_joints = (joints_above_first ^ joints_above_second).intersection(moving_names)
        if tied_joints:
            cause = f"the bodies '{first}' and '{second}' are tied to each other"
            loops[cause] = frozenset(tied_joints)
    return loops


def _find_largest_torques(check: Mapping[str, Any]) -> dict[str, float]:
    torques = np.array(check["torques"]).reshape(len(check["q"]), len(check["joints"]))
    return dict(zip(check["joints"], np.abs(torques).max(axis=0).tolist(), strict=True))


class _Chain(NamedTuple):
    """The links from a link to the base, and the joints between them."""

    links: list[str]
    joints: list[str]


def _trace_chain(link: str, parents: Mapping[str, tuple[str, str]]) -> _Chain:
    links = [link]
    joints = list[str]()
    while links[-1] in parents and len(joints) < len(parents):
        parent, joint = parents[links[-1]]
        links.append(parent)
        joints.append(joint)
    return _Chain(links, joints)


def _resolve_followers(path: Path, followers: Followers, names: set[str]) -> Followers:
    resolved = {}
    for name, (leader, slope, offset) in followers.items():
        if name not in names:
            continue
        visited = {name}
        while leader in followers and leader not in visited:
            visited.add(leader)
            next_leader, factor, shift = followers[leader]
            leader, slope, offset = next_leader, slope * factor, offset + slope * shift
        cause = ""
        if leader in visited:
            leader, *_ = followers[name]
            cause = "which follows it"
        elif leader not in names:
            cause = "which does not move"
        if cause:
            raise RobotError(
                f"{path}: joint '{name}' follows joint '{leader}', {cause}; correct its <mimic> or "
                "equality."
            )
        resolved[name] = leader, slope, offset
    return resolved


def _require_agreement(file: RobotModelFile, reference: Mapping[str, Any]) -> None:
    import pinocchio as pin  # slow to import

    pin_model = file.pin_model.copy()
    names = reference["joints"]
    joints = [pin_model.joints[pin_model.getJointId(name)] for name in names]
    pin_model.gravity.linear = np.array(file.gravity)
    data = pin_model.createData()
    dofs = [joint.idx_v for joint in joints]
    expected_torques = np.array(reference["torques"])
    torques = []
    for q, dq, ddq in zip(reference["q"], reference["dq"], reference["ddq"], strict=True):
        state = pin.neutral(pin_model)
        velocity = np.zeros(pin_model.nv)
        acceleration = np.zeros(pin_model.nv)
        for joint, position in zip(joints, q, strict=True):
            set_joint(joint, state, position)
        velocity[dofs] = dq
        acceleration[dofs] = ddq
        torques.append(pin.rnea(pin_model, data, state, velocity, acceleration)[dofs])
    differences = np.abs(np.array(torques).reshape(expected_torques.shape) - expected_torques)
    largest = float(np.abs(expected_torques).max(initial=0.0))
    if differences.max(initial=0.0) > _MAX_TORQUE_DIFFERENCE * largest:
        worst = int(np.argmax(differences.max(axis=0)))
        raise RobotError(
            f"{file.path}: the torque of joint '{names[worst]}' differs from MuJoCo's by "
            f"{100 * differences.max() / largest:.2g} % of the largest torque, so the file is read "
            "in two ways; simplify the joint or the links after it, and report the file."
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class JointFrame:
    """Place of a joint in the kinematic tree: its pose at zero relative to the parent."""

    name: str
    parent: int  # -1 for the base
    rotation: Array
    translation: Array
    axis: Array  # unit vector in the frame of the joint
    prismatic: bool  # slides along the axis


def joint_frames(pin_model: Any, neutral: Array) -> Iterator[JointFrame]:
    """Yield the frames of a model's joints, from base to tip."""
    for k, name in enumerate(list(pin_model.names)[1:], start=1):
        placement = pin_model.jointPlacements[k]
        joint = pin_model.joints[k]
        data = joint.createData()
        joint.calc(data, neutral)
        subspace = np.asarray(data.S, dtype=float).ravel()
        translation_axis = subspace[:3]
        rotation_axis = subspace[3:]
        prismatic = bool(np.any(translation_axis))
        yield JointFrame(
            name=name,
            parent=int(pin_model.parents[k]) - 1,
            rotation=np.array(placement.rotation),
            translation=np.array(placement.translation),
            axis=translation_axis if prismatic else rotation_axis,
            prismatic=prismatic,
        )


@dataclass(frozen=True, kw_only=True)
class ModelJoint:
    """A joint of a model file."""

    name: str
    freedom: int  # 0 for joints that follow others
    slides: bool
    finger: bool = field(default=False, repr=False)
    in_loop: bool = field(default=False, repr=False)  # without a torque of its own
    rest_position: float = field(default=0.0, repr=False)  # position while locked
    parent: str = field(default="", repr=False)  # name of the joint before it


def read_joints(path: Path) -> tuple[ModelJoint, ...]:
    """Return the moving joints from base to tip."""
    file = load(path)
    pin_model = file.pin_model
    parents = list(pin_model.parents)
    joints = []
    for number, name in enumerate(pin_model.names):
        if number == 0:
            continue  # Pinocchio's "universe"
        joint = pin_model.joints[number]
        lower, upper = position_limits(pin_model, joint)
        slides = _slides(joint)
        is_short = slides and upper - lower < _MAX_FINGER_RANGE and number not in parents
        freedom = joint.nv
        if name in file.followers:
            freedom = 0
        model_joint = ModelJoint(
            name=name,
            freedom=freedom,
            slides=slides,
            finger=is_short or bool(_FINGER_NAME.search(name)),
            in_loop=file.is_in_loop(name),
            rest_position=min(max(file.rest_positions.get(name, 0.0), lower), upper),
            parent=pin_model.names[parents[number]],
        )
        joints.append(model_joint)
    return tuple(joints)


def _slides(joint: Any) -> bool:
    # Pinocchio's names: PX, PY, PZ, PrismaticUnaligned; planar joints have more freedom.
    return joint.nv == 1 and str(joint.shortname()).startswith("JointModelP")


def find_driven_joints(path: Path, names: Sequence[str] = ()) -> tuple[ModelJoint, ...]:
    """Return the wanted joints, or all usable ones but fingers and those in loops.

    Raises RobotError if there are none.
    """
    joints = read_joints(path)
    if names:
        return _select_joints(path, joints, names)
    driven_joints = tuple(joint for joint in joints if joint.freedom == 1)
    if not driven_joints:
        raise RobotError(f"{path}: has no revolute or prismatic joint; at least one is needed.")
    determined_joints = tuple(joint for joint in driven_joints if not joint.in_loop)
    arm_joints = tuple(joint for joint in determined_joints if not joint.finger)
    return arm_joints or determined_joints or driven_joints


def _select_joints(
    path: Path, joints: Sequence[ModelJoint], names: Sequence[str]
) -> tuple[ModelJoint, ...]:
    """Return the joints with some names, in the order of the model; RobotError if one has none."""
    by_name = {joint.name: joint for joint in joints}
    for name in names:
        if name not in by_name:
            raise RobotError(f"{path}: has no joint '{name}'; it has {', '.join(by_name)}.")
        if by_name[name].freedom == 0:
            raise RobotError(
                f"{path}: joint '{name}' follows another (mimic); only driven joints can be used."
            )
        require_one_axis(name, by_name[name].freedom, path)
    return tuple(joint for joint in joints if joint.name in names)


def find_arm(path: Path) -> tuple[ModelJoint, ...]:
    """Return the driven joints from the base to the end of the longest chain without branches."""
    driven_joints = {joint.name: joint for joint in find_driven_joints(path)}
    chains: dict[str, list[str]] = {}  # driven joints from the base to each joint
    parents: dict[str, str] = {}  # driven joint before each driven joint, "" for the base
    for joint in read_joints(path):
        chain = list(chains.get(joint.parent, []))
        if joint.name in driven_joints:
            parents[joint.name] = chain[-1] if chain else ""
            chain.append(joint.name)
        chains[joint.name] = chain
    branches = Counter(parents.values())
    lengths = {"": 0}
    for name, parent in parents.items():
        lengths[name] = 1
        if branches[parent] == 1:
            lengths[name] += lengths[parent]
    tip = max(driven_joints, key=lengths.__getitem__)
    return tuple(driven_joints[name] for name in chains[tip])


def find_rest_positions(
    joints: Iterable[ModelJoint], used_joints: Collection[str] = ()
) -> dict[str, float]:
    """Return the rest positions [rad or m] of joints that are not `used_joints`."""
    return {
        joint.name: joint.rest_position
        for joint in joints
        if joint.freedom == 1 and joint.name not in used_joints
    }


def require_one_axis(name: str, freedom: int, path: Path) -> None:
    """Raise RobotError unless a joint has one degree of freedom."""
    if freedom != 1:
        raise RobotError(
            f"{path}: joint '{name}' has several degrees of freedom; "
            "only revolute and prismatic joints can be used."
        )


def set_joint(joint: Any, states: Array, position: Array) -> None:
    """Write a position [rad or m] into `states`, (nq,) or (nq, N)."""
    if joint.nq == 1:
        states[joint.idx_q] = position
    else:
        states[joint.idx_q] = np.cos(position)
        states[joint.idx_q + 1] = np.sin(position)
