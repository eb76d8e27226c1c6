"""Design of exciting motions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal, get_args, overload

from cosim.workflow.answer import Answer, Written
from cosim.workflow.arguments import require_choice, require_text, to_optional_path
from hesr_model.errors import ConfigError, HesrError
from hesr_model.support import plugins
from hesr_model.support.files import PathArg, require_writable, to_path, written_together
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from pathlib import Path

    from hesr_model.motions.excitation import Excitation

Purpose = Literal["body", "friction", "test", "all"]

_COMPARED = 200
_TABLES = (".csv", ".parquet", ".pq")


@dataclass(frozen=True, kw_only=True, eq=False)
class ExcitationDesign:
    """A designed excitation and its files.

    Attributes
    ----------
    excitation : motion [rad; m] with its condition number.
    random_condition : median condition number of random motions within the same limits.
    forward : table of the motion.
    backward : table of the time-reversed motion.
    picture : figure of the motion with its limits.
    """

    excitation: Excitation
    random_condition: float
    forward: Path
    backward: Path
    picture: Path


@overload
def excite(
    robot: PathArg,
    *,
    output: PathArg = ...,
    settings: PathArg | None = ...,
    purpose: Literal["body"] = ...,
    time: None = ...,
    after: None = ...,
    format: None = ...,
    progress: Stages = ...,
) -> ExcitationDesign: ...
@overload
def excite(
    robot: PathArg,
    *,
    output: PathArg = ...,
    settings: PathArg | None = ...,
    purpose: Purpose = ...,
    time: float | None = ...,
    after: PathArg | None = ...,
    format: str | None = ...,
    progress: Stages = ...,
) -> ExcitationDesign | Answer: ...
def excite(
    robot: PathArg,
    *,
    output: PathArg = "motion.csv",
    settings: PathArg | None = None,
    purpose: Purpose = "body",
    time: float | None = None,
    after: PathArg | None = None,
    format: str | None = None,  # noqa: A002 - name of the option
    progress: Stages = silent,
) -> ExcitationDesign | Answer:
    r"""Design motions for the body, friction, and tests.

    They stay within the limits of the robot's model and of the settings.
    Without `time`, `after` and `format`, the motion for the body is the one
    that identifies a robot best, without checks of collisions. Other motions
    start and end at rest in one pose, and collisions are checked.

    Parameters
    ----------
    robot : path
        Robot file (.toml).
    output : path
        CSV or Parquet file to write; default: motion.csv.
    settings : path, optional
        TOML file with limits, harmonics and periods; also start pose, floor and
        walls.
    purpose : {"body", "friction", "test", "all"}
        What the motion is for; 'all' writes one file for each.
    time : float, s, optional
        Total time of the motions; default: 30 s for the body, 60 s for
        friction, 45 s for tests.
    after : path, optional
        Results of `run`: plan the motion that resolves most of what they
        leave open.
    format : str, optional
        Format of the files: csv, parquet, urscript, ros2; default: that of the
        suffix.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    ExcitationDesign or Answer
        Motion (positions in rad, time in s), its condition number and the
        files; or the parts of planned motions and their files.

    Raises
    ------
    HesrError
        If the robot or the settings cannot be used, or no motion keeps the
        limits.

    Examples
    --------
    On the command line::

        $ hesr excite robot.toml -o motion.csv
        $ hesr excite robot.toml --for all --time 120 -o motion.csv
        $ hesr excite robot.toml --after results/my_arm --format urscript \
          -o next.script

    >>> import hesr
    >>> twin = hesr.new("my_twin", twin=True).folder
    >>> limits = twin / "motion.toml"  # also floor and walls
    >>> robot = twin / "robot.toml"
    >>> hesr.excite(robot, settings=limits, purpose="friction", time=30.0).files
    [PosixPath('motion.csv'), PosixPath('motion.html')]
    """
    require_choice("purpose", purpose, get_args(Purpose))
    require_text("format", format)
    path = to_path(output, "'output'")
    robot_path = to_path(robot, "'robot'")
    settings_path = to_optional_path("settings", settings)
    if purpose != "body" or time is not None or after is not None or format:
        planned: Answer = plugins.find("hesr.motions", "plan")(
            robot_path,
            path,
            purpose=purpose,
            time=time,
            after=to_optional_path("after", after),
            format=format,
            settings=settings_path,
            progress=progress,
        )
        return planned
    if path.suffix.lower() not in _TABLES:
        raise ConfigError(
            f"{path}: the motion is written as a table; the suffix must be one of "
            f"{', '.join(_TABLES)}."
        )
    return _design_for_body(robot_path, settings_path, path, progress)


def _design_for_body(
    robot_path: Path, settings_path: Path | None, path: Path, progress: Stages
) -> ExcitationDesign:
    """Design the motion that identifies the body best; write it, its reverse and a picture."""
    backward = path.with_stem(f"{path.stem}_reversed")
    picture = path.with_suffix(".png")
    require_writable(path, backward, picture)
    import numpy as np
    from threadpoolctl import threadpool_limits

    from cosim.report.figures.motions import write_excitation as draw_excitation
    from hesr_model.logs.tables import number_columns, write_table
    from hesr_model.motions.excitation import ExcitationSettings, condition, design, random_motions
    from hesr_model.rigid_body.base_parameters import base_columns
    from hesr_model.robots.robot import Robot, RobotDescription

    loaded_robot = Robot(RobotDescription.read(robot_path))
    limits = ExcitationSettings()
    if settings_path:
        limits = ExcitationSettings.read(settings_path)
    try:
        excitation = design(
            loaded_robot, limits, progress=partial(progress, "designing the motion")
        )
    except HesrError as error:
        raise type(error)(f"{settings_path or robot_path}: {error}") from error
    base = base_columns(loaded_robot)
    with threadpool_limits(1):  # threads cost more than they save
        random = random_motions(loaded_robot, limits, _COMPARED, limits.seed)
        conditions = [condition(loaded_robot, base, motion) for motion in random]
    t, q, dq, ddq = excitation.setpoints()  # [s, rad, rad/s, rad/s2; m for prismatic joints]
    with written_together(path) as new:
        write_table(new(path), {"t": t} | number_columns(q=q, dq=dq, ddq=ddq))
        backward_columns = number_columns(q=q[::-1], dq=-dq[::-1], ddq=ddq[::-1])
        write_table(new(backward), {"t": t} | backward_columns)
        draw_excitation(new(picture), excitation, loaded_robot.description.joints)
    return ExcitationDesign(
        excitation=excitation,
        random_condition=float(np.median(conditions)),
        forward=path,
        backward=backward,
        picture=picture,
    )


def answer(designed: ExcitationDesign, _: PathArg | None) -> Answer:
    """Return the answer of a designed motion: condition number, start and peak torques."""
    motion = designed.excitation.motion
    torque = designed.excitation.peak_torque
    start = ", ".join(f"{q:.3f}" for q in designed.excitation.setpoints()[1][0])
    peaks = ", ".join(f"{peak:.3g}" for peak in torque)
    return Written(
        format="hesr-excitation-1",
        lines=[
            f"Period {motion.period:.3f} s, condition number {designed.excitation.condition:.3g} "
            f"(random motions within the same limits: {designed.random_condition:.3g} in the "
            "median).",
            f"It starts at {start}; rigid-body torque peaks at {peaks} N.m without friction.",
            "Collisions are not checked: check the motion before you run it.",
        ],
        data={
            "period": motion.period,
            "condition": designed.excitation.condition,
            "random_condition": designed.random_condition,
            "peak_torque": [float(peak) for peak in torque],
        },
        files=[designed.forward, designed.backward, designed.picture],
    )
