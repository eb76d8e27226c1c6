"""The text of an exported Modelica package, and refusals."""

import re
from dataclasses import replace

import pytest
import sympy
from containing import Containing

from hesr.extras.modelica.modelica_package import export_modelica, package
from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ArtifactError, ExportError
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.trained_range import TrainedRange


def part(text, kind, name):
    """Return a class of a package."""
    found = re.search(rf"^ *{kind} {name}\b.*?end {name};$", text, re.DOTALL | re.MULTILINE)
    assert found, f"there is no {kind} {name}"
    return found[0]


def law(output, *relaxations, **values):
    own = tuple(Coefficient(name=n, unit="N.m", description=f"the {n}") for n in values)
    form = LawForm(coefficients=own, memory=relaxations, output=output)
    return FrictionLaw(name="odd", form=form, values=values)


def test_a_law_becomes_a_block(make_model):
    k, z = sympy.symbols("k z", real=True)
    bristle = Relaxation(name="z", unit="rad", drive=DQ, rate=absolute(DQ) / k)
    stiff = law(k * z + sympy.Symbol("dz", real=True) + sgn(z), bristle, k=0.1)
    text = package(make_model(replace(stiff, start=(-1e-5,))), "Bench")
    before, after = part(text, "block", "Odd").split("    initial equation\n")
    beginning, lines = after.split("    equation\n")
    assert re.sub(r"\s+", " ", beginning).startswith(" z = if steadyStart then z_start + (")
    assert beginning.endswith("        else z_start;\n")
    assert before + lines == (
        '    block Odd "Equations of odd"\n'
        "      extends Interfaces.Law;\n"
        '      parameter Real k(unit="N.m") "the k";\n'
        '      parameter Real z_start(unit="rad") "Start value of z";\n'
        "      parameter Boolean steadyStart = true\n"
        '        "= true, if states begin steady where dq is 0.02 rad/s or more" annotation '
        "(choices(checkBox=true));\n"
        '      Real z(unit="rad", start=z_start) "Friction state";\n'
        "    protected\n"
        "      Real sign_dq = if dq > 0 then 1 elseif dq < 0 then -1 else 0\n"
        '        "Held between events";\n'
        "      der(z) = dq - (sign_dq*dq/k)*z;\n"
        "      tau = der(z) + k*z + sign(z);\n"
        "    end Odd;"
    )
    assert part(text, "block", "Joint1").splitlines()[:5] == [
        '  block Joint1 "Friction of axis_1"',
        "    extends Laws.Odd(",
        "      k=0.1,",
        "      z_start=-1e-05,",
        "      z(nominal=0.1));",
    ]


def test_joints_share_the_equations_of_a_form(make_law, make_model):
    tanh, cos = make_law("parfam_tanh"), make_law("parfam_cos")
    text = package(make_model(tanh, cos, replace(tanh, start=(0.5,))), "Arm")
    blocks = re.findall(r"block (\w+) \"", text)
    assert blocks == ["Law", "ByHand_1", "ByHand_2", "Joint1", "Joint2", "Joint3", "Sine"]
    bases = [
        re.search(r"extends Laws.(\w+)", part(text, "block", f"Joint{i}"))[1] for i in (1, 2, 3)
    ]
    assert bases == ["ByHand_1", "ByHand_2", "ByHand_1"]
    assert "h_start=0.5," in part(text, "block", "Joint3")


def test_a_law_without_parameters_is_exported(make_law, make_model):
    text = package(make_model(make_law("bare")), "Bare")
    assert "    extends Laws.ByHand;\n" in part(text, "block", "Joint1")


def test_load_is_an_input_if_a_law_uses_it(make_model):
    loaded, plain = law(absolute(TAU_LOAD) * DQ), law(2 * DQ)
    text = package(make_model(loaded, plain), "Arm")
    assert "(useLoad=true, redeclare Joint1 law)" in part(text, "model", "Joint1Bearing")
    assert "(redeclare Joint2 law)" in part(text, "model", "Joint2Bearing")
    assert "connect(load.y, bearing.tau_load)" in part(text, "model", "Joint1Speed")
    assert "tau_load" not in part(text, "model", "Joint2Speed")


def test_a_jump_at_rest_is_noted_and_not_coupled_to_an_inertia(make_law, make_model):
    text = package(make_model(make_law("viscous"), make_law("lugre")), "Arm")
    assert "model Joint1Torque" not in text
    assert "model Joint2Torque" in text
    assert "the torque of Joint1 jumps with the sign of the velocity" in text
    assert "jumps with the sign" not in package(make_model(make_law("lugre")), "Arm")


