"""Scores: comparisons, their significance, and equality of FMU and model scores."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.report.tables.scores import errors
from cosim.report.tables.terminal import TerminalTable
from cosim.study.scores import (
    MEASURES,
    Comparison,
    _is_classic,
    compare,
    input_classes,
    name_inputs,
    select_window,
    transpose_records,
)
from fmu_src import export_fmu
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.predictions import predict_fmu, predict_model
from hesr_model.errors import ArtifactError, ConfigError, SimulationError
from hesr_model.fitting.estimator import estimator, select_laws
from hesr_model.friction.band import Band
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.typed_files import from_json, to_json

BRISTLE = {
    "linear": ["1", "dq", "h", "h_load"],
    "units": [],
    "state": "bristle",
    "ripple": {"gear_ratio": 101.0, "orders": [2]},
}
BRISTLE_VALUES = {
    "c_0": 0.4, "c_dq": 5.0, "c_h": 9.0, "c_h_load": 0.2, "kappa": 40.0, "rho": 1.3, "v_s": 0.1,
    "ripple2_cos": 0.5, "ripple2_sin": -0.3, "lag": 3e-3, "smoothing": 1e-3,
}  # fmt: skip
STRIBECK_VALUES = {"F_c": 6.0, "F_s": 9.0, "v_s": 0.1, "sigma_2": 4.0, "tau_0": -0.3}


def law(name: str, structure: Mapping[str, object], values: Mapping[str, float]) -> FrictionLaw:
    form = estimator(name).form(structure)
    return FrictionLaw(name=name, structure=structure, form=form, values=values)


def bristle(*, start_samples: int = 5) -> FrictionLaw:
    return replace(law("parfam_hx", BRISTLE, BRISTLE_VALUES), start_samples=start_samples)


def stribeck() -> FrictionLaw:
    return law("stribeck", {}, STRIBECK_VALUES)


def model_of(*laws: FrictionLaw) -> FrictionModel:
    joints = tuple(f"j{k}" for k, _ in enumerate(laws, start=1))
    return FrictionModel(law="made", robot="bench", joints=joints, laws=laws, sample_time=0.008)


def record(joint: str, seed: int, rows: int = 700) -> FrictionRecord:
    """Rows of uneven steps; the torque is that of a bristle deflected at the start."""
    rng = np.random.default_rng(seed)
    t = 3.0 + np.cumsum(rng.uniform(0.005, 0.011, rows))
    phase = rng.uniform(0.0, 2.0 * np.pi)
    dq = 0.7 * np.sin(1.9 * t + phase) + 0.2 * np.sin(6.0 * t)
    dq[:20] = 0.0
    q = np.cumsum(dq) * 0.008
    load = 12.0 * np.cos(0.8 * t)
    tau = predict(bristle(), t=t, dq=dq, q=q, tau_load=load, start=(-0.7,))
    tau += 0.2 * rng.normal(size=rows)
    return FrictionRecord(log=f"log{seed}", joint=joint, t=t, dq=dq, q=q, tau_load=load, tau=tau)


@pytest.fixture(scope="module")
def records() -> list[list[FrictionRecord]]:
    """Two joints, two logs; the joints of a log share its time stamps."""
    logs = []
    for seed in (0, 1):
        first = record("j1", seed)
        logs.append([first, replace(first, joint="j2", dq=-0.8 * first.dq, tau=-first.tau)])
    return transpose_records(logs)


# --- comparisons -------------------------------------------------------------------------------


def wrong_by(
    records: list[list[FrictionRecord]], size: float, seed: int, memory: float = 0.9
) -> list[list[np.ndarray]]:
    """Predictions with this RMSE and an error correlation over several rows."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(seed)
    scale = size * np.sqrt(1.0 - memory**2)
    return [
        [r.tau + lfilter([scale], [1.0, -memory], rng.normal(size=len(r.tau))) for r in of_joint]
        for of_joint in records
    ]


