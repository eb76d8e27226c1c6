"""Trained ranges: kept from the fit to the model file, and compared with logs."""

import json
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest
from joint_data import HX_PAPER, along, law, path

from hesr_model.errors import ArtifactError
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record
from hesr_model.friction.trained_range import TrainedRange, find_excess

TRUTH = law("parfam_hx", HX_PAPER, c_0=0.4, c_dq=5.0, c_h=9.0, c_dh=0.02, alpha=10.0, beta=50.0)
RECORDS = [along(TRUTH, path(k), log=f"{k}") for k in range(2)]


@pytest.fixture(scope="module")
def model() -> FrictionModel:
    """Two joints; the second moves less."""
    slow = [along(TRUTH, path(k, peak=0.4), log=f"{k}") for k in range(2)]
    records = [RECORDS, [replace(r, joint="j2") for r in slow]]
    return fit_models(["stribeck"], records, robot="bench", seed=0, workers=1)["stribeck"]


def test_a_fit_records_the_range_of_each_joint(model: FrictionModel) -> None:
    assert model.trained[0] == TrainedRange.from_records(RECORDS)
    assert model.trained[1].speed < 0.6 * model.trained[0].speed
    for name in ("dq", "q", "tau_load", "tau"):
        low, high = getattr(model.trained[0], name)
        assert low == min(getattr(r, name).min() for r in RECORDS)
        assert high == max(getattr(r, name).max() for r in RECORDS)


def test_ranges_are_saved_with_the_model(model: FrictionModel, tmp_path: File) -> None:
    model.write(tmp_path / "law.json")
    read = FrictionModel.read(tmp_path / "law.json")
    assert read.trained == model.trained
    assert read.training_rmse == model.training_rmse


def test_a_fit_records_its_errors(model: FrictionModel) -> None:
    stribeck = model.laws[0]
    errors = np.concatenate([predict_record(stribeck, r) - r.tau for r in RECORDS])
    assert model.training_rmse[0] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-12, abs=0.0)
    assert 0.0 < model.training_rmse[1] < model.training_rmse[0]


def test_a_file_without_ranges_gives_a_model_without_ranges(
    model: FrictionModel, tmp_path: File
) -> None:
    replace(model, trained=(), training_rmse=()).write(tmp_path / "law.json")
    read = FrictionModel.read(tmp_path / "law.json")
    assert (read.trained, read.training_rmse) == ((), ())


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda d: d["joints"][0]["trained"].update(dq=[1.0, -1.0]), "'dq' is 1.0 to -1.0"),
        (lambda d: d["joints"][0]["trained"].pop("tau"), "'joints.0.trained.tau' is missing"),
        (lambda d: d["joints"][0]["trained"].update(q="wide"), "not a friction model"),
        (lambda d: d["joints"][1].pop("trained"), "1 trained ranges for 2 joints"),
        (lambda d: d["joints"][1].pop("training_rmse"), "1 training errors for 2 joints"),
    ],
)
def test_damaged_ranges_name_the_file(
    model: FrictionModel, tmp_path: File, spoil: object, said: str
) -> None:
    file = tmp_path / "law.json"
    model.write(file)
    data = json.loads(file.read_text())
    spoil(data)  # type: ignore[operator]
    file.write_text(json.dumps(data))
    with pytest.raises(ArtifactError) as caught:
        FrictionModel.read(file)
    assert str(file) in str(caught.value)
    assert said in str(caught.value)


def test_the_sample_time_is_the_median_of_all_rows() -> None:
    t = np.concatenate([0.01 * np.arange(100), [5.0]])  # a gap at the end
    gap = replace(RECORDS[0], **{n: getattr(RECORDS[0], n)[:101] for n in ("dq", "q", "tau_load",
                  "tau")}, t=t)  # fmt: skip
    assert TrainedRange.from_records([gap]).sample_time == pytest.approx(0.01)


def test_middle_and_speed_cover_the_whole_range() -> None:
    trained = replace(TrainedRange.from_records(RECORDS), q=(-1.0, 2.0), dq=(-0.9, 0.4))
    assert trained.middle == 0.5
    assert trained.speed == 0.9


def test_logs_within_the_range_give_no_excess() -> None:
    trained = TrainedRange.from_records(RECORDS)
    assert find_excess(trained, RECORDS) == {}
    for record in RECORDS:
        assert find_excess(trained, [record]) == {}


def test_a_faster_log_exceeds_the_range_by_its_extra_speed() -> None:
    trained = TrainedRange.from_records(RECORDS)
    faster = replace(RECORDS[0], dq=1.5 * RECORDS[0].dq)
    found = find_excess(trained, [RECORDS[1], faster])
    assert list(found) == ["dq"]
    assert found["dq"].above == pytest.approx(max(0.0, faster.dq.max() - trained.dq[1]))
    assert found["dq"].below == pytest.approx(max(0.0, trained.dq[0] - faster.dq.min()))
    beyond = np.sum((faster.dq > trained.dq[1]) | (faster.dq < trained.dq[0]))
    assert found["dq"].rows == pytest.approx(beyond / (len(faster.t) + len(RECORDS[1].t)))
