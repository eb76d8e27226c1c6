"""Physics checks on laws with known results, some in closed form."""

import re
from dataclasses import replace
from math import exp, tanh
from pathlib import Path

import numpy as np
import pytest
import sympy
from subjects import INERTIA, SPEED, bristle, law, model

from fmu_src import export_fmu, model_file
from hesr.extras.properties.battery import Subject, measure, run_battery
from hesr_model.audit.audit import audit
from hesr_model.audit.properties import EXPECTATIONS, Properties, PropertyResult
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Stop
from hesr_model.errors import ConfigError
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange

LEVEL, STIFFNESS = 8.0, 8000.0  # of `bristle()`
SLIDES = LEVEL / STIFFNESS
"""Deflection of that bristle when it slides [rad]."""


def finding(found: Properties, key: str, joint: int = 1) -> PropertyResult:
    return found.joints[joint - 1].findings[key]


def value(found: Properties, key: str, joint: int = 1, figure: int = 0) -> float:
    number = finding(found, key, joint).figures[figure].value
    assert number is not None
    return number


# --- prescribed motion --------------------------------------------------------------------------


def test_the_loop_of_a_bristle_matches_its_closed_form(bristles: Properties) -> None:
    """z = z_s - (z_s + z_r) exp(-x / z_s) after a reversal at -z_r = -z_s tanh(A / z_s)."""
    amplitude = bristles.joints[0].deflection
    assert amplitude == pytest.approx(np.log(2.0) * SLIDES, rel=0.15)  # on a grid of deflections
    turned = SLIDES * tanh(amplitude / SLIDES)
    width = 2.0 * amplitude
    half = SLIDES * width - (SLIDES + turned) * SLIDES * (1.0 - exp(-width / SLIDES))
    assert finding(bristles, "presliding").verdict == "pass"
    assert value(bristles, "presliding", figure=1) == pytest.approx(2 * STIFFNESS * half, rel=0.01)
    steepest = STIFFNESS * (1.0 + turned / SLIDES)
    assert value(bristles, "presliding") == pytest.approx(steepest, rel=0.03)
    assert value(bristles, "presliding", figure=2) == pytest.approx(1.0, abs=1e-6)


def test_the_reversal_error_of_a_bristle_matches_its_closed_form(
    bristles: Properties,
) -> None:
    amplitude = bristles.joints[0].deflection
    turned = tanh(amplitude / SLIDES)
    at_turn = 1.0 - (1.0 + turned) * exp(-1.5 * amplitude / SLIDES)
    e = exp(-0.5 * amplitude / SLIDES)
    back = 1.0 - e * (2.0 - (1.0 + at_turn) * e)
    found = finding(bristles, "memory")
    assert found.verdict == "fail"
    assert "One first-order state cannot have non-local" in found.reason
    assert value(bristles, "memory") == pytest.approx(abs(back - at_turn) / (2 * turned), rel=0.01)


def test_spring_sliders_remember_their_reversal(slip_fmu: Path) -> None:
    found = measure(Subject(name="slip", model=None, fmu=slip_fmu, inertia=(1.0,)))
    assert finding(found, "presliding").verdict == "pass"
    assert finding(found, "memory").verdict == "pass"
    assert value(found, "memory") < 1e-12
    assert value(found, "memory", figure=2) < 0.5


def test_a_static_map_has_no_loop_memory_or_lag(maps: Properties) -> None:
    for joint in (1, 2):
        assert finding(maps, "presliding", joint).verdict == "fail"
        assert (
            "pre-sliding: the torque reverses at once" in finding(maps, "presliding", joint).reason
        )
        assert finding(maps, "memory", joint).verdict == "fail"
        assert finding(maps, "memory", joint).figures[0].value is None
        assert "law without a state" in finding(maps, "memory", joint).reason
        assert finding(maps, "lag", joint).verdict == "fail"
        assert value(maps, "lag", joint) == 0.0


