"""Recorded sections of the report of a small made-up run: numbers, names, tables and charts.

After an intended change run `pytest tests/cosim/report/test_sections.py --regen-all` and review it.
"""

import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joint_data import law
from markupsafe import Markup
from matplotlib.figure import Figure
from pytest_regressions.file_regression import FileRegressionFixture

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.loop.traces import LoopOutcome, Overcompensation, Trace, Tracked
from cosim.report.figures.chart import Chart, Line
from cosim.report.results import Results
from cosim.report.sections import inputs, laws, prediction, summary
from cosim.report.tables.loop import table_ii, table_iii
from cosim.report.tables.table import ResultTable, csv_text
from cosim.study.replicates import Replicates
from cosim.study.results import SavedLog, SavedRun, read_torques, write_findings, write_torques
from cosim.study.scores import ORACLE, Comparison, compare, input_classes, predict_models
from cosim.study.study import TimeBand
from hesr_model.findings import Finding
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.inference.replicates import ErrorSplit
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody

COULOMB = {"F_c": 3.0, "F_s": 3.1, "v_s": 0.1, "sigma_2": 1.5, "tau_0": 0.1}
BRISTLES = COULOMB | {"sigma_0": 500.0, "sigma_1": 1.0}
JOINTS = ("base", "arm")


def records(seed: int) -> list[FrictionRecord]:
    """One log of 18 s."""
    t = 0.01 * np.arange(1800)
    found = []
    for k, joint in enumerate(JOINTS):
        dq = np.sin((1.1 + 0.3 * k) * t + seed) + 0.3 * np.sin(2.3 * t)
        load = 4.0 * np.cos(0.4 * t + k)
        noise = np.random.default_rng(10 * seed + k).normal(0.0, 0.3, len(t))
        tau = 3.0 * np.tanh(30.0 * dq) + 1.5 * dq + noise
        found.append(
            FrictionRecord(
                log=f"log{seed}",
                joint=joint,
                t=t,
                dq=dq,
                q=np.cumsum(0.01 * dq),
                tau_load=load,
                tau=tau,
            )
        )
    return found


def model(name: str, values: dict[str, float], *, scale: float = 1.0) -> FrictionModel:
    own = {key: scale * value if key in ("F_c", "F_s") else value for key, value in values.items()}
    one = law(name, {}, **own)
    errors = dict.fromkeys(own, 0.01)
    return FrictionModel(
        law=name,
        robot="bench",
        joints=JOINTS,
        sample_time=0.01,
        laws=(replace(one, standard_errors=errors), replace(one, values=own | {"F_c": 2.9})),
        trained=tuple(TrainedRange.from_records([record]) for record in records(1)),
    )


def scored(logs: list[FrictionRecord], models: dict[str, FrictionModel]) -> Comparison:
    of_joints = [[record] for record in logs]
    predicted = predict_models(models, of_joints)
    truth = [[record.tau + 0.05 * np.sin(record.t)] for record in logs]
    return compare(of_joints, predicted | {ORACLE: truth}, input_classes(models), models)


def outcome() -> LoopOutcome:
    def tracked(scheme: Scheme, name: str, scale: float) -> Tracked:
        rmse = scale * np.array([[0.001, 0.02], [0.003, 0.05]])
        return Tracked(scheme=scheme, law=name, rmse=rmse, last=rmse / 8.0)

    schemes = [
        Scheme(compensation="none"),
        Scheme(compensation="torque_error"),
        Scheme(compensation="torque_error", Kx=5.0),
        Scheme(compensation="servo_inversion"),
        Scheme(compensation="servo_inversion", source="filtered"),
    ]
    names = (StandIn.BODY_ONLY, "lugre", "own")
    rows = [
        tracked(s, n, 1.0 + k + 0.1 * m) for k, s in enumerate(schemes) for m, n in enumerate(names)
    ]
    return LoopOutcome(
        tracking=rows,
        long=rows[:2],
        sweeps=[replace(rows[0], law="lugre")],
        overcompensation=[Overcompensation(law="lugre", scheme=schemes[1], factor=1.5)],
    )


def replicates(models: dict[str, FrictionModel]) -> Replicates:
    splits = (
        ErrorSplit(rmse=2.5, repeats=0.91, low=0.8, high=1.0, smooth=0.75),
        ErrorSplit(rmse=0.125, repeats=0.0, low=0.0, high=0.0625, smooth=0.03),
    )
    return Replicates(
        joints=JOINTS,
        count=5.0,
        rows=1700,
        all_rows=1800,
        period=3.5,
        laws=dict.fromkeys((*models, ORACLE), splits),
        fast=dict.fromkeys(("stribeck", "lugre"), splits),
    )


