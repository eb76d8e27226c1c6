"""A friction model with a law of its own on each joint: its file, its FMUs and other exports."""

import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmu_src import export_fmu
from fmu_src.check.run import check
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.replay import replay
from fmu_src.pages import datasheet
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel, mix_models
from hesr_model.friction.trained_range import TrainedRange

LAWS = ("stribeck", "lugre_load", "parfam_s", "rbfnn_h")
"""Without memory, with load, with stops, and with coefficients as constants."""
JOINTS = tuple(f"j{k}" for k, _ in enumerate(LAWS, start=1))
SEEN = TrainedRange(
    sample_time=0.005, dq=(-2.0, 2.0), q=(-1.0, 1.0), tau_load=(-9.0, 9.0), tau=(-15.0, 15.0)
)


@pytest.fixture(scope="module")
def models(fitted: dict[str, FrictionLaw]) -> list[FrictionModel]:
    """Models of one law for all joints."""
    return [
        FrictionModel(
            law=name,
            robot="bench",
            joints=JOINTS,
            laws=(fitted[name],) * len(LAWS),
            sample_time=0.005,
            trained=tuple(replace(SEEN, dq=(-k, k)) for k in (1.0, 1.5, 2.0, 2.5)),
            training_rmse=(0.1 * number,) * len(LAWS),
        )
        for number, name in enumerate(LAWS, start=1)
    ]


@pytest.fixture(scope="module")
def model(models: list[FrictionModel]) -> FrictionModel:
    return mix_models(models)


def test_each_joint_has_its_own_law_and_errors(model: FrictionModel, fitted) -> None:
    assert model.law == "recommended"
    assert model.laws == tuple(fitted[name] for name in LAWS)
    assert model.training_rmse == pytest.approx((0.1, 0.2, 0.3, 0.4))
    assert [seen.dq[1] for seen in model.trained] == [1.0, 1.5, 2.0, 2.5]
    assert (model.left_out_rmse, model.thermal) == ((), ())


def test_its_file_is_read_back_with_the_same_bytes(model: FrictionModel, tmp_path: Path) -> None:
    first, second = tmp_path / "a.json", tmp_path / "b.json"
    model.write(first)
    again = FrictionModel.read(first)
    again.write(second)
    assert again == model
    assert second.read_bytes() == first.read_bytes()


@pytest.mark.parametrize("fmi", [2, pytest.param(3, marks=pytest.mark.nightly("laws"))])
def test_its_torque_is_that_of_an_fmu_of_each_law(
    fmi: int, models, model: FrictionModel, tmp_path: Path, make_motion: Callable
) -> None:
    """Bit for bit, on a motion with rests and reversals."""
    t, *motion = make_motion(len(LAWS))
    whole = replay(export_bare(model, tmp_path / "mixed.fmu", fmi=fmi), t, *motion)
    assert np.ptp(whole, axis=0).min() > 5.0
    for k, of_law in enumerate(models):
        one = replace(of_law, joints=("j",), laws=of_law.laws[:1], trained=(), training_rmse=())
        fmu = export_bare(one, tmp_path / f"{k}.fmu", fmi=fmi)
        alone = replay(fmu, t, *(column[:, k : k + 1] for column in motion))
        np.testing.assert_array_equal(whole[:, k], alone[:, 0])


@pytest.mark.ci
@pytest.mark.parametrize("fmi", [2, pytest.param(3, marks=pytest.mark.nightly("laws"))])
def test_its_fmu_passes_all_checks_and_its_page_names_the_law_of_each_joint(
    fmi: int, model: FrictionModel, tmp_path: Path
) -> None:
    fmu = export_fmu(model, tmp_path / "Friction.fmu", fmi=fmi)
    assert check(fmu).problems == ()
    with zipfile.ZipFile(fmu) as archive:
        page = archive.read("documentation/index.html").decode()
    for k, title in enumerate(("Stribeck", "LuGre+load", "ParFam-S", "RBFNN-H"), start=1):
        assert f"<h3>Joint {k}: j{k}, {title}</h3>" in page


def test_it_is_proven_joint_by_joint(models, model: FrictionModel) -> None:
    seen = model.trained[:2]
    two, *alone = (
        replace(one, joints=JOINTS[:2], laws=one.laws[:2], trained=seen, training_rmse=())
        for one in (model, *models[:2])
    )
    found = datasheet.certificates(two, seen)
    assert [one.verdict for one in found] == ["proven", "tested"]
    assert found == tuple(datasheet.certificates(one, seen)[k] for k, one in enumerate(alone))