def test_a_bristle_lags_only_on_a_falling_level(
    bristles: Properties,
) -> None:
    assert value(bristles, "lag", 1) == 0.0
    assert finding(bristles, "lag", 2).verdict == "pass"
    assert value(bristles, "lag", 2) > 10.0 * value(bristles, "lag", 2, figure=1) > 0.0


def test_checks_of_the_fmu_agree_with_the_audit_of_its_law(table_1: Properties) -> None:
    laws = FrictionModel.read(model_file("uf850-table1"))
    seen = TrainedRange(
        sample_time=laws.sample_time,
        dq=(-1.2, 1.2),
        q=(0.0, 0.0),
        tau_load=(0.0, 0.0),
        tau=(0.0, 0.0),
    )
    for joint, of_joint in enumerate(laws.laws, start=1):
        expected = audit(of_joint, seen)
        assert value(table_1, "chatter", joint) == pytest.approx(expected.chatter, rel=1e-9)
        assert value(table_1, "work", joint) == pytest.approx(expected.generated, rel=1e-9)
        assert expected.slope
        assert value(table_1, "coupling", joint, figure=2) == pytest.approx(
            expected.slope, rel=1e-6
        )


def test_a_law_is_run_at_its_training_loads() -> None:
    """Friction that falls with the load supplies energy only at the largest one."""
    falls = law("lugre_load", F_c=8.0, F_s=8.0, sigma_0=8000.0, v_s=0.1, mu=-0.1)
    found = measure(Subject(name="load", model=model(falls), inertia=None))
    assert finding(found, "work").verdict == "fail"
    constant = replace(falls, values={**falls.values, "mu": 0.0})
    found = measure(Subject(name="load", model=model(constant), inertia=None))
    assert finding(found, "work").verdict == "pass"


def test_the_given_load_applies_to_load_dependent_laws() -> None:
    rises = law("lugre_load", F_c=8.0, F_s=8.0, sigma_0=8000.0, v_s=0.1, mu=0.1)
    levels = [
        measure(Subject(name="load", model=model(rises)), load=load).joints[0].level
        for load in (0.0, 5.0)
    ]
    assert levels == pytest.approx([8.0, 12.0])


# --- coupled ------------------------------------------------------------------------------------


def test_the_stable_step_of_viscous_friction_is_exact(maps: Properties) -> None:
    """dq+ = (1 - s dt / J) dq alternates for dt > J / s and never decays for dt > 2 J / s."""
    slope = 100.0
    assert finding(maps, "coupling", 2).verdict == "pass"
    assert INERTIA / slope < value(maps, "coupling", 2) < 2.0 * INERTIA / slope
    assert value(maps, "coupling", 2, figure=1) == pytest.approx(2.0 * INERTIA / slope, rel=1e-6)


def test_a_discontinuous_torque_chatters_at_every_step(maps: Properties) -> None:
    found = finding(maps, "coupling", 1)
    assert found.verdict == "fail"
    assert found.figures[0].value is None
    assert "smallest step tried, 0.05 ms" in found.reason
    assert finding(maps, "chatter", 1).verdict == "fail"


# --- driven -------------------------------------------------------------------------------------


def test_only_viscous_joints_creep(bristles: Properties, maps: Properties) -> None:
    assert finding(bristles, "hold", 1).verdict == "pass"
    assert finding(bristles, "hold", 2).verdict == "pass"
    assert finding(maps, "hold", 1).verdict == "pass"
    creep = finding(maps, "hold", 2)
    assert creep.verdict == "fail"
    # Half the level: the slope at 10 % of the speed.
    assert value(maps, "hold", 2, figure=1) == pytest.approx(0.05 * SPEED, rel=1e-6)
    assert creep.reason == "It creeps."


def test_only_bristles_drift_under_dither(bristles: Properties, maps: Properties) -> None:
    for joint in (1, 2):
        assert finding(bristles, "dither", joint).verdict == "fail"
        assert value(bristles, "dither", joint) > 0.01
    assert finding(maps, "dither", 1).verdict == "pass"


