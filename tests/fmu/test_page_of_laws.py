"""What the page of a friction FMU says of its laws: titles, coefficients and uncertainty."""

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from containing import Containing

from fmu_src.friction.friction_component import friction_equations
from fmu_src.friction.friction_fmu import describe_friction_fmu
from fmu_src.pages.friction_page import model_title, to_html
from hesr.extras.drive.drive_fmu import Motors, content
from hesr.extras.modelica.modelica_package import export_modelica
from hesr.extras.one_file.c_header import export_c
from hesr.extras.one_file.tensors import export_torch
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.uncertainty import MAX_COEFFICIENTS
from hesr_model.friction.band import Band
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import MIXED, FrictionModel
from hesr_model.friction.predict import predict, predict_band
from hesr_model.friction.trained_range import TrainedRange

BAND = Band(
    floor=0.3, slow=0.6, slow_speed=0.05, rest=0.2, fast=0.4, load=0.02, tail=0.65, envelope=1.0
)
SPEED, LOAD = 0.8, 25.0  # the trained ones
TRAINED = TrainedRange(
    sample_time=0.005, dq=(-SPEED, 0.5), q=(-1.0, 1.0), tau_load=(-LOAD, 5.0), tau=(-9.0, 9.0)
)


def page_of(model: FrictionModel) -> str:
    table = friction_equations(model)[0]
    return to_html(model, table, describe_friction_fmu(model, "friction", "from their motion"))


def test_every_coefficient_has_a_meaning_of_its_own(
    registry_models: dict[str, FrictionModel],
) -> None:
    """A reader tells them apart by their descriptions alone."""
    for name, model in registry_models.items():
        counts = Counter(c.description for c in model.laws[0].form.coefficients)
        assert [text for text, count in counts.items() if count > 1] == [], name


def test_the_uncertainty_is_stated_or_its_absence_explained(
    registry_models: dict[str, FrictionModel],
) -> None:
    reasons = Counter[str]()
    for name, model in registry_models.items():
        law = model.laws[0]
        text = page_of(model)
        assert "uncertainty of the coefficients is unknown" not in text, name
        if law.standard_errors:
            reason = "1.96 standard errors"
            assert text.count("± ") == len(law.standard_errors), name
            partial = len(law.standard_errors) < len(law.values)
            assert ("fixed or at a bound" in text) == partial, name
        elif law.covariance is not None:
            reason = "the data also chose the terms"
        elif not law.values:
            reason = "has no coefficients"
        else:
            assert len(law.values) > MAX_COEFFICIENTS, name
            reason = "those of a network"
        assert reason in text, name
        reasons[reason] += 1
    assert len(reasons) == 4, reasons


def test_a_model_without_covariance_says_so(table1: FrictionModel) -> None:
    text = page_of(table1)
    assert text.count("uncertainty of the coefficients is unknown") == 3
    assert "95 % band" not in text


@pytest.mark.parametrize("law_name", ["stribeck", "lugre_load_ripple"])
def test_the_band_is_that_of_the_model(
    law_name: str, registry_models: dict[str, FrictionModel]
) -> None:
    """The page prints half of the distance between both ends at steady speeds."""
    fitted = registry_models[law_name]
    law = replace(fitted.laws[0], band=BAND)
    model = replace(fitted, laws=(law,), trained=(TRAINED,), training_rmse=(0.2,))
    row = r"95 % band, ([^<]*)</th><td class=\"number\">± ([\d.]+)</td>"
    cells = re.findall(row, page_of(model))
    labels = [label for label, _ in cells]
    assert labels == [
        Containing("a tenth of the trained speed [N.m]"),
        "at the trained speed [N.m]",
        Containing("the largest trained load [N.m]"),
    ]
    points = [(0.1 * SPEED, 0.0), (SPEED, 0.0), (SPEED, LOAD)]
    for (dq, load), (_, printed) in zip(points, cells, strict=True):
        count = 200  # until the states are steady
        record = {
            "t": 0.005 * np.arange(count),
            "dq": np.full(count, dq),
            "q": np.zeros(count),
            "tau_load": np.full(count, load),
        }
        torque = predict(law, **record)
        lower, upper = predict_band(law, torque=torque, coverage=0.95, **record)
        half_width = float(upper[-1] - lower[-1]) / 2.0
        assert BAND.half_width(dq, load) == pytest.approx(half_width, rel=1e-9)
        assert float(printed) == pytest.approx(half_width, rel=0.05)


@pytest.fixture
def mixed_model(
    registry_models: dict[str, FrictionModel], make_model: Callable[..., FrictionModel]
) -> FrictionModel:
    laws = [registry_models[name].laws[0] for name in ("stribeck", "lugre", "stribeck")]
    return replace(make_model(*laws), law=MIXED, robot="bench")


def test_titles_name_the_laws(mixed_model: FrictionModel, tmp_path: Path) -> None:
    """In every format that has a title; 'recommended' is the name of a file."""
    titles = f"{registry()['stribeck'].title} and {registry()['lugre'].title}"
    assert model_title(mixed_model) == titles
    page = page_of(mixed_model)
    assert f"<h1>Friction of bench by {titles}</h1>" in page
    rigid = (0.0, 0.0, 0.0)
    ones = (1.0, 1.0, 1.0)
    motors = Motors(inertia=ones, stiffness=rigid, damping=rigid, ratio=ones)
    drive = content(mixed_model, motors, bare=True)
    assert drive.about.name == f"Drive of bench with {titles}"
    for export, name in ((export_c, "f.h"), (export_modelica, "F.mo"), (export_torch, "f.py")):
        export(mixed_model, tmp_path / name)
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert f"Friction of bench by {titles}" in text
        assert MIXED not in text


def test_a_law_of_one_kind_has_its_title(
    every_law: dict[str, FrictionLaw],
    registry_models: dict[str, FrictionModel],
    make_model: Callable[..., FrictionModel],
) -> None:
    assert model_title(registry_models["lugre"]) == registry()["lugre"].title
    variant = replace(registry_models["lugre"], law="lugre_relaxed")
    assert model_title(variant) == "lugre_relaxed"
    by_hand = make_model(next(iter(every_law.values())))
    assert model_title(by_hand) == by_hand.law
