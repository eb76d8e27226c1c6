"""The uncertainty band in the report's figure of torques."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from cosim.report.sections.prediction import band
from hesr_model.friction.band import Band
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.lugre import LuGre

BAND = Band(
    floor=0.7, slow=0.0, slow_speed=0.02, rest=0.0, fast=0.5, load=0.0, tail=0.65, envelope=0.0
)


def test_both_limits_of_a_band_are_drawn() -> None:
    values = {"F_c": 9.0, "F_s": 11.0, "v_s": 0.1, "sigma_0": 4e3, "sigma_1": 0.0, "sigma_2": 3.0,
              "tau_0": 0.0}  # fmt: skip
    law = FrictionLaw(name="lugre", form=LuGre.form({}), values=values, band=BAND)
    model = FrictionModel(
        law="lugre", robot="bench", joints=("axis",), laws=(law,), sample_time=0.01
    )
    t = 0.01 * np.arange(200)
    dq = np.cos(t)
    torques = {"t": t, "dq1": dq, "q1": np.sin(t), "tau_rb1": 0.0 * t, "lugre.tau_f1": 10.0 * dq}
    shown = SimpleNamespace(models={"lugre": model}, joints=("J1",))
    lower, upper = band(shown, "lugre", 1, torques)
    half = np.sqrt(0.7**2 + (0.5 * dq) ** 2)
    assert upper.y == pytest.approx(10.0 * dq + half, rel=1e-9)
    assert lower.y == pytest.approx(10.0 * dq - half, rel=1e-9)
    bare = replace(model, laws=(replace(law, band=None),))
    assert band(SimpleNamespace(models={"lugre": bare}), "lugre", 1, torques) == ()
