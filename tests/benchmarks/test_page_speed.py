"""Time that the page of a friction FMU takes for a log of 60 s, six joints and 100 Hz."""

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from fmu_src import export_fmu, model_file
from hesr_model.friction.model import FrictionModel

ROWS, JOINTS = 6000, 6


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_a_dropped_log(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """Time from choosing the file to the drawn loops."""
    playwright = pytest.importorskip("playwright.sync_api")
    model = FrictionModel.read(model_file("uf850-table1"))
    model = replace(
        model, joints=tuple(f"J{k}" for k in range(JOINTS)), laws=(model.laws * 2)[:JOINTS]
    )
    with zipfile.ZipFile(export_fmu(model, tmp_path / "six.fmu")) as archive:
        archive.extract("documentation/index.html", tmp_path)
    rng, t = np.random.default_rng(1), 0.01 * np.arange(ROWS)
    signals = [np.sin(np.outer(t, 0.2 + 0.1 * np.arange(JOINTS))) for _ in range(4)]
    names = [f"{name}{k}" for name in ("q", "dq", "tau_load", "tau") for k in range(JOINTS)]
    rows = np.column_stack([t, *(s + 1e-3 * rng.normal(size=s.shape) for s in signals)])
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, delimiter=",", header=",".join(["t", *names]), comments="", fmt="%.17g")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page()
        page.goto((tmp_path / "documentation/index.html").as_uri())
        page.locator(".log-start").wait_for()

        def dropped() -> None:
            page.evaluate("document.querySelector('.log-app').hidden = true")
            page.locator(".log-file").set_input_files([])
            page.locator(".log-file").set_input_files(path)
            page.locator("path.log-law[d^=M]").wait_for()

        benchmark.pedantic(dropped, rounds=5)
        browser.close()
