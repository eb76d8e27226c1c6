"""modelDescription.xml and the documentation describe the FMU correctly."""

import math
import zipfile
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu

from fmu_src import export_fmu
from fmu_src.blocks.controller import velocity
from fmu_src.export.description import si_exponents
from fmu_src.friction.friction_fmu import export_bare
from hesr_model.errors import ExportError
from hesr_model.friction.trained_range import TrainedRange


def described(fmu):
    return read_model_description(fmu, validate=True, validate_model_structure=True)


def indices(unknowns):
    return [u.variable.name for u in unknowns]


def dependencies(unknown):
    return {v.name for v in unknown.dependencies}


def test_fmpy_finds_no_problem(every_law, make_model, tmp_path):
    model = make_model(*(law for n, law in every_law.items() if not n.startswith("fitted_")))
    assert validate_fmu(str(export_bare(model, tmp_path / "F.fmu"))) == []


def test_outputs_depend_exactly_on_the_inputs_of_the_law(make_law, make_model, tmp_path):
    model = make_model(make_law("lugre"), make_law("viscous"))
    about = described(export_fmu(model, tmp_path / "F.fmu"))
    assert indices(about.outputs) == ["tau[1]", "tau[2]", "dtau_ddq[1]", "dtau_ddq[2]"]
    for first, second in (about.outputs[:2], about.outputs[2:]):
        assert dependencies(first) == {"dq[1]", "z[1]"}
        assert dependencies(second) == {"dq[2]", "q[2]", "tau_load[2]"}
    assert dependencies(about.derivatives[0]) == {"dq[1]", "z[1]"}


def test_initial_unknowns_are_those_of_the_standard_in_order(table1_fmu):
    about = described(table1_fmu)
    assert indices(about.initialUnknowns) == [
        "tau[1]", "tau[2]", "tau[3]", "dtau_ddq[1]", "dtau_ddq[2]", "dtau_ddq[3]",
        "h[1]", "der(h[1])", "h[2]", "der(h[2])", "h[3]", "der(h[3])",
    ]  # fmt: skip
    assert {"dq[1]", "h_start[1]", "joint[1].c_g1"} <= dependencies(about.initialUnknowns[0])
    for unknown in about.initialUnknowns[6:8]:
        assert dependencies(unknown) == {
            "dq[1]", "start_mode", "h_start[1]", "joint[1].alpha", "joint[1].beta",
        }  # fmt: skip


def test_states_are_calculated_and_linked_to_their_derivatives(make_law, make_model, tmp_path):
    about = described(export_fmu(make_model(make_law("elements")), tmp_path / "F.fmu"))
    variables = {v.name: v for v in about.modelVariables}
    state = variables["x2[1]"]
    assert (state.initial, state.start, state.causality) == ("calculated", None, "local")
    start = variables["x2_start[1]"]
    assert (start.variability, start.start, start.unit) == ("fixed", "-0.2", state.unit)
    assert variables["der(x2[1])"].derivative is state
    assert indices(about.derivatives) == ["der(x1[1])", "der(x2[1])"]
    assert variables["der(x2[1])"].unit == "1/s"


def test_parameters_are_the_coefficients(table1, table1_fmu):
    about = described(table1_fmu)
    variables = {v.name: v for v in about.modelVariables}
    for joint, law in enumerate(table1.laws, start=1):
        for coefficient in law.form.coefficients:
            parameter = variables[f"joint[{joint}].{coefficient.name}"]
            assert float(parameter.start) == law.values[coefficient.name]
            assert (parameter.variability, parameter.unit) == ("tunable", coefficient.unit)
    choice = variables["discretisation"]
    assert (choice.variability, choice.start) == ("fixed", "2")
    assert choice.description.endswith(": 1 = exact, 2 = euler")


def test_units_are_defined_in_si(table1_fmu):
    units = {u.name: u.baseUnit for u in described(table1_fmu).unitDefinitions}
    torque = units["N.m"]
    assert (torque.kg, torque.m, torque.s, torque.rad) == (1, 2, -2, 0)
    damping = units["N.m.s/rad"]
    assert (damping.kg, damping.m, damping.s, damping.rad) == (1, 2, -1, -1)


@pytest.mark.parametrize(
    ("unit", "exponents"),
    [
        ("1", {}),
        ("1/s", {"s": -1}),
        ("rad/s2", {"rad": 1, "s": -2}),
        ("N.m/(rad.s)", {"kg": 1, "m": 2, "s": -3, "rad": -1}),
        ("s/rad", {"s": 1, "rad": -1}),
    ],
)
def test_si_exponents_are_right(unit, exponents):
    assert si_exponents(unit) == exponents


def test_quantities_and_display_units_are_given(table1_fmu):
    about = described(table1_fmu)
    variables = {v.name: v for v in about.modelVariables}
    shown = {
        n: (variables[n].quantity, variables[n].displayUnit) for n in ("dq[1]", "q[1]", "tau[1]")
    }
    assert shown == {
        "dq[1]": ("AngularVelocity", "deg/s"),
        "q[1]": ("Angle", "deg"),
        "tau[1]": ("Torque", None),
    }
    units = {u.name: u for u in about.unitDefinitions}
    (degrees,) = units["rad"].displayUnits
    assert (degrees.name, degrees.factor * math.pi) == (
        "deg",
        pytest.approx(180.0, rel=1e-15, abs=0.0),
    )


