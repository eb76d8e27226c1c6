"""Registry of laws: those of HESR, then those of other packages (see `docs/add-a-law.md`)."""

from collections.abc import Mapping
from functools import cache

from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.fitting.estimator import Estimator, registered
from hesr_model.support import plugins

GROUP = "hesr.laws"  # entry points with a law's name and the module that registers it


@cache
def load_laws() -> None:
    """Register all laws; raise ConfigError if that of another package cannot be loaded."""
    for plugin in plugins.load(GROUP).values():
        plugin.load()
        if plugin.name not in registered():
            raise ConfigError(
                f"{plugin.label} is not registered by '{plugin.entry.value}'; the entry point "
                "must have the name of the law."
            )


def registry() -> Mapping[str, type[Estimator]]:
    """Return all estimators by name, sorted by their `order`, then as registered."""
    load_laws()
    return dict(sorted(registered().items(), key=lambda item: item[1].order))


def laws_of_paper() -> tuple[str, ...]:
    """Return the laws of the paper, its own first."""
    laws = [(law.paper, name) for name, law in registry().items() if law.paper]
    return tuple(name for _, name in sorted(laws))


def papers_law() -> str:
    """Return the paper's own law."""
    return laws_of_paper()[0]


def laws_with(fact: str) -> tuple[str, ...]:
    """Return the laws with a fact such as `quick` or `classic`."""
    return tuple(name for name, law in registry().items() if getattr(law, fact))


def estimator(name: str) -> type[Estimator]:
    """Return the estimator of a law; raise ArtifactError if it is unknown."""
    known = registry()
    if name not in known:
        raise ArtifactError(f"law '{name}' is unknown; known are {', '.join(known)}.")
    return known[name]
