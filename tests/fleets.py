"""Fleets of simulated robots, made as `hesr new` makes its sample logs."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from cosim import sample_logs as samples
from cosim.starter import start
from hesr_model.friction.law import FrictionLaw
from hesr_model.logs.robot_log import RobotLog
from hesr_model.motions.excitation import ExcitationSettings, random_motions
from hesr_model.motions.limits import MotionLimits
from hesr_model.robots.robot import RobotDescription, RobotModel

Scale = Callable[[str, int], float]
"""Factor on the friction of a robot in a log, by its name and the number of the log."""


def write_fleet(
    folder: Path,
    model: Path,
    *,
    robots: int,
    logs: int,
    scale: Scale = lambda robot, log: 1.0,
    law: str = "stribeck",
    seconds: float = 20.0,
    spread: float = 0.03,
) -> Path:
    """Write a fleet of robots R0, R1, .. of one model file, and return its file.

    Coefficients of each robot's friction are drawn about those of the sample logs, with a standard
    deviation of a share of `spread`.
    """
    start(folder / "type", model)
    robot = RobotModel(RobotDescription.read(folder / "type" / "robot.toml"))
    settings = ExcitationSettings(
        harmonics=5,
        period=(20.0, 20.0),
        sample_rate=samples.RATE,
        limits=MotionLimits(torque=(1e12,) * robot.n),
    )
    motions = random_motions(robot, settings, 3, 0)
    laws = samples._friction(robot, motions[0])
    rows = int(seconds * samples.RATE)
    for r in range(robots):
        rng = np.random.default_rng(r)
        own = [_drawn(one, rng, spread) for one in laws]
        for k in range(logs):
            today = [_scaled(one, scale(f"R{r}", k)) for one in own]
            log = samples._simulated(
                robot, motions[k % len(motions)], today, name="log", seed=1000 * r + k
            )
            day = f"day=2026-01-{1 + k:02d}" if k < 31 else f"day=2026-02-{k - 30:02d}"
            path = folder / "logs" / f"robot=R{r}" / day / "part-0.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            _first(log, rows).write(path)
    file = folder / "fleet.toml"
    file.write_text(
        f'name = "cell"\nlaws = ["{law}"]\nfmu = false\n\n'
        '[types.arm]\nrobot = "type/robot.toml"\nlogs = "logs/robot=*"\n',
        encoding="utf-8",
    )
    return file


def _first(log: RobotLog, rows: int) -> RobotLog:
    return log.rows(slice(0, rows))


def _drawn(law: FrictionLaw, rng: np.random.Generator, spread: float) -> FrictionLaw:
    values = {n: v * float(np.exp(spread * rng.standard_normal())) for n, v in law.values.items()}
    return replace(law, values=values)


def _scaled(law: FrictionLaw, factor: float) -> FrictionLaw:
    forces = ("F_c", "F_s", "sigma_2")
    return replace(law, values={n: v * (factor if n in forces else 1.0) for n, v in law.values.items()})
