"""Answers of single commands: sentences, tables and JSON of known results."""

from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from containing import Containing, OneSentence
from joint_data import law

from cosim.study.results import Seeds
from cosim.systems.signals import Signals
from cosim.workflow import export, fit, identify, report, run, simulate
from hesr_model.findings import Finding
from hesr_model.fitting.estimator import estimator
from hesr_model.fitting.uncertainty import MAX_COEFFICIENTS
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.support.typed_files import to_json

COULOMB = {"F_c": 3.0, "F_s": 3.0, "v_s": 0.1, "sigma_2": 1.5, "tau_0": 0.0}
RANGE = TrainedRange(
    sample_time=0.01, dq=(-1.0, 1.0), q=(-1.0, 1.0), tau_load=(0.0, 1.0), tau=(-4.0, 4.0)
)
WARNING = Finding(check="gaps", severity="warning", found="it has gaps")


@pytest.fixture
def model() -> FrictionModel:
    return FrictionModel(
        law="stribeck",
        robot="arm",
        joints=("j1", "j2"),
        sample_time=0.01,
        laws=(law("stribeck", {}, **COULOMB),) * 2,
        sliding=(False, True),
        training_rmse=(0.51234, 12.3456),
    )


def test_a_fitted_law_is_listed_by_joint(model: FrictionModel, tmp_path: Path) -> None:
    health = {"health": [to_json(WARNING)], "temperature": ["It falls with heat."]}
    written = fit.answer(
        replace(model, trained=(RANGE, RANGE), provenance=health), tmp_path / "law.json"
    )
    first, one, other, passivity, heat, file = written.summary().splitlines()
    assert first == "stribeck for j1, j2."
    assert one.startswith("j1: tau = ")
    assert one.endswith("  (RMSE 0.512 N.m)")
    assert other.endswith("  (RMSE 12.3 N)")
    assert passivity == "Passivity: proven on j1, j2."
    assert heat == "It falls with heat."
    assert file == f"Written: {tmp_path / 'law.json'}"
    assert (written.format, written.findings) == ("hesr-friction-model-1", [WARNING])
    assert written.data["law"] == "stribeck"
    *coefficients, audit = written.tables()
    assert [text.partition(":")[0] for text in coefficients] == ["j1", "j2"]
    assert [len(text.splitlines()) for text in coefficients] == [1 + len(COULOMB)] * 2
    assert audit.caption == "Audit of Stribeck"
    without = fit.answer(replace(model, training_rmse=()), None)
    assert [line.partition(" ")[0] for line in without.summary().splitlines()] == [
        "stribeck",
        "j1:",
        "j2:",
    ]
    assert "RMSE" not in without.summary()
    assert len(without.tables()) == 2


@pytest.mark.parametrize(("centres", "whole"), [(1, True), (40, False)])
def test_long_laws_are_summarised_by_their_size(
    model: FrictionModel, centres: int, whole: bool
) -> None:
    structure = {"centres": centres}
    form = estimator("rbfnn_h").form(structure)
    values = {one.name: 0.5 for one in form.coefficients}
    assert (len(values) <= MAX_COEFFICIENTS) is whole
    laws = (law("rbfnn_h", structure, **values),) * 2
    told = fit.answer(replace(model, law="rbfnn_h", laws=laws), None)
    line = told.summary().splitlines()[1]
    assert line.startswith("j1: tau = " if whole else f"j1: {len(values)} coefficients  (RMSE")
    assert len(told.tables()) == (2 if whole else 0)


def test_laws_are_listed_with_their_equations() -> None:
    found = fit.listing()
    assert found.shows_tables
    assert found.data["lugre"]["title"] == "LuGre"
    assert [str(row.head) for row in found.tables()[0].rows] == list(found.data)


def body(**provenance: object) -> RigidBody:
    return RigidBody(
        robot="arm",
        joints=("j1", "j2", "tip"),
        names=("l1.m", "l1.Ir"),
        base=(0, 1),
        parameters=np.array([1.0, 2.0]),
        standard_errors=np.array([0.1, 0.2]),
        condition=12.345,
        ridge=0.0,
        friction=np.zeros((3, 3)),
        rmse=np.array([0.5, 2.0, 3.0]),
        rows=10,
        logs=("a", "b"),
        method="stacked",
        weighting="wls",
        provenance=provenance,
    )


def test_a_rigid_body_is_reported_with_units() -> None:
    plain, sliding = (
        identify.answer(body(), None),
        identify.answer(body(sliding=[False, False, True]), None),
    )
    start = ("2 base parameters of 2 (1 of them", "condition 12.3, from a, b")
    assert plain.summary() == OneSentence(*start, "residual RMSE 0.5, 2, 3 N.m.")
    assert sliding.summary() == OneSentence(*start, "residual RMSE 0.5, 2, 3 N.m (N where")
    assert plain.format == "hesr-rigid-body-1"


def test_a_payload_is_reported_in_the_frame_of_the_last_joint() -> None:
    payload = {
        "parameters": {"m": 2.0, "mx": 0.1, "my": -0.2, "mz": 0.5, "Ixx": 9.0},
        "standard_errors": [0.0123, 1.0],
    }
    assert identify.answer(body(payload=payload), Path("b.json")).summary() == Containing(
        "2 +- 0.012 kg", "0.0500, -0.1000, 0.2500 m", "b.json"
    )


@pytest.mark.parametrize(
    ("suffix", "use"),
    [
        (".fmu", "FMU, for every tool"),
        (".MO", "Modelica package"),
        (".bin", "File for other tools"),
    ],
)
def test_an_export_is_reported_with_use_and_size(tmp_path: Path, suffix: str, use: str) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".fmu":
        with ZipFile(path, "w") as archive:
            archive.writestr("binaries/linux64/a.so", b"x" * 2300)
    else:
        path.write_bytes(b"x" * 2560)
    told = export.answer(path, path)
    first, *platforms, file = told.summary().splitlines()
    assert first.startswith(use)
    assert first.endswith(", 2 KiB.")
    assert ["linux64" in line for line in platforms] == [True] * (suffix == ".fmu")
    assert file == f"Written: {path}"
    assert told.data == str(path)


def test_a_simulation_is_reported_with_its_end() -> None:
    signals = Signals(t=np.array([0.0, 0.5, 1.5]), signals={"a.y": np.zeros(3)}, failure=None)
    told = simulate.answer(signals, None)
    assert told.summary() == Containing("3 samples of 1 signals", "1.5 s")
    assert told.data == {"samples": 3, "end": 1.5, "signals": ["a.y"]}


def test_a_report_is_reported_by_its_file(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert report.answer(page, None).summary() == f"Written: {page}"
    assert report.answer(tmp_path, None).summary() == f"Shown: {tmp_path}"


def test_scores_over_draws_are_printed_as_tables() -> None:
    found = Seeds(seeds=2, joints=("j1",), reference="lugre", tests={})
    assert run.answer(found, None).shows_tables
