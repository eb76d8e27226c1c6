"""User actions on a live section, and their results."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

SAME = 1e-12
"""Tolerance relative to the largest torque; the requirement is 1e-9."""

Columns = dict[str, np.ndarray]


def alive(page: "Page") -> "Page":
    for curve in page.locator("path.plot-now").all():
        curve.and_(page.locator("[d^=M]")).wait_for(state="attached")
    return page


def slider(page: "Page", name: str) -> "Locator":
    return page.locator(f".live-knob input[type=range][aria-label^='{name},']")


def field(page: "Page", name: str) -> "Locator":
    return page.locator(f".live-knob input[type=number][aria-label^='{name},']")


def settle(page: "Page") -> None:
    """Wait until the change is drawn."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def saved(page: "Page") -> Columns:
    settle(page)
    with page.expect_download() as download:
        page.get_by_role("button", name="Save as CSV").click()
    with Path(download.value.path()).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}


def expected(law: FrictionLaw, columns: Columns, **changed: float) -> np.ndarray:
    law = replace(law, values={**law.values, **changed})
    return predict(law, **{name: columns[name] for name in ("t", "dq", "q", "tau_load")})


def error(found: np.ndarray, wanted: np.ndarray) -> float:
    """Largest difference relative to the largest torque, of the worst joint."""
    return float(np.max(np.max(np.abs(found - wanted), axis=0) / np.max(np.abs(wanted), axis=0)))
