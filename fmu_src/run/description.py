"""What an FMU says of itself, read without running it and checked before it is used."""

import re
from pathlib import Path
from tempfile import TemporaryDirectory

from fmpy.model_description import ModelDescription, read_model_description

from fmu_src.run.archive import MOST_TEXT, Archive
from fmu_src.run.scalars import Declared, with_scalars
from hesr_model.errors import ArtifactError, SimulationError
from hesr_model.support.text import plain, quoted

DESCRIPTION = "modelDescription.xml"
_IDENTIFIER = re.compile(r"[A-Za-z_][0-9A-Za-z_]{0,199}")


def model_description(fmu: Path) -> ModelDescription:
    """Read what an FMU says of itself, of FMI 3.0 with its arrays as scalars.

    Raises
    ------
    SimulationError
        If it cannot be read, or names itself so that its name cannot be that of a file.
    """
    try:
        with Archive(fmu) as archive:
            return description_in(archive)[0]
    except ArtifactError as error:
        raise SimulationError(f"{error}") from error


def description_in(archive: Archive) -> tuple[ModelDescription, list[Declared]]:
    """Read what the FMU in an archive says of itself.

    Returns
    -------
    Its description and, of FMI 3.0, its variables; see `fmu_src.run.scalars`.

    Raises
    ------
    ArtifactError
        If there is no description in it, or a damaged one.
    SimulationError
        If it cannot be read, or names itself so that its name cannot be that of a file.
    """
    text, fmu = archive.read(DESCRIPTION, MOST_TEXT), archive.path
    with TemporaryDirectory(prefix="hesr-") as folder:
        Path(folder, DESCRIPTION).write_bytes(text)
        try:
            about = read_model_description(folder, validate=False)
        except Exception as error:  # FMPy raises bare exceptions
            raise SimulationError(f"{fmu}: not a readable FMU ({plain(str(error))}).") from error
    for kind in (about.coSimulation, about.modelExchange):
        # It becomes the name of a file, and of functions.
        if kind is not None and not _IDENTIFIER.fullmatch(kind.modelIdentifier or ""):
            raise SimulationError(
                f"{fmu}: its modelIdentifier is {quoted(str(kind.modelIdentifier))}; needed is an "
                "identifier of C with at most 200 characters."
            )
    if not about.fmiVersion.startswith("3."):
        return about, []
    try:
        return with_scalars(about)
    except ValueError as error:
        raise SimulationError(f"{fmu}: not a readable FMU ({plain(str(error))}).") from error
