"""Export of friction laws, arms and systems for other tools."""

from __future__ import annotations

import inspect
import logging
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack, get_args

from cosim.workflow.answer import Answer, Written, written_files
from hesr_model.errors import ArgumentError
from hesr_model.support import plugins
from hesr_model.support.files import PathArg, path_of, scratch_folder
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from cosim.workflow.arguments import BodyArg, LawArg, PerJoint, RobotArg
    from hesr_model.friction.model import FrictionModel

Fmi = Literal[2, 3]
Ssp = Literal["1.0", "2.0"]


class ExportOptions(TypedDict, total=False):
    """Options of the formats of `export`; see there."""

    fmi: Fmi
    inertia: PerJoint
    stiffness: PerJoint
    damping: PerJoint
    ratio: PerJoint
    project: bool
    properties: bool
    power: bool
    band: bool
    low_pass: float
    no_events: bool
    no_documentation: bool
    robot: RobotArg
    rigid_body: BodyArg
    signals: PathArg
    ssp: Ssp
    kv: PerJoint
    ki: PerJoint
    kp: PerJoint
    tool: bool
    calibration: Sequence[PathArg]
    bandwidth: float
    torque_constants: PerJoint


_PER_JOINT = ("inertia", "stiffness", "damping", "ratio", "kv", "ki", "kp", "torque_constants")
_OF_ROBOTS = ("plant", "observer")  # formats with the dynamics of the robot
_BATTERY = ("hesr.tests", "properties")
_OF_ARMS = ("signals",)
_OF_SYSTEMS = ("ssp",)
_log = logging.getLogger(__name__)


