"""Design of exciting motions."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from cosim.workflow.answer import Answer, Written
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from cosim.loop.design import ExcitationDesign
    from hesr_model.support.files import PathArg


def excite(
    robot: PathArg,
    *,
    output: PathArg = "motion.csv",
    settings: PathArg | None = None,
    progress: Stages = silent,
) -> ExcitationDesign:
    """Design the motion that identifies a robot best.

    It stays within the limits of the robot's model and of the settings.

    Parameters
    ----------
    robot : path
        Robot file (.toml).
    output : path
        CSV or Parquet file to write; default: motion.csv.
    settings : path, optional
        TOML file with limits, harmonics and periods.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    ExcitationDesign
        Motion (positions in rad, time in s), its condition number and the files.

    Raises
    ------
    HesrError
        If the robot or the settings cannot be used, or no motion keeps the limits.

    Examples
    --------
    On the command line::

        $ hesr excite robot.toml -o motion.csv

    In Python:

    >>> import hesr
    >>> hesr.excite("robot.toml", output="motion.csv").forward.name
    'motion.csv'
    """
    from cosim.loop.design import design
    from hesr_model.support.files import path_of

    path = path_of(output, "a motion")
    chosen = None if settings is None else path_of(settings, "a file of settings")
    stages = partial(progress, "designing the motion")
    return design(path_of(robot, "a robot"), path, chosen, progress=stages)


def answer(found: ExcitationDesign, _: PathArg | None) -> Answer:
    """Return the answer of a designed motion: condition number, start and peak torques."""
    motion, torque = found.excitation.motion, found.excitation.peak_torque
    start = ", ".join(f"{q:.3f}" for q in found.excitation.setpoints()[1][0])
    peaks = ", ".join(f"{peak:.3g}" for peak in torque)
    return Written(
        format="hesr-excitation-1",
        lines=[
            f"Period {motion.period:.3f} s, condition number {found.excitation.condition:.3g} "
            f"(random motions within the same limits: {found.random_condition:.3g} in the median).",
            f"It starts at {start}; rigid-body torque peaks at {peaks} N.m without friction.",
            "Collisions are not checked: check the motion before you run it.",
        ],
        data={
            "period": motion.period,
            "condition": found.excitation.condition,
            "random_condition": found.random_condition,
            "peak_torque": [float(peak) for peak in torque],
        },
        files=[found.forward, found.backward, found.picture],
    )
