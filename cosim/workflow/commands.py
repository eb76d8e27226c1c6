"""The commands as calls in Python, which return what they find: `import hesr`.

Paths are text or paths; a log, a robot, a rigid body or a friction model is itself or its file.
Logs are checked as the command line checks them: what cannot be right raises, naming all of it;
what is odd is logged.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.workflow.arguments import (
    BodyArg as Body,
)
from cosim.workflow.arguments import (
    LawArg as Model,
)
from cosim.workflow.arguments import (
    LogArg as Log,
)
from cosim.workflow.arguments import (
    body_of,
    checked_logs,
    laws_of,
    listed,
    model_given,
    page_body,
)
from hesr_model.errors import ConfigError
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import RobotLog
from hesr_model.robots.robot import RobotLike
from hesr_model.support import plugins
from hesr_model.support.files import PathArg, models_folder, path_of

if TYPE_CHECKING:
    from cosim.loop.design import ExcitationDesign
    from cosim.study.run import Outcome
    from cosim.study.scores import Comparison
    from cosim.study.starter import NewProject
    from cosim.systems.simulation import Result
    from cosim.workflow.answer import Answer
    from cosim.workflow.jobs import PluginJob
    from hesr_model.audit.audit import Audit
    from hesr_model.audit.properties import Properties
    from hesr_model.health.proposal import Proposal


def new(folder: PathArg, robot: PathArg, joints: Sequence[str] = ()) -> "NewProject":
    """Lay a folder to start from, for a robot's URDF or MJCF; see `cosim.study.starter.start`."""
    from cosim.study.starter import start

    return start(path_of(folder, "a folder"), path_of(robot, "a robot's model"), joints)


def inspect(logs: Log | Sequence[Log], robot: RobotLike | None = None) -> "Proposal":
    """Look at logs in files; return what is wrong or odd, and a robot that reads them."""
    from hesr_model.health.proposal import inspected

    files = [log.path if isinstance(log, RobotLog) else path_of(log, "a log")
             for log in listed(logs)]  # fmt: skip
    if None in files or not files:
        raise ConfigError("logs are inspected in their files; needed is the path of each.")
    return inspected([file for file in files if file], robot)


def run(
    study: PathArg | None = None,
    output: PathArg | None = None,
    *,
    platforms: Sequence[str] = ("linux64",),
    quick: bool = False,
    accept: Sequence[str] = (),
) -> "Outcome":
    """Do the whole job of a study, by default that of the digital twin; see `cosim.study.run`.

    Results stand in ``results/NAME`` where no folder is given.
    """
    from cosim.study.run import run_study
    from cosim.study.study import Study

    path = path_of(study or models_folder() / "studies" / "default.toml", "a study")
    folder = path_of(output or Path("results") / Study.read(path).name, "a folder")
    return run_study(path, folder, platforms=platforms, quick=quick, accepted=accept)


def report(results: PathArg, output: PathArg | None = None) -> Path:
    """Write the report of a run anew and return its path."""
    from cosim.report.page import write_report

    page = None if output is None else path_of(output, "a page")
    return write_report(path_of(results, "a folder"), page)


def results(folders: PathArg | Sequence[PathArg], output: PathArg) -> Path:
    """Write the tables of one or several runs as a page of Markdown and return its path."""
    from cosim.report.digest import write_digest

    return write_digest(
        [path_of(folder, "a folder") for folder in listed(folders)], path_of(output, "a page")
    )


def excite(robot: PathArg, output: PathArg, settings: PathArg | None = None) -> "ExcitationDesign":
    """Design the motion that identifies a robot best; see `cosim.loop.design`."""
    from cosim.loop.design import design

    chosen = None if settings is None else path_of(settings, "a file of settings")
    return design(path_of(robot, "a robot"), path_of(output, "a motion"), chosen)


def evaluate(
    models: Model | Sequence[Model] | Mapping[str, Model],
    logs: Log | Sequence[Log],
    rigid_body: Body,
    robot: RobotLike | None = None,
    *,
    accept: Sequence[str] = (),
) -> "Comparison":
    """Score friction models on logs; they are named by their law, or as the mapping says.

    Models that can start from measured torques have a second row, ``NAME + start``.
    """
    from cosim.study.scores import by_joint, compare, input_classes, predict_models

    models_by_name = _named(models)
    records = by_joint(_records(logs, robot, rigid_body, accept))
    predicted = predict_models(models_by_name, records)
    return compare(records, predicted, input_classes(models_by_name), models_by_name)


