"""A law as commands take it: a model's file, an FMU that may carry one, or a built-in name."""

from pathlib import Path
from typing import TYPE_CHECKING

from hesr_model.errors import ConfigError

if TYPE_CHECKING:
    from hesr_model.friction.model import FrictionModel


def given_law(law: str) -> "tuple[FrictionModel | None, Path | None]":
    """Return the model of a law and its FMU; None for what there is not.

    Raises
    ------
    ConfigError
        If it is nothing of the kind.
    """
    from fmu_src import BUILT_IN, model_file
    from fmu_src.friction.embedded_model import embedded_model
    from hesr_model.friction.model import FrictionModel

    suffix = Path(law).suffix.lower()
    if suffix == ".fmu":
        return embedded_model(Path(law)), Path(law)
    if law not in BUILT_IN and suffix != ".json":
        raise ConfigError(
            f"'{law}' is neither a friction model (.json), nor an FMU (.fmu), nor one of "
            f"{', '.join(BUILT_IN)}."
        )
    return FrictionModel.read(model_file(law)), None
