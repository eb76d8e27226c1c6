"""Project folders of benches: motors or sliding axes without a model file."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cosim.study.starter import NewProject, environment, project_name, require_new
from hesr_model.errors import ArgumentError
from hesr_model.health.proposal import robot_text
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import folder_written_whole

_GRAVITY = 9.81  # [m/s2]
_AXES = {"rotary": ("0 0 1", "0 1 0"), "sliding": ("1 0 0", "0 0 1")}  # without and with gravity


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Independent bodies, one per joint; a number that is None is identified.

    `inertia` [kg.m2] of a sliding joint is its mass [kg]; `moment` [N.m] is the amplitude of the
    gravity moment, zero at the position `phase` [rad], where the body hangs. Under `gravity` rotary
    axes are horizontal and sliding ones vertical.
    """

    kind: Literal["rotary", "sliding"]
    joints: tuple[str, ...]
    gravity: bool = False
    inertia: tuple[float, ...] | None = None
    moment: tuple[float, ...] | None = None
    phase: tuple[float, ...] | None = None
    gear_ratio: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.kind not in _AXES:
            raise ArgumentError(f"'bench' is '{self.kind}'; it must be rotary or sliding.")
        for name in (name for name in self.joints if self.joints.count(name) > 1):
            raise ArgumentError(f"'joints' has '{name}' twice; every joint needs its own name.")
        if self.kind == "sliding" and (self.moment or self.phase):
            raise ArgumentError("'moment' and 'phase' are for a rotary bench; use 'gravity'.")
        if (self.moment is None) != (self.phase is None):
            raise ArgumentError("'moment' and 'phase' belong together; give both or neither.")
        for name in ("inertia", "moment", "phase"):
            for value in getattr(self, name) or ():
                if not (np.isfinite(value) and (value > 0.0 or name == "phase")):
                    wanted = "finite" if name == "phase" else "positive"
                    raise ArgumentError(f"'{name}' is {value:g}; it must be {wanted}.")

    @property
    def hangs(self) -> bool:
        """Whether gravity acts along or about the axes."""
        return self.gravity or self.moment is not None

    @property
    def known(self) -> tuple[str, ...]:
        """Names of the known parameters."""
        inertia = "m" if self.kind == "sliding" else "Iyy" if self.hangs else "Izz"
        names = [inertia] * bool(self.inertia) + ["mx", "mz"] * bool(self.moment)
        return tuple(f"{joint}.{name}" for joint in self.joints for name in names)

    def urdf(self) -> str:
        """Return a model with one link per joint."""
        return (
            environment()
            .get_template("bench.urdf.j2")
            .render(
                joints=[self._body(k) for k in range(len(self.joints))],
                type="continuous" if self.kind == "rotary" else "prismatic",
                axis=_AXES[self.kind][self.hangs],
            )
        )

    def _body(self, k: int) -> Mapping[str, Any]:
        """Return mass, inertia and centre of a body; half of its inertia is that of the mass."""
        inertia = self.inertia[k] if self.inertia else 1.0
        turns = self.kind == "rotary" and self.hangs
        first = (self.moment[k] if self.moment else 1.0) / _GRAVITY if turns else 0.0
        mass = 2.0 * first**2 / inertia if turns else inertia
        phase = self.phase[k] if self.phase else 0.0
        return {
            "name": self.joints[k],
            "mass": mass,
            "inertia": inertia - first**2 / mass,
            "x": first / mass * float(np.sin(phase)),
            "z": -first / mass * float(np.cos(phase)),
        }


def start_bench(
    folder: Path, bench: Bench, log: Mapping[str, Any], source: str | None = None
) -> NewProject:
    """Create a folder with the model of a bench and its robot file, which has `log` as [log].

    `source` is that of the torque constants in `log`.
    """
    require_new(folder)
    with folder_written_whole(folder) as temporary:
        model, file = (temporary.resolve() / name for name in ("bench.urdf", "robot.toml"))
        model.write_text(bench.urdf(), encoding="utf-8")
        description = RobotDescription.validated(
            folder / "robot.toml",
            {
                "name": project_name(folder),
                "model": str(model),
                "joints": bench.joints,
                "known": bench.known,
                "rotor_inertia": False,
                "gear_ratio": bench.gear_ratio,
                "log": log,
                "sources": {"torque_per_ampere": source} if source else {},
            },
        )
        Robot(description)
        head = "Written by 'hesr new'; 'hesr inspect --write' adds the columns of a log."
        file.write_text(robot_text(description, file, head), encoding="utf-8")
    return NewProject(
        folder=folder, joints=bench.joints, followers=(), locked={}, doubts=(), bench=bench.kind
    )