def replay(
    fmu: PathArg,
    logs: Log | Sequence[Log],
    rigid_body: Body,
    robot: RobotLike | None = None,
    *,
    accept: Sequence[str] = (),
) -> "Comparison":
    """Run a friction FMU over logs through FMPy and score it."""
    from cosim.study.scores import by_joint, compare, predict_fmu

    file = path_of(fmu, "an FMU")
    records = by_joint(_records(logs, robot, rigid_body, accept))
    return compare(records, {file.stem: predict_fmu(file, records)})


def audit(model: Model) -> "dict[str, Audit]":
    """Audit a fitted friction model: does it brake, is it bounded. By joint.

    Raises
    ------
    ConfigError
        If the model does not say what it was fitted to.
    """
    from hesr_model.audit.audit import audit as audit_law

    read = model_given(model)
    if not read.trained:
        raise ConfigError(f"friction model '{read.law}' does not say what it was fitted to; an "
                          "audit needs these ranges.")  # fmt: skip
    pairs = zip(read.joints, read.laws, read.trained, strict=True)
    return {joint: audit_law(law, trained) for joint, law, trained in pairs}


def properties(
    models: Model | Sequence[Model] | Mapping[str, Model], *, load: float = 0.0
) -> "dict[str, Properties]":
    """Put friction models to the test of the property battery; `load` in N.m."""
    from cosim.properties.battery import Subject, run_battery

    subjects = [Subject(name=name, model=model) for name, model in _named(models).items()]
    found = run_battery(subjects, load=load)
    return {subject.name: of_law for subject, of_law in zip(subjects, found, strict=True)}


def arena(file: PathArg, entries: Sequence[PathArg], output: PathArg | None = None) -> "Answer":
    """Score friction FMUs on the logs of a leaderboard file.

    Parameters
    ----------
    file : arena file.
    entries : FMUs; "ROBOT=FILE" where the arena has several robots.
    output : page to write; none where not given.
    """
    fmus = [path_of(entry, "an FMU") for entry in listed(entries)]
    page = None if output is None else path_of(output, "a page")
    job: PluginJob = plugins.find("hesr.jobs", "leaderboard")
    return job.run(path_of(file, "an arena file"), fmus=fmus, output=page)


def export(
    model: Model,
    output: PathArg,
    format: str = "fmu",  # noqa: A002  # as --format
    *,
    robot: RobotLike | None = None,
    rigid_body: Body | None = None,
    **options: Any,
) -> Path:
    """Write a friction model for other tools.

    Parameters
    ----------
    model, output : the model, and the file or folder to write.
    format : an FMU, a drive, actuators of MuJoCo, a Modelica package, a header in C,
        a module of PyTorch or JAX, or a parameter set of SSP.
    robot, rigid_body : for the page of an FMU, which then finds the friction in a log of measured
        torques itself.
    options : of the format's own function, as `platforms` of FMUs or `inertia` of drives.

    Raises
    ------
    ConfigError
        If the format is unknown.
    ExportError
        If the model cannot be written so.
    """
    write = plugins.find("hesr.exports", format)
    path = path_of(output, "an output")
    if (robot is None) != (rigid_body is None):
        raise ConfigError("'robot' and 'rigid_body' go together; only one of them was given.")
    if robot is not None and rigid_body is not None:
        if format != "fmu":
            raise ConfigError(f"'rigid_body' is for the page of an FMU, the format is '{format}'.")
        options["body"] = page_body(robot, rigid_body)
    write(model_given(model), path, **options)
    return path


def simulate(system: PathArg) -> "Result":
    """Run a system of FMUs, of a TOML file or an SSP, and return the signals that it observes."""
    from cosim.systems.simulation import Master
    from cosim.systems.ssp_reader import opened_system

    path = path_of(system, "a system")
    with opened_system(path) as spec, Master(spec, path) as master:
        result = master.run()
    result.require_success()
    return result


def package(
    system: PathArg, output: PathArg, *, container: bool = False, ssp: Literal["1.0", "2.0"] = "1.0"
) -> Path:
    """Write a system of FMUs as one file: an SSP, or one FMU."""
    from cosim.systems.container import write_container
    from cosim.systems.contents import read_contents
    from cosim.systems.ssp import write_ssp
    from cosim.systems.ssp_reader import opened_system

    path, written = path_of(system, "a system"), path_of(output, "a package")
    with opened_system(path) as spec:
        contents = read_contents(spec, path)
        if container:
            write_container(contents, written)
        else:
            write_ssp(contents, written, version=ssp)
    return written


def _records(logs: Any, robot: Any, rigid_body: Any, accept: Sequence[str]) -> Any:
    read = checked_logs(logs, robot, accept)
    return read.records(body_of(rigid_body, read.logs, read.robot))


def _named(models: Any) -> dict[str, FrictionModel]:
    found = {law.name: law.model for law in laws_of(models)}
    return {name: model for name, model in found.items() if model}
