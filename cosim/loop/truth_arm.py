"""The arm of a twin's study, with the truth that the study names."""

from pathlib import Path

from cosim.loop.closed_loop import ARM
from cosim.study.study import Twin
from fmu_src.arm.alternative_plants import write_truth
from fmu_src.arm.native import export_mjcf
from fmu_src.arm.plant import Plant
from fmu_src.arm.table import SignalTable
from hesr_model.errors import ConfigError


def twins_plant(twin: Twin, study: Path, folder: Path) -> tuple[Plant, SignalTable | None]:
    """Return a twin's arm with its truth, and the names of its signals where it has them.

    Parameters
    ----------
    twin : of the study.
    study : its file, for errors.
    folder : into which the MJCF of another truth than the arm's own is written.

    Raises
    ------
    ConfigError
        If a file is wrong, or the plant has no such truth.
    """
    plant = Plant.read(twin.plant)
    signals = SignalTable.read(twin.signals) if twin.signals else None
    if twin.truth is None or signals is None:
        return plant, signals
    if twin.truth not in plant.truths:
        known = ", ".join(plant.truths) or "none"
        raise ConfigError(
            f"{study}: truth '{twin.truth}' is unknown; those of {twin.plant} are: {known}."
        )
    mjcf = folder / "arm.xml"
    signals = write_truth(plant.truths[twin.truth], plant.model, plant.joints, signals, mjcf)
    return plant.model_copy(update={"model": mjcf}), signals


def twins_fmu(plant: Plant, signals: SignalTable | None, folder: Path) -> Path | None:
    """Write a twin's arm as an FMU, where its signals are named."""
    if signals is None:
        return None
    path = folder / "fmus" / ARM
    path.parent.mkdir(exist_ok=True)
    return export_mjcf(plant.model, path, table=signals)