def test_only_break_away_of_bristles_falls_with_the_rate(
    bristles: Properties, maps: Properties
) -> None:
    assert finding(bristles, "breakaway", 2).verdict == "pass"
    slow, fast = (value(bristles, "breakaway", 2, figure=k) for k in (1, 2))
    assert 8.0 < fast < slow < 12.0
    assert value(maps, "breakaway", 1, figure=1) == pytest.approx(12.0, rel=1e-3)
    assert "break-away torque does not fall" in finding(maps, "breakaway", 1).reason
    assert finding(maps, "breakaway", 2).reason.startswith("No break-away: ")


def test_only_a_falling_curve_shows_stick_slip(bristles: Properties, maps: Properties) -> None:
    for found, joint in ((bristles, 2), (maps, 1)):
        assert finding(found, "stick_slip", joint).verdict == "pass"
        assert value(found, "stick_slip", joint) > 0.01
        assert value(found, "stick_slip", joint, figure=1) > 0.5
    for found, joint in ((bristles, 1), (maps, 2)):
        assert finding(found, "stick_slip", joint).verdict == "pass"
        assert value(found, "stick_slip", joint) == 0.0


def test_table_1_fails_as_friction(table_1: Properties) -> None:
    """Joints 1 and 2 are driven at low speed: they gain energy, run away and never stop."""
    for joint in (1, 2):
        verdicts = {key: finding(table_1, key, joint).verdict for key in EXPECTATIONS}
        assert verdicts.pop("coupling") == "not applicable"
        assert verdicts.pop("start") == "pass"
        assert set(verdicts.values()) == {"fail"}, verdicts
    assert value(table_1, "work", 1) == pytest.approx(12.4, abs=0.05)
    assert value(table_1, "work", 2) == pytest.approx(20.6, abs=0.05)
    assert finding(table_1, "work", 3).verdict == "pass"
    assert value(table_1, "coupling", 3) < 2.0 * 0.6 / 2282.0
    for key in ("presliding", "memory", "hold", "chatter", "coupling"):
        assert finding(table_1, key, 3).verdict == "fail"


# --- whole sheets -------------------------------------------------------------------------------


@pytest.mark.ci
def test_fmu_and_model_agree_for_any_number_of_processes(
    bristles: Properties, tmp_path: Path
) -> None:
    made = model(bristle(), bristle(static=12.0, sigma_1=50.0, sigma_2=1.0))
    fmu = export_fmu(made, tmp_path / "bristles.fmu")
    subjects = [
        Subject(name="fmu", model=made, fmu=fmu, inertia=(INERTIA, INERTIA)),
        Subject(name="model", model=made, inertia=(INERTIA,)),
    ]
    told: list[tuple[int, int]] = []
    found = run_battery(subjects, workers=2, progress=lambda *now: told.append(now))
    assert found == [bristles, bristles]
    assert told == [(0, 2), (1, 2), (2, 2)]


def test_driven_checks_need_an_inertia() -> None:
    found = measure(Subject(name="bench", model=model(bristle())))
    for key in ("breakaway", "stick_slip", "dither", "hold", "drive", "coupling"):
        assert finding(found, key).verdict == "not run"
        assert "run: the inertia of the joints" in finding(found, key).reason
    assert found.joints[0].inertia is None
    uf850 = measure(Subject(name="uf850", model=model(*[bristle()] * 3, robot="uf850")))
    assert [joint.inertia for joint in uf850.joints] == [3.0, 3.0, 0.6]


def test_checks_that_need_a_law_are_reported_as_skipped(slip_fmu: Path) -> None:
    found = measure(Subject(name="slip", model=None, fmu=slip_fmu, inertia=(1.0,)))
    assert (found.law, found.robot) == ("slip", "")
    for key in ("breakaway", "stick_slip", "dither", "hold", "drive"):
        assert finding(found, key).verdict == "not run"
        assert "run: the FMU contains no law" in finding(found, key).reason
    assert finding(found, "work").verdict == "pass"
    assert finding(found, "coupling").verdict in ("pass", "fail")


