"""Declarative laws: extensions of a core."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from joint_data import GEAR_RATIO, along, error_on, law, path, training

from hesr_model.errors import ArtifactError, FitError
from hesr_model.fitting.declarative import DeclarativeEstimator, OneForm, no_structure
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.laws.stribeck import Stribeck

RIPPLE = {"ripple": {"gear_ratio": GEAR_RATIO, "orders": [3]}}
STRIBECK = {"F_c": 6.0, "F_s": 9.0, "v_s": 0.1, "sigma_2": 4.0, "tau_0": -0.3}
WAVES = {"ripple3_cos": 0.5, "ripple3_sin": 0.2, "lag": 2e-3, "smoothing": 1e-3}

DESCRIBED = [name for name, entry in registry().items() if issubclass(entry, DeclarativeEstimator)]


class StribeckRipple(Stribeck):
    """A law with ripple, declared in one line."""

    ripple = True
    start_samples = 3


def test_most_laws_are_declarative() -> None:
    assert {"stribeck", "lugre", "lugre_load", "dahl", "strain_wave", "parfam_hx"} <= set(DESCRIBED)


def test_any_core_can_be_extended_by_ripple() -> None:
    for name in DESCRIBED:
        entry = registry()[name]
        structure: Mapping[str, Any] = {}
        try:
            core = entry.form({})
        except ArtifactError:
            structure = {"linear": ["dq", "h"], "units": []}
            core = entry.form(structure)
        whole = entry.form({**structure, **RIPPLE})
        added = [c.name for c in whole.coefficients[len(core.coefficients) :]]
        assert added == list(WAVES)
        assert whole.coefficients[: len(core.coefficients)] == core.coefficients
        assert whole.relaxations == core.relaxations
        assert "q" in map(str, whole.inputs)
        assert "q" not in map(str, core.inputs)


def test_a_subclass_with_ripple_finds_it() -> None:
    truth = law("stribeck", RIPPLE, **STRIBECK, **WAVES)
    records = training(truth, noise=0.1, gear_ratio=GEAR_RATIO)
    fitted = StribeckRipple().fit(records, np.random.default_rng(0))
    assert fitted.structure == RIPPLE
    assert fitted.start_samples == 3
    for name, value in {**STRIBECK, **WAVES}.items():
        scale = max(abs(value), 0.05 if name in STRIBECK or "_" in name else 1e-3)
        assert fitted.values[name] == pytest.approx(value, abs=0.12 * scale), name


def test_a_law_without_ripple_does_not_search_for_it() -> None:
    truth = law("stribeck", RIPPLE, **STRIBECK, **WAVES)
    records = training(truth, noise=0.1, gear_ratio=GEAR_RATIO)
    fitted = Stribeck().fit(records, np.random.default_rng(0))
    assert fitted.structure == {}
    assert fitted.start_samples == 0
    assert error_on(fitted, records[0]) > 0.3


def test_a_fitted_law_has_its_form_and_values() -> None:
    records = training(law("stribeck", {}, **STRIBECK), noise=0.1, gear_ratio=GEAR_RATIO)
    fitted = StribeckRipple().fit(records, np.random.default_rng(0))
    assert fitted.structure == {}
    again = FrictionLaw(name="stribeck", form=Stribeck.form({}), values=fitted.values)
    assert error_on(again, records[0]) == error_on(fitted, records[0])


class Flat(OneForm):
    """A law with five coefficients, for as many rows."""

    name = "flat"
    title = "flat"

    @staticmethod
    def core(structure: Mapping[str, Any]) -> LawForm:
        no_structure("flat", structure)
        return Stribeck.core({})

    def space(self) -> SearchSpace:
        return Stribeck().space()


def test_fewer_rows_than_coefficients_are_refused() -> None:
    record = along(law("stribeck", {}, **STRIBECK), path(0))
    short = {n: v[:4] for n, v in vars(record).items() if isinstance(v, np.ndarray)}
    with pytest.raises(FitError, match="4 rows for 5 coefficients"):
        Flat().fit([type(record)(**(vars(record) | short))], np.random.default_rng(0))


@pytest.mark.parametrize("structure", [{"states": 2}, {"ripples": {}}, {"linear": []}])
def test_a_law_of_one_form_has_no_structure(structure: Mapping[str, Any]) -> None:
    with pytest.raises(ArtifactError, match=r"^law 'flat' has no structure, found"):
        Flat.form(structure)
    with pytest.raises(ArtifactError, match="has no structure"):
        Flat.form({**structure, **RIPPLE})
    no_structure("flat", {})
