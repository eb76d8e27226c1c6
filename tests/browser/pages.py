"""Pages of every kind, with a robot of seven joints if a page has joints."""

import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from adaptive_models import lugre
from small_fmus import LAGS, lag

from cosim.report.inspection import write_inspection
from cosim.report.markup import Section, table, write_sections
from cosim.report.result_page import write_answer
from cosim.report.tables.scores import errors
from cosim.study.scores import compare
from fmu_src import export_fmu
from hesr.extras.adaptive.monitor import watch
from hesr.extras.adaptive.page import Monitoring
from hesr.extras.sweep.job import run_sweep
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.health.proposal import inspect_logs
from hesr_model.rigid_body.friction_record import FrictionRecord

JOINTS = tuple(f"shoulder_number_{k}_joint" for k in range(1, 8))
SWEEP = """
name = "lags"
system = "lags.toml"
design = "sobol"
runs = 8
inputs = [{ variables = ["a.u"], low = 1.0, high = 3.0 },
          { variables = ["b.T"], values = [1.0, 2.0], factor = true }]
outputs = [{ name = "end", signal = "b.y", measure = "final" }]
"""


def _motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = 0.01 * np.arange(800)
    phases = np.arange(7.0)
    return t, 0.8 * np.sin(1.3 * t[:, None] + phases), 0.8 * 1.3 * np.cos(1.3 * t[:, None] + phases)


def _model() -> FrictionModel:
    seen = TrainedRange(
        sample_time=0.01,
        dq=(-1.2345, 1.2345),
        q=(-3.0, 3.0),
        tau_load=(-30.0, 30.0),
        tau=(-4e1, 4e1),
    )
    errors = dict.fromkeys(lugre().values, 0.01)
    return FrictionModel(
        law="lugre_load",
        robot="seven",
        joints=JOINTS,
        sample_time=0.01,
        trained=(seen,) * 7,
        laws=(replace(lugre(), standard_errors=errors),) * 7,
        training_rmse=(1.2345,) * 7,
    )


def _records(model: FrictionModel) -> list[FrictionRecord]:
    t, q, dq = _motion()
    noise = np.random.default_rng(1).normal(size=q.shape)
    return [
        FrictionRecord(
            log="day",
            joint=joint,
            t=t,
            dq=dq[:, k],
            q=q[:, k],
            tau_load=np.zeros_like(t),
            tau=1.4 * predict(law, t=t, dq=dq[:, k], q=q[:, k]) + noise[:, k],
        )
        for k, (joint, law) in enumerate(zip(model.joints, model.laws, strict=True))
    ]


def log_csv() -> str:
    t, q, dq = _motion()
    names = [f"{name}{k}" for name in ("q", "dq", "tau") for k in range(1, 8)]
    tau = np.column_stack([record.tau for record in _records(_model())])
    rows = np.column_stack([t, q, dq, tau]).tolist()
    return "\n".join([",".join(["t", *names]), *(",".join(map(repr, row)) for row in rows)]) + "\n"


def fmu_page(folder: Path) -> Path:
    with zipfile.ZipFile(export_fmu(_model(), folder / "seven.fmu")) as archive:
        archive.extractall(folder / "fmu")
    return folder / "fmu/documentation/index.html"


def inspection(folder: Path) -> Path:
    (folder / "log.csv").write_text(log_csv(), encoding="utf-8")
    write_inspection(folder / "inspect.html", inspect_logs([folder / "log.csv"]))
    return folder / "inspect.html"


def monitor(folder: Path) -> Path:
    model = _model()
    followed = watch(model, [_records(model)] * 2)
    write_answer(Monitoring(**vars(followed)), folder / "monitor.html")
    return folder / "monitor.html"


def sweep(folder: Path) -> Path:
    lag(folder)
    system = LAGS.replace("FMU", str(folder / "Lag.fmu")).replace(
        "step = 0.2", "start = { T = 0.3 }"
    )
    (folder / "lags.toml").write_text(system, encoding="utf-8")
    (folder / "study.toml").write_text(SWEEP, encoding="utf-8")
    run_sweep(folder / "study.toml", folder / "out", workers=1)
    return folder / "out/sweep.html"


def scores(folder: Path) -> Path:
    """The report's widest table: errors with the intervals of their ratios."""
    model = _model()
    records = [[record] for record in _records(model)]
    laws: Mapping[str, float] = {"lugre": 1.1, "stribeck": 1.2, "parfam_h": 0.95}
    predictions = {law: [[share * r.tau] for (r,) in records] for law, share in laws.items()}
    html = table(errors("test", compare(records, predictions)))
    write_sections(
        folder / "scores.html",
        title="Seven",
        heading="Seven",
        summary=html,
        sections=[Section(key="more", title="Again", html=html)],
    )
    return folder / "scores.html"


PAGES: Mapping[str, Callable[[Path], Path]] = {
    page.__name__: page for page in (fmu_page, inspection, monitor, sweep, scores)
}
