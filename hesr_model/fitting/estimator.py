"""Interface of estimators, and registry of laws: HESR's, then those of other packages."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any, ClassVar, TypeVar

import numpy as np

from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.friction.law import FrictionLaw, LawForm, form_lines
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support import parallel, plugins


class Estimator(ABC):
    """Estimator of one law from the friction records of one joint.

    Hyper-parameters are arguments of the constructor. To add a law, write a
    class with `form` and `fit`, decorate it with `register` and name its module
    in an entry point of the group `hesr.laws` (`docs/add-a-law.md`). Subclasses
    do not inherit `baseline` and the facts below it.

    Attributes
    ----------
    name : key in the registry and in model files.
    title : usual name.
    typical : structure for showing the equations without a fit.
    needs : optional fields of a `FrictionRecord` that the law requires.
    everyday : True to include it in studies without a list of laws.
    classic : True for laws of the literature; the strongest is the reference in
        scores.
    baseline : True for simple laws that others must beat; they can be fitted to
        any log.
    order : position in tables; laws of other packages come last.
    quick : True to include it in quick runs.
    proposed : True to include it in proposed studies.
    from_commands : True to choose among it for logs without torque; by `order`
        from few coefficients to many.
    paper : position among the laws of the paper, from 1; 0 for others.
    adds : law that it extends and part that it adds, for the ablation table.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    typical: ClassVar[Mapping[str, Any]] = {}
    needs: ClassVar[tuple[str, ...]] = ()
    everyday: ClassVar[bool] = True
    classic: ClassVar[bool] = False
    baseline: ClassVar[bool] = False
    order: ClassVar[int] = 1000
    quick: ClassVar[bool] = False
    proposed: ClassVar[bool] = False
    from_commands: ClassVar[bool] = False
    by_direction: ClassVar[bool] = False  # whether it has a slope for each direction
    paper: ClassVar[int] = 0
    adds: ClassVar[tuple[str, str] | None] = None

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        for fact in ("baseline", "order", "quick", "proposed", "from_commands", "paper", "adds"):
            if fact not in vars(cls):
                setattr(cls, fact, getattr(Estimator, fact))

    @staticmethod
    @abstractmethod
    def form(structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions of `structure`; raises ArtifactError if it is invalid."""

    @classmethod
    def as_text(cls) -> str:
        """Return the equations of the law, or of a typical one of its family."""
        return "; ".join(form_lines(cls.form(cls.typical)))

    @classmethod
    def require_usable(cls) -> None:
        """Raise ConfigError or ArtifactError, with the attribute, if the class is not a law yet."""
        for attribute in ("name", "title"):
            value = getattr(cls, attribute, None)
            if not isinstance(value, str) or not value:
                raise ConfigError(
                    f"law {cls.__name__}: '{attribute}' is missing; give it as text.",
                    code=f"law.class.{attribute}",
                    key=attribute,
                )
        missing = sorted(cls.__abstractmethods__)
        if missing:
            raise ConfigError(
                f"law '{cls.name}': '{missing[0]}' is missing; define this method.",
                code="law.class.method",
                key=missing[0],
            )
        form: object = cls.form(cls.typical)
        if not isinstance(form, LawForm):
            raise ConfigError(
                f"law '{cls.name}': 'form' returns {type(form).__name__}; expected LawForm.",
                code="law.class.form",
                key="form",
            )

    @abstractmethod
    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Return the law of the records; raises FitError if they do not determine it."""


_REGISTRY: dict[str, type[Estimator]] = {}
_NOTEBOOK = "__main__"  # module of classes in a notebook or script
Registered = TypeVar("Registered", bound=type[Estimator])


_OWN_PACKAGES = ("hesr_model", "hesr")  # whose laws the tests check


def register(estimator: Registered) -> Registered:
    """Register an estimator by name.

    It replaces an earlier definition of the same module. Raises ConfigError if
    another module has this name, or the class is not a usable law.
    """
    module = estimator.__module__
    if module.partition(".")[0] not in _OWN_PACKAGES:
        estimator.require_usable()
    other = _find_module(estimator.name, module)
    # A law moves from a notebook to a module; a notebook does not replace the law of a module.
    if other not in (None, module, _NOTEBOOK):
        raise ConfigError(
            f"law '{estimator.name}' is defined in the modules '{other}' and '{module}'; rename "
            "one."
        )
    _REGISTRY[estimator.name] = estimator
    return estimator


def _find_module(law_name: str, module: str) -> str | None:
    """Return the module that has a law of this name already, or None."""
    if law_name in _REGISTRY:
        return _REGISTRY[law_name].__module__
    # Installed laws are imported on use. That of a module may just be on its way.
    plugin = plugins.load(GROUP).get(law_name)
    if plugin and module == _NOTEBOOK:
        return plugin.entry.value
    return None


def to_law_name(law: str | type[Estimator]) -> str:
    """Return the name of a law given by name or class; a class is registered.

    Raises ConfigError if the class is not a usable law, or another module has its name.
    """
    if not isinstance(law, type):
        return law
    if not issubclass(law, Estimator):
        raise ConfigError(
            f"class {law.__name__} is not a law; derive it from OneForm or Estimator.",
            code="law.class.base",
            key="law",
        )
    if _REGISTRY.get(getattr(law, "name", "")) is not law:
        register(law)
    return law.name


def is_of_session(law_name: str) -> bool:
    """Whether a law was registered in this process and is not installed, as from a notebook."""
    return law_name in _REGISTRY and law_name not in plugins.load(GROUP)


def _carry_laws() -> "partial[None] | None":
    """Return the job that registers the laws of this session in a worker."""
    laws = [law for law_name, law in _REGISTRY.items() if is_of_session(law_name)]
    if not laws:
        return None
    return partial(_register_carried, laws)


def _register_carried(laws: Sequence[type[Estimator]]) -> None:
    for law in laws:
        _REGISTRY[law.name] = law


parallel.carry(_carry_laws)


GROUP = "hesr.laws"  # entry points with a law's name and the module that registers it


@cache
def load_laws() -> None:
    """Register all laws; raise ConfigError if that of another package cannot be loaded."""
    for plugin in plugins.load(GROUP).values():
        plugin.load()
        if plugin.name not in _REGISTRY:
            raise ConfigError(
                f"{plugin.label} is not registered by '{plugin.entry.value}'; the entry point "
                "must have the name of the law."
            )


def registry() -> Mapping[str, type[Estimator]]:
    """Return all estimators by name, sorted by their `order`, then by name."""
    load_laws()
    return dict(sorted(_REGISTRY.items(), key=lambda item: (item[1].order, item[0])))


def laws_of_paper() -> tuple[str, ...]:
    """Return the laws of the paper, its own first."""
    laws = [(law.paper, name) for name, law in registry().items() if law.paper]
    return tuple(name for _, name in sorted(laws))


def papers_law() -> str:
    """Return the paper's own law."""
    return laws_of_paper()[0]


def select_laws(fact: str) -> tuple[str, ...]:
    """Return the laws with a fact such as `quick` or `classic`."""
    return tuple(name for name, law in registry().items() if getattr(law, fact))


def estimator(name: str) -> type[Estimator]:
    """Return the estimator of a law; raise ArtifactError if it is unknown."""
    plugin = plugins.load(GROUP).get(name)
    if plugin and name not in _REGISTRY:
        plugin.load()  # it alone: the modules of all laws are slow to import
    if name not in _REGISTRY:
        raise ArtifactError(f"law '{name}' is unknown; known are {', '.join(registry())}.")
    return _REGISTRY[name]
