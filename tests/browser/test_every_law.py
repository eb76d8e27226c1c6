"""The live section of each law: a slider changes its torque as the law says."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from live_page import SAME, alive, error, expected, field, saved, slider
from registry_models import STUDIED, live_of, sampled

from fmu_src.pages.live import live_assets, live_section
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.scales import add_scales

if TYPE_CHECKING:
    from playwright.sync_api import Page


WITH_TORQUE = [name for name in STUDIED if name != "none"]
"""Laws whose torque a slider changes."""


@pytest.mark.parametrize("name", sampled(WITH_TORQUE))
def test_the_torque_follows_the_first_slider(
    name: str,
    registry_models: dict[str, FrictionModel],
    open_page: Callable[..., "Page"],
    tmp_path: Path,
) -> None:
    [law] = registry_models[name].laws
    live = live_of(registry_models[name])
    path = tmp_path / "page.html"
    text = '<!DOCTYPE html><meta charset="utf-8">' + live_section(live) + live_assets()
    path.write_text(text, encoding="utf-8")
    page = alive(open_page(path))
    first = live["joints"][0]["coefficients"][0]["name"]
    slider(page, first).fill("0.8")
    value = float(field(page, first).input_value())
    columns = saved(page)
    if first == "coulomb_scale[1]":
        factors = {"coulomb_scale": value, "viscous_scale": 1.0}
        whole = replace(law, form=add_scales(law.form), values={**law.values, **factors})
        wanted = expected(whole, columns)
    else:
        wanted = expected(law, columns, **{first: value})
    assert error(columns["tau"], wanted) < SAME
    assert error(columns["tau"], columns["tau_fitted"]) > 1e-3
