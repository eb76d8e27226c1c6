"""Project folders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from cosim.workflow.answer import Answer, Written
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from cosim.study.starter import NewProject
    from hesr_model.support.files import PathArg


def new(
    folder: PathArg, robot: PathArg, *, joints: Sequence[str] = (), progress: Stages = silent
) -> NewProject:
    """Create a project folder: study, robot file, sample logs.

    'hesr run' runs it at once; comments in the study say what can be changed.

    Parameters
    ----------
    folder : path
        New or empty folder.
    robot : path
        URDF or MJCF (.xml) of the robot.
    joints : sequence of str, optional
        Joints that move in the logs, repeatable or with commas; default: all but fingers.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    NewProject
        Joints of the study, and joints that are not used.

    Raises
    ------
    HesrError
        If the folder is in use or the model cannot be used.

    Examples
    --------
    On the command line::

        $ hesr new my_arm --robot my_arm.urdf

    In Python:

    >>> import hesr
    >>> hesr.new("my_arm", "arm.xml").joints
    ('j1', 'j2', 'j3')
    """
    from cosim.study.starter import start
    from hesr_model.support.files import path_of

    progress("making sample logs", 0, 1)
    names = [name.strip() for joint in joints for name in joint.split(",") if name.strip()]
    return start(path_of(folder, "a folder"), path_of(robot, "a robot's model"), names)


def answer(made: NewProject, _: PathArg | None) -> Answer:
    """Return the answer of a new project: its joints and the next command."""
    lines = [f"{made.folder}: a study of the joints {', '.join(made.joints)}."]
    if made.unused:
        lines.append(f"Not used, without motion: {', '.join(made.unused)}.")
    if made.followers:
        lines.append(f"Followers of other joints: {', '.join(made.followers)}.")
    if made.fingers:
        places = ", ".join(f"{name} = {x:g} m" for name, x in made.fingers.items())
        lines.append(f"Locked as fingers of a gripper: {places}; --joints selects other joints.")
    lines += [doubt.sentence for doubt in made.doubts]
    lines += [
        f"Its logs are sample data; replace them with yours: see {made.folder / 'README.txt'}.",
        f"Next: hesr run {made.folder / 'study.toml'}",
    ]
    data = {"joints": list(made.joints), "unused": list(made.unused)}
    return Written(format="hesr-project-1", lines=lines, data=data)
