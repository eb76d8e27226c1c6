"""Laws with non-finite expressions of their coefficients: every export refuses them."""

from collections.abc import Callable
from pathlib import Path

import pytest
import sympy
from containing import Containing
from registry_models import live_of

from fmu_src import export_fmu
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.validity import require_numbers
from hesr.extras.drive.drive_fmu import export_drive
from hesr.extras.mjcf.mjcf_file import export_mjcf_law
from hesr.extras.modelica.modelica_package import export_modelica
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.lugre import LuGre

EXPORTS: dict[str, Callable[[FrictionModel, Path], object]] = {
    "fmu": lambda model, folder: export_fmu(model, folder / "F.fmu"),
    "bare": lambda model, folder: export_bare(model, folder / "F.fmu"),
    "live": lambda model, _: live_of(model),
    "drive": lambda model, folder: export_drive(model, folder / "D.fmu", inertia=(3.0, 3.0)),
    "modelica": lambda model, folder: export_modelica(model, folder / "F.mo"),
    "mjcf": lambda model, folder: export_mjcf_law(model, folder / "f.xml"),
    "mjcf, projected": lambda model, folder: export_mjcf_law(model, folder / "f.xml", project=True),
}


def lugre(f_c: float) -> FrictionLaw:
    values = {"sigma_0": 1e4, "sigma_1": 10.0, "sigma_2": 5.0, "F_c": f_c, "F_s": 8.0, "v_s": 0.1,
              "tau_0": 0.0}  # fmt: skip
    return FrictionLaw(name="lugre", form=LuGre.core({}), values=values)


@pytest.mark.parametrize("way", EXPORTS)
def test_a_zero_divisor_is_refused(
    way: str, make_model: Callable[..., FrictionModel], tmp_path: Path
) -> None:
    model = make_model(lugre(9.0), lugre(0.0), law="lugre")
    with pytest.raises(ExportError) as caught:
        EXPORTS[way](model, tmp_path)
    assert str(caught.value) == Containing("law 'lugre' of joint 'axis_2'", "F_c = 0")
    assert not list(tmp_path.iterdir())


A, B = (Coefficient(name=name, unit="1", description=name) for name in "ab")
a, b = A.symbol, B.symbol
UNDEFINED = {
    "square": (sympy.exp(-((DQ / a) ** 2)), "a**(-2) in it is not finite with a = 0."),
    "within what hides it": (1 / (1 + 1 / a), "1/a in it is not finite with a = 0."),
    "beside an input": (
        1 / (a * DQ + a**2),
        "1/(a**2 + a*dq) in it is not finite with a = 0.",
    ),
    "logarithm": (sympy.log(a), "log(a) in it is not finite with a = 0."),
    "root": (sympy.sqrt(b) * DQ, "sqrt(b) in it is not finite with b = -2."),
    "several": (DQ / (a * b + a), "1/(a*b + a) in it is not finite with a = 0, b = -2."),
    "own functions": (1 / absolute(a * b), "1/abs(a*b) in it is not finite with a = 0, b = -2."),
}


def by_hand(output: sympy.Expr, rate: sympy.Expr) -> FrictionLaw:
    state = Relaxation(name="x", unit="1", drive=DQ, rate=rate)
    form = LawForm(coefficients=(A, B), memory=(state,), output=output + state.state)
    return FrictionLaw(name="odd", form=form, values={"a": 0.0, "b": -2.0})


@pytest.mark.parametrize("name", UNDEFINED)
def test_the_part_and_its_coefficients_are_named(
    name: str, make_model: Callable[..., FrictionModel]
) -> None:
    part, said = UNDEFINED[name]
    for law in (by_hand(part, absolute(DQ)), by_hand(DQ, absolute(DQ) + part)):
        with pytest.raises(ExportError) as caught:
            require_numbers(make_model(law, law="odd"))
        assert str(caught.value) == f"law 'odd' of joint 'axis_1' cannot be run: {said}"


def test_a_harmless_zero_is_accepted(
    every_law: dict[str, FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    require_numbers(make_model(by_hand(DQ / (1 + a) + a**2, absolute(DQ))))
    require_numbers(make_model(*every_law.values()))
