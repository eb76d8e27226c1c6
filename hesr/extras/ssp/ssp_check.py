"""Checks of SSPs: archive, schemas, and the FMUs inside."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from cosim.systems.wiring import Wiring
from fmu_src.check import archive
from fmu_src.check.archive import Contents
from fmu_src.check.reader_process import ReaderProcess
from fmu_src.check.rules import Problem, findings
from fmu_src.check.run import Report, check
from fmu_src.export.record import MEMBER
from fmu_src.run.variables import Variables, model_description
from hesr.extras.ssp.contents import SSD
from hesr.extras.ssp.ssp_reader import UnsupportedError, open_ssp
from hesr_model.errors import HesrError
from hesr_model.findings import sort_by_severity

_XML_SUFFIXES = (".ssd", ".ssv", ".ssm", ".ssb")


def check_ssp(path: Path, *, vdmcheck: Path | None = None) -> Report:
    """Check an SSP without running its FMUs; raise ArtifactError if it is unreadable."""
    skipped: dict[str, None] = {}
    with TemporaryDirectory(prefix="hesr-check-") as temporary:
        files = Path(temporary, "files")
        folder = Path(temporary, "work")
        files.mkdir()
        folder.mkdir()
        contents = archive.unpack(path, files)
        changes = list(archive.compare_with_record(contents))
        with ReaderProcess(folder, files) as reader:
            xml_problems = list(_check_xml_members(contents, reader))
        ssp_findings = findings([*contents.problems, *changes, *xml_problems])
        if not any(finding.severity == "error" for finding in ssp_findings):
            ssp_findings += findings(_check_structure(path, contents))
        platforms: list[tuple[str, ...]] = []  # of each FMU
        for name, file in contents.files.items():
            if name.lower().endswith(".fmu"):
                report = check(file, vdmcheck=vdmcheck)
                platforms.append(report.platforms or ())
                ssp_findings += [
                    replace(inner_finding, found=f"{name}: {inner_finding.found}")
                    for inner_finding in report.problems
                ]
                skipped |= dict.fromkeys(f"{name}: {reason}" for reason in report.skipped)
    record = ""
    if MEMBER in contents.files and not changes:
        record = archive.UNCHANGED
    return Report(
        path=path,
        problems=tuple(sort_by_severity(ssp_findings)),
        skipped=tuple(skipped),
        platforms=_find_shared_platforms(platforms),
        record=record,
    )


def _find_shared_platforms(platforms: Sequence[tuple[str, ...]]) -> tuple[str, ...] | None:
    """Return the platforms of all FMUs, None without FMUs."""
    if not platforms:
        return None
    shared_platforms = list(platforms[0])
    for other_platforms in platforms[1:]:
        shared_platforms = [name for name in shared_platforms if name in other_platforms]
    return tuple(shared_platforms)


def _check_xml_members(contents: Contents, reader: ReaderProcess) -> Iterator[Problem]:
    if contents.names and SSD not in contents.names:
        yield "xml-unreadable", f"{SSD} is missing."
    for name, file in contents.files.items():
        if not name.lower().endswith(_XML_SUFFIXES):
            continue
        root, problems = archive.parse(name, file)
        yield from problems
        if root is not None:
            yield from archive.schema_problems(name, file, reader)


def _has_stop_time(contents: Contents) -> bool:
    root, _ = archive.parse(SSD, contents.files[SSD])
    if root is None:
        return False
    experiment = root.find("{*}DefaultExperiment")
    return experiment is not None and "stopTime" in experiment.attrib


def _check_structure(path: Path, contents: Contents) -> Iterator[Problem]:
    times: dict[str, float | None] = {}
    if not _has_stop_time(contents):  # a system is complete without it
        times = {"start": 0.0, "stop": 1.0}
    try:
        with open_ssp(path, times, {}) as system:
            variables = {
                component.name: Variables(component.fmu, model_description(component.fmu))
                for component in system.components
            }
            Wiring(system, variables, path)
    except UnsupportedError as error:
        yield "ssp-support", str(error).removeprefix(f"{path}: ")
    except HesrError as error:
        yield "ssp-structure", str(error).removeprefix(f"{path}: ")
