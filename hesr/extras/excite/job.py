"""Job of `hesr simulate TWIN.toml`: logs of planned motions from a digital twin."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from cosim.loop.excite import export_twin, loaded_arm, record, twin_plant
from cosim.study.forecast import SUFFIX
from cosim.study.study import Twin
from cosim.workflow.answer import PluginJob, Written
from hesr.extras.excite.motion import PlannedMotion
from hesr_model.errors import ArgumentError, ConfigError
from hesr_model.logs.tables import read_table
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Stages, counted, silent
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
    given = [name for name, value in options.items() if value]
    if given:
        raise ArgumentError(f"'{given[0]}' is for a sweep; {path} is a twin.")
    chosen = TwinFile.read(path)
    logs = output or path.parent / "logs"
    motions = sorted(path.parent.glob(chosen.plays))
    left = [motion for motion in motions if not (logs / f"{motion.stem}.csv").exists()]
    if not left:
        raise ConfigError(f"{path}: each of the {len(motions)} motions '{chosen.plays}' has a log.")
    files = []
    twin = Twin(plant=chosen.plant, signals=chosen.signals, motions=path, truth=chosen.truth)
    with scratch_folder() as folder:
        plant, signals = twin_plant(twin, path, folder)
        with loaded_arm(plant, fmu=export_twin(plant, folder, signals)) as arm:
            for motion in counted(left, lambda *of: progress("running the arm", *of)):
                table = read_table(motion)
                names = ["t", *(f"q{k + 1}" for k in range(len(plant.joints)))]
                t, *q = table.numbers(names).T
                rate = float(1.0 / np.median(np.diff(t)))
                planned = PlannedMotion(rate=rate, rows=np.column_stack(q))
                files.append(logs / f"{motion.stem}.csv")
                record(arm, planned, chosen.seed, name=motion.stem).log.write(files[-1])
                plan = motion.with_suffix(SUFFIX)
                if plan.is_file():
                    shutil.copyfile(plan, files[-1].with_suffix(SUFFIX))
    return Written(lines=[f"{len(files)} motions on the twin."], files=files)


JOB = PluginJob("simulate", "plays", _run)
