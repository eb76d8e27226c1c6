"""Mistakes in the class of a law: each has a sentence of its own, which names the attribute."""

from collections.abc import Callable
from typing import Any

import pytest
import sympy

from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation, Stop
from hesr_model.errors import HesrError
from hesr_model.fitting import estimator
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import Estimator, register, registry, to_law_name
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, LawForm

FORCE = Coefficient(name="force", unit="N.m", description="friction")
WIDTH = Coefficient(name="width", unit="rad/s", description="width of the step")
KAPPA = Coefficient(name="kappa", unit="1/rad", description="stiffness")
STEP = FORCE.symbol * sympy.tanh(DQ / WIDTH.symbol)
STATE = sympy.Symbol("z", real=True)
SPACE = SearchSpace(bounds=(("width", (1e-3, 1.0)),), linear=("force",), non_negative=1)
MEMORY_SPACE = SearchSpace(bounds=(("kappa", (1.0, 1e3)),), linear=("force",))


def define(
    output: Any = STEP,
    space: Any = SPACE,
    coefficients: Any = (FORCE, WIDTH),
    memory: Any = (),
    **attributes: Any,
) -> type[Estimator]:
    """Define and register a law as a notebook does."""

    class Own(OneForm):
        name = "own_law"
        title = "Own law"
        expressions = LawForm(coefficients=coefficients, memory=memory, output=output)

        def space(self) -> SearchSpace:
            return space  # type: ignore[no-any-return]  # a mistake may be of any type

    for attribute, value in attributes.items():
        setattr(Own, attribute, value)
    return register(Own)


def define_relaxation(rate: Any) -> type[Estimator]:
    """Define a law whose memory has this rate."""
    element = Relaxation(name="z", unit="1", drive=KAPPA.symbol * DQ, rate=rate)
    return define(FORCE.symbol * STATE, MEMORY_SPACE, (FORCE, KAPPA), (element,))


@pytest.fixture(autouse=True)
def own_registry(monkeypatch: pytest.MonkeyPatch) -> None:
    registry()
    monkeypatch.setattr(estimator, "_REGISTRY", dict(estimator._REGISTRY))


MISTAKES: list[tuple[Callable[[], Any], str, str]] = [
    (lambda: define(space=SearchSpace(bounds=(), linear=("force",))), "missing", "space"),
    (lambda: define(coefficients=(FORCE,)), "symbol", "output"),
    (lambda: define(FORCE.symbol * sympy.tanh(sympy.Symbol("dq"))), "symbol", "output"),
    (
        lambda: define(space=SearchSpace(bounds=(), linear=("force", "width"))),
        "linear",
        "space.linear",
    ),
    (lambda: define(STEP + DQ), "offset", "space.linear"),
    (lambda: Coefficient(name="width", description="width"), "unit", "width.unit"),
    (lambda: define([STEP, STEP]), "shape", "output"),
    (lambda: Relaxation(name="z", unit="1", drive=DQ, rate=(1, 2)), "shape", "rate"),
    (lambda: define_relaxation(-KAPPA.symbol * absolute(DQ)), "rate", "memory.z.rate"),
    (lambda: define_relaxation(KAPPA.symbol * DQ), "rate", "memory.z.rate"),
    (lambda: define_relaxation(0), "start", "memory.z.rate"),
    (
        lambda: define(
            FORCE.symbol * STATE,
            MEMORY_SPACE,
            (FORCE, KAPPA),
            (Stop(name="z", unit="1", velocity=DQ, deflection=-KAPPA.symbol, bound=1),),
        ),
        "deflection",
        "memory.z.deflection",
    ),
    (
        lambda: define(
            space=SearchSpace(bounds=(("widht", (1e-3, 1.0)), *SPACE.bounds), linear=("force",))
        ),
        "unknown",
        "space",
    ),
    (
        lambda: define(space=SearchSpace(bounds=(("width", (1.0, 1e-3)),), linear=("force",))),
        "bounds",
        "space.bounds",
    ),
    (lambda: define(space={"width": (1e-3, 1.0)}), "space", "space"),
    (lambda: define(coefficients=FORCE), "kind", "coefficients"),
    (lambda: define(name=""), "name", "name"),
    (lambda: define(title=None), "title", "title"),
    (lambda: to_law_name(dict), "base", "law"),  # type: ignore[arg-type]  # the mistake
]


@pytest.mark.parametrize(("mistake", "rule", "attribute"), MISTAKES)
def test_a_mistake_is_refused_with_its_attribute(
    mistake: Callable[[], Any], rule: str, attribute: str
) -> None:
    with pytest.raises(HesrError) as refused:
        mistake()
    assert (refused.value.code, refused.value.key) == (f"law.class.{rule}", attribute)
    assert f"'{attribute.rpartition('.')[2]}'" in str(refused.value) or attribute in str(
        refused.value
    )
    assert str(refused.value).count("\n") == 0


def test_each_kind_of_mistake_has_its_sentence() -> None:
    sentences = set()
    for mistake, _, _ in MISTAKES:
        with pytest.raises(HesrError) as refused:
            mistake()
        sentences.add(str(refused.value))
    assert len(sentences) == len(MISTAKES)


def test_a_method_that_is_missing_is_named() -> None:
    class Half(OneForm):
        name = "half"
        title = "Half a law"
        expressions = LawForm(coefficients=(FORCE,), output=FORCE.symbol * DQ)

    with pytest.raises(HesrError, match=r"^law 'half': 'space' is missing") as refused:
        register(Half)
    assert refused.value.key == "space"


def test_a_law_is_defined_anew_in_the_same_module_only() -> None:
    first = define()
    second = define(STEP)
    assert estimator.estimator("own_law") is second is not first
    with pytest.raises(HesrError, match=r"^law 'lugre' is defined in the modules"):
        define(name="lugre")


def test_a_law_of_a_notebook_moves_to_a_module() -> None:
    define(__module__="__main__")
    moved = define()
    assert estimator.estimator("own_law") is moved
    with pytest.raises(HesrError, match="rename one"):
        define(__module__="__main__")


def test_every_law_fulfils_what_own_laws_must() -> None:
    for law in registry().values():
        law.require_usable()
