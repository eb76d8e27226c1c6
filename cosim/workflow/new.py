"""Project folders."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from cosim.workflow.answer import Answer, Written
from cosim.workflow.arguments import list_names, list_numbers, per_joint, require_mapping
from hesr_model.errors import ArgumentError
from hesr_model.support.files import PathArg, path_of
from hesr_model.support.progress import Stages, silent
from hesr_model.support.text import few

if TYPE_CHECKING:
    from cosim.study.starter import NewProject
    from cosim.workflow.arguments import Names, PerJoint


BenchKind = Literal["rotary", "sliding"]
StatedSource = Literal["measured", "datasheet", "identified", "guessed"]


def new(
    folder: PathArg,
    robot: PathArg | None = None,
    *,
    joints: Names = (),
    bench: BenchKind | None = None,
    twin: bool = False,
    inertia: PerJoint | None = None,
    gravity: bool = False,
    moment: PerJoint | None = None,
    phase: PerJoint | None = None,
    gear_ratio: PerJoint | None = None,
    log: Mapping[str, Any] | None = None,
    source: StatedSource | None = None,
    progress: Stages = silent,
) -> NewProject:
    """Create a project folder: study, robot file, sample logs.

    'hesr run' runs it at once; comments in the study say what can be changed. The folder of a bench
    has a robot file and a model of independent bodies, whose study 'hesr inspect' writes.

    Parameters
    ----------
    folder : path
        New or empty folder.
    robot : path, optional
        URDF or MJCF (.xml) of the robot.
    joints : str or sequence of str, optional
        Joints that move in the logs, repeatable or with commas; default: the longest chain, without
        fingers; 'motor' or 'axis' of a bench.
    bench : {"rotary", "sliding"}, optional
        Kind of a bench: motors or sliding axes without a model file.
    twin : bool
        A digital twin instead of a robot: 'hesr simulate' makes the logs of its motions.
    inertia : float or sequence of float, kg m2 or kg, optional
        Bench: inertia, or mass of a sliding axis, one for all or one per joint; default:
        identified.
    gravity : bool
        Bench: sliding axes are vertical, or rotary bodies have a gravity moment.
    moment : float or sequence of float, N m, optional
        Bench: amplitude of the gravity moment; default with 'gravity': identified.
    phase : float or sequence of float, rad, optional
        Bench: rest position of the hanging body; required with 'moment'.
    gear_ratio : float or sequence of float, optional
        Bench: turns of the motor per turn of the joint, for laws with motor ripple.
    log : mapping, optional
        Bench: keys of [log] in the robot file, such as torque_per_ampere=0.2; repeatable.
    source : {"measured", "datasheet", "identified", "guessed"}, optional
        Bench: how the torque constants of 'log' are known.
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
        $ hesr new my_motor --bench rotary --log torque_per_ampere=0.2 --source datasheet
        $ hesr new my_lift --bench sliding --gravity --inertia 80

    >>> import hesr
    >>> hesr.new("my_arm", "arm.xml").joints
    ('j1', 'j2', 'j3')
    """
    from cosim.study.starter import Bench, start, start_bench, start_twin

    place = path_of(folder, "'folder'")
    names = tuple(list_names("joints", joints, commas=True))
    require_mapping("log", log)
    stated = {"inertia": inertia, "moment": moment, "phase": phase, "gear_ratio": gear_ratio}
    numbers = {
        name: None if value is None else list_numbers(name, value) for name, value in stated.items()
    }
    if twin:
        if robot is not None or bench is not None:
            raise ArgumentError("'twin' excludes 'robot' and 'bench'; it has a robot of its own.")
        return start_twin(place)
    if bench is None:
        options = {**numbers, "log": log, "source": source, "gravity": gravity or None}
        for name in (name for name, value in options.items() if value is not None):
            raise ArgumentError(f"'{name}' needs 'bench': other robots have a model file.")
        if robot is None:
            raise ArgumentError("give 'robot', a URDF or MJCF, or 'bench' without a model file.")
        progress("making sample logs", 0, 1)
        return start(place, path_of(robot, "'robot'"), names)
    if robot is not None:
        raise ArgumentError("'robot' and 'bench' exclude each other; a bench has no model file.")
    if source is not None and "torque_per_ampere" not in (log or {}):
        raise ArgumentError("'source' needs 'torque_per_ampere' in 'log', whose source it states.")
    used = names or ("motor" if bench == "rotary" else "axis",)
    each = {name: per_joint(name, value, len(used)) for name, value in numbers.items()}
    return start_bench(
        place, Bench(kind=bench, joints=used, gravity=gravity, **each), log or {}, source
    )


def answer(made: NewProject, _: PathArg | None) -> Answer:
    """Return the answer of a new project: its joints and the next command."""
    if made.bench:
        file = made.folder / "robot.toml"
        study = made.folder / "study.toml"
        next_ = f"hesr inspect LOG --robot {file} --write {file} --study {study}"
        if made.bench == "twin":
            next_ = f"the commands in {made.folder / 'README.txt'}"
        lines = [
            f"{file}: a {made.bench} bench with the joints {', '.join(made.joints)}.",
            f"Next: {next_}",
        ]
        return Written(format="hesr-project-1", lines=lines, data={"joints": list(made.joints)})
    lines = [f"{made.folder}: a study of the joints {', '.join(made.joints)}."]
    if made.followers:
        lines.append(f"Followers of other joints: {few(made.followers)}.")
    if made.locked:
        places = few([f"{name} = {x:.4g}" for name, x in made.locked.items()])
        lines.append(f"Locked [rad or m]: {places}; --joints selects other joints.")
    lines += [finding.sentence for finding in made.doubts]
    lines += [
        f"Its logs are sample data; replace them with yours: see {made.folder / 'README.txt'}.",
        f"Next: hesr run {made.folder / 'study.toml'}",
    ]
    data = {"joints": list(made.joints), "locked": dict(made.locked)}
    return Written(format="hesr-project-1", lines=lines, data=data)
