"""C from SymPy: literals, functions and shared forms."""

import math
import re
import struct
from math import inf

import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.equations.c_functions import Functions
from fmu_src.export.interface import (
    Enumeration,
    Interface,
    Variable,
    extract_numbers,
    literal,
    to_c,
)
from fmu_src.friction import friction_component as friction
from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.memory import Relaxation, Stop
from hesr_model.equations.program import Jumps
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, LawForm


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_literals_are_read_back_exactly(value):
    text = literal(value)
    assert struct.pack("d", float(text)) == struct.pack("d", value)
    assert "." in text or "e" in text  # a C literal without them is an int


def test_extreme_literals_use_an_exponent():
    assert literal(2e-5) == "2.0000000000000002e-05"
    assert literal(1e-300) == "1e-300"
    assert literal(3.0) == "3.0"


def own(form, *, tunable=True):
    return Functions(form.component, "law", tunable=tunable)


def test_a_step_has_no_branches():
    h = Relaxation(name="h", unit="1", drive=2 * DQ, rate=absolute(DQ))
    form = LawForm(coefficients=(), memory=(h,), output=sgn(DQ) * h.state + h.derivative)
    assert own(form).step() == (
        "QUICK void law_step(const double *k, const double *u, const double *s, const double *p, "
        "const double *c, double dt, double euler, double *x, double *y, double *r)\n"
        "{\n"
        "    (void)k, (void)p, (void)c, (void)r;\n"
        "    const double u_0 = u[0];\n"
        "    const double s_0 = s[0];\n"
        "    const double x_0 = x[0];\n"
        "    const double t0 = positive(fabs(u_0));\n"
        "    const double t1 = dt*t0;\n"
        "    const double t2 = quick_decay(t1, euler);\n"
        "    const double t3 = 2*u_0;\n"
        "    const double a_0 = dt*t3*share(t1, t2, euler) + x_0*(t2 + 1);\n"
        "    const double a_1 = -a_0*t0 + t3;\n"
        "    const double a_2 = a_1 + a_0*s_0;\n"
        "    x[0] = a_0;\n"
        "    y[0] = a_2;\n"
        "}\n"
    )


def test_code_shared_by_two_laws_is_written_once(table1):
    """Joints 2 and 3 have equal states, with coefficients at the same offsets."""
    _, text = friction.friction_equations(table1)
    defined = re.findall(r"^(?:(?:SELDOM )?static|QUICK) void (law_\d_\w+)\(", text, re.MULTILINE)
    assert "law_3_begin" not in defined
    rows = [line for line in text.splitlines() if line.startswith("    {") and "_step" in line]
    found = [re.findall(r"law_\d_(?:begin|step)\b", row) for row in rows]
    assert found[1:] == [["law_2_step", "law_2_begin"], ["law_3_step", "law_2_begin"]]
    assert all(name in defined for names in found for name in names)


def test_tangents_follow_the_same_lines():
    h = Relaxation(name="h", unit="1", drive=2 * DQ, rate=absolute(DQ))
    form = LawForm(coefficients=(), memory=(h,), output=sgn(DQ) * h.state + h.derivative)
    text = own(form).tangent()
    assert "tdx[0] = " in text
    assert "ty[0] = " in text
    assert "dk[0]" not in text


def test_a_stop_is_clipped():
    x = Stop(name="x", unit="1", velocity=DQ, deflection=0.25, bound=TAU_LOAD)
    functions = own(LawForm(coefficients=(), memory=(x,), output=x.state))
    assert "const double a_0 = clip(u_0*c_0 + x_0, positive(u_2));" in functions.step()
    assert "c[0] = fixed_0;" in functions.invariants()
    assert "const double fixed_0 = 4.0*dt;" in functions.invariants()


def test_numbers_have_every_digit():
    form = LawForm(coefficients=(), output=sympy.Float(0.1) * DQ + sympy.pi + sympy.E)
    text = own(form).read()
    assert "0.10000000000000001*u_0" in text
    assert f"{math.pi:.17g}" in text
    assert f"{math.e:.17g}" in text


def test_shared_parts_are_computed_once():
    bump = sympy.exp(-(DQ**2))
    text = own(LawForm(coefficients=(), output=bump + sympy.tanh(bump))).read()
    assert text.count("exp(") == 1