def export(
    source: LawArg,
    output: PathArg,
    *,
    format: str | None = None,  # noqa: A002  # the option's name
    platform: Sequence[str] | None = None,
    progress: Stages = silent,
    **options: Unpack[ExportOptions],
) -> Path:
    """Write a law, an arm, a system or a closed loop for other tools.

    Parameters
    ----------
    source : law or path
        Friction model (.json) or uf850-table1 (the paper's); MJCF or URDF of an arm (.xml, .urdf);
        system of FMUs (.toml, .ssp); with format loop, results of a study of a twin, or the study.
    output : path
        File to write, or folder of a loop.
    format : str, optional
        Of a law: fmu (default; velocity in, torque out), adaptive (an FMU that estimates friction
        from measured torques), drive (an FMU with the rotor: torque in, velocity out), plant (an
        FMU of the whole robot: torque in, motion out), observer (an FMU or, with an output in .h,
        one C header: motion and motor torque in, external torque and contact out), mjcf (actuators
        for MuJoCo), mujoco-plugin (a library with the law itself, and MJCF that loads it into a
        scene), modelica, c (one header without FMI), torch or jax (one batched, differentiable
        file), ssv (coefficients and covariance as a parameter set of SSP). Of an arm: fmu
        (default), or python-arm for hosts with Python, HESR and MuJoCo. Of a system: ssp. Of
        results or a study, which is run with its quick laws: loop (all FMUs of the closed loop,
        the system as SSP and TOML, and a script that runs it with FMPy and NumPy).
    platform : sequence of str, optional
        Platforms of an FMU: linux64, win64, darwin64, aarch64-linux or all; repeatable; by default
        linux64, win64 and that of this machine. The FMU of an arm has that of this machine only by
        default: MuJoCo for other platforms must be downloaded.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Other Parameters
    ----------------
    fmi : {2, 3}
        Version of FMI; 3 has arrays, dq for dq[i].
    inertia : float or sequence of float, kg.m2
        Drive: inertia of the rotors, one value or one per joint.
    stiffness : float or sequence of float, N.m/rad
        Drive: stiffness of the flexsplines; by default rigid.
    damping : float or sequence of float, N.m.s/rad
        Drive: damping of the flexsplines; by default 0.
    ratio : float or sequence of float
        Drive: turns of the motor per turn of the joint; by default 1.
    project : bool
        MJCF: approximate a law that MuJoCo cannot express exactly.
    properties : bool
        FMU: run the physics checks and add their table to the pages.
    power : bool
        FMU: add the dissipated power as an output.
    band : bool
        FMU: add the 95 % band of measured friction as outputs, and write coefficients and
        covariance as NAME.ssv.
    low_pass : float, Hz
        FMU: cut-off of a causal low pass of the velocity; by default none.
    no_events : bool
        FMU: no event indicators in model exchange; where a law jumps at reversals, the jump is a
        steep line below 0.001 rad/s.
    no_documentation : bool
        FMU, adaptive: no page, picture and reference results, for pipelines: half the time.
    robot : robot or path
        Plant and observer: the robot of the law.
    rigid_body : body or path
        Plant and observer: result of 'hesr identify' for --robot; by default the parameters of the
        model file. Drive: inertia, stiffness and damping of elastic gears.
    kv : float or sequence of float, N.m.s/rad
        Plant: proportional gains of a servo with a speed command; by default no servo.
    ki : float or sequence of float, N.m/rad
        Plant: integral gains of the servo; by default 0.
    kp : float or sequence of float, 1/s
        Plant: gains of a position command of the servo; by default it has only a speed command.
    tool : bool
        Plant: add the pose of the last joint's frame as outputs.
    calibration : sequence of path
        Observer: logs without contact that the law was not fitted to, or results of 'hesr run' for
        its test logs, which determine limits and threshold; repeatable; by default those follow
        from the bands of the law.
    bandwidth : float, Hz
        Observer: cut-off of the external torque; by default 15.
    torque_constants : float or sequence of float, N.m/A
        Observer: torque of a joint per current; the inputs are then currents.
    signals : path
        Arm: TOML file with inputs and outputs; by default every control and sensor, or torques,
        positions and speeds of its joints if it has none.
    ssp : {"1.0", "2.0"}
        SSP: version; by default 1.0.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ConfigError
        If the format is unknown, or an option is of another format.
    ExportError
        If the format cannot express the source.

    Examples
    --------
    On the command line::

        $ hesr export law.json -o Friction.fmu --platform all
        $ hesr export law.json --format drive --inertia 3,3,0.6 -o Drive.fmu
        $ hesr export law.json --format plant --robot robot.toml --rigid-body body.json -o Arm.fmu
        $ hesr export robot.xml -o Arm.fmu --signals arm.toml --platform win64
        $ hesr export robot.urdf -o Arm.fmu
        $ hesr export closed_loop.toml -o loop.ssp

    >>> import hesr
    >>> hesr.export("uf850-table1", "Table1.h", format="c").name
    'Table1.h'
    """
    path = path_of(output, "an output")
    for option, choices in (("fmi", Fmi), ("ssp", Ssp)):
        if options.get(option) is not None:
            from cosim.workflow.arguments import require_choice  # slow to import

            require_choice(option, options.get(option), get_args(choices))
    given: dict[str, Any] = {k: v for k, v in options.items() if v is not None and v is not False}
    alone = format == "drive" or (format in _OF_ROBOTS and "robot" in given)
    if ("robot" in given) != ("rigid_body" in given) and not alone:
        raise ArgumentError("'robot' and 'rigid_body' must be given together.")
    suffix = Path(source).suffix.lower() if isinstance(source, str | Path) else ""
    request = _Request(path, format, platform, given, progress)
    if format == "loop":
        _write_loop(Path(str(source)), request)
    elif suffix in (".xml", ".urdf"):
        _write_arm(Path(str(source)), request)
    elif suffix in (".toml", ".ssp"):
        _write_system(Path(str(source)), request)
    else:
        _write_law(source, request)
    return path


@dataclass(frozen=True)
class _Request:
    """Arguments of `export`; `given` are its further options that are set."""

    output: Path
    format: str | None
    platform: Sequence[str] | None
    given: Mapping[str, Any]
    progress: Stages


