"""Export of friction laws, arms and systems for other tools."""

from __future__ import annotations

import json
import logging
import os
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from cosim.workflow.answer import Answer, Written, written_files
from cosim.workflow.arguments import (
    expand_per_joint,
    list_logs,
    list_names,
    list_numbers,
    list_paths,
    read_body,
    require_text,
)
from cosim.workflow.export_formats import LAW, ExportFormat, choose_format, find_title
from cosim.workflow.export_formats import help_sections as help_sections
from fmu_src.exporter import Exporter, ExportOption, ExportRequest
from hesr_model.support.files import PathArg, to_path
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from cosim.workflow.arguments import LawArg, Names
    from cosim.workflow.export_options import ExportOptions

_VALUES = ("bool", "int", "float", "str")  # types of options that do not refer to files
_LISTS: Mapping[str, Callable[[str, Any], list[Any]]] = {
    "float": list_numbers,
    "log": list_logs,
    "path": list_paths,
    "str": list_names,
}
"""Readers of repeatable options, by type."""
_log = logging.getLogger(__name__)


def export(
    source: LawArg,
    output: PathArg,
    *,
    format: str | None = None,  # noqa: A002  # the option's name
    platform: Names | None = None,
    progress: Stages = silent,
    **options: Unpack[ExportOptions],
) -> Path:
    r"""Write a law, an arm, a system or a closed loop for other tools.

    Parameters
    ----------
    source : law or path
        Friction model (.json), uf850-table1 (the paper's), or a shipped robot
        (ur10, fretting, cylinder), which brings robot file, body and logs;
        MJCF or URDF of an arm (.xml, .urdf); system of FMUs (.toml, .ssp); with
        format loop, results of a study of a twin, or the study.
    output : path
        File to write, or folder of a loop.
    format : str, optional
        One of the formats that 'hesr export --help' lists, of HESR or another
        package; by default fmu of a law or an arm, and ssp of a system.
    platform : str or sequence of str, optional
        Platforms of an FMU: linux64, win64, darwin64, aarch64-linux or all; by
        default linux64, win64 and that of this machine. The FMU of an arm has
        that of this machine only by default: MuJoCo for other platforms must be
        downloaded.
    progress : callable, optional
        Called with stage, steps done and steps in total.
    **options
        Options of the format, see `ExportOptions`.

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
        $ hesr export law.json --format plant --robot robot.toml \
          --rigid-body body.json -o Arm.fmu
        $ hesr export robot.xml -o Arm.fmu --signals arm.toml --platform win64
        $ hesr export robot.urdf -o Arm.fmu
        $ hesr export closed_loop.toml -o loop.ssp
        $ hesr export ur10 --format mjcf-joint -o ur10_friction.xml

    >>> import hesr
    >>> hesr.export("law.json", "Friction.fmu", platform="linux64").name
    'Friction.fmu'
    >>> hesr.export("law.json", "friction.h", format="c").name
    'friction.h'
    """
    output = to_path(output, "'output'")
    platforms = None if platform is None else list_names("platform", platform)
    require_text("format", format)
    export_format = choose_format(source, format, output)
    source, given_options = _take_ready_model(source, export_format, _drop_unset(options), progress)
    request = ExportRequest(
        source=source,
        output=output,
        options=given_options,
        platforms=export_format.choose_platforms(platforms),
        progress=progress,
    )
    export_format.require_options(request.options, platforms)
    if export_format.kind is LAW:
        _export_law(export_format, request)
    else:
        request = replace(request, source=Path(str(source)))
        _write(export_format.exporter, request, _prepare(export_format.exporter, request))
    return output


def _drop_unset(options: Mapping[str, object]) -> dict[str, object]:
    """Return the options that are set; any format accepts a flag that is off."""
    return {
        name: value for name, value in options.items() if value is not None and value is not False
    }


def _take_ready_model(
    source: LawArg, export_format: ExportFormat, options: dict[str, object], progress: Stages
) -> tuple[LawArg, dict[str, object]]:
    """Return the laws of a shipped robot by its name, and options with its robot, body and logs.

    Other sources are returned as they are, and options that are set stay.
    """
    if export_format.kind is not LAW or not isinstance(source, str) or Path(source).exists():
        return source, options
    from cosim.study.shipped_studies import find_measured_studies

    study_path = find_measured_studies().get(source)
    if study_path is None:
        return source, options
    from cosim.study.ready_model import build_ready_model

    ready = build_ready_model(study_path, progress)
    own = {
        "robot": ready.robot,
        "rigid_body": ready.body,
        "log": ready.training,
        "test_log": ready.tests,
    }
    known = export_format.exporter.option_names
    defaults = {name: value for name, value in own.items() if name in known}
    return ready.model, defaults | options


