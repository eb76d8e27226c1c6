"""A user-defined law of ten stops in 25 lines works wherever other laws do."""

import sys
from pathlib import Path

import numpy as np
import pytest

from fmu_src import export_fmu
from fmu_src.check.run import check
from fmu_src.friction.replay import replay
from fmu_src.run.fmu import FmuInstance
from hesr.extras.drive.drive_fmu import export_drive
from hesr.extras.modelica.modelica_package import export_modelica
from hesr.extras.properties.battery import Subject, run_battery
from hesr_model.fitting import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.rigid_body.friction_record import FrictionRecord

SOURCE = Path(__file__).parents[1] / "contract" / "maxwell_slip.py"
DT = 0.005
T = DT * np.arange(4000)
DQ = 0.5 * np.sin(0.5 * np.pi * T) * np.exp(-(((T - 10.0) / 6.0) ** 2))
FORCES = {f"F_{i}": 1.0 + 0.1 * i for i in range(1, 11)}


@pytest.fixture(scope="module")
def maxwell_slip(monkeypatch_module: pytest.MonkeyPatch) -> type[estimator.Estimator]:
    monkeypatch_module.syspath_prepend(str(SOURCE.parent))
    monkeypatch_module.setattr(estimator, "_REGISTRY", dict(estimator._REGISTRY))
    sys.modules.pop("maxwell_slip", None)
    from maxwell_slip import MaxwellSlip

    return estimator.register(MaxwellSlip)


@pytest.fixture(scope="module")
def monkeypatch_module():
    with pytest.MonkeyPatch.context() as patch:
        yield patch


@pytest.fixture(scope="module")
def model(maxwell_slip: type[estimator.Estimator]) -> FrictionModel:
    law = FrictionLaw(
        name="maxwell_slip",
        form=maxwell_slip.form({}),
        values={**FORCES, "sigma_2": 3.0, "tau_0": 0.2},
    )
    return FrictionModel(
        law="maxwell_slip", robot="tried", joints=("axis",), laws=(law,), sample_time=DT
    )


@pytest.fixture(scope="module")
def fmu(model: FrictionModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_fmu(model, tmp_path_factory.mktemp("maxwell") / "MaxwellSlip.fmu", power=True)


def torque(model: FrictionModel, t: np.ndarray, dq: np.ndarray) -> np.ndarray:
    return predict(model.laws[0], t=t, dq=dq)


def test_the_definition_is_short() -> None:
    lines = SOURCE.read_text(encoding="utf-8").splitlines()
    assert len([line for line in lines if line.strip()]) <= 25


def test_the_law_is_fitted(maxwell_slip: type[estimator.Estimator], model: FrictionModel) -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.05, len(T))
    record = FrictionRecord(
        log="made",
        joint="axis",
        t=T,
        dq=DQ,
        q=np.cumsum(DQ) * DT,
        tau_load=np.zeros_like(T),
        tau=torque(model, T, DQ) + noise,
    )
    found = maxwell_slip().fit([record], np.random.default_rng(0))
    for name, value in model.laws[0].values.items():
        assert found.values[name] == pytest.approx(value, abs=0.05)


def test_the_model_is_read_back(model: FrictionModel, tmp_path: Path) -> None:
    model.write(tmp_path / "law.json")
    assert FrictionModel.read(tmp_path / "law.json").laws == model.laws


def test_the_fmu_matches_the_law(model: FrictionModel, fmu: Path) -> None:
    expected = torque(model, T, DQ)
    found = replay(fmu, T, DQ[:, None])[:, 0]
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()
    assert check(fmu).problems == ()


def test_power_is_consistent_with_its_derivative(fmu: Path) -> None:
    with FmuInstance(fmu) as component:
        about = {v.name: v for v in component.description.modelVariables}
        assert about["power[1]"].unit == "W"
        needs = {
            unknown.variable.name: {d.name for d in unknown.dependencies}
            for unknown in component.description.outputs
        }
        assert {"dq[1]", "x1[1]"} <= needs["power[1]"]
        component.initialise(start={"dq[1]": 0.3})
        component.step(0.0, DT)
        tau, power, slope = component.get(["tau[1]", "power[1]", "dtau_ddq[1]"])
        assert power == pytest.approx(tau * 0.3, rel=1e-15, abs=0.0)
        known, unknown = about["dq[1]"].valueReference, about["power[1]"].valueReference
        slave = component._instance.slave
        [found] = slave.getDirectionalDerivative([unknown], [known], [1.0])
        # At frozen states: tau + dq sigma_2.
        assert found == pytest.approx(tau + 0.3 * 3.0, rel=1e-12, abs=0.0)
        assert np.isfinite(slope)


def test_model_exchange_matches_co_simulation(model: FrictionModel, fmu: Path) -> None:
    from fmpy import simulate_fmu

    t = 1e-3 * np.arange(6000)
    dq = 0.5 * np.sin(0.5 * np.pi * t)
    given = np.array(list(zip(t, dq, strict=True)), dtype=[("time", float), ("dq[1]", float)])
    found = simulate_fmu(
        str(fmu),
        fmi_type="ModelExchange",
        input=given,
        output=["tau[1]"],
        stop_time=5.9,
        output_interval=1e-3,
        relative_tolerance=1e-7,
        start_values={"q[1]": 0.0, "tau_load[1]": 0.0},
    )
    fine = 1e-4 * np.arange(59000)
    truth = torque(model, fine, 0.5 * np.sin(0.5 * np.pi * fine))
    error = np.interp(found["time"], fine, truth) - found["tau[1]"]
    assert np.abs(error).max() <= 0.005 * np.abs(truth).max()


def test_the_law_is_exported_to_a_drive_and_to_modelica(
    model: FrictionModel, tmp_path: Path
) -> None:
    drive = export_drive(model, tmp_path / "Drive.fmu", inertia=[0.5])
    with FmuInstance(drive) as component:
        component.initialise(start={"tau_motor[1]": 5.0})
        for k in range(400):
            component.step(DT * k, DT)
        held = component.get(["q[1]", "dq[1]"])
        # Ten stops hold 15.5 N.m: it rests where their torque balances the load.
        assert abs(held[1]) < 1e-6
        assert 0.0 < held[0] < 1e-3
    export_modelica(model, tmp_path / "MaxwellSlip.mo")
    assert "der(x10)" in (tmp_path / "MaxwellSlip.mo").read_text(encoding="utf-8")


def test_the_law_has_a_memory_that_relaxation_lacks(model: FrictionModel) -> None:
    [found] = run_battery([Subject(name="maxwell_slip", model=model)])
    [joint] = found.joints
    assert joint.findings["memory"].verdict == "pass"