def _write_arm(model: Path, to: _Request) -> None:
    """Write the arm of an MJCF or URDF."""
    from fmu_src.arm.native import export_mjcf
    from fmu_src.arm.python_arm.export import export_python_arm
    from fmu_src.export.toolchain import HOST

    _refuse_others(to.given, _OF_ARMS, "friction laws, not for a robot")
    signals = to.given.get("signals")
    format_ = to.format or "fmu"
    signals = None if signals is None else Path(signals)
    if format_ == "python-arm":
        if to.platform is not None:
            raise ArgumentError("'platform' is for native FMUs, not python-arm.")
        if model.suffix.lower() == ".urdf":
            raise ArgumentError("'format' is python-arm, which needs an MJCF; omit it for a URDF.")
        export_python_arm(model, signals, to.output)
    elif format_ == "fmu":
        platforms = HOST if to.platform is None else to.platform
        progress = partial(to.progress, f"building {to.output.name}")
        export_mjcf(model, to.output, table=signals, platforms=platforms, progress=progress)
    else:
        raise ArgumentError(
            f"'format' is {format_}, which is for friction laws; a robot becomes an FMU (fmu, "
            "python-arm)."
        )


def _write_loop(source: Path, to: _Request) -> None:
    """Write the closed loop of results, or of a study, which is run first."""
    from cosim.loop.traces import copy_loops
    from cosim.study.run import run_study
    from cosim.study.study import Study
    from fmu_src.export.toolchain import DEFAULT_PLATFORMS

    _refuse_others(to.given, (), "other formats than loop")
    if to.platform is not None:
        raise ArgumentError(
            "'platform' is for single FMUs; those of a loop have the platforms of its run: "
            "'hesr run --platform'."
        )
    if source.is_dir():
        copy_loops(source, to.output)
        return
    if Study.read(source).tracking is None:
        raise ArgumentError(f"{source}: has no [tracking], which a loop needs; add it, and [twin].")
    with scratch_folder() as folder:
        run_study(
            source,
            folder / "results",
            platforms=DEFAULT_PLATFORMS,
            quick=True,
            progress=to.progress,
        )
        copy_loops(folder / "results", to.output)


def _write_system(system: Path, to: _Request) -> None:
    """Write a system of FMUs as an SSP."""
    from cosim.systems.system import opened_system

    _refuse_others(to.given, _OF_SYSTEMS, "friction laws, not for a system")
    if to.platform is not None:
        raise ArgumentError("'platform' is for FMUs; a system contains built ones.")
    if "fmu" in (to.format, to.output.suffix.lower().removeprefix(".")):
        raise ArgumentError(
            "HESR writes systems as SSP (.ssp), not as one FMU: such a container has a coupling of "
            "its own. docs/exports.md names tools that build one from the SSP."
        )
    if to.format not in (None, "ssp"):
        raise ArgumentError(f"'format' is {to.format}; a system becomes an SSP (ssp).")
    with opened_system(system) as spec:
        note = plugins.find("hesr.systems", "ssp")(spec, system, to.output, **to.given)
        if note:
            _log.warning("%s", note)