@pytest.fixture
def results(tmp_path: Path) -> Results:
    models = {
        "stribeck": model("stribeck", COULOMB, scale=0.9),
        "lugre": model("lugre", BRISTLES),
        "own": replace(model("lugre", BRISTLES, scale=1.2), law="lugre"),
    }
    test = records(2)
    write_torques(
        tmp_path / "traces" / "torques_1.npz",
        test,
        {
            name: [one[0] for one in of_law]
            for name, of_law in predict_models(models, [[r] for r in test]).items()
        }
        | {ORACLE: [r.tau for r in test]},
    )
    whole = scored(test, models)
    half = scored([r.rows(slice(900, None)) for r in test], models)
    log = SavedLog(
        name="unseen log",
        file="unseen.csv",
        sha256="ab",
        roles=("unseen", "identification"),
        rows=1800,
        duration=17.99,
        rate=100.0,
        trace="torques_1.npz",
    )
    other = replace(log, name="train", file="t.csv", roles=("training",), trace="", sample=True)
    run = SavedRun(
        study="made up",
        command="hesr run study.toml",
        robot="bench",
        model="arm.xml",
        joints=JOINTS,
        gear_ratio=(101.0, 50.5),
        twin=True,
        quick=False,
        seed=3,
        logs=(log, other, replace(other, name="spare", roles=())),
        bands=(TimeBand(test="unseen", name="late", start=9.0),),
        inputs={"stribeck": "v", "lugre": "v", "own": "v"},
        variants={"own": "lugre"},
        controller={"drift": 12.0, "Kx": 5.0},
        versions={"numpy": "2.0", "hesr": "0.1"},
    )
    body = RigidBody(
        robot="bench",
        joints=JOINTS,
        names=("l1.m", "l1.Ir", "l2.m"),
        base=(0, 1),
        parameters=np.array([1.2345, -0.5, 0.0]),
        standard_errors=np.array([0.0123, 0.25]),
        condition=12.345,
        ridge=0.0,
        friction=np.zeros((2, 3)),
        rmse=np.array([0.123, 4.567]),
        rows=1800,
        logs=("log1",),
        method="stacked",
        weighting="wls",
    )
    findings = [
        Finding(check="a", severity="warning", found="one", remedy="do it"),
        Finding(check="b", severity="advice", logs=("unseen log",), found="two"),
        Finding(check="c", severity="advice", found="three"),
    ]
    write_findings(tmp_path, findings)
    fmus = tmp_path / "fmus"
    fmus.mkdir()
    (fmus / "stribeck.fmu").write_bytes(b"no archive")
    t = np.linspace(0.0, 1.0, 11)
    path = Trace(t=t, q_d=np.column_stack([t, t]), q=np.column_stack([t + 0.01, t - 0.02]))
    keys = [(Scheme(compensation="torque_error"), name) for name in (StandIn.BODY_ONLY, "lugre")]
    return Results(
        folder=tmp_path,
        run=run,
        body=body,
        models=models,
        comparisons={"unseen": whole, "late": half},
        replicates={"unseen": replicates(models), "training logs": None},
        truths={"stiff": {"unseen": {"stribeck": (1.0, 2.0), "lugre": (0.5, 0.7)}}},
        loop=outcome(),
        paths=dict.fromkeys(keys, path),
        provenance={
            "files": [
                {"name": "robot.toml", "sha256": "cd"},
                {"name": "unseen.csv", "sha256": "ab"},
            ]
        },
    )


def test_units_are_those_of_a_joint_or_of_all(results: Results) -> None:
    """The second joint slides."""
    models = {name: replace(model, sliding=(False, True)) for name, model in results.models.items()}
    mixed = replace(results, models=models)
    assert [mixed.unit("N.m", j) for j in range(2)] == ["N.m", "N"]
    assert mixed.unit("N.m") == "N.m (N where it slides)"
    assert [results.unit("N.m", j) for j in (0, 1, None)] == ["N.m"] * 3


_NUMBER = re.compile(r"-?\d+\.\d{4,}(e-\d+)?")


def shown(value: object) -> str:
    if isinstance(value, float | np.floating):
        return f"{value:.3g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(shown, value))}]"
    return str(value)


def of_line(line: Line) -> str:
    y = np.asarray(line.y, dtype=float)
    numbers = (line.x[0], line.x[-1], y[0], y[-1], np.sum(y), np.sum(np.abs(y)))
    return f"{line.name} {line.stroke} {len(line.x)} {shown([float(n) for n in numbers])}"


