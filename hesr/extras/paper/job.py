"""Job of `hesr run paper`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cosim.workflow.answer import PluginJob, Written
from hesr.extras.paper.evidence import PaperStudy
from hesr_model.errors import ArgumentError
from hesr_model.support import parallel
from hesr_model.support.progress import Stages, silent
from hesr_model.support.result_folder import folder_written_whole
from hesr_model.support.typed_files import to_json, write_json


def _run(
    path: Path,
    *,
    output: Path | None = None,
    measured: Sequence[Path] = (),
    progress: Stages = silent,
    **options: Any,
) -> Written:
    """Judge all claims and write results, page and tables, by default into ``results/NAME``.

    They are also judged on the joints of `measured` studies.
    """
    from hesr.extras.paper.evidence import gather_evidence
    from hesr.extras.paper.report import (
        FILE,
        FORMAT,
        PaperResult,
        compose_opening,
        tables,
        write_page,
    )

    option_names = [name for name, value in options.items() if value]
    if option_names:
        raise ArgumentError(f"'{option_names[0]}' is for a study of laws; omit it for {path}.")
    study = PaperStudy.read(path).with_measured(measured)
    folder = output or Path("results") / study.name
    command = replay_command(path, measured)
    with folder_written_whole(folder) as temporary, parallel.one_pool("hesr_model.fitting.fit"):
        result = PaperResult.from_evidence(
            gather_evidence(study, path, temporary / "fmus", progress), command
        )
        write_json(temporary / FILE, {"format": FORMAT, **to_json(result)})
        write_page(temporary)
    return Written(
        format=FORMAT,
        lines=[*compose_opening(result), f"Report: {folder / 'report.html'}"],
        shown=[*tables(result).values()],
        data=to_json(result),
    )


def replay_command(path: Path, measured: Sequence[Path]) -> str:
    """Return the command that repeats the study."""
    command = f"hesr run {path.stem if path.is_absolute() else path.as_posix()}"
    return command + "".join(f" --measured {file.as_posix()}" for file in measured)


JOB = PluginJob("run", "claims", _run)
