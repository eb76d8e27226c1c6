"""A log dropped into an FMU's page: errors of `hesr test --on` at zero phase, and its messages."""

import csv
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from browser_pages import OpenPage
from containing import Containing

import hesr
from cosim.study.scores import Comparison
from fmu_src import export_fmu
from fmu_src.friction.predictions import predict_fmu
from fmu_src.friction.replay import replay
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import FrictionRecord, friction_records
from hesr_model.robots.robot import Robot, RobotDescription

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

SAME = 1e-12
NOISE = 0.4

DROP = """(element, [name, text]) => {
  const data = new DataTransfer();
  data.items.add(new File([text], name, { type: "text/csv" }));
  for (const kind of ["dragover", "drop"]) {
    element.dispatchEvent(new DragEvent(kind, { dataTransfer: data, bubbles: true }));
  }
}"""


@pytest.fixture(scope="module")
def model(table1: FrictionModel) -> FrictionModel:
    seen = TrainedRange(
        sample_time=0.005, dq=(-2.0, 2.0), q=(-1.0, 1.0), tau_load=(0.0, 0.0), tau=(-9.0, 9.0)
    )
    return replace(
        table1, joints=("j1", "j2", "j3"), trained=(seen,) * 3, training_rmse=(NOISE,) * 3
    )


