"""The laws there are, in the order in which tables show them: those of HESR, then installed ones.

A package of anybody brings a law by an entry point of the group `hesr.laws`: its name is that of
the law, its value the module that registers it (see `docs/add-a-law.md`).
"""

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.fitting.estimator import Estimator, registered

MODULES = (
    "hesr_model.laws.stribeck",
    "hesr_model.laws.parfam.velocity",
    "hesr_model.laws.lugre",
    "hesr_model.laws.dahl",
    "hesr.extras.laws.mlp",
    "hesr_model.laws.networks.rbf",
    "hesr_model.laws.parfam.estimator",
    "hesr.extras.laws.strain_wave",
    "hesr_model.laws.parfam.hx",
    "hesr_model.laws.stops.estimator",
    "hesr.extras.laws.bam",
    "hesr.extras.laws.gms",
)
"""Modules whose import registers HESR's own estimators."""

GROUP = "hesr.laws"
"""Group of the entry points by which other packages bring laws."""


@cache
def load_laws() -> None:
    """Register all laws.

    Raises
    ------
    ConfigError
        If the law of another package cannot be loaded.
    """
    for module in MODULES:
        import_module(module)
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        _load(entry)


def registry() -> Mapping[str, type[Estimator]]:
    """All estimators by name, in the order in which they were registered.

    Raises
    ------
    ConfigError
        If the law of another package cannot be loaded.
    """
    load_laws()
    return registered()


def estimator(name: str) -> type[Estimator]:
    """Return the estimator of that name.

    Raises
    ------
    ArtifactError
        If there is none, naming those that there are.
    """
    known = registry()
    if name not in known:
        raise ArtifactError(f"law '{name}' is unknown; known are {', '.join(known)}.")
    return known[name]


def _load(entry: EntryPoint) -> None:
    package = entry.dist.name if entry.dist else "?"
    try:
        entry.load()
    except Exception as error:  # whatever the module of somebody else may raise
        raise ConfigError(
            f"law '{entry.name}' of the package '{package}' cannot be loaded "
            f"({type(error).__name__}: {error}); mend the package or uninstall it."
        ) from error
    if entry.name not in registered():
        raise ConfigError(
            f"law '{entry.name}' of the package '{package}' is not registered by "
            f"'{entry.value}'; the entry point must have the name of the law."
        )
