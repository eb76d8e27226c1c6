"""Robots of several kinds: a chain and a tree with random frames, followers, a mounted MJCF."""

from pathlib import Path

import numpy as np

from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.transmission import Transmission

UF850 = Path(__file__).parents[3] / "models" / "uf850" / "robot.toml"
HALF = 1.5707963267948966
UR_FRAMES = (
    ("0 0 0.1807", "0 0 0"), ("0 0 0", f"{HALF} 0 0"), ("-0.6127 0 0", "0 0 0"),
    ("-0.57155 0 0.17415", "0 0 0"), ("0 -0.11985 0", f"{HALF} 0 0"),
    ("0 0.11655 0", f"{HALF} {2 * HALF} {2 * HALF}"),
)  # fmt: skip

PANDA_FRAMES = (
    ("0 0 0.333", "0 0 0"), ("0 0 0", f"-{HALF} 0 0"), ("0 -0.316 0", f"{HALF} 0 0"),
    ("0.0825 0 0", f"{HALF} 0 0"), ("-0.0825 0.384 0", f"-{HALF} 0 0"), ("0 0 0", f"{HALF} 0 0"),
    ("0.088 0 0", f"{HALF} 0 0"),
)  # fmt: skip


def _link(name: str, rng: np.random.Generator) -> str:
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    i = turn @ np.diag(rng.uniform(0.02, 0.03, 3)) @ turn.T
    mass, (x, y, z) = rng.uniform(0.5, 5.0), rng.uniform(-0.2, 0.2, 3)
    return (
        f'<link name="{name}"><inertial><origin xyz="{x} {y} {z}"/><mass value="{mass}"/>'
        f'<inertia ixx="{i[0, 0]}" ixy="{i[0, 1]}" ixz="{i[0, 2]}" iyy="{i[1, 1]}" '
        f'iyz="{i[1, 2]}" izz="{i[2, 2]}"/></inertial></link>'
    )


def _joint(k: int, parent: int, kind: str, frame: tuple[str, str], axis: str, more: str) -> str:
    return (
        f'<joint name="j{k}" type="{kind}"><parent link="l{parent}"/><child link="l{k}"/>'
        f'<origin xyz="{frame[0]}" rpy="{frame[1]}"/><axis xyz="{axis}"/>'
        f'<limit lower="-9" upper="9" effort="0" velocity="9"/>{more}</joint>'
    )


def _urdf(folder: Path, name: str, joints: list[str], rng: np.random.Generator) -> Path:
    links = [_link(f"l{k}", rng) for k in range(len(joints) + 1)]
    compiler = '<mujoco><compiler boundmass="0" boundinertia="0" fusestatic="false"/></mujoco>'
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="{name}">{compiler}{"".join(links + joints)}</robot>')
    return path


def ur_like(folder: Path) -> Path:
    """Six joints about z with the frames of a UR10e."""
    return chain(folder, 6)


def chain(folder: Path, count: int) -> Path:
    """The first three or all joints of `ur_like`, or seven joints with the frames of a Panda."""
    frames = PANDA_FRAMES if count == len(PANDA_FRAMES) else UR_FRAMES[:count]
    joints = [_joint(k, k - 1, "revolute", frame, "0 0 1", "") for k, frame in enumerate(frames, 1)]
    return _urdf(folder, "ur", joints, np.random.default_rng(1))


def tree(folder: Path, followers: bool = False) -> Path:
    """Two arms on one joint, with skewed axes and a prismatic joint in each."""
    rng = np.random.default_rng(2)
    joints = []
    for k, parent in enumerate((0, 1, 2, 3, 1, 5, 6), start=1):
        kind = "prismatic" if k in (3, 6) else "revolute"
        texts = (" ".join(map(str, rng.uniform(-1, 1, 3).round(3))) for _ in range(3))
        place, turn, axis = texts
        more = '<mimic joint="j2" multiplier="-0.7" offset="0.2"/>' if followers and k == 7 else ""
        joints.append(_joint(k, parent, kind, (place, turn), axis, more))
    return _urdf(folder, "followers" if followers else "tree", joints, rng)


def coupled(folder: Path) -> RobotDescription:
    """The six joints of `ur_like` whose last two motors turn both joints."""
    matrix = np.diag([101.0, -101.0, 101.0, 80.0, 80.0, 80.0])
    matrix[5, 4] = 80.0
    names = tuple(f"j{k}" for k in range(1, 7))
    transmission = Transmission(matrix=tuple(map(tuple, matrix.tolist())))
    return RobotDescription(
        name="coupled",
        model=ur_like(folder),
        joints=names,
        transmission=transmission,
        mount=(0.3, -0.8, 0.4),
        balancers=("j2", "j6"),
    )


def sprung(folder: Path) -> RobotDescription:
    """The tree with springs on a turning and a sliding joint and a balancer."""
    names = tuple(f"j{k}" for k in range(1, 8))
    return RobotDescription(
        name="sprung",
        model=tree(folder),
        joints=names,
        springs=("j2", "j3"),
        balancers=("j2",),
        rotor_inertia=True,
    )


def robots(folder: Path) -> dict[str, Robot]:
    """Return robots by name."""
    sources = {
        "mounted MJCF": UF850,
        "UR": ur_like(folder),
        "tree": tree(folder),
        "followers": tree(folder, followers=True),
        "coupled": coupled(folder),
        "springs": sprung(folder),
    }
    return {name: Robot(source) for name, source in sources.items()}