def test_a_failing_fmu_fails_the_check_with_its_reason() -> None:
    """Its torque overflows at the trained speed."""
    steep = Coefficient(name="steep", unit="s/rad", description="far too steep")
    torque = sympy.exp(steep.symbol * DQ) - sympy.exp(-steep.symbol * DQ)
    form = LawForm(coefficients=(steep,), output=torque)
    wild = FrictionLaw(name="wild", form=form, values={"steep": 1e6})
    found = measure(Subject(name="wild", model=model(wild), inertia=(1.0,)))
    for key in EXPECTATIONS:
        assert finding(found, key).verdict == "fail"
        assert finding(found, key).reason.startswith("The FMU gives up: ")


def test_a_subject_is_required() -> None:
    with pytest.raises(ConfigError) as caught:
        measure(Subject(name="nothing", model=None))
    assert str(caught.value) == "nothing: model and FMU are both missing."


def test_a_load_factor_supplies_energy_while_it_varies() -> None:
    """Half of its motions hold the load constant and dissipate energy."""
    dahl = law("dahl_load", kappa_1=5e3, F_1=2.0, mu_1=1.0)
    found = measure(Subject(name="load", model=model(dahl), inertia=(INERTIA,)))
    work = finding(found, "work")
    assert work.verdict == "fail"
    assert "while the load swings by 10 N.m." in work.reason
    drive = finding(found, "drive")
    assert (drive.verdict, drive.figures[0].unit) == ("fail", "J")
    assert re.search(r"0\.\d+ levels it generates \S+ J", drive.reason)
    assert value(found, "drive") > 1e-6


def test_a_load_bound_supplies_no_energy_and_keeps_reversals() -> None:
    """Maxwell-slip whose strength is the load: two nested loops close under it."""
    deflections = (3e-4, 1e-3, 3e-3)
    stops = tuple(
        Stop(name=f"x{i}", unit="1", velocity=DQ, deflection=w, bound=1 + absolute(TAU_LOAD) / 10)
        for i, w in enumerate(deflections, start=1)
    )
    form = LawForm(coefficients=(), memory=stops, output=sum(2 * x.state for x in stops))
    own = FrictionLaw(name="loaded", form=form, values={})
    found = measure(Subject(name="loaded", model=model(own), inertia=(INERTIA,)))
    for key in ("memory", "nested", "start", "work", "drive"):
        assert finding(found, key).verdict == "pass", key
    assert value(found, "nested") < 1e-12
    assert value(found, "drive") == 0.0
    assert 0.1 < value(found, "nested", figure=2) < 0.5


def test_starting_in_motion_from_relaxed_states_is_wrong_at_once(
    slip_fmu: Path, bristles: Properties, maps: Properties
) -> None:
    """Spring-sliders start unstretched: first torque 5 v instead of 5 v + 10 N.m in sliding."""
    found = measure(Subject(name="slip", model=None, fmu=slip_fmu, inertia=(1.0,)))
    assert finding(found, "start").verdict == "fail"
    slowest = 0.05 * found.joints[0].speed
    missing = 10.0 / (10.0 + 5.0 * slowest)
    assert value(found, "start") == pytest.approx(missing, rel=1e-9)
    assert f"first torque is off by -{missing:.0%}" in finding(found, "start").reason
    for of_laws in (bristles, maps):
        for joint in (1, 2):
            assert finding(of_laws, "start", joint).verdict == "pass"
            assert value(of_laws, "start", joint) < 1e-6


def test_two_loops_of_one_bristle_miss_their_reversals(bristles: Properties) -> None:
    found = finding(bristles, "nested")
    assert found.verdict == "fail"
    assert "One first-order state cannot have non-local" in found.reason
    assert value(bristles, "nested") >= value(bristles, "memory")


def test_dither_is_scaled_to_slow_sliding() -> None:
    """A level that rises tenfold with speed is not the one at rest."""
    rising = law("lugre", F_c=8.0, F_s=0.8, sigma_0=8e5, v_s=0.02)
    found = measure(Subject(name="rising", model=model(rising), inertia=(0.7,))).joints[0]
    drift = found.findings["dither"].figures[0].value
    assert drift is not None
    assert abs(drift) < 0.01
