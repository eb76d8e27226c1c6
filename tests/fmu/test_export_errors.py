"""Models that cannot become an FMU are refused with a reason."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import sympy
from containing import Containing

from fmu_src import export_fmu
from fmu_src.arm.native import arm, export_mjcf
from fmu_src.arm.signals import read_signals
from fmu_src.export.package import write_fmu
from fmu_src.friction.reference import ReferenceMotion
from fmu_src.pages.datasheet import costs
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ArtifactError, ExportError, SimulationError
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.support.files import models_folder


def test_joints_with_different_integration_are_refused(make_law, make_model, tmp_path):
    one = make_law("parfam_tanh")
    model = make_model(one, replace(one, discretisation="euler"))
    with pytest.raises(ExportError, match="both exact and Euler"):
        export_fmu(model, tmp_path / "F.fmu")


@pytest.mark.parametrize(
    ("name", "unit", "reason"),
    [("é", "1", "not a structured name"), ("a", "furlong", "'furlong' is unknown")],
)
def test_names_invalid_in_fmi_are_refused(make_model, tmp_path, name, unit, reason):
    own = Coefficient(name=name, unit=unit, description="odd")
    form = LawForm(coefficients=(own,), output=own.symbol * DQ)
    law = FrictionLaw(name="odd", form=form, values={name: 1.0})
    with pytest.raises(ExportError, match=reason):
        export_fmu(make_model(law), tmp_path / "F.fmu")


def test_states_named_like_the_output_are_refused():
    state = Relaxation(name="tau", unit="1", drive=DQ, rate=sympy.Integer(1))
    with pytest.raises(ArtifactError, match=r"^friction law: 'tau' is used twice among"):
        LawForm(coefficients=(), memory=(state,), output=state.state)


def test_states_named_like_another_variable_are_refused(make_model, tmp_path):
    state = Relaxation(name="dtau_ddq", unit="1", drive=DQ, rate=sympy.Integer(1))
    form = LawForm(coefficients=(), memory=(state,), output=state.state)
    law = FrictionLaw(name="odd", form=form, values={})
    with pytest.raises(ExportError, match=r"'dtau_ddq\[1\]' is used twice"):
        export_fmu(make_model(law), tmp_path / "F.fmu")


def test_a_torque_that_is_not_finite_has_no_data_sheet(make_model):
    own = Coefficient(name="c", unit="s/rad", description="far too steep")
    form = LawForm(coefficients=(own,), output=sympy.exp(own.symbol * DQ))
    law = FrictionLaw(name="odd", form=form, values={"c": 1e4})
    t = 0.01 * np.arange(100)
    dq = np.sin(t)[:, None]
    motion = ReferenceMotion(t=t, dq=dq, q=np.zeros_like(dq), tau_load=np.zeros_like(dq))
    with np.errstate(over="ignore", invalid="ignore"), pytest.raises(SimulationError) as caught:
        costs(make_model(law), motion)
    assert "finite on this motion" in str(caught.value)


ARM = models_folder() / "uf850" / "uf850.xml"


def test_an_arm_supports_only_the_platforms_of_its_libraries(tmp_path):
    content = arm(read_signals(ARM), name="UF850", source=ARM.read_bytes(), platforms=["linux64"])
    with pytest.raises(ExportError) as caught:
        write_fmu(content, tmp_path / "Arm.fmu", platforms=("win64",))
    assert "platform 'win64': this FMU needs" in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_an_arm_needs_the_library_of_its_platform(tmp_path, monkeypatch):
    monkeypatch.setattr(mujoco, "__file__", str(tmp_path / "mujoco" / "__init__.py"))
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    with pytest.raises(ExportError) as caught:
        export_mjcf(ARM, tmp_path / "Arm.fmu")
    wanted = f"mujoco-core=={mujoco.__version__}"
    assert str(caught.value) == Containing("platform 'linux64': pip could not", wanted)
    assert not list(tmp_path.iterdir())