def told(name: str, value: Any) -> Iterator[str]:
    """Yield lines on what a template gets."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from told(f"{name}.{key}", inner)
    elif isinstance(value, ResultTable):
        yield f"{name}: table {value.words} {value.numeric}"
        yield _NUMBER.sub(lambda found: f"{float(found[0]):.4g}", csv_text(value))
    elif isinstance(value, Chart):
        yield f"{name}: chart {value.x} {value.height} {value.window}"
        for panel in (panel for row in value.rows for panel in row):
            yield f"  {panel.title!r} {panel.y!r} {panel.marks}"
            yield from (f"    {of_line(line)}" for line in panel.lines)
    elif isinstance(value, Figure):
        yield f"{name}: figure {shown(list(value.get_size_inches()))}"
        for axes in value.axes:
            labels = [axes.get_title(loc="left"), axes.get_xlabel(), axes.get_ylabel()]
            sums = [float(np.nansum(line.get_ydata())) for line in axes.lines]
            ends = [float(np.nansum(line.get_xdata())) for line in axes.lines]
            yield f"  {labels} {shown(list(axes.get_xlim()))} {shown(ends)} {shown(sums)}"
    elif isinstance(value, list) and value and isinstance(value[0], dict | tuple | ResultTable):
        for k, inner in enumerate(value):
            yield from told(f"{name}[{k}]", inner)
    elif isinstance(value, tuple) and any(isinstance(one, ResultTable | list) for one in value):
        yield from (
            told(name, list(value))
            if isinstance(value[0], ResultTable)
            else (line for k, inner in enumerate(value) for line in told(f"{name}.{k}", inner))
        )
    elif isinstance(value, str) and len(value.split()) > 6:
        yield f"{name}: a sentence"
    elif isinstance(value, SavedRun | RigidBody | SavedLog):
        yield f"{name}: {type(value).__name__}"
    else:
        yield f"{name}: {shown(value)}"


Recorded = Callable[..., None]


@pytest.fixture
def recorded(file_regression: FileRegressionFixture) -> Recorded:
    def check(**sections: object) -> None:
        lines = [line for name, values in sections.items() for line in told(name, values)]
        file_regression.check("\n".join(lines) + "\n", encoding="utf-8")

    return check


def test_the_first_layer(results: Results) -> None:
    assert results.recommended == (results.best,) * 2 == ("stribeck", "stribeck")
    assert results.tests == ["unseen"]
    assert results.laws == ["stribeck", "lugre"]
    first = summary.summary(results)
    assert (first["law"], first["fmu"], first["laws"]) == ("Stribeck", "fmus/stribeck.fmu", 3)
    assert (first["findings"], first["winners"]) == (3, [("LuGre", "stiff")])
    assert [sentence.rpartition(": ")[2] for sentence in first["first"]] == ["one", "two"]
    assert [row.cells[0].value for row in first["errors"].rows] == [
        pytest.approx(error) for error in results.comparisons["unseen"].laws["stribeck"].rmse
    ]


def test_predictions(results: Results, recorded: Recorded) -> None:
    errors = prediction.errors_of_tests(results)
    # Their wording is tested with the replicates.
    assert len(errors["tests"][0]["replicates"].pop("sentences")) == 2
    assert len(errors["training"].pop("sentences")) == 1
    recorded(
        errors=errors,
        chirp=prediction.chirp(results),
        loops=prediction.loops(results),
    )


def test_laws_and_physics(results: Results, recorded: Recorded) -> None:
    audit = laws.audit(results)
    assert audit
    table = audit.pop("proofs")
    assert not table.numeric
    assert all(row.cells[1].text.startswith("passive, proven") for row in table.rows)
    proofs = [(row.head, row.cells[0].text) for row in table.rows]
    assert proofs == [
        (law, joint) for law in ("Stribeck", "LuGre", "own") for joint in ("J1", "J2")
    ]
    recorded(
        coefficients=laws.equations(results)["coefficients"]["lugre"],
        energy=audit["energy"],
        variants=laws.ablation(results)["tables"],
    )


def test_the_hysteresis_of_the_papers_law(results: Results, table1: FrictionModel) -> None:
    """The slopes of the paper's Table I, over the trained speeds."""
    run = replace(results.run, joints=table1.joints)
    one, *_ = results.models["lugre"].trained
    seen = tuple(replace(one, dq=(-speed, speed)) for speed in (0.3, 0.6, 0.9))
    model = replace(table1, trained=seen)
    found = laws.hysteresis(replace(results, run=run, models={"parfam_h": model}))
    assert found is not None
    assert found["values"] == "J1 (11.37, 256.8); J2 (19.62, 143.9); J3 (8.45, 278.2)"
    slope, *loops = found["picture"].axes
    assert 0.0 < slope.get_xlim()[1] < 20.0  # mrad/s
    for axes in loops:
        assert axes.get_xlim()[1] == pytest.approx(0.3, rel=0.1)
        assert all(np.nanmax(np.abs(line.get_ydata())) <= 1.0 for line in axes.lines)


