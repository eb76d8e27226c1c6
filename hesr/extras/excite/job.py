"""Job of `hesr simulate TWIN.toml`: logs of planned motions from a digital twin."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from cosim.loop.excite import export_twin, load_arm, record, twin_plant
from cosim.study.forecast import SUFFIX
from cosim.study.study import Twin
from cosim.workflow.answer import PluginJob, Written
from hesr.extras.excite.motion import PlannedMotion
from hesr_model.errors import ArgumentError, ConfigError
from hesr_model.logs.tables import read_table
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Stages, report_progress, silent
from hesr_model.support.typed_files import Config, RelativePath


class TwinFile(Config):
    """Twin, and the motions that it runs."""

    plays: str  # pattern of CSV files next to the file
    plant: RelativePath
    signals: RelativePath
    truth: str | None = None
    seed: int = 1


def _run(
    path: Path, *, output: Path | None = None, progress: Stages = silent, **options: Any
) -> Written:
    """Record each motion without a log; plans are copied next to their logs."""
    option_names = [name for name, value in options.items() if value]
    if option_names:
        raise ArgumentError(f"'{option_names[0]}' is for a sweep; {path} is a twin.")
    twin_file = TwinFile.read(path)
    logs_folder = output or path.parent / "logs"
    motions = sorted(path.parent.glob(twin_file.plays))
    unrecorded = [motion for motion in motions if not (logs_folder / f"{motion.stem}.csv").exists()]
    if not unrecorded:
        raise ConfigError(
            f"{path}: each of the {len(motions)} motions '{twin_file.plays}' has a log."
        )
    files = []
    twin = Twin(
        plant=twin_file.plant, signals=twin_file.signals, motions=path, truth=twin_file.truth
    )
    with scratch_folder() as folder:
        plant, signals = twin_plant(twin, path, folder)
        with load_arm(plant, fmu=export_twin(plant, folder, signals)) as arm:
            for motion in report_progress(
                unrecorded, lambda *counts: progress("running the arm", *counts)
            ):
                table = read_table(motion)
                names = ["t", *(f"q{j + 1}" for j in range(len(plant.joints)))]
                t, *q = table.numbers(names).T
                rate = float(1.0 / np.median(np.diff(t)))
                planned_motion = PlannedMotion(rate=rate, rows=np.column_stack(q))
                files.append(logs_folder / f"{motion.stem}.csv")
                record(arm, planned_motion, twin_file.seed, name=motion.stem).log.write(files[-1])
                plan = motion.with_suffix(SUFFIX)
                if plan.is_file():
                    shutil.copyfile(plan, files[-1].with_suffix(SUFFIX))
    return Written(lines=[f"{len(files)} motions on the twin."], files=files)


JOB = PluginJob("simulate", "plays", _run)