def test_the_interval_of_a_ratio_contains_the_truth() -> None:
    """Repeated errors of known size: about 95 of 100 intervals contain the true ratio."""
    rows = [[replace(record("j1", k, rows=2500), log=f"log_{k}") for k in range(6)]]
    held, widths = [], []
    for seed in range(40):
        lugre, other = wrong_by(rows, 1.0, 2 * seed), wrong_by(rows, 0.7, 2 * seed + 1)
        (found,) = compare(rows, {"lugre": lugre, "other": other}).ratios.laws["other"]
        held.append(found.low <= 0.7 <= found.high)
        widths.append(found.high - found.low)
        assert found.low < found.value < found.high
    assert np.mean(held) >= 0.85
    assert np.mean(widths) < 0.3


def test_ratios_are_taken_to_lugre_or_else_to_the_first_law(
    records: list[list[FrictionRecord]],
) -> None:
    wrong = {
        name: wrong_by(records, size, k)
        for k, (name, size) in enumerate({"stribeck": 2.0, "lugre": 1.0, "parfam_h": 0.8}.items())
    }
    scores = compare(records, wrong)
    assert scores.ratios.reference == "lugre"
    assert set(scores.ratios.laws) == {"stribeck", "parfam_h"}
    for joint in range(2):
        for name, row in scores.ratios.laws.items():
            errors = [scores.laws[law].rmse[joint] for law in (name, "lugre")]
            assert row[joint].value == pytest.approx(errors[0] / errors[1], rel=1e-12, abs=0.0)
    del wrong["lugre"]
    assert compare(records, wrong).ratios.reference == "stribeck"
    assert compare(records, {"parfam_h": wrong["parfam_h"]}).ratios.laws == {}


def test_scores_pool_the_logs_of_a_joint(records: list[list[FrictionRecord]]) -> None:
    wrong = wrong_by(records, 1.0, 0)
    scores = compare(records, {"made": wrong})
    assert scores.joints == ("j1", "j2")
    for joint, (of_joint, predicted) in enumerate(zip(records, wrong, strict=True)):
        pooled = np.concatenate([p - r.tau for r, p in zip(of_joint, predicted, strict=True)])
        assert scores.laws["made"].rmse[joint] == pytest.approx(rmse(pooled), rel=1e-12, abs=0.0)


def test_a_comparison_is_written_as_json(records: list[list[FrictionRecord]]) -> None:
    scores = compare(
        records, {"lugre": wrong_by(records, 1.0, 0), "other": wrong_by(records, 0.5, 1)}
    )
    data = to_json(scores)
    assert data["joints"] == ["j1", "j2"]
    assert set(data["laws"]) == {"lugre", "other"}
    for of_law in data["laws"].values():
        assert set(of_law) == {*MEASURES, "rmse_rest"}
        assert all(len(values) == 2 for values in of_law.values())
    assert data["ratios"]["reference"] == "lugre"
    for entry in data["ratios"]["laws"]["other"]:
        assert entry["value"] > 0.0
        assert (entry["low"], entry["high"], entry["p"]) == (None, None, None)  # 8 s are too short
    assert from_json(Comparison, data, Path("scores.json"), "scores") == scores
    assert scores == compare(
        records, {"lugre": wrong_by(records, 1.0, 0), "other": wrong_by(records, 0.5, 1)}
    )


def test_uncertainty_bands_are_scored(records: list[list[FrictionRecord]]) -> None:
    band = Band(
        floor=0.5, slow=0.4, slow_speed=0.05, rest=0.3, fast=0.1, load=0.02, tail=0.6, envelope=0.0
    )
    wide = model_of(*(replace(stribeck(), band=band) for _ in range(2)))
    models = {"wide": wide, "bare": model_of(stribeck(), stribeck())}
    predicted = {name: predict_model(model, records) for name, model in models.items()}
    found = compare(records, predicted, models=models)
    assert set(found.bands) == {"wide"}
    for joint, of_joint in enumerate(found.bands["wide"]):
        inside = []
        for log in transpose_records(records):
            lower, upper = wide.predict_band(log)
            tau = log[joint].tau
            inside.append((tau >= lower[:, joint]) & (tau <= upper[:, joint]))
        assert of_joint.held == np.concatenate(inside).mean()
        assert 0.0 < of_joint.least_log < 1.0
    assert from_json(Comparison, to_json(found), Path("scores.json"), "scores") == found
    assert compare(records, predicted).bands == {}


