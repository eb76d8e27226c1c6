"""The uncertainty band of a friction FMU: that of the model, with derivatives and dependencies."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy
from test_derivatives import difference, initialising, tangent, worst

from fmu_src.check.run import check
from fmu_src.friction.embedded_model import read_embedded_model
from fmu_src.friction.friction_fmu import export_bare, export_fmu
from fmu_src.friction.replay import replay
from hesr.cli import main
from hesr_model.equations.memory import Relaxation, Stop
from hesr_model.errors import SimulationError
from hesr_model.friction.band import Band
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.lugre import LuGre
from hesr_model.rigid_body.friction_record import FrictionRecord

BAND = Band(
    floor=0.7, slow=1.3, slow_speed=0.02, rest=0.4, fast=0.5, load=0.05, tail=0.7, envelope=1.0
)
ENDS = ("tau_lower", "tau_upper")


LAWS = ("lugre", "viscous", "elements", "gaussians", "bare", "stops")


def stops() -> FrictionLaw:
    """A stop whose bound depends on an earlier state and the load."""
    named = {"F": ("N.m", 4.0), "v_s": ("rad/s", 0.05), "sigma_2": ("N.m.s/rad", 3.0)}
    own = tuple(Coefficient(name=n, unit=u, description="its") for n, (u, _) in named.items())
    f, v_s, sigma_2 = (c.symbol for c in own)
    p = Relaxation(name="p", unit="1", drive=20 * sympy.exp(-((DQ / v_s) ** 2)), rate=20)
    bound = 1 + p.state / 2 + TAU_LOAD**2 / 1000
    x = Stop(name="x", unit="1", velocity=DQ, deflection=1e-3, bound=bound)
    form = LawForm(coefficients=own, memory=(p, x), output=f * x.state + sigma_2 * DQ)
    return FrictionLaw(
        name="by_hand", form=form, values={name: value for name, (_, value) in named.items()}
    )


@pytest.fixture(scope="module")
def model(make_law, make_model) -> FrictionModel:
    laws = [stops() if name == "stops" else make_law(name) for name in LAWS]
    bands = [BAND for _ in laws]
    bands[1] = replace(BAND, envelope=0.0)  # only one joint was seen at rest
    return make_model(*(replace(x, band=band) for x, band in zip(laws, bands, strict=True)))


@pytest.fixture(scope="module")
def path(model, tmp_path_factory) -> Path:
    return export_bare(model, tmp_path_factory.mktemp("band") / "F.fmu", band=True)


@pytest.fixture(scope="module")
def fmu(path, load):
    return load(path)


def test_an_fmu_has_the_band_of_its_model(model, path, make_motion) -> None:
    t, dq, q, load = make_motion(len(model.joints))
    records = [
        FrictionRecord(
            log="made",
            joint=joint,
            t=t,
            dq=dq[:, k],
            q=q[:, k],
            tau_load=load[:, k],
            tau=np.zeros_like(t),
        )
        for k, joint in enumerate(model.joints)
    ]
    for coverage in (0.95, 0.8, 2.0):
        for end, expected in zip(ENDS, model.predict_band(records, coverage=coverage), strict=True):
            found = replay(path, t, dq, q, load, start={"coverage": coverage}, output=end)
            assert np.abs(found - expected).max() <= 1e-10 * np.abs(expected).max()


@pytest.mark.parametrize("name", LAWS)
def test_directional_derivatives_are_those_of_the_band(fmu, name) -> None:
    joint = 1 + LAWS.index(name)
    unknowns = [f"{end}[{joint}]" for end in ENDS]
    knowns = [
        v.name
        for v in fmu.about.modelVariables
        if v.start is not None
        and v.type == "Real"
        and (v.name.endswith(f"[{joint}]") or f"joint[{joint}]." in v.name or v.name == "coverage")
    ]
    start = {v.name: float(v.start) for v in fmu.about.modelVariables if v.name in knowns}
    for speed in (0.0031, -0.0117):  # below and above the speed threshold of rest
        values = start | {f"dq[{joint}]": speed, f"q[{joint}]": 0.4, f"tau_load[{joint}]": 7.0}
        c, moved = (initialising(fmu, values) for _ in range(2))
        for known in knowns:

            def at(x, known=known, values=values, moved=moved):
                assert fmu.set_all(moved, values | {known: x}) == 0
                return np.array(fmu.get(moved, *unknowns))

            found = tangent(fmu, c, unknowns, {known: 1.0})
            assert worst(found, *difference(at, values[known])) <= 1e-5, (known, speed)


def test_dependencies_are_those_of_the_band(fmu) -> None:
    joint = 1 + LAWS.index("lugre")
    needs = {
        unknown.variable.name: {d.name for d in unknown.dependencies}
        for unknown in fmu.about.outputs
    }
    of_band = {f"band_{name}[{joint}]" for name in vars(BAND)} | {"coverage"}
    for end in ENDS:
        found = needs[f"{end}[{joint}]"]
        assert found >= needs[f"tau[{joint}]"] | {f"dq[{joint}]", f"tau_load[{joint}]"}
    assert not needs[f"tau[{joint}]"] & of_band
    about = {v.name: v for v in fmu.about.modelVariables}
    assert (about["coverage"].min, about["coverage"].max) == ("0.5", "0.999")
    assert about[f"band_fast[{joint}]"].unit == "N.m.s/rad"


@pytest.fixture(scope="module")
def law(make_law) -> FrictionLaw:
    return replace(make_law("lugre"), band=BAND)


@pytest.mark.ci
@pytest.mark.parametrize("fmi", [2, 3])
def test_checkers_find_no_problem(law, make_model, tmp_path: Path, fmi) -> None:
    whole = export_fmu(make_model(law, law), tmp_path / "F.fmu", band=True, power=True, fmi=fmi)
    assert check(whole).problems == ()


def test_the_band_at_rest_reaches_both_break_away_torques(law, make_model) -> None:
    """For any state of the bristle, extended by the floor of the measured residuals."""
    t = 0.005 * np.arange(400)
    dq = np.where(t < 1.0, 0.3, 0.0)
    record = FrictionRecord(
        log="made", joint="axis_1", t=t, dq=dq, q=0.0 * t, tau_load=0.0 * t, tau=0.0 * t
    )
    lower, upper = make_model(law).predict_band([record])
    level = 9.0 + 3.0 * np.exp(-((0.02 / 0.08) ** 2))
    assert upper[-1, 0] == pytest.approx(level + BAND.floor, rel=1e-6)
    assert lower[-1, 0] == pytest.approx(-level - BAND.floor, rel=1e-6)
    seen = replace(law, band=replace(BAND, envelope=0.0))
    lower, upper = make_model(seen).predict_band([record])
    width = np.sqrt(BAND.floor**2 + BAND.slow**2 + BAND.rest**2)
    assert (upper - lower)[-1, 0] == pytest.approx(2.0 * width, rel=1e-9)


def test_a_model_without_a_band_exports_none(make_law, make_model, tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match="fit the model to logs"):
        export_fmu(make_model(make_law("lugre")), tmp_path / "F.fmu", band=True)
    assert not list(tmp_path.iterdir())


def test_the_command_writes_the_fmu_and_its_parameter_set(tmp_path: Path, monkeypatch) -> None:
    values = {"F_c": 9.0, "F_s": 11.0, "v_s": 0.1, "sigma_0": 4e3, "sigma_1": 0.0, "sigma_2": 3.0,
              "tau_0": 0.0}  # fmt: skip
    law = FrictionLaw(name="lugre", form=LuGre.form({}), values=values, band=BAND)
    model = FrictionModel(
        law="lugre", robot="bench", joints=("axis",), laws=(law,), sample_time=0.01
    )
    model.write(tmp_path / "law.json")
    fmu = tmp_path / "F.fmu"
    monkeypatch.setattr(
        sys, "argv", ["hesr", "export", str(tmp_path / "law.json"), "--band", "-o", str(fmu)]
    )
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    found = read_embedded_model(fmu)
    assert found is not None
    assert found.laws[0].band == BAND
    assert b'name="joint[1].F_c"' in fmu.with_suffix(".ssv").read_bytes()
