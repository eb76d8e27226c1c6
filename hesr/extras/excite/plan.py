"""Planned motions for `hesr excite`: files (tables, URScript, ROS 2), page, and answer."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cosim.report.figures.motions import draw_limited_motion
from cosim.report.figures.style import apply_style
from cosim.report.markup import ResultFigure
from cosim.report.result_page import write_answer
from cosim.study.forecast import FORMAT, SUFFIX
from cosim.workflow.answer import Written
from hesr.extras.excite.motion import PlannedMotion
from hesr.extras.excite.planner import Guard, MotionSettings, Planner
from hesr.extras.excite.sequel import plan_sequel
from hesr_model.errors import ConfigError, HesrError
from hesr_model.logs.tables import write_table
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.files import models_folder, written_whole
from hesr_model.support.plugins import find
from hesr_model.support.progress import Stages, silent
from hesr_model.support.typed_files import to_json, write_json

HEAD = "Planned by HESR and not run on a controller: check it at low speed first."
_UR_JOINTS = 6


def write_csv(path: Path, motion: PlannedMotion, joints: Sequence[str]) -> None:
    """Write t [s], q, dq and ddq [rad, rad/s, rad/s2] below a line on the origin."""
    write_columns(path, motion, joints)
    text = path.read_text(encoding="utf-8")
    path.write_text(f"# {HEAD} {motion.rate:g} Hz.\n{text}", encoding="utf-8")


def write_columns(path: Path, motion: PlannedMotion, joints: Sequence[str]) -> None:
    """Write t, q1.., dq1.., ddq1.. as a table."""
    t, q, dq, ddq = motion.setpoints()
    columns = {"t": t}
    for name, values in (("q", q), ("dq", dq), ("ddq", ddq)):
        for j in range(len(joints)):
            columns[f"{name}{j + 1}"] = values[:, j]
    write_table(path, columns)


def write_urscript(path: Path, motion: PlannedMotion, joints: Sequence[str]) -> None:
    """Write a URScript program that moves to the start, then sends a position per period."""
    if len(joints) != _UR_JOINTS:
        raise ConfigError(f"URScript is for {_UR_JOINTS} joints; this robot has {len(joints)}.")
    q = motion.rows
    move_options = f", t={1.0 / motion.rate!r}, lookahead_time=0.1, gain=300)"
    moves = "\n".join(f"  servoj({_format_row(row)}{move_options}" for row in q)
    header_fields = {"head": HEAD, "count": len(q), "rate": motion.rate, "start": _format_row(q[0])}
    _fill_template("urscript.txt", path, **header_fields, moves=moves)


def write_ros2(path: Path, motion: PlannedMotion, joints: Sequence[str]) -> None:
    """Write a trajectory_msgs/msg/JointTrajectory as YAML."""
    t, q, dq, ddq = motion.setpoints()
    points = []
    for k in range(len(t)):
        # From the index, not from t: whole nanoseconds without accumulated round-off.
        sec, nanosec = divmod(round(k * 1e9 / motion.rate), 10**9)
        points.append(
            f"- {{positions: {_format_row(q[k])}, velocities: {_format_row(dq[k])}, "
            f"accelerations: {_format_row(ddq[k])}, effort: [], "
            f"time_from_start: {{sec: {sec}, nanosec: {nanosec}}}}}"
        )
    names = ", ".join("'" + name.replace("'", "''") + "'" for name in joints)  # quoted as in YAML
    _fill_template("ros2.txt", path, head=HEAD, joints=names, points="\n".join(points))


def _fill_template(template: str, path: Path, **values: Any) -> None:
    text = (models_folder() / "motions" / template).read_text(encoding="utf-8")
    path.write_text(text.format(**values), encoding="utf-8")


def _format_row(values: Array) -> str:
    return f"[{', '.join(np.format_float_positional(x, trim='0') for x in values)}]"


def write_motion(path: Path, motion: PlannedMotion, joints: Sequence[str], kind: str) -> Path:
    """Write a motion in a format; return the path, whose suffix is that of the format."""
    write, suffix = find("hesr.setpoints", kind)
    motion_path = path.with_suffix(suffix)
    with written_whole(motion_path) as temporary:
        write(temporary, motion, joints)
    return motion_path


CSV = (write_csv, ".csv")
PARQUET = (write_columns, ".parquet")
URSCRIPT = (write_urscript, ".script")
ROS2 = (write_ros2, ".yaml")


TIMES = {"body": 30.0, "friction": 60.0, "test": 45.0}  # default durations [s]
_PURPOSES = {
    "body": "masses and inertias: all joints move at once",
    "friction": "laws: speeds in both directions, nested reversals, rests and slow break-away",
    "test": "scores: motions that no law is trained on",
}
_UR_RATE = 500.0  # [Hz] of the controllers that need a position per period
_MIN_DURATION = 10.0  # [s] of a motion
_MAX_DURATION = 1e4  # [s] of a motion


def plan_motions(
    robot_path: Path,
    output: Path,
    *,
    purpose: str,
    time: float | None = None,
    after: Path | None = None,
    format: str | None = None,  # noqa: A002  # the option's name
    settings: Path | None = None,
    progress: Stages = silent,
) -> Written:
    """Plan motions of a purpose and write them with a page; see `hesr.excite`."""
    robot = Robot(robot_path)
    motion_settings = _read_settings(settings, format, is_sequel=after is not None)
    if after:
        purpose = "friction"
    times = _share_time(purpose, time)
    stages = partial(progress, "planning the motion")
    plan_lines: list[str] = []
    forecast = None
    try:
        planner = Planner(Guard(robot, motion_settings), motion_settings)
        if after:
            motions, forecast, plan_lines = plan_sequel(planner, after, sum(times.values()))
        else:
            motions = {}
            for name, duration in times.items():
                motions[name] = planner.plan(name, duration, progress=stages)
    except HesrError as error:
        raise type(error)(f"{settings or robot_path}: {error}") from error
    format_name = format or output.suffix.lower().lstrip(".")
    files = []
    for name, motion in motions.items():
        path = output
        if len(motions) > 1:
            path = output.with_stem(f"{output.stem}_{name}")
        motion_path = write_motion(path, motion, robot.joints, format_name)
        files.append(motion_path)
        if forecast is not None and name == "friction":
            forecast_path = motion_path.with_suffix(SUFFIX)
            write_json(forecast_path, {"format": FORMAT, **to_json(forecast)})
            files.append(forecast_path)
    answer = _describe_motions(planner, motions, plan_lines)
    page_path = output.with_suffix(".html")
    write_answer(answer, page_path)
    return replace(answer, files=[*files, page_path])


def _read_settings(
    path: Path | None, format_name: str | None, *, is_sequel: bool
) -> MotionSettings:
    """Return the settings of a file, or the default ones, for a format."""
    settings = MotionSettings()
    if path:
        settings = MotionSettings.read(path)
    if is_sequel:  # new poses and tests
        settings = settings.model_copy(update={"seed": settings.seed + 1000})
    if format_name == "urscript" and not settings.sample_rate:
        settings = settings.model_copy(update={"sample_rate": _UR_RATE})
    return settings


def _share_time(purpose: str, time: float | None) -> dict[str, float]:
    """Return the duration [s] of each motion of a purpose; `time` [s] is the total.

    Raises ConfigError if a motion would be too short or too long.
    """
    defaults = {name: duration for name, duration in TIMES.items() if purpose in (name, "all")}
    factor = 1.0
    if time is not None:
        factor = time / sum(defaults.values())
    times = {name: factor * duration for name, duration in defaults.items()}
    for name, duration in times.items():
        if not _MIN_DURATION <= duration <= _MAX_DURATION:
            raise ConfigError(
                f"'time' gives the motion for {name} {duration:.3g} s; it needs "
                f"{_MIN_DURATION:g} to {_MAX_DURATION:g} s."
            )
    return times


def _describe_motions(
    planner: Planner, motions: Mapping[str, PlannedMotion], plan_lines: Sequence[str]
) -> Written:
    """Return the answer on motions by purpose, without files: lines, figures and data."""
    guard = planner.guard
    contact_shapes = "capsules around the links"
    if guard.clearance.exact:
        contact_shapes = "the model's geometry"
    lines = [*plan_lines]
    figures = []
    for name, motion in motions.items():
        for part, first, last in motion.parts:
            lines.append(f"{name}, {part}: {first:.1f} to {last:.1f} s, for {_PURPOSES[name]}.")
        figures.append(_draw_motion(name, motion, guard))
    return Written(
        format="hesr-motions-1",
        title=f"Motions for {guard.robot.name}",
        origin=f"Contacts were checked with {contact_shapes}.",
        lines=[*lines, HEAD],
        drawn=figures,
        data={
            "start": planner.start.tolist(),
            "parts": {name: motion.parts for name, motion in motions.items()},
        },
    )


def _draw_motion(name: str, motion: PlannedMotion, guard: Guard) -> ResultFigure:
    """Draw positions and speeds of a motion within the stated limits."""
    t, q, dq, _ = motion.setpoints()
    with apply_style():
        figure = draw_limited_motion(t, q, dq, guard.stated_limits, guard.robot.joints, speeds=True)
    return ResultFigure(
        section=f"Motion for {name}",
        key=name,
        drawing=figure,
        caption="Dashed: limits. Right: time at each speed, forwards up, backwards down.",
        alt="Position, velocity and speeds by joint.",
    )