def _write_law(law: LawArg, to: _Request) -> None:
    """Write a friction law, or copy the cached FMU of the same file."""
    from fmu_src import model_file
    from fmu_src.export.cache import copied, exported
    from fmu_src.export.toolchain import DEFAULT_PLATFORMS

    output = to.output
    format_ = to.format or "fmu"
    given = dict(to.given)
    platforms = list(DEFAULT_PLATFORMS if to.platform is None else to.platform)
    plain = all(isinstance(value, str | int | float) for value in given.values())
    if (
        isinstance(law, str | Path)
        and plain
        and not ({"robot", "rigid_body", "band"} & given.keys())
    ):
        # Options that are kept were accepted; nothing slow is imported to copy.
        known = {**given, "platforms": platforms}
        if copied(model_file(str(law)), {**known, "format": format_, "body": None}, output):
            return
    from cosim.workflow import arguments
    from hesr_model.friction.model import FrictionModel

    formats = plugins.load("hesr.exports")
    arguments.require_choice("format", format_, formats)
    _refuse_others({k: v for k, v in given.items() if k in _OF_ARMS}, (), "an MJCF (.xml)")
    _refuse_others({k: v for k, v in given.items() if k in _OF_SYSTEMS}, (), "a system")
    writer = formats[format_].load()
    taken = inspect.signature(writer).parameters
    if to.platform is not None or "platforms" in taken:
        given["platforms"] = platforms
    if format_ == "drive" and "rigid_body" in given and "robot" not in given:
        given = _motors(given.pop("rigid_body")) | given
    for option in given:
        name = {"robot": "body", "rigid_body": "body"}.get(option, option)
        if name not in taken and not (name == "platforms" and to.platform is None):
            _refuse_option(option, format_, formats)
    if format_ in _OF_ROBOTS and "robot" not in given:
        raise ArgumentError(f"'format' {format_} needs 'robot', the robot of the law.")
    if "body" in taken and "robot" in given:
        own = {"plant": arguments.possible_body, "observer": arguments.plant_body}
        body_of = own.get(format_, arguments.plant_body)
        given["body"] = body_of(given.pop("robot"), given.pop("rigid_body", None))
    if "progress" in taken:
        given["progress"] = partial(to.progress, f"building {output.name}")

    def write() -> None:
        model = arguments.model_given(law)
        written = writer(model, output, **_complete_options(format_, given, model, to.progress))
        for line in getattr(written, "lines", list)():
            _log.warning("%s", line)

    fixed = not ({"properties", "calibration"} & given.keys())
    if "platforms" in taken and not isinstance(law, FrictionModel) and fixed:
        body = given.get("body")
        known = {k: v for k, v in given.items() if k not in ("progress", "body")}
        known |= {"format": format_, "body": body and body.key}
        exported(model_file(str(law)), known, output, write)
    else:
        write()
    if given.get("band"):
        plugins.find("hesr.exports", "ssv")(arguments.model_given(law), output.with_suffix(".ssv"))


def _motors(body: BodyArg) -> dict[str, Any]:
    """Return the options of a drive with the elastic gears of a rigid body."""
    from hesr_model.rigid_body.identification import RigidBody

    found = body if isinstance(body, RigidBody) else RigidBody.read(body)
    if not found.gears:
        raise ArgumentError(
            "'rigid_body' has no elastic gears, which need link encoders; give 'inertia' instead."
        )
    stiffness, damping = (
        [max(gear.parameters[name][0], 0.0) for gear in found.gears]
        for name in ("stiffness", "damping")
    )
    inertia = found.parameters[[found.names.index(f"{joint}.Ir") for joint in found.joints]]
    return {"inertia": inertia.tolist(), "stiffness": stiffness, "damping": damping}


def _complete_options(
    format_: str, given: Mapping[str, Any], model: FrictionModel, progress: Stages
) -> dict[str, Any]:
    """Return the options of a format for a model: one value per joint, physics checks run."""
    from cosim.workflow.arguments import per_joint

    done = dict(given)
    for name in _PER_JOINT:
        if name in done:
            done[name] = per_joint(name, done[name], len(model.joints))
    if format_ == "drive" and "inertia" not in done:
        raise ArgumentError("'format' drive needs 'inertia', the inertia of the rotors in kg.m2.")
    if done.get("properties"):
        from hesr_model.audit.properties import Subject

        subject = Subject(name=model.law, model=model)
        battery = plugins.find(*_BATTERY)
        [done["properties"]] = battery([subject], progress=partial(progress, "testing the law"))
    return done