def test_only_signs_of_inputs_are_held():
    a = Coefficient(name="a", unit="1", description="")
    h = Relaxation(name="h", unit="1", drive=DQ, rate=absolute(a.symbol * Q - DQ))
    output = sgn(DQ) + absolute(h.state) + sgn(TAU_LOAD * h.state) + absolute(TAU_LOAD)
    form = LawForm(coefficients=(a,), memory=(h,), output=output)
    # The magnitudes of the load and of a Q - dq have kinks in the torque but are not events.
    assert set(Jumps(form.component).expressions) == {DQ}
    assert set(Jumps(form.component, all_magnitudes=True).expressions) == {
        DQ,
        a.symbol * Q - DQ,
        TAU_LOAD,
    }
    text = own(form).read()
    assert {"fabs(x_0)", "fabs(u_2)"} <= set(re.findall(r"fabs\([^()]*\)", text))
    assert {"sgn(u_2*x_0)", "sgn(x_0*u_2)"} & set(re.findall(r"sgn\([^()]*\)", text))
    assert "sgn(u_0)" not in text


def test_velocity_reversals_are_events():
    h = Relaxation(name="h", unit="1", drive=DQ, rate=absolute(DQ))
    form = LawForm(coefficients=(), memory=(h,), output=h.state * absolute(TAU_LOAD))
    assert Jumps(form.component).expressions == (DQ,)
    assert "s[0]" not in own(form).read()  # but the magnitude follows the velocity


def test_coefficients_that_cannot_change_have_no_tangents():
    a = Coefficient(name="a", unit="1", description="")
    form = LawForm(coefficients=(a,), output=a.symbol * DQ)
    assert "dk[0]" in own(form).tangent()
    assert "dk[0]" not in own(form, tunable=False).tangent()


def test_equal_forms_are_written_once(make_law, make_model):
    model = make_model(make_law("lugre"), make_law("parfam_sin"), make_law("lugre"))
    _, text = friction.friction_equations(model)
    assert text.count("_step(const") == 2
    assert text.count(" law_1_step,") == 4  # in the table, and for EACH_JOINT


def test_functions_without_a_counterpart_in_c_are_refused():
    form = LawForm(coefficients=(), output=sympy.besselj(0, DQ))
    with pytest.raises(ExportError, match=r"besselj\(0, dq\)' has no counterpart in C\."):
        own(form).read()


def test_the_table_of_variables_is_complete():
    choice = Enumeration(name="Kind", items=(("a", "first"), ("b", "second")))
    table = Interface(
        variables=(
            Variable(name="u[1]", role="input", description="", unit="rad", start=0.1),
            Variable(name="kind", role="fixed", description="", enumeration=choice, start=2),
            Variable(name="held", role="input", description="", unit="rad"),
            Variable(
                name="y", role="output", description="", unit="rad", dependencies=("u[1]", "kind")
            ),
        )
    )
    text = to_c(table, "{guid}", 0.005)
    assert '{"u[1]", INPUT, REAL, 1, 1},' in text
    assert '{"kind", FIXED, INTEGER, 1, 0},' in text
    assert '{"held", INPUT, REAL, 0, 1},' in text  # not held: no output depends on an old value
    assert "{0.10000000000000001, -INFINITY, INFINITY},\n    {2.0, 1.0, 2.0},\n" in text
    assert '#define MODEL_GUID "{guid}"' in text
    blank, content = extract_numbers(text)
    assert content[:40] == b"{guid}".ljust(40, b"\0")
    numbers = (0.1, -inf, inf, 2.0, 1.0, 2.0, 0.0, -inf, inf, 0.0, -inf, inf)
    assert struct.unpack("<12d", content[40:]) == numbers
    assert "0.1" not in blank
    assert extract_numbers(blank) == (blank, bytes(len(content)))


def test_arrays_are_found_among_scalars():
    def many(name, unit="rad"):
        return Variable(name=name, role="input", description="", unit=unit)

    rows = [many(f"a[{i},{k}]") for i in (1, 2) for k in (1, 2, 3)]
    mixed = [many("q[1]"), many("q[2]", "m")]  # FMI 3.0 allows one unit per array
    odd = [many("u[2]"), many("u[3]")]
    table = Interface(variables=(many("x"), *rows, *mixed, *odd, many("w.v[1]")))
    found = [(a.name, a.shape, a.place) for a in table.arrays]
    assert found == [
        ("x", (), 0), ("a", (2, 3), 1), ("q[1]", (), 7), ("q[2]", (), 8), ("u[2]", (), 9),
        ("u[3]", (), 10), ("w.v", (1,), 11),
    ]  # fmt: skip
    assert (table.places["a"], table.places["a[2,1]"]) == (1, 4)


@pytest.mark.parametrize("name", ["a b", "1a", "a[x]", 'a"', "der(a", "a..b", ""])
def test_names_invalid_in_fmi_are_refused(name):
    with pytest.raises(ExportError, match="not a structured name"):
        Interface(variables=(Variable(name=name, role="input", description="", unit="1"),))


def test_names_are_distinct():
    one = Variable(name="a", role="input", description="", unit="1")
    with pytest.raises(ExportError, match="'a' is used twice"):
        Interface(variables=(one, one))
