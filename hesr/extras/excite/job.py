"""Job of `hesr simulate TWIN.toml`: logs of planned motions from a digital twin."""

import shutil
from functools import partial
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
    log_paths = []
    twin = Twin(
        plant=twin_file.plant, signals=twin_file.signals, motions=path, truth=twin_file.truth
    )
    stages = partial(progress, "running the arm")
    with scratch_folder() as folder:
        plant, signals = twin_plant(twin, path, folder)
        with load_arm(plant, fmu=export_twin(plant, folder, signals)) as arm:
            for motion in report_progress(unrecorded, stages):
                log_path = logs_folder / f"{motion.stem}.csv"
                planned_motion = _read_motion(motion, len(plant.joints))
                recording = record(arm, planned_motion, twin_file.seed, name=motion.stem)
                recording.log.write(log_path)
                log_paths.append(log_path)
                plan = motion.with_suffix(SUFFIX)
                if plan.is_file():
                    shutil.copyfile(plan, log_path.with_suffix(SUFFIX))
    return Written(lines=[f"{len(log_paths)} motions on the twin."], files=log_paths)


def _read_motion(path: Path, joint_count: int) -> PlannedMotion:
    """Return the motion through the positions of a table, at its usual rate."""
    names = ["t", *(f"q{j + 1}" for j in range(joint_count))]
    t, *q = read_table(path).numbers(names).T
    rate = float(1.0 / np.median(np.diff(t)))
    return PlannedMotion(rate=rate, rows=np.column_stack(q))


JOB = PluginJob("simulate", "plays", _run)
