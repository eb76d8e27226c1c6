"""C from SymPy: literals, functions and shared forms."""

import math
import re
import struct

import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.friction import component as friction
from fmu_src.friction.codegen import law_functions, switches
from fmu_src.interface import Enumeration, Interface, Variable, literal, to_c
from hesr_model.errors import ExportError
from hesr_model.friction.functions import DQ, TAU_LOAD, Q, absolute, sgn
from hesr_model.friction.law import Coefficient, LawForm, Relaxation


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_literals_read_back_as_the_same_double(value):
    text = literal(value)
    assert struct.pack("d", float(text)) == struct.pack("d", value)
    assert "." in text or "e" in text  # a C literal without them is an int


def test_literals_are_not_fixed_point():
    assert literal(2e-5) == "2.0000000000000002e-05"
    assert literal(1e-300) == "1e-300"
    assert literal(3.0) == "3.0"


def test_form_becomes_five_functions():
    h = Relaxation(name="h", unit="1", drive=2 * DQ, rate=absolute(DQ))
    form = LawForm(coefficients=(), relaxations=(h,), output=sgn(DQ) * h.state + h.derivative)
    assert law_functions(form, "law") == (
        "static void law_switches(const double *k, const double *u, double *z)\n"
        "{\n"
        "    (void)k;\n"
        "    const double u_dq = u[0];\n"
        "    z[0] = u_dq;\n"
        "}\n"
        "\n"
        "static void law_relaxations(const double *k, const double *u, const double *s, double "
        "*drive, double *rate)\n"
        "{\n"
        "    (void)k;\n"
        "    const double u_dq = u[0];\n"
        "    const double s_1 = s[0];\n"
        "    drive[0] = 2*u_dq;\n"
        "    rate[0] = s_1*u_dq;\n"
        "}\n"
        "\n"
        "static double law_torque(const double *k, const double *u, const double *s, const "
        "double *x, const double *dx)\n"
        "{\n"
        "    (void)k, (void)u;\n"
        "    const double s_1 = s[0];\n"
        "    const double x_h = x[0];\n"
        "    const double dx_dh = dx[0];\n"
        "    return s_1*x_h + dx_dh;\n"
        "}\n"
        "\n"
        "static void law_relaxations_tangent(const double *k, const double *u, const double "
        "*s, const double *dk, const double *du, double *drive, double *rate)\n"
        "{\n"
        "    (void)k, (void)u, (void)dk;\n"
        "    const double du_dq = du[0];\n"
        "    const double s_1 = s[0];\n"
        "    drive[0] = 2*du_dq;\n"
        "    rate[0] = s_1*du_dq;\n"
        "}\n"
        "\n"
        "static double law_torque_tangent(const double *k, const double *u, const double *s, "
        "const double *x, const double *dx, const double *dk, const double *du, const double "
        "*tx, const double *tdx)\n"
        "{\n"
        "    (void)k, (void)u, (void)x, (void)dx, (void)dk, (void)du;\n"
        "    const double s_1 = s[0];\n"
        "    const double tx_h = tx[0];\n"
        "    const double tdx_dh = tdx[0];\n"
        "    return s_1*tx_h + tdx_dh;\n"
        "}\n"
    )


def test_numbers_have_every_digit():
    form = LawForm(coefficients=(), output=sympy.Float(0.1) * DQ + sympy.pi + sympy.E)
    text = law_functions(form, "law")
    assert "0.10000000000000001*u_dq" in text
    assert f"{math.pi:.17g}" in text
    assert f"{math.e:.17g}" in text


def test_shared_parts_are_computed_once():
    bump = sympy.exp(-(DQ**2))
    text = law_functions(LawForm(coefficients=(), output=bump + sympy.tanh(bump)), "law")
    (torque,) = (part for part in text.split("static ") if part.startswith("double law_torque("))
    assert torque.count("exp(") == 1


def test_signs_of_inputs_are_held_and_those_of_states_are_not():
    a = Coefficient(name="a", unit="1", description="")
    h = Relaxation(name="h", unit="1", drive=DQ, rate=absolute(a.symbol * Q - DQ))
    output = sgn(DQ) + absolute(h.state) + sgn(TAU_LOAD * h.state) + absolute(a.symbol)
    form = LawForm(coefficients=(a,), relaxations=(h,), output=output)
    assert set(switches(form)) == {DQ, a.symbol * Q - DQ}
    text = law_functions(form, "law")
    assert "fabs(x_h)" in text
    assert "fabs(k_a)" in text
    assert {"sgn(u_tau_load*x_h)", "sgn(x_h*u_tau_load)"} & set(re.findall(r"sgn\([^()]*\)", text))
    assert "sgn(u_dq)" not in text


def test_coefficients_that_cannot_change_have_no_tangents():
    a = Coefficient(name="a", unit="1", description="")
    form = LawForm(coefficients=(a,), output=a.symbol * DQ)
    assert "dk[0]" in law_functions(form, "law")
    assert "dk[0]" not in law_functions(form, "law", tunable=False)


def test_equal_forms_are_written_once(make_law, make_model):
    model = make_model(make_law("lugre"), make_law("parfam_sin"), make_law("lugre"))
    text = friction.laws_to_c(model, friction.interface(model))
    assert text.count("_torque(const") == 2
    assert text.count(" law_1_torque,") == 2


def test_functions_without_a_counterpart_in_c_are_refused():
    form = LawForm(coefficients=(), output=sympy.besselj(0, DQ))
    with pytest.raises(ExportError, match=r"besselj\(0, dq\)' has no counterpart in C\."):
        law_functions(form, "law")


def test_table_of_variables():
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
    text = to_c(table, "{guid}")
    assert '{"u[1]", 0.10000000000000001, INPUT, REAL, 0, 0, 1},' in text
    assert '{"kind", 2.0, FIXED, INTEGER, 1, 2, 1},' in text
    assert '{"held", 0.0, INPUT, REAL, 0, 0, 0},' in text  # no output is older for it
    assert '#define MODEL_GUID "{guid}"' in text


@pytest.mark.parametrize("name", ["a b", "1a", "a[x]", 'a"', "der(a", "a..b", ""])
def test_names_that_fmi_does_not_allow_are_refused(name):
    with pytest.raises(ExportError, match="not a structured name"):
        Interface(variables=(Variable(name=name, role="input", description="", unit="1"),))


def test_names_are_distinct():
    one = Variable(name="a", role="input", description="", unit="1")
    with pytest.raises(ExportError, match="'a' is used twice"):
        Interface(variables=(one, one))