def test_a_report_runs_the_fmus_that_are_there(results: Results, table1_fmu: Path) -> None:
    assert laws.live(results) is None
    law_name = Path(results.fmu).stem
    folder = results.folder / "fmus"
    folder.mkdir(exist_ok=True)
    shutil.copyfile(table1_fmu, folder / f"{law_name}.fmu")
    shown_live = laws.live(results)
    assert shown_live is not None
    [(name, _, section)] = shown_live["lives"]
    assert name == law_name
    assert f"live-{law_name}" in section


def test_joints_whose_law_has_no_memory_have_no_loop(
    results: Results, table1: FrictionModel
) -> None:
    run = replace(results.run, joints=table1.joints)
    forms = [one.form for one in table1.laws]
    outputs = [
        form.output.subs({s: 0 for s in form.output.free_symbols if s.name in ("h", "dh")})
        for form in forms
    ]
    pairs = zip(table1.laws, forms, outputs, strict=True)
    bare = [replace(one, form=replace(f, memory=(), output=o), start=()) for one, f, o in pairs]
    for count in (1, 3):
        model = replace(table1, laws=(*bare[:count], *table1.laws[count:]))
        found = laws.hysteresis(replace(results, run=run, models={"parfam_h": model}))
        assert (found is None) == (count == 3)
        assert found is None or found["values"].startswith("J2 ")


def test_data_and_rigid_body(results: Results, recorded: Recorded) -> None:
    body = inputs.body(results)
    recorded(logs=inputs.data(results)["logs"], parameters=body["parameters"])
    measured = body["torques"].rows[1][0].lines[0]
    np.testing.assert_allclose(
        measured.y, read_torques(results.folder / "traces" / "torques_1.npz")["tau2"]
    )
    hashes = inputs.provenance(results)["hashes"]
    assert [(row.head, Markup(row.cells[0].text).striptags()) for row in hashes.rows] == [
        ("unseen.csv", "ab"), ("t.csv", "ab"), ("robot.toml", "cd"),
    ]  # fmt: skip


def test_the_closed_loop(results: Results, recorded: Recorded) -> None:
    tracking = prediction.tracking(results)
    assert tracking
    recorded(own=tracking["own"], more=tracking["more"], robustness=prediction.robustness(results))
    (body_only, *_), (errors, *_) = (
        panel.lines for panel in tracking["figures"]["torque_error"].rows[0]
    )
    np.testing.assert_allclose(body_only.y - body_only.x, 0.01)
    np.testing.assert_allclose(errors.y, 10.0)
    assert prediction.tracking(replace(results, loop=None)) is None


def test_tables_of_the_paper(recorded: Recorded) -> None:
    recorded(second=table_ii(("J1", "J2", "J3")), third=table_iii(("J1", "J2", "J3")))


def test_torques_of_one_joint_begin_at_zero(tmp_path: Path) -> None:
    record = replace(records(2)[0], t=records(2)[0].t + 5.0)
    write_torques(tmp_path / "torques_1.npz", [record], {"lugre": [record.tau]})
    found = read_torques(tmp_path / "torques_1.npz")
    assert (found["t"][0], found["t"][-1]) == pytest.approx((0.0, 17.99))
    assert list(found) == ["t", "q1", "dq1", "tau1", "tau_rb1", "lugre.tau_f1"]


def test_torques_of_older_results_are_parquet(tmp_path: Path) -> None:
    files = [tmp_path / f"torques_1.{suffix}" for suffix in ("npz", "parquet")]
    for file in files:
        write_torques(file, records(2), {"lugre": [r.tau for r in records(2)]})
    new, old = map(read_torques, files)
    assert list(new) == list(old)
    assert {"t", "q1", "tau2", "tau_rb2", "lugre.tau_f1"} <= set(new)
    for name, values in new.items():
        np.testing.assert_array_equal(values, old[name], strict=True)
