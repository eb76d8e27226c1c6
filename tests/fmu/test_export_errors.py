"""Models that cannot become an FMU are refused with a reason."""

from dataclasses import replace

import pytest
import sympy

from fmu_src import export_fmu
from hesr_model.errors import ExportError
from hesr_model.friction.functions import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm, Relaxation


def test_joints_with_different_integration(make_law, make_model, tmp_path):
    one = make_law("parfam_tanh")
    model = make_model(one, replace(one, discretisation="euler"))
    with pytest.raises(ExportError, match="both exact and Euler"):
        export_fmu(model, tmp_path / "F.fmu")


@pytest.mark.parametrize(
    ("name", "unit", "reason"),
    [("a b", "1", "not a structured name"), ("a", "furlong", "'furlong' is unknown")],
)
def test_laws_that_fmi_cannot_name(make_model, tmp_path, name, unit, reason):
    own = Coefficient(name=name, unit=unit, description="odd")
    form = LawForm(coefficients=(own,), output=own.symbol * DQ)
    law = FrictionLaw(name="odd", form=form, values={name: 1.0})
    with pytest.raises(ExportError, match=reason):
        export_fmu(make_model(law), tmp_path / "F.fmu")


def test_states_that_are_named_as_the_output(make_model, tmp_path):
    state = Relaxation(name="tau", unit="1", drive=DQ, rate=sympy.Integer(1))
    form = LawForm(coefficients=(), relaxations=(state,), output=state.state)
    law = FrictionLaw(name="odd", form=form, values={})
    with pytest.raises(ExportError, match=r"'tau\[1\]' is used twice"):
        export_fmu(make_model(law), tmp_path / "F.fmu")
