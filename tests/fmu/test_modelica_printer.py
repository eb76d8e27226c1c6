"""Equations in Modelica have the values of the law."""

import math
import re

import numpy as np
import pytest
import sympy

from hesr.extras.modelica.printer import print_equations
from hesr_model.equations.functions import NUMPY, absolute, clip, larger, over, positive, sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, LawForm

A, B = (Coefficient(name=name, unit="1", description="any") for name in "ab")
a, b = A.symbol, B.symbol
H = Relaxation(name="h", unit="1", drive=2 * DQ - a, rate=absolute(DQ) / positive(b))

OUTPUTS = {
    "larger": larger(DQ, a * Q),
    "larger of sums": 2 * larger(DQ - Q, a + b) * larger(a, b) - 1,
    "positive": positive(TAU_LOAD - b) ** 2,
    "clip": b * clip(DQ - Q, positive(b)),
    "over": over(a, DQ, b) - over(b, Q, a),
    "signs": sgn(DQ) * a + absolute(Q - a) ** 2 + 3 * absolute(TAU_LOAD),
    "state": a * H.state + b * H.derivative,
}

_CHOICE = re.compile(r"if ([^()]+) > 0 then ([^()]+) else ([^()]+)")
_SIGN = re.compile(r"if (.+) > 0 then 1 elseif (.+) < 0 then -1 else 0")


def evaluate(text: str, values: dict[str, float]) -> float:
    """Return the value of an expression in Modelica."""
    text = _CHOICE.sub(r"(\2) if (\1) > 0 else (\3)", text.replace("^", "**"))
    text = text.replace("der(h)", "der_h")
    return float(eval(text, {"abs": abs, "exp": math.exp}, values))


@pytest.mark.parametrize("name", OUTPUTS)
def test_values_are_those_of_the_law(name: str) -> None:
    output = OUTPUTS[name]
    memory = (H,) if name == "state" else ()
    written = print_equations(LawForm(coefficients=(A, B), memory=memory, output=output))
    symbols = (DQ, Q, TAU_LOAD, a, b, *([H.state] if memory else []))
    exact = output.subs(H.derivative, H.drive - H.rate * H.state)
    law = sympy.lambdify(symbols, exact, modules=[NUMPY, "numpy"])
    for numbers in np.random.default_rng(1).uniform(-2.0, 2.0, (50, len(symbols))):
        if memory:
            numbers[4] = abs(numbers[4])
        values = {str(symbol): float(x) for symbol, x in zip(symbols, numbers, strict=True)}
        held = {}
        for sign, text in written.signs.items():
            above, below = _SIGN.fullmatch(text).groups()
            assert above == below
            held[sign] = float(np.sign(evaluate(above, values)))
        values |= held
        for line in written.lines:
            result, _, text = " ".join(line.split()).partition(" = ")
            values[result.replace("der(h)", "der_h")] = evaluate(text, values)
        assert values["tau"] == pytest.approx(float(law(*numbers)), rel=1e-12, abs=1e-12)
