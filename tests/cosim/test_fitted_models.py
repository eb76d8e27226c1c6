"""A fitted model is complete: predictions and scores of logs, equations, tables, figures, FMU."""

from pathlib import Path

import numpy as np
import pytest
import sympy

import hesr
from hesr_model.errors import SimulationError

T = 0.005 * np.arange(1500)
DQ = np.cos(T) + 0.5 * np.cos(3.1 * T)
TABLE = {"t": T, "q": np.sin(T), "dq": DQ, "load": np.zeros_like(T)}
NOISE = 0.05 * np.random.default_rng(0).normal(size=len(T))
FRICTION = 4.0 * np.tanh(80.0 * DQ) + 2.0 * DQ + NOISE


@pytest.fixture(scope="module")
def model() -> hesr.FrictionModel:
    return hesr.FrictionRegressor("stribeck").fit(TABLE, FRICTION).model_


def test_equations_are_text_sympy_and_latex(model: hesr.FrictionModel) -> None:
    expressions = model.sympy()["joint1"]
    values = {"F_c", "F_s", "v_s", "sigma_2", "tau_0"}
    assert {str(symbol) for symbol in expressions.values} == values
    assert {str(symbol) for symbol in expressions.torque.free_symbols} == {*values, "dq"}
    assert expressions.units[hesr.DQ] == "rad/s"
    torque = float(expressions.numeric.subs(hesr.DQ, sympy.Float(0.5)))
    t = np.arange(2.0) * 0.005
    predicted = model.predict(t=t, dq=np.full((2, 1), 0.5))[-1, 0]
    assert torque == pytest.approx(predicted, rel=1e-9)
    assert model.equation().startswith("joint1:\n  tau = ")
    assert model.latex()["joint1"].startswith("\\begin{aligned}\n\\tau &= ")
    assert "\\dot{q}" in model.latex()["joint1"]
    assert model._repr_latex_().count("$") == 2
    assert model.laws[0].equation() in model.equation().replace("\n  ", "\n")


def test_coefficients_have_units_errors_and_provenance(model: hesr.FrictionModel) -> None:
    table = model.coefficients()
    rows = {row.name: row for row in table}
    assert rows["sigma_2"].unit == "N.m.s/rad"
    assert rows["sigma_2"].value == model.laws[0].values["sigma_2"]
    for row in table:
        assert (row.standard_error is None) == (row.lower is None) == (row.upper is None)
        assert row.at_bound == (row.standard_error is None)
        if row.lower is not None:
            assert row.upper is not None
            assert row.lower < row.value < row.upper
    assert table.provenance["seed"] == 0
    assert len(table) == len(str(table).splitlines()) == 5
    assert table._repr_html_().count("<tr>") == 6


def test_one_joint_of_a_model_is_a_model(model: hesr.FrictionModel) -> None:
    one = model.select("joint1")
    assert one.joints == ("joint1",)
    assert one.training_rmse == model.training_rmse
    with pytest.raises(SimulationError, match="no joint 'elbow'; it has joint1"):
        model.select("elbow")


def test_passivity_has_a_verdict_for_each_joint(model: hesr.FrictionModel) -> None:
    verdicts = {joint: certificate.verdict for joint, certificate in model.passivity().items()}
    assert set(verdicts) == {"joint1"}
    assert verdicts["joint1"] in ("proven", "refuted", "tested")


def test_a_model_writes_its_fmu(model: hesr.FrictionModel, tmp_path: Path) -> None:
    path = model.to_fmu(tmp_path / "F.fmu", platform="linux64", no_documentation=True)
    assert path == tmp_path / "F.fmu"
    assert path.is_file()


def test_a_log_needs_a_rigid_body(model: hesr.FrictionModel) -> None:
    log = hesr.Log(t=T, q=TABLE["q"], dq=np.cos(T), tau=FRICTION)
    for call in (model.predict, model.score, model.plot):
        with pytest.raises(SimulationError) as refused:
            call(log)
        assert refused.value.key == "rigid_body"
    assert log.plot().shape == (1, 3)
