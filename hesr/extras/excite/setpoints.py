"""Files of planned motions: tables, URScript, and ROS 2 trajectories."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hesr.extras.excite.motion import PlannedMotion
from hesr_model.errors import ConfigError
from hesr_model.logs.tables import write_table
from hesr_model.support.arrays import Array
from hesr_model.support.files import models_folder, written_whole
from hesr_model.support.plugins import find

HEAD = "Planned by HESR and not run on a controller: check it at low speed first."
_UR_JOINTS = 6


def write_csv(path: Path, motion: PlannedMotion, joints: Sequence[str]) -> None:
    """Write t [s], q, dq and ddq [rad, rad/s, rad/s2] below a line on the origin."""
    write_columns(path, motion, joints)
    text = path.read_text(encoding="utf-8")
    path.write_text(f"# {HEAD} {motion.rate:g} Hz.\n{text}", encoding="utf-8")


def write_columns(path: Path, motion: PlannedMotion, joints: Sequence[str]) -> None:
    """Write t, q1.., dq1.., ddq1.. as a table."""
    t, *values = motion.setpoints()
    names = [f"{name}{k}" for name in ("q", "dq", "ddq") for k in range(1, len(joints) + 1)]
    write_table(path, {"t": t} | dict(zip(names, np.hstack(values).T, strict=True)))


def write_urscript(path: Path, motion: PlannedMotion, joints: Sequence[str]) -> None:
    """Write a URScript program that moves to the start, then sends a position per period."""
    if len(joints) != _UR_JOINTS:
        raise ConfigError(f"URScript is for {_UR_JOINTS} joints; this robot has {len(joints)}.")
    q, end = motion.rows, f", t={1.0 / motion.rate!r}, lookahead_time=0.1, gain=300)"
    moves = "\n".join(f"  servoj({_row(row)}{end}" for row in q)
    about = {"head": HEAD, "count": len(q), "rate": motion.rate, "start": _row(q[0])}
    _fill("urscript.txt", path, **about, moves=moves)


def write_ros2(path: Path, motion: PlannedMotion, joints: Sequence[str]) -> None:
    """Write a trajectory_msgs/msg/JointTrajectory as YAML."""
    points = []
    for k, rows in enumerate(zip(*motion.setpoints()[1:], strict=True)):
        q, dq, ddq = map(_row, rows)
        sec, nanosec = divmod(round(k * 1e9 / motion.rate), 10**9)
        points.append(
            f"- {{positions: {q}, velocities: {dq}, accelerations: {ddq}, effort: [], "
            f"time_from_start: {{sec: {sec}, nanosec: {nanosec}}}}}"
        )
    names = ", ".join("'" + name.replace("'", "''") + "'" for name in joints)
    _fill("ros2.txt", path, head=HEAD, joints=names, points="\n".join(points))


def _fill(template: str, path: Path, **values: Any) -> None:
    text = (models_folder() / "motions" / template).read_text(encoding="utf-8")
    path.write_text(text.format(**values), encoding="utf-8")


def _row(values: Array) -> str:
    return f"[{', '.join(np.format_float_positional(x, trim='0') for x in values)}]"


def write_motion(path: Path, motion: PlannedMotion, joints: Sequence[str], kind: str) -> Path:
    """Write a motion in a format; return the path, whose suffix is that of the format."""
    write, suffix = find("hesr.setpoints", kind)
    with written_whole(path := path.with_suffix(suffix)) as temporary:
        write(temporary, motion, joints)
    return path


CSV, PARQUET = (write_csv, ".csv"), (write_columns, ".parquet")
URSCRIPT, ROS2 = (write_urscript, ".script"), (write_ros2, ".yaml")