def _export_law(export_format: ExportFormat, request: ExportRequest) -> None:
    """Write a friction law, or copy the FMU of the same file and options from the cache."""
    from fmu_src import model_file
    from fmu_src.export.cache import copy_from_cache, export_with_cache

    # Options in the cache were accepted before; nothing slow is imported to copy.
    key = _key_of_values(export_format, request)
    if key is not None and copy_from_cache(model_file(str(request.source)), key, request.output):
        return
    from cosim.workflow.arguments import read_model
    from fmu_src.friction.validity import require_scale

    exporter = export_format.exporter
    model = read_model(request.source)
    require_scale(model)
    keywords = _prepare(exporter, replace(request, source=model))
    if key is None:
        key = _key_of_keywords(export_format, request, keywords)

    def write() -> None:
        _write(exporter, replace(request, source=model), keywords)

    if key is None:
        write()
    else:
        export_with_cache(model_file(str(request.source)), key, request.output, write)


def _is_cached(export_format: ExportFormat, request: ExportRequest) -> bool:
    """Return whether a model file and the options determine the output: an FMU without more.

    A format of another package can change without a new version.
    """
    return (
        isinstance(request.source, str | os.PathLike)
        and export_format.is_own
        and bool(request.platforms)
        and all(option.cached for option in _set_options(export_format.exporter, request))
    )


def _set_options(exporter: Exporter, request: ExportRequest) -> list[ExportOption]:
    return [option for option in exporter.options if option.name in request.options]


def _key_of_values(export_format: ExportFormat, request: ExportRequest) -> dict[str, object] | None:
    """Return the key in the cache if no option refers to a file, else None."""
    options = _set_options(export_format.exporter, request)
    if all(option.type in _VALUES for option in options):
        return _key_of_keywords(export_format, request, request.options)
    return None


def _key_of_keywords(
    export_format: ExportFormat, request: ExportRequest, keywords: Mapping[str, Any]
) -> dict[str, object] | None:
    """Return the key in the cache, or None if an object does not state what determines it."""
    if not _is_cached(export_format, request):
        return None
    key = {name: getattr(value, "key", value) for name, value in keywords.items()}
    key |= {"format": export_format.name, "platforms": request.platforms}
    try:
        json.dumps(key)
    except TypeError:
        return None
    return key


def _prepare(exporter: Exporter, request: ExportRequest) -> Mapping[str, Any]:
    """Return the keywords of the writer; files among the options are read first."""
    options = dict(request.options)
    for option in _set_options(exporter, request):
        options[option.name] = read_option(option, options[option.name], request)
    return exporter.prepare(replace(request, options=options))


def read_option(option: ExportOption, value: Any, request: ExportRequest) -> Any:
    """Return the value of an option with files read, and several items as a list."""
    from hesr_model.robots.robot import to_robot

    if option.per_joint:
        return expand_per_joint(option.name, value, len(request.source.joints))
    if option.type == "robot":
        return to_robot(value)
    if option.type == "rigid_body":
        return read_body(value)
    if option.repeatable:
        return _LISTS[option.type](option.name, value)
    return to_path(value, f"'{option.name}'") if option.type == "path" else value


def _write(exporter: Exporter, request: ExportRequest, keywords: Mapping[str, Any]) -> None:
    """Write the output, and print the remarks of its exporter."""
    if request.platforms:
        keywords = {**keywords, "platforms": request.platforms, "progress": request.building}
    for remark in exporter.write(request.source, request.output, **keywords) or ():
        _log.warning("%s", remark)


def answer(path: Path, output: PathArg | None) -> Answer:
    """Return the answer of an export: the file, the tools that read it, and what they must know."""
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    size = sum(file.stat().st_size for file in files) / 1024.0
    suffix = path.suffix.lower()
    lines = [f"{_TOOLS.get(suffix) or find_title(suffix)}, {size:.0f} KiB."]
    if suffix == ".fmu":
        lines.append(_platform_line(path))
    elif suffix == ".ssp":
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


def _coupling_line(system_path: Path, effect: str = "") -> str:
    """Return the declared coupling of a system, and how other engines differ from it."""
    from cosim.systems.system import open_system

    with open_system(system_path) as system:
        if system.order == "jacobi" or not system.connections:
            return f"Coupling: {system.order}, as in other engines."
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
    ".xml": "XML, for MuJoCo",
    ".h": "C header without dependencies",
    ".py": "Python module",
}
