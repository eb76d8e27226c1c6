"""The structure of laws: valid forms and the values a law needs."""

from dataclasses import FrozenInstanceError

import pytest
import sympy

from hesr_model.equations.functions import sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.fitting.estimator import register
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.lugre import LuGre

A = Coefficient(name="a", unit="N.m", description="level")
R = Coefficient(name="r", unit="1/s", description="rate")
X = Relaxation(name="x", unit="rad", drive=DQ, rate=R.symbol)


def form() -> LawForm:
    return LawForm(
        coefficients=(A, R),
        memory=(X,),
        output=A.symbol * X.state + A.symbol * X.derivative,
    )


def law(**more: object) -> FrictionLaw:
    return FrictionLaw(**({"name": "test", "form": form(), "values": {"a": 1.0, "r": 2.0}} | more))


# --- forms ------------------------------------------------------------------------------------


def test_names_are_real_symbols() -> None:
    assert A.symbol == sympy.Symbol("a", real=True)
    assert (X.state.name, X.derivative.name) == ("x", "dx")
    assert X.state.is_real
    assert X.derivative.is_real


def test_inputs_are_the_used_ones_in_order() -> None:
    assert form().inputs == (DQ,)
    assert LawForm(coefficients=(A,), output=A.symbol * TAU_LOAD * sgn(DQ)).inputs == (DQ, TAU_LOAD)
    assert LawForm(coefficients=(A,), output=A.symbol * sympy.cos(Q)).inputs == (Q,)
    assert LawForm(coefficients=(A,), output=A.symbol).inputs == ()
    in_a_rate = Relaxation(name="x", unit="rad", drive=DQ, rate=R.symbol * TAU_LOAD**2)
    used = LawForm(coefficients=(R,), memory=(in_a_rate,), output=in_a_rate.state)
    assert used.inputs == (DQ, TAU_LOAD)


def test_an_input_that_cancels_is_not_used() -> None:
    assert LawForm(coefficients=(A,), output=A.symbol * (Q - Q) + DQ).inputs == (DQ,)


@pytest.mark.parametrize(
    ("relaxation", "output", "symbol"),
    [
        (None, A.symbol * sympy.Symbol("b", real=True), "b"),
        (None, X.state, "x"),
        (Relaxation(name="x", unit="1", drive=sympy.Symbol("c"), rate=R.symbol), X.state, "c"),
        (Relaxation(name="x", unit="1", drive=DQ, rate=sympy.Symbol("d")), X.state, "d"),
        # A drive must not depend on the state: x' = b(v, u) - r(v, u) x.
        (Relaxation(name="x", unit="1", drive=DQ * X.state, rate=R.symbol), X.state, "x"),
        # The same name without "real" is a different symbol.
        (None, sympy.Symbol("dq"), "dq"),
    ],
)
def test_an_undefined_symbol_is_refused(
    relaxation: Relaxation | None, output: sympy.Expr, symbol: str
) -> None:
    message = rf"friction law: symbol '{symbol}' of '[\w.]+'"
    with pytest.raises(ArtifactError, match=message):
        LawForm(
            coefficients=(A, R),
            memory=(relaxation,) if relaxation else (),
            output=output,
        )


@pytest.mark.parametrize(
    ("coefficients", "relaxations", "name"),
    [
        ((A, R, A), (X,), "a"),
        ((A, R), (X, X), "x"),
        ((R, Coefficient(name="dx", unit="1", description="no derivative")), (X,), "dx"),
        ((R, Coefficient(name="dq", unit="1", description="no velocity")), (X,), "dq"),
    ],
)
def test_duplicate_names_are_refused(
    coefficients: tuple[Coefficient, ...], relaxations: tuple[Relaxation, ...], name: str
) -> None:
    with pytest.raises(ArtifactError, match=f"^friction law: '{name}' is used twice among"):
        LawForm(coefficients=coefficients, memory=relaxations, output=X.state)


# --- laws -------------------------------------------------------------------------------------


def test_values_are_floats_in_the_order_of_the_form() -> None:
    made = law(values={"r": 2, "a": 1})
    assert list(made.values.items()) == [("a", 1.0), ("r", 2.0)]
    assert all(type(value) is float for value in made.values.values())


def test_states_start_at_zero_by_default() -> None:
    assert law().start == (0.0,)
    assert law(start=(0.3,)).start == (0.3,)
    static = LawForm(coefficients=(A,), output=A.symbol * sgn(DQ))
    assert FrictionLaw(name="static", form=static, values={"a": 1.0}).start == ()


def test_a_law_is_exact_by_default() -> None:
    assert law().discretisation == "exact"


def test_a_law_is_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        law().name = "other"


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"a": 1.0}, "law 'test': coefficient 'r' is missing; expected a, r."),
        ({}, "law 'test': coefficient 'a' is missing; expected a, r."),
        (
            {"a": 1.0, "r": 2.0, "zeta": 3.0},
            "law 'test': coefficient 'zeta' is unknown; expected a, r.",
        ),
        (
            {"a": 1.0, "R": 2.0},
            "law 'test': coefficient 'r' is missing and 'R' is unknown; expected a, r.",
        ),
        ({"a": float("nan"), "r": 2.0}, "law 'test': coefficient 'a' is nan."),
        ({"a": 1.0, "r": float("inf")}, "law 'test': coefficient 'r' is inf."),
        ({"a": 1.0, "r": -float("inf")}, "law 'test': coefficient 'r' is -inf."),
    ],
)
def test_superfluous_values_are_refused(values: dict[str, float], sentence: str) -> None:
    with pytest.raises(ArtifactError) as caught:
        law(values=values)
    assert str(caught.value) == sentence


def test_a_wrong_number_of_start_values_is_refused() -> None:
    with pytest.raises(ArtifactError) as caught:
        law(start=(0.0, 1.0))
    assert str(caught.value) == "law 'test': 2 start values for 1 states."


def test_a_non_numeric_start_value_is_refused() -> None:
    with pytest.raises(ArtifactError, match=r"^law 'test': start value of 'x' is nan\.$"):
        law(start=(float("nan"),))


# --- models -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("joints", "laws", "sentence"),
    [
        (("j1", "j2"), 1, "friction model 'm': 1 laws for 2 joints."),
        ((), 0, "friction model 'm': 0 laws for 0 joints."),
    ],
)
def test_a_model_has_one_law_per_joint(joints: tuple[str, ...], laws: int, sentence: str) -> None:
    with pytest.raises(ArtifactError) as caught:
        FrictionModel(law="m", robot="r", joints=joints, laws=(law(),) * laws, sample_time=0.005)
    assert str(caught.value) == sentence


@pytest.mark.parametrize("sample_time", [0.0, -0.005, float("nan"), float("inf")])
def test_a_model_needs_a_sample_time(sample_time: float) -> None:
    with pytest.raises(ArtifactError, match="model 'm': sample time is"):
        FrictionModel(law="m", robot="r", joints=("j",), laws=(law(),), sample_time=sample_time)


def test_two_modules_must_not_define_the_same_law() -> None:
    other = type("Other", (LuGre,), {"__module__": "elsewhere"})
    with pytest.raises(
        ConfigError,
        match=r"modules 'hesr_model\.laws\.lugre' and 'elsewhere'; rename one",
    ):
        register(other)
