"""Scores on alternative plants, because the twin's bristles favour bristle laws."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from cosim.loop.excite import recordings
from cosim.loop.motions import Motions
from cosim.loop.twin import export_twin, twin_plant
from cosim.study.scores import MEASURED_START, Errors
from cosim.study.seeds import errors_on
from cosim.study.study import Study, Twin
from hesr_model.fitting.fit import fit_models
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Progress, counted, silent


def under_truths(
    study: Study, path: Path, laws: Sequence[str], *, progress: Progress = silent
) -> dict[str, Errors]:
    """Return the errors of laws by alternative plant of the twin, refitted to each."""
    twin = study.twin
    names = twin.truths if twin else ()
    return {
        truth: _under(study, twin.model_copy(update={"truth": truth}), path, laws)
        for truth in counted(names, progress, str)
        if twin
    }


def _under(study: Study, twin: Twin, path: Path, laws: Sequence[str]) -> Errors:
    with scratch_folder() as folder:
        plant, signals = twin_plant(twin, path, folder)
        arm = export_twin(plant, folder, signals)
        found = list(recordings(Motions.read(twin.motions), plant, fmu=arm))
    fit = partial(fit_models, seed=study.seed, left_out=lambda *_: None)
    return {
        test: {law: rmse for law, rmse in of_test.items() if not law.endswith(MEASURED_START)}
        for test, of_test in errors_on(study, found, laws, fit).items()
    }
