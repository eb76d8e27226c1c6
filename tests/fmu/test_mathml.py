"""Names and numbers of equations on pages, as a reader sees them."""

import re
from html import unescape

import pytest
import sympy

from fmu_src.pages.mathml import MAX_TERMS, equations, symbol
from hesr_model.equations.functions import (
    absolute,
    cardinal_sine,
    clip,
    larger,
    positive,
    sgn,
)
from hesr_model.equations.memory import Relaxation, Stop
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm


def visible(page: str) -> str:
    """Return the text of MathML with x_{1,2} for indices, x^{2} for powers and x' for dots."""
    page = page.replace('<mo lspace="0" rspace="0.17em">&#8290;</mo>', "·")
    page = re.sub(r"<mover>(.*?)<mo class=\"dot\">˙</mo></mover>", r"\1'", page)
    page = re.sub(r"<msub>(<m.>[^<]*</m.>)<mrow>(.*?)</mrow></msub>", r"\1_{\2}", page)
    page = re.sub(r"<msup>(.*?)<mn>(\W?\d+)</mn></msup>", r"\1^{\2}", page)
    return unescape(re.sub(r"<[^>]+>", "", page))


def law(output: sympy.Expr, *memory: Relaxation | Stop, **values: float) -> FrictionLaw:
    coefficients = tuple(Coefficient(name=k, unit="1", description="any") for k in values)
    form = LawForm(coefficients=coefficients, memory=memory, output=output)
    return FrictionLaw(name="own", form=form, values=values)


def c(name: str) -> sympy.Symbol:
    return Coefficient(name=name, unit="1", description="any").symbol


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("x", "x"),
        ("beta", "β"),
        ("alpha12", "α_{12}"),
        ("F_c", "F_{c}"),
        ("sigma_0", "σ_{0}"),
        ("tau_load", "τ_{load}"),
        ("theta1_dq", "θ_{1,q'}"),
        ("k12_z_3", "k_{12,z,3}"),
        ("a_dz_dh", "a_{z',h'}"),
        ("f_mu", "f_{μ}"),
        ("a<b&c", "a<b&c"),
    ],
)
def test_names_have_greek_letters_and_indices(name: str, text: str) -> None:
    assert visible(symbol(name)) == text
    assert name.startswith("a<") or "&lt;" not in symbol(name)


def test_indices_that_are_numbers_are_upright() -> None:
    assert "<mn>12</mn>" in symbol("k12_z")
    assert "<mi>z</mi>" in symbol("k12_z")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.23456, "1.235"),
        (0.5, "0.5"),
        (2.0, "2"),
        (9999.4, "9999"),
        (1.5e-7, "1.5×10^{−7}"),
        (1e5, "10^{5}"),
        (123456.0, "1.235×10^{5}"),
        (2e10, "2×10^{10}"),
        (0.0001, "0.0001"),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_numbers_have_four_digits(value: float, text: str, sign: float) -> None:
    written = equations(law(c("a") * DQ, a=sign * value), numbers=True)
    assert list(map(visible, written)) == [f"τ= {'−' if sign < 0.0 else ''}{text}·q'"]


def test_products_of_numbers_have_four_digits_and_constants_twelve() -> None:
    (written,) = map(visible, equations(law(c("a") * c("b") * DQ, a=1.234, b=1.234), numbers=True))
    assert written == "τ= 1.523·q'"
    (written,) = map(visible, equations(law(c("a") * sympy.Float(0.12345678901234) * DQ, a=1.0)))
    assert "0.123456789012·" in written


def test_signs_stand_between_terms() -> None:
    own = law(c("a") * DQ + c("b") * Q - c("c"), a=-1.0, b=2.5, c=0.5)
    (written,) = map(visible, equations(own))
    assert sorted(written.removeprefix("τ=").split()) == ["+b·q", "a·q'", "−c"]
    (written,) = map(visible, equations(law(-c("a") * DQ, a=1.0)))
    assert written == "τ= −a·q'"


def test_functions_are_named_as_usual() -> None:
    output = (
        larger(c("a"), DQ) + positive(Q) - absolute(TAU_LOAD) + clip(DQ, c("a"))
        + cardinal_sine(Q) + sgn(DQ)
    )  # fmt: skip
    (written,) = map(visible, equations(law(output, a=1.0)))
    assert sorted(written.removeprefix("τ=").split()) == sorted(
        ["−|τ_{load}|", "+sinc(q)", "+clip(q',a)", "+max(a,q')", "+max(q,0)", "+sgn(q')"]
    )


def test_states_have_their_rates() -> None:
    h = Relaxation(name="h", unit="1", drive=2 * DQ - Q, rate=absolute(DQ) + c("a"))
    stop = Stop(name="z", unit="1", velocity=DQ, deflection=sympy.Float(1e-3), bound=c("b"))
    own = law(h.state + 3 * stop.state + h.derivative, h, stop, a=2.0, b=4.0)
    named, numbered = ([visible(line) for line in equations(own, numbers=n)] for n in (False, True))
    assert "h'" in named[0]
    assert "3·z" in named[0]
    assert named[1].startswith("h'= ")
    assert {"2·q'", "q"} <= {term.lstrip("+−") for term in named[1].split()[1:]}
    assert re.search(r"−\((a\+\|q'\||\|q'\|\+a)\)·h$", named[1].replace(" ", ""))
    assert re.search(r"−\((2\+\|q'\||\|q'\|\+2)\)·h$", numbered[1].replace(" ", ""))
    assert named[2].startswith("z'= ")
    assert named[3] == "|z|≤b"
    assert numbered[3] == "|z|≤4"


@pytest.mark.parametrize("count", [MAX_TERMS, MAX_TERMS + 1, 20])
def test_long_sums_show_their_first_terms_and_the_last(count: int) -> None:
    names = [f"a_{i}" for i in range(count)]
    output = sum((c(name) * DQ**i for i, name in enumerate(names, start=1)), sympy.Integer(0))
    (written,) = equations(law(output, **dict.fromkeys(names, 1.0)))
    terms = visible(written).removeprefix("τ=").split()
    assert written.count("<math") == len(terms) + 1
    if count <= MAX_TERMS:
        assert len(terms) == count
    else:
        assert len(terms) == MAX_TERMS // 2 + 2
        assert terms[0].startswith("a_{0}")
        assert terms[-2:] == ["+⋯", f"+a_{{{count - 1}}}·q'^{{{count}}}"]