def test_origin_and_findings_are_documented(table1):
    text = package(table1, "Friction")
    joint, whole = (
        part(text, "block", "Joint1"),
        text[text.index("<p>Friction torque of 3 joints") :],
    )
    assert "tau = 16.24*h - 0.163*h&#39; + 37.72*tanh(" in joint
    assert joint == Containing("0.4 rad/s at 0.05 Hz", "generates 12.4 J")
    assert "Table I of the paper" in whole
    assert "explicit Euler steps of 0.005 s" in whole
    assert (
        "<td>Most energy given in a closed cycle [J]</td><td>12.4</td><td>20.6</td><td>0</td>"
        in whole
    )
    assert text.isascii()


def test_results_of_the_fit_are_documented(make_law, make_model):
    fitted = replace(make_law("lugre"), standard_errors={"F_c": 0.1}, start_samples=5)
    seen = TrainedRange(
        sample_time=0.005, dq=(-0.8, 0.9), q=(0.0, 1.0), tau_load=(-3.0, 5.0), tau=(-12.0, 12.0)
    )
    where = {"files": [{"name": "C:\\logs\\a.csv", "sha256": "0f"}], "seed": 3}
    model = make_model(fitted, trained=(seen,), training_rmse=(0.25,), provenance=where)
    text = package(model, "Friction")
    joint = part(text, "block", "Joint1")
    assert "F_c = 9 +- 0.2 N.m" in joint
    assert "from the first 5 measured torques" in joint
    assert (
        "Training ranges: dq &#8722;0.8 to 0.9 rad/s, q 0 to 1 rad, tau_load &#8722;3 to 5 N.m."
        in joint
    )
    assert "RMSE on the training logs: 0.25 N.m." in joint
    assert "<li>a.csv, SHA-256 0f</li>" in text
    assert "Seed: 3." in text


def test_a_missing_audit_is_explained(make_model):
    growing = Relaxation(name="h", unit="1", drive=DQ, rate=sympy.Integer(1))
    odd = law(sympy.exp(sympy.exp(1000 * growing.state + 1000)), growing)
    text = package(make_model(odd), "Odd")
    assert "<b>Not audited:</b> " in text
    assert "Joint1Speed" in text
    assert "Joint1Torque" not in text


def test_strings_are_escaped(make_law, make_model):
    model = replace(make_model(make_law("bare")), robot='a "b" \\ c', joints=('j"1',))
    text = package(model, "F")
    assert text.startswith('within ;\npackage F "Friction of a \\"b\\" \\\\ c by by_hand"\n')
    assert 'block Joint1 "Friction of j\\"1"' in text


def test_the_export_is_complete_and_reproducible(make_law, make_model, tmp_path):
    model = make_model(make_law("lugre"))
    path = tmp_path / "folder" / "Friction.mo"
    assert export_modelica(model, path) == path
    first = path.read_bytes()
    assert first.endswith(b"end Friction;\n")
    export_modelica(model, path)
    assert path.read_bytes() == first
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Friction.txt", "package ends in .mo, found '.txt'"),
        ("Friction", "package ends in .mo, found ''"),
        (
            "my-law.mo",
            "'my-law' is not a valid name",
        ),
        ("3law.mo", "'3law' is not a valid name in Modelica"),
        ("naïve.mo", "'naïve' is not a valid name in Modelica"),
        ("model.mo", "'model' is taken by Modelica"),
        ("Modelica.mo", "'Modelica' is taken by Modelica"),
    ],
)
def test_invalid_file_names_are_refused(name, reason, make_law, make_model, tmp_path):
    with pytest.raises(ExportError, match=re.escape(reason)):
        export_modelica(make_model(make_law("bare")), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_folder_is_reported(make_law, make_model, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArtifactError, match="cannot be written there"):
        export_modelica(make_model(make_law("bare")), tmp_path / "file" / "F.mo")


@pytest.mark.parametrize(
    "expression", [sympy.gamma(DQ), sympy.Piecewise((DQ, DQ > 1), (1, True)), sympy.erf(DQ) + DQ]
)
def test_expressions_missing_in_modelica_are_refused(expression, make_model, tmp_path):
    with pytest.raises(ExportError, match="has no counterpart in Modelica") as found:
        export_modelica(make_model(law(expression)), tmp_path / "F.mo")
    assert str(found.value) == f"friction law: '{expression}' has no counterpart in Modelica."
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("end", "taken by Modelica"),
        ("time", "taken by Modelica"),
        ("exp", "taken by Modelica"),
        ("é", "not a valid name in Modelica"),
        ("sign_dq", "used twice"),
    ],
)
def test_names_invalid_in_modelica_are_refused(name, reason, make_model):
    odd = law(absolute(DQ) * sympy.Symbol(name, real=True), **{name: 1.0})
    with pytest.raises(ExportError) as found:
        package(make_model(odd), "F")
    assert f"'odd': the name '{name}' is {reason}" in str(found.value)
