"""Laws outside MuJoCo's parts, approximated by the nearest combination with a stated error."""

from dataclasses import replace

import numpy as np
import pytest
import sympy
from containing import Containing
from mujoco_joints import Joints

from fmu_src import model_file
from fmu_src.friction.reference import UNKNOWN_SPEED
from hesr.extras.mjcf.mjcf_file import export_mjcf_law, project_law
from hesr.extras.mjcf.parts import find_parts
from hesr_model.errors import ExportError
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws import dahl
from hesr_model.motions.trajectories import random_fourier

STEP = 0.005
TRAINED = TrainedRange(
    sample_time=STEP, dq=(-0.9, 0.8), q=(0.2, 1.0), tau_load=(-10.0, 20.0), tau=(-20.0, 20.0)
)


DEFLECTIONS = {f"kappa_{i}": 1.0 / x for i, x in enumerate(dahl.DEFLECTIONS, start=1)}


def by_hand(name, structure=None, **values):
    return FrictionLaw(
        name=name,
        structure=structure or {},
        form=estimator(name).form(structure or {}),
        values=values,
    )


def stribeck():
    return by_hand("stribeck", F_c=9.5, F_s=12.0, v_s=0.08, sigma_2=16.0, tau_0=0.3)


def dahl_basis(**forces):
    return by_hand("dahl", **DEFLECTIONS, **forces, sigma_2=12.0, tau_0=0.1)


def test_laws_within_the_family_are_recovered():
    law = dahl_basis(F_1=1.0, F_2=7.5, F_3=2.0, F_4=0.2, F_5=0.3)
    found, misfit, unseen = project_law(law, TRAINED, STEP)
    assert max(misfit.relative, unseen.relative) < 2e-3
    assert found.values["sigma_2"] == pytest.approx(12.0, rel=1e-3)
    assert found.values["tau_0"] == pytest.approx(0.1, abs=1e-3)


def test_a_negative_element_is_projected():
    """A least-squares fit of the Dahl basis may have one; MuJoCo would ignore it."""
    law = dahl_basis(F_1=-0.6, F_2=8.4, F_3=2.0, F_4=0.0, F_5=0.2)
    found, misfit, unseen = project_law(law, TRAINED, STEP)
    assert 1e-3 < misfit.relative < 0.05
    assert unseen.relative < 0.05
    assert all(bristle.stiffness > 0.0 for bristle in find_parts(found).bristles)


@pytest.mark.parametrize("name", ["parfam_tanh", "parfam_cos", "viscous", "gaussians", "bare"])
def test_every_projection_uses_only_parts_of_mujoco(name, make_law):
    found, misfit, unseen = project_law(make_law(name), TRAINED, STEP)
    parts = find_parts(found)
    assert len(parts.bristles) <= 5
    assert parts.viscous >= 0.0
    assert np.isfinite([misfit.rmse, misfit.relative, unseen.rmse, unseen.relative]).all()
    if name == "bare":
        assert parts.viscous == pytest.approx(3.0)
        assert unseen.relative < 1e-9