def test_a_relaxed_variant_is_a_reference_by_its_left_out_error(
    records: list[list[FrictionRecord]],
) -> None:
    """On the test it has the largest error; variants of other laws are no references."""
    laws = {"lugre": "lugre", "lugre_relaxed": "lugre", "hx_bare": "parfam_hx"}
    sizes = {"lugre": 0.8, "lugre_relaxed": 1.0, "hx_bare": 0.5}
    left_out = {"lugre": 2.0, "lugre_relaxed": 1.0, "hx_bare": 0.1}
    form = estimator("lugre").form({})
    models = {
        row: FrictionModel(
            law=law_name,
            robot="r",
            joints=tuple(joint_records[0].joint for joint_records in records),
            laws=(
                FrictionLaw(
                    name=law_name,
                    form=form,
                    values=dict.fromkeys([c.name for c in form.coefficients], 1.0),
                ),
            )
            * len(records),
            sample_time=0.01,
            left_out_rmse=(left_out[row],) * len(records),
        )
        for row, law_name in laws.items()
    }
    predictions = {row: wrong_by(records, size, k) for k, (row, size) in enumerate(sizes.items())}
    scores = compare(records, predictions, dict.fromkeys(laws, "v"), models)
    relaxed = ("lugre_relaxed",) * len(records)
    assert scores.ratios.by_joint == {"lugre": relaxed, "hx_bare": relaxed}


def test_each_class_of_inputs_has_its_strongest_classic_law_as_reference(
    records: list[list[FrictionRecord]],
) -> None:
    sizes = {"stribeck": 2.0, "lugre": 1.0, "lugre_load": 0.8, "dahl_load": 0.9, "hx_bare": 0.7,
             "hx_load": 0.6, "parfam_hx": 0.5}  # fmt: skip
    inputs = {"stribeck": "v", "lugre": "v", "lugre_load": "v, load", "dahl_load": "v, load",
              "hx_bare": "v", "hx_load": "v, load", "parfam_hx": "v, q, load, start"}  # fmt: skip
    predictions = {law: wrong_by(records, size, k) for k, (law, size) in enumerate(sizes.items())}
    scores = compare(records, predictions, inputs)
    assert scores.ratios.by_joint == {
        law: (reference,) * len(records)
        for law, reference in {
            "stribeck": "lugre",
            "hx_bare": "lugre",
            "dahl_load": "lugre_load",
            "hx_load": "lugre_load",
            "parfam_hx": "lugre_load",
        }.items()
    }
    assert "lugre_load" not in scores.ratios.laws  # it is stronger than laws with fewer inputs
    found = scores.ratios.laws["parfam_hx"][0].value
    rmses = [scores.laws[law].rmse[0] for law in ("parfam_hx", "lugre_load")]
    assert found == pytest.approx(rmses[0] / rmses[1], rel=1e-12, abs=0.0)
    text = shown(TerminalTable(errors("unseen", scores, inputs=inputs)))
    assert "the strongest classic law" in " ".join(text.split())


def test_a_row_of_all_classic_laws_is_classic() -> None:
    everything = select_laws("classic")
    assert len(everything) > 1
    laws = tuple(
        FrictionLaw(
            name=law_name,
            form=estimator(law_name).form({}),
            values={c.name: 1.0 for c in estimator(law_name).form({}).coefficients},
        )
        for law_name in (*everything, "stribeck_direction")
    )
    names = tuple(f"j{j}" for j in range(len(laws)))
    mixed = FrictionModel(
        law="mixed", robot="r", joints=names[:-1], laws=laws[:-1], sample_time=0.01
    )
    other = replace(mixed, joints=names, laws=laws)
    models = {"mixed": mixed, "other": other}
    assert _is_classic("mixed", models)
    assert not _is_classic("other", models)
    assert _is_classic(everything[0], {})


