"""WebAssembly compared with Python and a binary: every law on the FMU's reference motion."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from live_page import SAME, alive, error, expected, field, saved, slider
from registry_models import STUDIED, live_of

from fmu_src import export_fmu
from fmu_src.friction.reference import ReferenceMotion, reference_motion, torques
from fmu_src.pages.live import live_assets, live_section
from fmu_src.run.fmu import FmuInstance
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.scales import scaled

if TYPE_CHECKING:
    from playwright.sync_api import Page

# A separate importer that shares only the module with the page.
RUN = """async ([motion, joints, step]) => {
  const bytes = Uint8Array.from(atob(globalThis.packed), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const module = await WebAssembly.compile(await new Response(stream).arrayBuffer());
  if (WebAssembly.Module.imports(module).length) throw new Error("it imports something");
  const fmu = (await WebAssembly.instantiate(module)).exports;
  const check = (status) => { if (status) throw new Error(`status ${status}`); };
  check(fmu.live_reset());
  const put = (row) => row.forEach((u, i) => check(fmu.live_set(i, u)));
  const read = () => Array.from({ length: joints }, (_, i) => fmu.live_get(3 * joints + i));
  put(motion[0]);
  check(fmu.live_initialise());
  const found = [read()];
  for (let k = 1; k < motion.length; k++) {
    put(motion[k]);
    check(fmu.live_step((k - 1) * step, step));
    found.push(read());
  }
  return found;
}"""


@pytest.fixture(scope="module")
def models(
    table1: FrictionModel, registry_models: dict[str, FrictionModel]
) -> dict[str, FrictionModel]:
    return {"table1": table1} | registry_models


def in_browser(
    page: "Page", data: dict[str, Any], motion: ReferenceMotion, step: float
) -> np.ndarray:
    """Torques (N, n) of the module in a page, stepped as in the replay of a log."""
    page.evaluate("(text) => { globalThis.packed = text; }", data["module"])
    rows = np.column_stack([motion.dq, motion.q, motion.tau_load])
    return np.array(page.evaluate(RUN, [rows.tolist(), motion.dq.shape[1], step]))


def in_binary(path: Path, motion: ReferenceMotion, step: float) -> np.ndarray:
    """The same from the FMU's binary for this machine."""
    joints = range(1, motion.dq.shape[1] + 1)
    with FmuInstance(path) as component:
        inputs = component.buffer([f"{u}[{i}]" for u in ("dq", "q", "tau_load") for i in joints])
        tau = component.buffer([f"tau[{i}]" for i in joints])
        rows = np.column_stack([motion.dq, motion.q, motion.tau_load])
        component.initialise(
            start=dict(
                zip(
                    (f"{u}[{i}]" for u in ("dq", "q", "tau_load") for i in joints),
                    rows[0],
                    strict=True,
                )
            )
        )
        found = []
        for k, row in enumerate(rows):
            if k:
                inputs.values[:] = row
                inputs.write()
                component.step((k - 1) * step, step)
            tau.read()
            found.append(tau.values.copy())
    return np.array(found)


@pytest.fixture(scope="module")
def live(models: dict[str, FrictionModel]) -> Callable[[str], dict[str, Any]]:
    """Data of a model's live section, computed once."""
    return lru_cache(maxsize=None)(lambda name: live_of(models[name]))


@pytest.fixture
def page_of(
    live: Callable[[str], dict[str, Any]], open_page: Callable[..., "Page"], tmp_path: Path
) -> Callable[[str], "Page"]:
    def page(name: str) -> "Page":
        path = tmp_path / "page.html"
        path.write_text(
            '<!DOCTYPE html><meta charset="utf-8">' + live_section(live(name)) + live_assets(),
            encoding="utf-8",
        )
        return alive(open_page(path))

    return page


EVERY = ("table1", *STUDIED)


@pytest.mark.parametrize("name", EVERY)
def test_the_module_matches_python_and_follows_its_first_slider(
    name: str,
    models: dict[str, FrictionModel],
    live: Callable[[str], dict[str, Any]],
    page_of: Callable[[str], "Page"],
    tmp_path: Path,
) -> None:
    model, page = models[name], page_of(name)
    motion = reference_motion(model)
    found = in_browser(page, live(name), motion, model.sample_time)
    assert error(found, torques(model, motion, "direct")) < SAME
    if name == "table1":
        fmu = export_fmu(model, tmp_path / "F.fmu")
        assert error(found, in_binary(fmu, motion, model.sample_time)) < SAME
    law = model.laws[0]
    first = live(name)["joints"][0]["coefficients"][0]["name"]
    slider(page, first).fill("0.8")
    value = float(field(page, first).input_value())
    columns = saved(page)
    if first == "coulomb_scale[1]":
        factors = {"coulomb_scale": value, "viscous_scale": 1.0}
        whole = replace(law, form=scaled(law.form), values={**law.values, **factors})
        wanted = expected(whole, columns)
    else:
        wanted = expected(law, columns, **{first: value})
    assert error(columns["tau"], wanted) < SAME
    assert error(columns["tau"], columns["tau_fitted"]) > 1e-3
