"""The interface of estimators and the one registry in which they stand.

An estimator turns friction records of one joint into a frozen law. Hyper-parameters go into the
constructor, data into `fit`, randomness through a passed generator. To add a law, write one class
with `form` and `fit`, decorate it with `register` and name its module in an entry point of the
group `hesr.laws` (`docs/add-a-law.md`).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np

from hesr_model.errors import ConfigError
from hesr_model.friction.equation import form_lines
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.rigid_body.residual import FrictionRecord


class Estimator(ABC):
    """Fits one law to the friction records of one joint.

    Attributes
    ----------
    name : key in the registry and in files of models.
    title : the name that people use.
    typical : a structure that its equations are shown with where none was found by a fit.
    needs : fields of a `FrictionRecord` that may be unknown, and that the law cannot do without.
    everyday : whether studies without a list of laws include it.
    classic : whether it is a law of the literature; the strongest is the reference in scores.
    order : place in tables; laws of other packages come last.
    quick : whether quick runs include it.
    proposed : whether proposed studies include it.
    paper : place among the laws of the paper, from 1 for the paper's own; 0 if not one of them.
    adds : the law that it extends and the part that it adds, as in the ablation table.

    `order` and all below it are facts about one law: a subclass does not inherit them.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    typical: ClassVar[Mapping[str, Any]] = {}
    needs: ClassVar[tuple[str, ...]] = ()
    everyday: ClassVar[bool] = True
    classic: ClassVar[bool] = False
    order: ClassVar[int] = 1000
    quick: ClassVar[bool] = False
    proposed: ClassVar[bool] = False
    paper: ClassVar[int] = 0
    adds: ClassVar[tuple[str, str] | None] = None

    def __init_subclass__(cls) -> None:
        """Reset the facts that a subclass does not inherit."""
        super().__init_subclass__()
        for fact in ("order", "quick", "proposed", "paper", "adds"):
            if fact not in vars(cls):
                setattr(cls, fact, getattr(Estimator, fact))

    @staticmethod
    @abstractmethod
    def form(structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions that `structure` selects (JSON data, checked here).

        Raises
        ------
        ArtifactError
            If the structure is not one of this law.
        """

    @classmethod
    def as_text(cls) -> str:
        """Return the law as text, a typical one of a family."""
        return "; ".join(form_lines(cls.form(cls.typical)))

    @abstractmethod
    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Return the law that explains the records' `tau` [N.m] best.

        Raises
        ------
        FitError
            If the records do not determine the law.
        """


_REGISTRY: dict[str, type[Estimator]] = {}

Registered = TypeVar("Registered", bound=type[Estimator])


def register(estimator: Registered) -> Registered:
    """Enter an estimator under its name; the same class again, as in a notebook, replaces it.

    Raises
    ------
    ConfigError
        If an estimator of another module has the name.
    """
    other = _REGISTRY.get(estimator.name, estimator).__module__
    if other != estimator.__module__:
        raise ConfigError(
            f"law '{estimator.name}' of the module '{estimator.__module__}' has the name of one of "
            f"'{other}'; names must differ."
        )
    _REGISTRY[estimator.name] = estimator
    return estimator


def registered() -> Mapping[str, type[Estimator]]:
    """Estimators that were registered until now, by name."""
    return _REGISTRY