def _refuse_others(given: Mapping[str, Any], allowed: Sequence[str], kind: str) -> None:
    for option in given:
        if option not in allowed:
            raise ArgumentError(f"'{option}' is for {kind}.")


def _refuse_option(option: str, format_: str, formats: Mapping[str, Any]) -> None:
    """Refuse options of other formats, which would have no effect."""
    name = {"robot": "body", "rigid_body": "body"}.get(option, option)
    taking = [
        other for other, one in formats.items() if name in inspect.signature(one.load()).parameters
    ]
    shown = "platform" if option == "platforms" else option
    if not taking:
        raise ArgumentError(f"'{shown}' is not an option of any format.")
    raise ArgumentError(
        f"'{shown}' needs 'format' {' or '.join(taking)}, but the format is '{format_}'."
    )


def further_options() -> list[inspect.Parameter]:
    """Return the options of all formats: those of `ExportOptions`, and those of plug-ins."""
    listed = {k: v.__forward_arg__ for k, v in ExportOptions.__annotations__.items()}
    for plugin in plugins.load("hesr.exports").values():
        if not plugin.own:
            own = inspect.signature(plugin.load()).parameters.values()
            listed |= {
                one.name: one.annotation
                for one in own
                if one.kind is one.KEYWORD_ONLY
                and one.name not in ("progress", "platforms", *listed)
            }
    return [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)
        for name, kind in listed.items()
    ]


def answer(path: Path, output: PathArg | None) -> Answer:
    """Return the answer of an export: the file, the tools that read it, and what they must know."""
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    size = sum(file.stat().st_size for file in files) / 1024.0
    lines = [f"{_TOOLS.get(path.suffix.lower(), 'File for other tools')}, {size:.0f} KiB."]
    if path.suffix.lower() == ".fmu":
        lines.append(_platform_line(path))
    elif path.suffix.lower() == ".ssp":
        lines.append(_coupling_line(path))
    elif path.is_dir():
        lines.append(_coupling_line(path / "closed_loop.toml", _DELAY_OF_LOOP))
    return Written(format="hesr-export-1", lines=lines, data=str(path), files=written_files(output))


def _platform_line(fmu: Path) -> str:
    """Return the platforms of an FMU, and how a missing one for Windows is added."""
    with zipfile.ZipFile(fmu) as archive:
        names = [name.split("/") for name in archive.namelist() if name.startswith("binaries/")]
    platforms = list(dict.fromkeys(folder for _, folder, *_ in names))
    if not platforms:  # of Python
        return "Platforms: those of Python."
    windows = any(name in ("win64", "x86_64-windows") for name in platforms)
    remedy = "" if windows else "; tools on Windows need --platform win64 as well"
    return f"Platforms: {', '.join(platforms)}{remedy}."


def _coupling_line(system: Path, effect: str = "") -> str:
    """Return the declared coupling of a system, and how other engines differ from it."""
    from cosim.systems.system import opened_system

    with opened_system(system) as spec:
        if spec.order == "jacobi" or not spec.connections:
            return f"Coupling: {spec.order}, as in other engines."
    return (
        "Coupling: gauss_seidel, in 'hesr simulate' and simulate.py. Jacobi engines (libcosim, "
        f"OMSimulator) pass each value on a step later{effect}: see docs/import.md."
    )


_DELAY_OF_LOOP = " and track 2.5 to 6 times worse, unless 'preview' is a step longer"
"""Measured with the shipped loop, see docs/import.md."""

_TOOLS = {
    "": "FMUs of a closed loop with simulate.py, for FMPy, and its SSP",
    ".fmu": "FMU, for every tool that imports FMI",
    ".ssp": "SSP, for OMSimulator, easySSP and other importers",
    ".ssv": "parameter set of SSP",
    ".mo": "Modelica package, for OpenModelica and Dymola",
    ".xml": "MJCF with actuators, for MuJoCo",
    ".h": "C header without dependencies",
    ".py": "Python module, batched and differentiable",
}