@pytest.mark.parametrize("name", ["parfam_tanh", "viscous"])
def test_the_stated_error_is_that_of_mujoco(name, make_law, make_model, tmp_path):
    """The unseen motion, run in MuJoCo with the written file, compared with the law."""
    law = make_law(name)
    model = make_model(law, trained=(TRAINED,))
    report = export_mjcf_law(model, tmp_path / "friction.xml", project=True)
    assert not report.exact
    motion = random_fourier(
        seed=1, harmonics=10, period=20.0, peak_velocity=np.array([0.8]), offset=np.array([0.6])
    )
    t = STEP * np.arange(4000)
    q, dq, _ = motion.sample(t)
    joints = Joints(model.joints, tmp_path / "friction.xml", STEP)
    found = [joints.torque(q[0], dq[0])]
    for k in range(1, len(t)):
        joints.hold(q[k], dq[k])
        found.append(joints.torque(q[k], dq[k]))
    load = 5.0 + 15.0 * np.cos(0.5 * np.pi * t)
    expected = predict(law, t=t, dq=dq[:, 0], q=q[:, 0], tau_load=load)
    difference = np.squeeze(found) - expected
    (joint,) = report.joints
    assert joint.unseen.rmse == pytest.approx(np.sqrt(np.mean(difference**2)), rel=1e-9)
    worst = np.max(np.abs(difference)) / np.max(np.abs(expected))
    assert joint.unseen.relative == pytest.approx(worst, rel=1e-9)
    assert joint.fitted.rmse != joint.unseen.rmse
    assert report.lines() == [
        Containing(
            f"axis_1: projected, since {joint.missing}",
            f"{joint.fitted.rmse:.3g} N.m where fitted",
            f"{joint.unseen.rmse:.3g} N.m on another",
            f"{100 * joint.fitted.relative:.3g} and {100 * joint.unseen.relative:.3g} %",
        )
    ]
    assert report.lines()[0].partition("RMSE")[2] in (tmp_path / "friction.xml").read_text()


def test_only_unsupported_parts_are_projected(make_law, make_model, tmp_path):
    model = make_model(stribeck(), make_law("lugre"), law="mixed")
    report = export_mjcf_law(model, tmp_path / "friction.xml", project=True)
    assert [joint.missing is None for joint in report.joints] == [False, True]
    assert report.lines()[1] == "axis_2: exact"
    assert export_mjcf_law(model, tmp_path / "again.xml", project=True) == report
    assert (tmp_path / "again.xml").read_bytes() == (tmp_path / "friction.xml").read_bytes()


def test_ripple_is_kept():
    """Its poles are known; lag and smoothing over speed have no counterpart and cause the error."""
    law = by_hand(
        "lugre_load_ripple",
        {"ripple": {"gear_ratio": 30.0, "orders": [2]}},
        sigma_0=5000.0,
        sigma_1=2.0,
        sigma_2=16.0,
        F_c=9.0,
        F_s=11.0,
        v_s=0.08,
        tau_0=0.1,
        mu=0.0,
        ripple2_cos=0.0,
        ripple2_sin=1.5,
        lag=1e-3,
        smoothing=1e-3,
    )
    waves = [wave for wave in find_parts(project_law(law, TRAINED, STEP)[0]).waves if wave.poles]
    assert {wave.poles for wave in waves} == {60.0}
    assert max(abs(wave.amplitude) for wave in waves) == pytest.approx(1.5, rel=0.1)


def test_the_projection_of_the_papers_law_is_poor(tmp_path):
    """Table I is far from any sum of bristles and viscous friction, and the file states it."""
    model = FrictionModel.read(model_file("uf850-table1"))
    report = export_mjcf_law(model, tmp_path / "friction.xml", project=True)
    assert not report.exact
    assert all(joint.unseen.relative > 0.5 for joint in report.joints)


def test_the_default_range_is_that_of_the_reference_motion():
    """Speeds reach the default value if the training range is unknown."""
    law = stribeck()
    wide = replace(TRAINED, dq=(-UNKNOWN_SPEED, UNKNOWN_SPEED), q=(0.0, 0.0), tau_load=(0.0, 0.0))
    assert project_law(law, None, STEP)[1:] == project_law(law, wide, STEP)[1:]


def test_a_law_without_a_finite_torque_is_refused(make_model, tmp_path):
    own = Coefficient(name="a", unit="1", description="")
    form = LawForm(coefficients=(own,), output=sympy.exp(own.symbol * DQ**2))
    law = FrictionLaw(name="wild", form=form, values={"a": 1e4})
    for project in (True, False):
        with pytest.raises(ExportError) as refusal:
            export_mjcf_law(make_model(law), tmp_path / "friction.xml", project=project)
        assert str(refusal.value) == Containing(
            "law 'by_hand' of joint 'axis_1'", "term exp(a*dq**2)", "law 'wild'", "up to 1.2 rad/s"
        )
        assert not list(tmp_path.iterdir())