def test_the_sign_of_the_torque_is_documented(table1_fmu):
    (tau,) = (v for v in described(table1_fmu).modelVariables if v.name == "tau[1]")
    assert ", delivered by the drive" in tau.description


def test_nominal_values_are_those_of_training(make_law, make_model, tmp_path):
    seen = TrainedRange(
        dq=(-0.5, 1.234), q=(-1.0, 1.0), tau_load=(-40.4, 3.0), tau=(-12.34, 3.0), sample_time=0.005
    )
    model = make_model(make_law("viscous"), trained=(seen,))
    about = described(export_bare(model, tmp_path / "F.fmu"))
    nominals = {v.name: v.nominal for v in about.modelVariables}
    assert [nominals[n] for n in ("dq[1]", "tau_load[1]", "tau[1]")] == ["1.2", "40.0", "12.0"]


@pytest.mark.parametrize("fmi", [2, 3])
def test_every_law_has_its_factors(fmi, make_law, make_model, tmp_path):
    laws = [make_law(name) for name in ("lugre", "viscous", "gaussians")]
    fmu = export_bare(make_model(*laws), tmp_path / "F.fmu", fmi=fmi)
    found = {v.name: v for v in described(fmu).modelVariables}
    for name in ("coulomb_scale", "viscous_scale"):
        for variable in [found[name]] if fmi == 3 else [found[f"{name}[{i}]"] for i in (1, 2, 3)]:
            assert (variable.causality, variable.variability) == ("parameter", "tunable")
            assert (variable.min, variable.max) == ("0.0", None)
            assert variable.start.split() in (["1.0"], ["1.0"] * 3)
            assert variable.description.startswith("factor on the ")
    if fmi == 2:
        idle = found["viscous_scale[1]"].description
        assert idle == "factor on the viscous friction of axis_1; its law has no such term"


@pytest.mark.parametrize("fmi", [2, 3])
def test_author_and_licence_are_those_of_the_owner(fmi, make_law, make_model, tmp_path):
    owner = {"author": "A & B", "license": "Apache-2.0"}
    whose = {"mine": make_model(make_law("viscous"), provenance={"owner": owner})}
    whose["unknown"] = make_model(make_law("viscous"))
    for name, expected in (("mine", owner), ("unknown", {})):
        fmu = export_bare(whose[name], tmp_path / f"{name}.fmu", fmi=fmi)
        with zipfile.ZipFile(fmu) as archive:
            root = ET.fromstring(archive.read("modelDescription.xml"))
            assert b"HESR authors" in archive.read("documentation/licenses/license.txt")
        found = {k: root.get(k) for k in ("author", "copyright", "license") if root.get(k)}
        assert found == expected


def test_fmus_of_our_code_only_have_our_licence():
    about = velocity(1).about
    assert about.owner.known == {
        "author": "The HESR authors",
        "license": "MIT",
        "copyright": "Copyright (c) 2026 The HESR authors",
    }


def test_fmus_of_our_code_only_have_the_date_of_the_version():
    citation = Path(__file__).parents[2].joinpath("CITATION.cff").read_text(encoding="utf-8")
    assert f'date-released: "{velocity(1).about.created.removesuffix("T00:00:00Z")}"' in citation


def test_unknown_units_are_refused():
    with pytest.raises(ExportError, match=r"unit 'lbf\.ft': 'lbf' is unknown"):
        si_exponents("lbf.ft")


def test_the_default_experiment_is_given(table1_fmu):
    about = described(table1_fmu)
    experiment = about.defaultExperiment
    assert (experiment.startTime, experiment.stopTime, experiment.stepSize) == ("0", "5", "0.005")
    assert about.generationDateAndTime.endswith("Z")


def test_the_documentation_is_complete(table1, table1_fmu):
    with zipfile.ZipFile(table1_fmu) as archive:
        page = archive.read("documentation/index.html").decode()
        licence = archive.read("documentation/licenses/license.txt").decode()
    for law in table1.laws:
        for value in law.values.values():
            assert f"{value:.6g}".removeprefix("-") in page
    assert "MIT License" in licence


def test_text_of_a_model_is_escaped(make_law, make_model, tmp_path):
    model = make_model(make_law("lugre"), robot='<b>"&', law="a-b c")
    fmu = export_fmu(model, tmp_path / "F.fmu")
    with zipfile.ZipFile(fmu) as archive:
        root = ET.fromstring(archive.read("modelDescription.xml"))
        assert "<b>" not in archive.read("documentation/index.html").decode()
    assert root.get("modelName") == 'Friction of <b>"& by a-b c'
    assert root.find("CoSimulation").get("modelIdentifier") == "friction_a_b_c"


def test_the_licence_is_that_of_the_project(request):
    root = request.config.rootpath
    own = (root / "LICENSE").read_text(encoding="utf-8")
    assert (root / "fmu_src/pages/templates/license.txt").read_text(encoding="utf-8") == own