def test_p_values_are_adjusted_for_all_comparisons_of_a_table() -> None:
    """Twice as many equal comparisons double the smallest p-value."""
    rows = [[record("j1", 0, rows=9000)]]
    base = {"lugre": wrong_by(rows, 1.0, 0), "other": wrong_by(rows, 0.8, 1)}
    (alone,) = compare(rows, base).ratios.laws["other"]
    more = {f"copy{k}": base["lugre"] for k in range(3)}
    (among,) = compare(rows, base | more).ratios.laws["other"]
    assert among.p == alone.p  # that of the interval
    assert alone.adjusted_p is not None
    assert among.adjusted_p == pytest.approx(min(1.0, 4.0 * alone.adjusted_p))
    assert (among.value, among.low, among.high) == (alone.value, alone.low, alone.high)
    assert alone.verdict == "better"
    assert replace(alone, adjusted_p=0.2).verdict == "alike"
    assert replace(alone, value=1.2).verdict == "worse"
    earlier = replace(alone, p=None, adjusted_p=None)  # judged by its interval
    assert earlier.verdict == "better"
    assert replace(earlier, high=1.1).verdict == "alike"


def test_records_convert_between_logs_and_joints(records: list[list[FrictionRecord]]) -> None:
    assert [[r.joint for r in of_joint] for of_joint in records] == [["j1", "j1"], ["j2", "j2"]]
    assert transpose_records(transpose_records(records)) == records


# --- bands ------------------------------------------------------------------------------------


def test_bands_divide_the_rows(records: list[list[FrictionRecord]]) -> None:
    """Time counts from the start of each log, whatever its time stamps are."""
    wrong = wrong_by(records, 1.0, 0)
    middle = 2.0
    bands = [select_window(records, wrong, *band) for band in ((0.0, middle), (middle, 1e9))]
    for joint in range(2):
        for log in range(2):
            whole = records[joint][log]
            since = whole.t - whole.t[0]
            parts = [rows[joint][log] for rows, _ in bands]
            assert [len(p.t) for p in parts] == [(since < middle).sum(), (since >= middle).sum()]
            np.testing.assert_array_equal(np.concatenate([p.tau for p in parts]), whole.tau)
            np.testing.assert_array_equal(
                np.concatenate([torques[joint][log] for _, torques in bands]), wrong[joint][log]
            )


def test_a_band_is_scored_on_its_own_rows(records: list[list[FrictionRecord]]) -> None:
    """An error in the second half only does not affect the first."""
    wrong = [
        [r.tau + np.where(r.t - r.t[0] < 2.0, 0.1, 1.0) for r in of_joint] for of_joint in records
    ]
    for band, expected in (((0.0, 2.0), 0.1), ((2.0, 1e9), 1.0)):
        rows, torques = select_window(records, wrong, *band)
        assert compare(rows, {"made": torques}).laws["made"].rmse == pytest.approx(
            [expected] * len(rows), rel=1e-9
        )


def test_a_log_that_ends_before_a_band_is_left_out_of_it(
    records: list[list[FrictionRecord]],
) -> None:
    wrong = wrong_by(records, 1.0, 0)
    short = [[r, _first(r, 200)] for r, _ in records]
    cut = [[p, q[:200]] for p, q in wrong]
    rows, torques = select_window(short, cut, 3.0, 1e9)
    assert [len(of_joint) for of_joint in rows] == [len(p) for p in torques] == [1, 1]
    assert compare(rows, {"lugre": torques, "other": torques}).ratios.laws["other"][0].value == 1.0


def test_a_band_without_rows_is_refused(records: list[list[FrictionRecord]]) -> None:
    with pytest.raises(ConfigError, match=r"^the band from 60 to 70 s is empty.* lasts 5\."):
        select_window(records, wrong_by(records, 1.0, 0), 60.0, 70.0)


def _first(data: FrictionRecord, rows: int) -> FrictionRecord:
    columns = {n: v[:rows] for n, v in vars(data).items() if isinstance(v, np.ndarray)}
    return replace(data, **columns)


