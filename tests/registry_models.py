"""Models of every registered law."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pytest
from _pytest.mark.structures import ParameterSet

from fmu_src.export.package import translation_unit
from fmu_src.friction.friction_fmu import _component
from fmu_src.pages.live import live_data, wasm
from hesr_model.fitting.estimator import Estimator, registry
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.rigid_body.friction_record import FrictionRecord

_ONE_OF_EACH_KIND = ("bam_m6", "strain_wave_bound", "gms")
"""Samples of the classic laws, which are available by name only; soak tests run all of them."""


STUDIED = tuple(name for name, law in registry().items() if law.everyday)
"""Laws of the default study, for tests that are slow for each law."""


def everyday() -> dict[str, type[Estimator]]:
    """Laws of the registry in everyday tests."""
    laws = registry().items()
    return {name: law for name, law in laws if law.everyday or name in _ONE_OF_EACH_KIND}


SAMPLES = ("stribeck", "lugre_load_ripple", "parfam_s_load", "rbfnn_h")
"""One law of each form: without memory, with relaxations, load and position, with stops, and with
coefficients as constants. Tests that are slow for each law run others once a night."""


def is_of_this_project(law: str) -> bool:
    """Return whether a law is not that of another package."""
    return registry()[law].__module__.split(".")[0] in ("hesr", "hesr_model")


def sampled(laws: Iterable[str]) -> list[ParameterSet]:
    """Return laws as parameters of a slow test: samples for the gate, the others for the night.

    Laws of other packages are in the gate of those who install them.
    """
    nightly = pytest.mark.nightly("laws")
    return [
        pytest.param(law, marks=nightly if is_of_this_project(law) and law not in SAMPLES else ())
        for law in laws
    ]


def models_of_registry(laws: Iterable[str] | None = None) -> Iterator[FrictionModel]:
    """A model of each law, by default of everyday tests, fitted to a noisy motion with a rest."""
    t = 0.01 * np.arange(900)
    dq = np.sin(2.0 * t) * np.sin(0.7 * t)
    q = np.cumsum(dq) * 0.01
    load = 5.0 * np.sin(q) + 3.0
    tau = 6.0 * np.tanh(40.0 * dq) + 2.0 * dq + 0.05 * load
    tau += np.random.default_rng(1).normal(0.0, 0.1, t.shape)
    record = FrictionRecord(
        log="made", joint="j1", t=t, dq=dq, q=q, tau_load=load, tau=tau, gear_ratio=101.0
    )
    for name in everyday() if laws is None else laws:
        yield FrictionModel(
            law=name,
            robot="bench",
            joints=("j1",),
            laws=(fit_joint(name, [record], seed=0),),
            sample_time=0.01,
            trained=(TrainedRange.from_records([record]),),
            provenance={
                "files": [{"name": "/home/someone/secret/made.csv", "sha256": "ab" * 32}],
                "seed": 0,
                "versions": {"numpy": "2.9"},
            },
        )


def live_of(model: FrictionModel) -> dict[str, Any]:
    """Return the data of a model's interactive section, for pages outside its FMU."""
    bare = _component(model)
    return live_data(model, bare.table, wasm(translation_unit(bare)[1]))
