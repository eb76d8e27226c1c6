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
        Joints that move in the logs, repeatable or with commas; default: the longest chain, without
        fingers.
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
    from cosim.workflow.arguments import joint_names
    from hesr_model.support.files import path_of

    progress("making sample logs", 0, 1)
    model = path_of(robot, "a robot's model")
    return start(path_of(folder, "a folder"), model, joint_names(joints))


def answer(made: NewProject, _: PathArg | None) -> Answer:
    """Return the answer of a new project: its joints and the next command."""
    from hesr_model.support.text import few

    lines = [f"{made.folder}: a study of the joints {', '.join(made.joints)}."]
    if made.followers:
        lines.append(f"Followers of other joints: {few(made.followers)}.")
    if made.locked:
        places = few([f"{name} = {x:.4g}" for name, x in made.locked.items()])
        lines.append(f"Locked [rad or m]: {places}; --joints selects other joints.")
    lines += [doubt.sentence for doubt in made.doubts]
    lines += [
        f"Its logs are sample data; replace them with yours: see {made.folder / 'README.txt'}.",
        f"Next: hesr run {made.folder / 'study.toml'}",
    ]
    data = {"joints": list(made.joints), "locked": dict(made.locked)}
    return Written(format="hesr-project-1", lines=lines, data=data)
