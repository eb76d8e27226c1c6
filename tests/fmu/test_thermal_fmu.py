"""The FMU of a model with temperature: the torque of Python, with heat as its state."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from adaptive_models import lugre, model, motion, stops
from fmpy import read_model_description
from fmpy.validation import validate_fmu

from cosim.workflow.export import export
from fmu_src.check.run import check
from fmu_src.export.package import Version
from fmu_src.friction.convention import judge
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.predictions import predict_fmu
from fmu_src.friction.replay import replay
from fmu_src.run.fmu import FmuInstance
from hesr.extras.properties.battery import Subject, measure
from hesr_model.audit.properties import Properties
from hesr_model.errors import ExportError, SimulationError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.thermal import Thermal
from hesr_model.laws.stribeck import Stribeck
from hesr_model.rigid_body.friction_record import FrictionRecord

WARM = Thermal(
    coulomb=0.004,
    viscous=0.02,
    coulomb_scale=1.1,
    viscous_scale=0.9,
    reference=25.0,
    resistance=0.5,
    time_constant=30.0,
    ambient=22.0,
)
MODEL = replace(
    model(lugre(), stops()), thermal=(WARM, replace(WARM, coulomb=0.008, reference=30.0))
)


@pytest.fixture(scope="module", params=[2, 3])
def fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    version: Version = request.param
    return export(MODEL, tmp_path_factory.mktemp("thermal") / "Warm.fmu", fmi=version)


def records(*, measured: bool) -> list[list[FrictionRecord]]:
    """One log of each joint."""
    found = []
    for k, joint in enumerate(MODEL.joints):
        t, dq, q, load = motion(20.0, seed=k)
        warm = 20.0 + 1.5 * t + 5.0 * np.sin(t) if measured else None
        found.append(
            [
                FrictionRecord(
                    log="one",
                    joint=joint,
                    t=t,
                    dq=dq,
                    q=q,
                    tau_load=load,
                    tau=np.zeros_like(t),
                    temperature=warm,
                )
            ]
        )
    return found


@pytest.mark.parametrize("measured", [True, False])
def test_the_fmu_matches_the_python_prediction(fmu: Path, measured: bool) -> None:
    logs = records(measured=measured)
    expected = MODEL.predict([log[0] for log in logs])
    found = np.column_stack([torques[0] for torques in predict_fmu(fmu, logs)])
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())
    cold = replace(MODEL, thermal=()).predict([log[0] for log in logs])
    assert np.abs(found - cold).max(axis=0).min() > 0.5


def test_the_law_is_unchanged_at_the_reference_temperature(tmp_path: Path) -> None:
    neutral = replace(MODEL, thermal=(replace(WARM, coulomb_scale=1.0, viscous_scale=1.0),) * 2)
    t, dq, q, load = motion(5.0)
    columns = [np.column_stack([x, x]) for x in (dq, q, load)]
    found = replay(
        export_bare(neutral, tmp_path / "N.fmu"),
        t,
        *columns,
        temperature=np.full((len(t), 2), WARM.reference),
    )
    plain = replay(export_bare(replace(neutral, thermal=()), tmp_path / "P.fmu"), t, *columns)
    np.testing.assert_allclose(found, plain, rtol=0.0, atol=1e-12 * np.abs(plain).max())


def test_logs_without_temperature_are_replayed_with_start_values(tmp_path: Path) -> None:
    thermal = export_bare(MODEL, tmp_path / "T.fmu")
    t, dq, *_ = motion(2.0)
    columns = t, np.column_stack([dq, dq])
    start = {f"coulomb_scale[{i}]": 0.0 for i in (1, 2)}
    without, found = replay(thermal, *columns), replay(thermal, *columns, start=start)
    assert np.abs(without - found).max(axis=0).min() > 0.1


def test_the_fmu_is_valid_and_states_its_kind(fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []
    assert check(fmu).problems == ()
    description = read_model_description(fmu)
    assert description.modelExchange is None
    found = {v.name: v for v in description.modelVariables}
    arrays = description.fmiVersion == "3.0"
    ends = ("",) if arrays else ("[1]", "[2]")
    assert {v.name for v in description.modelVariables if v.causality == "input"} == {
        f"{n}{end}" for n in ("dq", "q", "tau_load", "temperature") for end in ends
    }
    starts = found["temperature"].start if arrays else found["temperature[1]"].start
    assert str(starts[0] if arrays and isinstance(starts, list) else starts).startswith("25")
    assert "from their motion and temperature" in description.description


def test_factors_act_in_addition_to_temperature(fmu: Path) -> None:
    with FmuInstance(fmu) as component:
        names = component.variables.expand_values({"coulomb_scale": 0.0, "viscous_scale": 2.0})
        component.initialise(start=names)
        component.set({"dq[1]": 0.5, "temperature[1]": 25.0})
        component.step(0.0, 1.0)
        values = MODEL.laws[0].values
        expected = 2.0 * WARM.viscous_scale * values["sigma_2"] * 0.5 + values["tau_0"]
        assert component.get(["tau[1]"])[0] == pytest.approx(expected, abs=1e-6)


def test_heat_is_a_state_cleared_by_reset(fmu: Path) -> None:
    with FmuInstance(fmu) as component:
        component.initialise(start={f"joint[{i}].thermometer": 0.0 for i in (1, 2)})
        found = []
        for _ in range(2):
            component.set({"dq[1]": 1.0, "dq[2]": -1.0})
            rise = []
            for k in range(400):
                component.step(0.1 * k, 0.1)
                rise.append(component.get(["rise[1]", "rise[2]"]))
            found.append(np.array(rise))
            component.reset()
            component.initialise(start={f"joint[{i}].thermometer": 0.0 for i in (1, 2)})
        # A lag of 30 s towards R |tau dq|.
        assert np.all(np.diff(found[0], axis=0) > 0.0)
        assert np.all((found[0][-1] > 5.0) & (found[0][-1] < 20.0))
        assert np.array_equal(*found)


@pytest.mark.parametrize("more", ["power", "band", "properties", "no_events"])
def test_unsupported_options_are_refused(more: str, tmp_path: Path) -> None:
    found = Properties(law="lugre", robot="arm", tau_load=0.0, joints=())
    options = {more: found if more == "properties" else True}
    with pytest.raises(ExportError, match="a thermal FMU supports no"):
        export(MODEL, tmp_path / "F.fmu", **options)
    assert not list(tmp_path.iterdir())


def test_a_law_without_bounds_is_refused(tmp_path: Path) -> None:
    values = {"F_c": 1.0, "F_s": 1.0, "v_s": 0.1, "sigma_2": 1.0, "tau_0": 0.0}
    law = FrictionLaw(name="stribeck", form=Stribeck.form({}), values=values)
    with pytest.raises(ExportError, match="has neither stops nor bristles"):
        export(replace(model(law), thermal=(WARM,)), tmp_path / "Static.fmu")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("form", "name"),
    [
        ("drive", "F.fmu"),
        ("mjcf", "F.xml"),
        ("modelica", "F.mo"),
        ("c", "f.h"),
        ("torch", "f.py"),
        ("jax", "f.py"),
    ],
)
def test_formats_without_temperature_are_refused(form: Any, name: str, tmp_path: Path) -> None:
    options = {"inertia": (1.0, 1.0)} if form == "drive" else {}
    with pytest.raises(ExportError, match="law 'tried' depends on temperature, which"):
        export(MODEL, tmp_path / name, format=form, **options)
    assert not list(tmp_path.iterdir())


def test_comparisons_with_the_law_need_a_constant_law(fmu: Path, tmp_path: Path) -> None:
    adaptive = export(replace(MODEL, thermal=()), tmp_path / "Adaptive.fmu", format="adaptive")
    for path in (fmu, adaptive):
        with pytest.raises(SimulationError, match="support adaptive or thermal FMUs"):
            judge(path)


def test_the_physics_checks_run_at_the_fitted_temperature() -> None:
    own = model(lugre())
    found = [
        measure(Subject(name="law", model=tried, inertia=(1.0,)))
        for tried in (own, replace(own, thermal=(WARM,)))
    ]
    assert found[0] == found[1]
