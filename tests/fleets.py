"""Fleets of simulated robots, made like the sample logs of `hesr new`."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.study.sample_logs import RATE, plausible_friction, sample_settings, simulate_log
from hesr_model.friction.law import FrictionLaw
from hesr_model.laws.lugre import LuGre
from hesr_model.motions.excitation import random_motions
from hesr_model.robots.robot import Robot, RobotDescription

INERTIA = '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>'
LINK = f'<inertial><origin xyz="0.2 0 0"/><mass value="2"/>{INERTIA}</inertial>'


Array = NDArray[np.float64]

_FORCES = np.isin([c.name for c in LuGre.form({}).coefficients], ["F_c", "F_s", "sigma_2"])


def urdf(joints: int) -> str:
    """Return a robot whose joints alternate between vertical and horizontal axes."""
    parts = ['<robot name="chain"><link name="link0"/>']
    for k in range(1, joints + 1):
        axis = "0 1 0" if k % 2 else "0 0 1"
        parts.append(
            f'<joint name="j{k}" type="revolute"><origin xyz="0.3 0 0"/>'
            f'<parent link="link{k - 1}"/><child link="link{k}"/><axis xyz="{axis}"/>'
            '<limit lower="-1.5" upper="1.5" effort="40" velocity="2"/></joint>'
            f'<link name="link{k}">{LINK}</link>'
        )
    return "".join([*parts, "</robot>"])


def write_fleet(
    folder: Path,
    *,
    robots: int,
    logs: int,
    joints: int = 1,
    seconds: float = 5.0,
    scale: Callable[[int, int], float] = lambda *_: 1.0,
    spread: float = 0.03,
    law: str = "stribeck",
) -> Path:
    """Write a partitioned data set of robots R0, R1, .. of one model, and return the fleet's file.

    Friction coefficients of each robot scatter about those of the sample logs by a share of
    `spread`; `scale` is a factor on its friction in a log.
    """
    model = folder / "chain.urdf"
    model.write_text(urdf(joints), encoding="utf-8")
    names = [f"j{k}" for k in range(1, joints + 1)]
    (folder / "robot.toml").write_text(
        f'name = "chain"\nmodel = "chain.urdf"\njoints = {names}\n[log]\nsample_rate = {RATE}\n',
        encoding="utf-8",
    )
    robot = Robot(RobotDescription.read(folder / "robot.toml"))
    motions = random_motions(robot, sample_settings(robot, seconds), 3, 0)
    laws = plausible_friction(robot, motions[0])
    for r in range(robots):
        rng = np.random.default_rng(r)
        own = [_times(one, np.exp(spread * rng.standard_normal(7))) for one in laws]
        for k in range(logs):
            log = simulate_log(
                robot,
                motions[k % len(motions)],
                [_times(one, np.where(_FORCES, scale(r, k), 1.0)) for one in own],
                name="log",
                seed=1000 * r + k,
                seconds=seconds,
            )
            part = f"robot=R{r}/day=2026-{1 + k // 28:02d}-{1 + k % 28:02d}/part-0.parquet"
            path = folder / "logs" / part
            path.parent.mkdir(parents=True, exist_ok=True)
            log.write(path)
    file = folder / "fleet.toml"
    file.write_text(
        f'name = "cell"\nlaws = ["{law}"]\nfmu = false\n\n'
        '[types.arm]\nrobot = "robot.toml"\nlogs = "logs/robot=*"\n',
        encoding="utf-8",
    )
    return file


def _times(law: FrictionLaw, factors: Array) -> FrictionLaw:
    """Return a LuGre law with a factor on each of its coefficients."""
    pairs = zip(law.values.items(), factors, strict=True)
    return replace(law, values={name: value * float(factor) for (name, value), factor in pairs})