@pytest.fixture(scope="module")
def fmu(model: FrictionModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_fmu(model, tmp_path_factory.mktemp("fmu") / "law.fmu")


@pytest.fixture
def page(open_page: OpenPage, fmu: Path) -> "Page":
    return opened(open_page, fmu)


def opened(open_page: OpenPage, fmu: Path) -> "Page":
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(fmu.parent)
    page = open_page(fmu.parent / "documentation/index.html")
    page.locator(".log-start").wait_for()
    return page


def drop(page: "Page", text: str, name: str = "day.csv") -> None:
    page.evaluate(
        "for (const e of document.querySelectorAll('.log-app, .log-wrong')) e.hidden = true"
    )
    page.locator("section.log").evaluate(DROP, [name, text])
    shown = ".log-app:not([hidden]), .log-wrong:not([hidden])"
    page.locator(shown).first.wait_for()


def wrong(page: "Page") -> str:
    return (
        page.locator(".log-wrong").inner_text() if page.locator(".log-wrong").is_visible() else ""
    )


def cells(page: "Page", joint: int) -> "Locator":
    return page.locator(".log-rows tr").nth(joint).locator("td")


def saved(page: "Page") -> dict[str, np.ndarray]:
    with page.expect_download() as download:
        page.get_by_role("button", name="Save the result as CSV").click()
    with Path(download.value.path()).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def columns(records: Sequence[FrictionRecord], log: Log) -> dict[str, np.ndarray]:
    found = {"t": log.t}
    for k, record in enumerate(records):
        found[f"q{k + 1}"] = log.q[:, k]
        if log.dq is not None:
            found[f"dq{k + 1}"] = log.dq[:, k]
        found[f"tau_load{k + 1}"] = record.tau_load
        found[f"tau{k + 1}"] = log.tau[:, k]
    return found


def table(named: dict[str, np.ndarray], delimiter: str = ",", point: str = ".") -> str:
    rows = np.column_stack(list(named.values())).tolist()
    lines = [delimiter.join(named)]
    lines += [delimiter.join(repr(x).replace(".", point) for x in row) for row in rows]
    return "\n".join(lines) + "\n"


@pytest.fixture
def measured(arm_log: Log, arm: RobotDescription) -> Log:
    """With noise and uneven time stamps."""
    rng = np.random.default_rng(3)
    t = arm_log.t + 2e-4 * rng.uniform(-1.0, 1.0, len(arm_log.t))
    assert arm_log.dq is not None
    dq = arm_log.dq + 1e-3 * rng.normal(size=arm_log.dq.shape)
    tau = arm_log.tau + 0.1 * rng.normal(size=arm_log.tau.shape)
    return Log(name="day", t=t, q=arm_log.q, dq=dq, tau=tau, robot=arm)


def scores_of(fmu: Path, log: Log, body: RigidBody, arm: RobotDescription) -> Comparison:
    """Scores of an FMU on a log."""
    report = hesr.test(fmu, on=[log], kind=["prediction"], robot=arm, rigid_body=body)
    assert report.scores is not None
    return report.scores


@pytest.mark.parametrize("logged", [True, False], ids=["velocity logged", "velocity derived"])
def test_numbers_match_the_replay(
    page: "Page", fmu: Path, measured: Log, arm: RobotDescription, logged: bool
) -> None:
    body = hesr.identify(measured, robot=arm)
    log = measured if logged else replace(measured, dq=None)
    records = friction_records(log, Robot(arm), body)
    scores = scores_of(fmu, log, body, arm)
    drop(page, table(columns(records, log)))
    assert wrong(page) == ""
    found = saved(page)
    dq, load = (np.column_stack([found[f"{u}{k}"] for k in (1, 2, 3)]) for u in ("dq", "tau_load"))
    own = replay(fmu, found["t"], dq, log.q, load)
    for k, ((wanted,), record) in enumerate(
        zip(predict_fmu(fmu, [[r] for r in records]), records, strict=True)
    ):
        law, size = found[f"tau_law{k + 1}"], np.max(np.abs(wanted))
        assert np.max(np.abs(dq[:, k] - record.dq)) < SAME * np.max(np.abs(record.dq))
        assert np.max(np.abs(law - own[:, k])) < SAME * size
        # The last digits of position differences are round-off, which laws steep at rest amplify.
        assert np.max(np.abs(law - wanted)) < (SAME if logged else 1e-10) * size
        assert np.array_equal(found[f"tau_friction{k + 1}"], record.tau)
        shown = float(cells(page, k).first.get_attribute("data-value") or "nan")
        assert shown == pytest.approx(scores.zero_phase["law"][k], rel=SAME)
        assert float(cells(page, k).nth(1).inner_text().split()[0]) == pytest.approx(
            100.0 * scores.zero_phase["law"][k] / scores.tau_std[k], rel=6e-3
        )


@pytest.mark.parametrize("logged", [True, False], ids=["velocity logged", "velocity derived"])
def test_the_page_computes_friction_with_its_rigid_body(
    open_page: OpenPage,
    model: FrictionModel,
    measured: Log,
    arm: RobotDescription,
    tmp_path: Path,
    logged: bool,
) -> None:
    body = hesr.identify(measured, robot=arm)
    fmu = hesr.export(model, tmp_path / "law.fmu", robot=arm, rigid_body=body)
    page = opened(open_page, fmu)
    log = measured if logged else replace(measured, dq=None)
    records = friction_records(log, Robot(arm), body)
    scores = scores_of(fmu, log, body, arm)
    named = columns(records, log)
    drop(page, table({name: c for name, c in named.items() if not name.startswith("tau_load")}))
    assert wrong(page) == ""
    assert "Rigid-body torque of the body" in page.locator(".log-notes").inner_text()
    found = saved(page)
    for k, record in enumerate(records):
        size = np.max(np.abs(record.tau_load))
        within = SAME if logged else 1e-10  # as above, doubled
        assert np.max(np.abs(found[f"tau_load{k + 1}"] - record.tau_load)) < within * size
        assert np.max(np.abs(found[f"tau_friction{k + 1}"] - record.tau)) < within * size
        shown = float(cells(page, k).first.get_attribute("data-value") or "nan")
        assert shown == pytest.approx(scores.zero_phase["law"][k], rel=within)
    # A column of the log has priority over the body.
    drop(page, table({**named, "tau_load1": named["tau_load1"] + 5.0}))
    assert saved(page)["tau_load1"] == pytest.approx(records[0].tau_load + 5.0, abs=1e-12)
    # Without positions it cannot be computed.
    drop(page, table({name: c for name, c in named.items() if name[0] != "q" and "_" not in name}))
    if logged:
        assert "requires positions" in page.locator(".log-answer").inner_text()
    else:
        assert "no position or velocity columns were recognised" in wrong(page)


def test_a_foreign_log_is_read(page: "Page", fmu: Path, measured: Log) -> None:
    """Semicolons, decimal commas, units, rows without numbers, a gap."""
    gap = np.r_[0:900, 960 : len(measured.t)]
    assert measured.dq is not None
    named = {"Time [ms]": 1e3 * measured.t[gap]}
    for k in range(3):
        named[f"Actual Position J{k + 1}"] = np.rad2deg(measured.q[gap, k])
    for k in range(3):
        named[f"Axis speed {k + 1}"] = measured.dq[gap, k]
    lines = table(named, ";", ",").splitlines()
    lines[200] = lines[200].rsplit(";", 1)[0] + ";"
    lines.insert(300, lines[300])
    drop(page, "\n".join(["# of a controller", "", *lines]))
    assert wrong(page) == ""
    notes = page.locator(".log-notes").inner_text()
    for part in ("1939 rows", "2 rows with missing numbers", "2 parts between gaps", "q is in deg"):
        assert part in notes
    assert page.locator("select[data-unit=t]").input_value() == "ms"
    found = saved(page)
    assert found["q1"] == pytest.approx(np.delete(measured.q[gap, 0], 199), abs=1e-12)
    whole = predict_of(fmu, measured, gap)
    assert found["tau_law2"] == pytest.approx(whole, abs=1e-9 * np.max(np.abs(whole)))
    answer = page.locator(".log-answer").inner_text()
    assert answer == "Unknown: no measured torque is chosen."
    assert page.locator(".log-rows tr").count() == 0
    assert page.get_by_role("radio", name="residual").is_disabled()


def predict_of(fmu: Path, log: Log, rows: np.ndarray) -> np.ndarray:
    """Torque of the second joint caused by the tool, term by term."""
    kept = log.rows(np.delete(rows, 199))
    parts = [smooth(part) for part in kept.parts()]
    assert len(parts) == 2
    return np.concatenate([replay(fmu, part.t, part.dq, part.q_raw)[:, 1] for part in parts])


def test_uncertain_columns_are_mapped_manually(page: "Page", measured: Log) -> None:
    named = {"stamp": measured.t}
    for k in range(3):
        named[f"a{k + 1}"] = measured.q[:, k]
        named[f"b{k + 1}"] = measured.tau[:, k]
    drop(page, table(named))
    assert wrong(page) == (
        "day.csv: no position or velocity columns were recognised for 3 joints; choose them below."
    )
    assert page.locator(".log-columns").get_attribute("open") is not None
    fields = page.locator("select[data-column=q]")
    fields.first.select_option("a1")  # the others follow
    assert fields.nth(2).input_value() == "a3"
    assert wrong(page) == ""
    page.locator("select[data-column=tau]").first.select_option("b1")
    assert "Unknown: a total torque requires" in page.locator(".log-answer").inner_text()
    assert page.locator(".log-rows tr").count() == 0
    page.locator(".log-kind").select_option("friction")
    assert page.locator(".log-rows tr").count() == 3
    fields.nth(1).select_option("")
    assert wrong(page) == (
        "day.csv: the column 'q' of j2 is missing; choose it below, or none for all joints."
    )
    assert not page.locator(".log-app").is_visible()


@pytest.fixture
def friction(model: FrictionModel) -> dict[str, np.ndarray]:
    """A motion with the law's own friction and noise like that of the fit."""
    rng, t = np.random.default_rng(5), 0.01 * np.arange(3000)
    dq = np.column_stack([np.cos(0.6 * t + k) for k in range(3)])
    q = np.column_stack([np.sin(0.6 * t + k) / 0.6 for k in range(3)])
    tau = model.predict(t=t, dq=dq, q=q) + NOISE * rng.normal(size=dq.shape)
    return {"t": t} | {
        f"{name}{k + 1}": values[:, k]
        for name, values in (("q", q), ("dq", dq), ("tau_friction", tau))
        for k in range(3)
    }


def test_drifted_friction_is_detected(page: "Page", friction: dict[str, np.ndarray]) -> None:
    tau = friction["tau_friction2"]
    for changed, answer, cell in (
        (tau, "No.", "No: the level is within 10 %"),
        (1.3 * tau, "Yes, on j2.", "Friction is 30 % higher than the law."),
        (0.7 * tau, "Yes, on j2.", "Friction is 30 % lower than the law."),
        (tau + 1.0, "No. The torque is shifted on j2.", "The torque is off by 1 N.m"),
        (
            tau + 2.0 * np.sin(np.arange(3000)),
            "No. The error has grown on j2.",
            "The level is as fitted, but the error is 3.7 times",
        ),
    ):
        drop(page, table({**friction, "tau_friction2": changed}))
        assert page.locator(".log-answer").inner_text() == answer
        assert cells(page, 1).last.inner_text().startswith(cell)
        assert cells(page, 0).last.inner_text().startswith("No: the level is within 10 %")


def test_speeds_beyond_training_and_joints_at_rest_are_noted(
    page: "Page", friction: dict[str, np.ndarray]
) -> None:
    rest = np.zeros(3000)
    drop(page, table({**friction, "dq1": 3.0 * friction["dq1"], "q3": rest, "dq3": rest}))
    assert "j1 is faster than the training data." in page.locator(".log-notes").inner_text()
    assert cells(page, 2).last.inner_text() == "The joint rests in this log."


ROWS = "\n".join(f"{0.01 * k},{k % 7},2,3,1,2,3" for k in range(200))
HEAD = "t,q1,q2,q3,dq1,dq2,dq3\n"


WRONG = [
    ("", "log needs a header and rows"),
    ("a\0b", "the file is not text; choose a CSV."),
    ("hello\nworld\n", "it has no table; a line of names above lines of numbers is needed"),
    (f"t,q1,q1\n{ROWS}", "it has no table; a line of names"),
    (f"t,q1,q1,q3,dq1,dq2,dq3\n{ROWS}", "column 'q1' appears twice; names must differ."),
    (f"{HEAD}{ROWS}\n2.0,1,2", "row 202 has 3 cells"),
    (f"{HEAD}{ROWS}\n2.0,oops,2,3,1,2,3", "row 202: 'oops' where a number"),
    (f"{HEAD}{ROWS}\n1.0,1,2,3,1,2,3", "column 't', row 202: time must increase, but 1 s follows"),
    (f"x,q1,q2,q3,dq1,dq2,dq3\n{ROWS}", "no time column was recognised; choose it below."),
    (f"{HEAD}0.0,1,2,3,1,2,3\n0.01,1,2,3,1,2,", "no time column was recognised; choose it below."),
    ("\n".join((HEAD + ROWS).splitlines()[:20]), "a cut-off of 15 Hz needs more than 21 rows"),
]


def test_unreadable_logs_are_one_sentence(page: "Page") -> None:
    for text, said in WRONG:
        drop(page, text)
        assert wrong(page) == Containing("day.csv: ", said)
        assert wrong(page).count("\n") == 0
        assert not page.locator(".log-app").is_visible()


def test_a_file_can_be_chosen_and_binary_files_are_refused(
    page: "Page", friction: dict[str, np.ndarray], tmp_path: Path
) -> None:
    (tmp_path / "bag.mcap").write_bytes(b"\x89MCAP0\xff\xfe")
    page.locator(".log-file").set_input_files(tmp_path / "bag.mcap")
    page.locator(".log-wrong").wait_for()
    assert wrong(page).startswith("bag.mcap: the file is not text; choose a CSV.")
    (tmp_path / "day.csv").write_text(table(friction))
    page.locator(".log-file").set_input_files(tmp_path / "day.csv")
    page.locator(".log-app").wait_for()
    assert wrong(page) == ""
    for view in ("position", "time", "residual", "velocity"):
        page.get_by_role("radio", name=view).last.check(force=True)
        assert len(page.locator("path.plot-law").get_attribute("d") or "") > 100
        measured = page.locator("path.plot-measured").get_attribute("d") or ""
        assert (measured == "") == (view == "residual")


def test_refusals_of_the_fmu_are_shown(page: "Page", friction: dict[str, np.ndarray]) -> None:
    drop(page, table({**friction, "t": 10.0 * friction["t"]}))
    assert "h[1]: Euler needs rate * step" in wrong(page)
