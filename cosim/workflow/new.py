"""Project folders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

from cosim.workflow.answer import Answer, Written
from cosim.workflow.arguments import (
    expand_per_joint,
    list_names,
    list_numbers,
    require_mapping,
    to_optional_path,
)
from hesr_model.errors import ArgumentError
from hesr_model.support.files import PathArg, to_path
from hesr_model.support.progress import Stages, silent
from hesr_model.support.text import join_few

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
    public: PathArg | None = None,
    inertia: PerJoint | None = None,
    gravity: bool = False,
    moment: PerJoint | None = None,
    phase: PerJoint | None = None,
    gear_ratio: PerJoint | None = None,
    log: Mapping[str, Any] | None = None,
    source: StatedSource | None = None,
    progress: Stages = silent,
) -> NewProject:
    r"""Create a project folder: study, robot file, sample logs.

    `run` runs it at once; comments in the study say what can be changed.
    The folder of a bench has a robot file and a model of independent bodies,
    whose study `inspect` writes.

    Parameters
    ----------
    folder : path
        New or empty folder.
    robot : path, optional
        URDF or MJCF (.xml) of the robot; default: a sample, the UF850. With
        `public` the URDF, if the repository has none.
    joints : str or sequence of str, optional
        Joints that move in the logs; default: the longest chain, without
        fingers; 'motor' or 'axis' of a bench.
    bench : {"rotary", "sliding"}, optional
        Kind of a bench: motors or sliding axes without a model file.
    twin : bool
        A digital twin instead of a robot: `simulate` makes the logs of its
        motions.
    public : path, optional
        Clone of a public repository with the logs of a measured robot;
        docs/data.md lists them.
    inertia : float or sequence of float, kg m2 or kg, optional
        Bench: inertia, or mass of a sliding axis, one for all or one per joint;
        default: identified.
    gravity : bool
        Bench: sliding axes are vertical, or rotary bodies have a gravity
        moment.
    moment : float or sequence of float, N m, optional
        Bench: amplitude of the gravity moment; default with `gravity`:
        identified.
    phase : float or sequence of float, rad, optional
        Bench: rest position of the hanging body; required with `moment`.
    gear_ratio : float or sequence of float, optional
        Bench: turns of the motor per turn of the joint, for laws with motor
        ripple.
    log : mapping, optional
        Bench: keys of [log] in the robot file, such as torque_per_ampere=0.2.
    source : {"measured", "datasheet", "identified", "guessed"}, optional
        Bench: how the torque constants of `log` are known.
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
        $ hesr new my_motor --bench rotary --log torque_per_ampere=0.2 \
          --source datasheet
        $ hesr new my_lift --bench sliding --gravity --inertia 80
        $ hesr new ur10e --public dynamic_calibration

    >>> import hesr
    >>> hesr.new("my_motor", bench="rotary", joints="motor_1, motor_2").joints
    ('motor_1', 'motor_2')
    """
    from cosim.study.public_logs import start_public
    from cosim.study.starter import Bench, sample_model, start, start_bench, start_twin

    project_folder = to_path(folder, "'folder'")
    names = tuple(list_names("joints", joints, commas=True))
    require_mapping("log", log)
    numbers = _list_numbers(
        {"inertia": inertia, "moment": moment, "phase": phase, "gear_ratio": gear_ratio}
    )
    # The joints of a twin, and those of public logs, are those of its own robot.
    others = {"bench": bench, "joints": names or None}
    _require_one_robot({"twin": twin or None, "public": public, **others})
    if twin:
        _require_one_robot({"twin": twin, "robot": robot})
    if bench is None:
        _refuse_bench_options(numbers, log, source, gravity=gravity)
    if twin:
        return start_twin(project_folder)
    if public is not None:
        clone = to_path(public, "'public'")
        return start_public(project_folder, clone, to_optional_path("robot", robot))
    if bench is None:
        model_path = sample_model() if robot is None else to_path(robot, "'robot'")
        progress("making sample logs", 0, 1)
        project = start(project_folder, model_path, names)
        return replace(project, is_sample=robot is None)
    _require_bench(robot, log, source)
    if not names:
        names = ("motor",) if bench == "rotary" else ("axis",)
    stated = {name: expand_per_joint(name, value, len(names)) for name, value in numbers.items()}
    return start_bench(
        project_folder,
        Bench(kind=bench, joints=names, gravity=gravity, **stated),
        log or {},
        source,
    )


def _require_one_robot(robots: Mapping[str, Any]) -> None:
    """Raise ArgumentError if `twin` or `public`, the first ones, is given with another argument."""
    stated = [name for name, value in robots.items() if value is not None]
    if len(stated) > 1 and stated[0] in ("twin", "public"):
        raise ArgumentError(f"'{stated[0]}' excludes '{stated[1]}'; it has a robot of its own.")


def _list_numbers(arguments: Mapping[str, PerJoint | None]) -> dict[str, list[float]]:
    """Return the numbers of the arguments that are stated."""
    numbers = {}
    for name, value in arguments.items():
        if value is not None:
            numbers[name] = list_numbers(name, value)
    return numbers


def _refuse_bench_options(
    numbers: Mapping[str, Sequence[float]],
    log: Mapping[str, Any] | None,
    source: StatedSource | None,
    *,
    gravity: bool,
) -> None:
    """Refuse options of a bench for a robot with a model file."""
    options = {**numbers, "log": log, "source": source, "gravity": gravity or None}
    for name, value in options.items():
        if value is not None:
            raise ArgumentError(
                f"'{name}' needs 'bench': other robots have a model file.",
                code="new.bench_option",
                key=name,
            )


def _require_bench(
    robot: PathArg | None, log: Mapping[str, Any] | None, source: StatedSource | None
) -> None:
    """Raise ArgumentError for options that contradict a bench."""
    if robot is not None:
        raise ArgumentError("'robot' and 'bench' exclude each other; a bench has no model file.")
    if source is not None and "torque_per_ampere" not in (log or {}):
        raise ArgumentError("'source' needs 'torque_per_ampere' in 'log', whose source it states.")


def answer(project: NewProject, _: PathArg | None) -> Answer:
    """Return the answer of a new project: its joints and the next command."""
    study = project.folder / "study.toml"
    guide = project.folder / "README.txt"
    joints = ", ".join(project.joints)
    if project.bench:
        file = project.folder / "robot.toml"
        next_ = f"hesr inspect LOG --robot {file} --write {file} --study {study}"
        if project.bench == "twin":
            next_ = f"the commands in {guide}"
        lines = [f"{file}: a {project.bench} bench with the joints {joints}.", f"Next: {next_}"]
        return Written(format="hesr-project-1", lines=lines, data={"joints": list(project.joints)})
    lines = [f"{project.folder}: a study of the joints {joints}."]
    if project.is_sample:
        lines.append("Its robot is a sample, the UF850; --robot takes the URDF or MJCF of yours.")
    if project.followers:
        lines.append(f"Followers of other joints: {join_few(project.followers)}.")
    if project.locked:
        positions = join_few([f"{name} = {q:.4g}" for name, q in project.locked.items()])
        lines.append(f"Locked [rad or m]: {positions}; --joints selects other joints.")
    lines += [finding.sentence for finding in project.doubts]
    logs_text = f"Its logs are sample data; replace them with yours: see {guide}."
    if project.source:
        logs_text = f"Its logs are those of {project.source}."
    lines += [logs_text, f"Next: hesr run {study}"]
    data = {"joints": list(project.joints), "locked": dict(project.locked)}
    return Written(format="hesr-project-1", lines=lines, data=data)