# --- input classes -----------------------------------------------------------------------------


def test_a_class_is_named_by_the_inputs_of_any_joint() -> None:
    loaded = law("lugre_load", {}, {"sigma_0": 2e3, "sigma_1": 1.0, "sigma_2": 1.0, "F_c": 5.0,
                                    "F_s": 6.0, "v_s": 0.1, "tau_0": 0.0, "mu": 0.1})  # fmt: skip
    assert name_inputs(model_of(stribeck(), stribeck())) == "v"
    assert name_inputs(model_of(stribeck(), loaded)) == "v, load"
    assert name_inputs(model_of(stribeck(), bristle(start_samples=0))) == "v, q, load"
    starting = model_of(stribeck(), bristle())
    assert name_inputs(starting) == "v, q, load"
    assert input_classes({"plain": model_of(stribeck()), "own": starting}) == {
        "plain": "v",
        "own": "v, q, load",
        "own + start": "v, q, load, start",
    }


def shown(table: object, width: int = 120) -> str:
    from io import StringIO

    from rich.console import Console

    out = StringIO()
    Console(file=out, width=width).print(table)
    return out.getvalue()


def test_tables_group_laws_by_inputs_fewest_first(
    records: list[list[FrictionRecord]],
) -> None:
    sizes = {"parfam_hx": 0.5, "lugre": 1.0, "hx_bare": 0.9, "lugre_load": 0.8}
    scores = compare(
        records, {name: wrong_by(records, size, k) for k, (name, size) in enumerate(sizes.items())}
    )
    classes = {"parfam_hx": "v, q, load, start", "lugre": "v", "hx_bare": "v",
               "lugre_load": "v, load"}  # fmt: skip
    text = shown(TerminalTable(errors("unseen", scores, inputs=classes)))
    lines = [line.strip() for line in text.splitlines()]
    headings = [line for line in lines if line.startswith("inputs")]
    assert headings == ["inputs v", "inputs v, load", "inputs v, q, load, start"]
    places = [
        next(k for k, line in enumerate(lines) if line.startswith(row))
        for row in ("hx_bare", headings[1], "LuGre+load", headings[2], "ParFam-HX")
    ]
    assert places == sorted(places)


# --- FMUs -------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[export_fmu, export_bare])
def fmu(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[FrictionModel, Path]:
    """A model with one joint whose start is estimated from the first torques."""
    model = model_of(bristle(), stribeck())
    return model, request.param(model, tmp_path_factory.mktemp("fmu") / "made.fmu")


def test_an_fmu_with_estimated_start_matches_its_model(
    fmu: tuple[FrictionModel, Path], records: list[list[FrictionRecord]]
) -> None:
    model, path = fmu
    for known in (False, True):
        expected = predict_model(model, records, measured_start=known)
        found = predict_fmu(path, records, measured_start=known)
        for joint in range(2):
            for log in range(2):
                worst = np.abs(found[joint][log] - expected[joint][log]).max()
                assert worst <= 1e-12 * np.abs(expected[joint][log]).max()


def test_the_estimated_start_reaches_the_fmu(
    fmu: tuple[FrictionModel, Path], records: list[list[FrictionRecord]]
) -> None:
    """Without it the first torques are wrong by most of the friction."""
    _, path = fmu
    from_zero, estimated = (predict_fmu(path, records, measured_start=k) for k in (False, True))
    for log, r in enumerate(records[0]):
        resting = slice(0, 20)
        assert np.abs(estimated[0][log] - r.tau)[resting].mean() < 0.4
        assert np.abs(from_zero[0][log] - r.tau)[resting].mean() > 4.0


def test_records_of_other_joints_are_refused(
    fmu: tuple[FrictionModel, Path], records: list[list[FrictionRecord]]
) -> None:
    model, path = fmu
    with pytest.raises(ArtifactError, match="joints j1, j2; the robot"):
        predict_model(model, records[:1])
    with pytest.raises(SimulationError, match="2 joints"):
        predict_fmu(path, records[:1])
