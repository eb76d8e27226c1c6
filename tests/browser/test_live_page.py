"""The live section of a friction FMU's documentation, with the actions of a user."""

import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import sympy
from live_page import SAME, alive, error, expected, field, saved, settle, slider
from registry_models import live_of

from fmu_src.pages.live import live_assets, live_section
from hesr_model.equations.functions import absolute, sgn
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange

if TYPE_CHECKING:
    from playwright.sync_api import Page

OpenPage = Callable[..., "Page"]


@pytest.fixture(scope="module")
def unzipped(table1_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fmu")
    with zipfile.ZipFile(table1_fmu) as archive:
        archive.extractall(folder)
    return folder / "documentation/index.html"


@pytest.fixture
def page(open_page: OpenPage, unzipped: Path) -> "Page":
    return alive(open_page(unzipped))


def drawn(page: "Page", name: str) -> np.ndarray:
    settle(page)
    text = page.locator(f".live .plot .plot-{name}").get_attribute("d") or ""
    return np.array([p.split() for p in text.strip("M").split("L")], dtype=float)


def scale(page: "Page", anchor: str, place: str) -> np.ndarray:
    """Slope and offset from values to pixels, from the labels of an axis."""
    labels = page.locator(f".live .plot text[text-anchor={anchor}]:not(.plot-axis)")
    found = labels.evaluate_all(f"all => all.map(e => [e.textContent, e.getAttribute('{place}')])")
    values, pixels = zip(*((float(v.replace("−", "-")), float(p)) for v, p in found), strict=True)
    return np.polyfit(values, pixels, 1)


def test_the_fitted_loop_is_that_of_the_law(page: "Page", table1: FrictionModel) -> None:
    for number, law in enumerate(table1.laws):
        page.get_by_role("combobox", name="Joint").select_option(str(number))
        columns = saved(page)
        assert error(columns["tau"], expected(law, columns)) < SAME
        assert np.array_equal(columns["tau"], columns["tau_fitted"])
        assert np.max(columns["dq"]) == pytest.approx(1.2)


def test_a_slider_moves_the_loop(page: "Page", table1: FrictionModel) -> None:
    before = drawn(page, "now")
    moved = slider(page, "theta1_h")
    moved.focus()
    for _ in range(20):
        moved.press("ArrowRight")
    value = float(field(page, "theta1_h").input_value())
    assert abs(value) > abs(1.05 * table1.laws[0].values["theta1_h"]) or abs(value) < 0.57
    columns = saved(page)
    assert error(columns["tau"], expected(table1.laws[0], columns, theta1_h=value)) < SAME
    assert error(columns["tau_fitted"], expected(table1.laws[0], columns)) < SAME
    assert error(columns["tau"], columns["tau_fitted"]) > 0.01
    assert not np.array_equal(drawn(page, "now"), before)
    assert f"Changed: theta1_h {value:g} instead of" in page.locator(
        ".live-changed"
    ).inner_text().replace("−", "-")


def test_the_drawn_curve_matches_the_computed_one(page: "Page") -> None:
    slider(page, "alpha").fill("0.9")
    columns = saved(page)
    cycle = slice(len(columns["t"]) - 801, None)
    across = np.polyval(scale(page, "middle", "x"), columns["dq"][cycle])
    up = np.polyval(scale(page, "end", "y") - [0.0, 4.0], columns["tau"][cycle])
    points = np.column_stack([across, up])
    curve = drawn(page, "now")
    # Each point of the curve is a row, to the written hundredth of a pixel ..
    distances = np.linalg.norm(curve[:, None] - points[None], axis=2)
    assert np.max(np.min(distances, axis=1)) < 0.02
    # .. and omitted rows are next to a drawn one.
    assert np.max(np.min(distances, axis=0)) < 0.35
    assert len(curve) > 300


def test_reset_restores_the_fitted_loop(page: "Page", table1: FrictionModel) -> None:
    before, columns = drawn(page, "now"), saved(page)
    for name, share in (("c_h", "0.9"), ("beta", "0.1"), ("frequency", "0.7")):
        slider(page, name).fill(share)
    assert not np.array_equal(drawn(page, "now"), before)
    page.get_by_role("button", name="beta back to 256.84").click()
    assert float(field(page, "beta").input_value()) == 256.84
    page.get_by_role("button", name="Reset all").click()
    assert np.array_equal(drawn(page, "now"), before)
    after = saved(page)
    assert all(np.array_equal(after[name], columns[name]) for name in columns)
    assert page.locator(".live-changed").inner_text() == "All as fitted."
    assert page.locator(".live-back:visible").count() == 0


def test_each_joint_keeps_its_values(page: "Page", table1: FrictionModel) -> None:
    field(page, "c_h").fill("20")
    page.get_by_role("combobox", name="Joint").select_option("2")
    assert float(field(page, "c_h").input_value()) == table1.laws[2].values["c_h"]
    field(page, "alpha").fill("3.25")
    columns = saved(page)
    assert error(columns["tau"], expected(table1.laws[2], columns, alpha=3.25)) < SAME
    page.get_by_role("combobox", name="Joint").select_option("0")
    columns = saved(page)
    assert error(columns["tau"], expected(table1.laws[0], columns, c_h=20.0)) < SAME


def test_motion_can_be_changed(page: "Page", table1: FrictionModel) -> None:
    field(page, "amplitude").fill("0.7")
    field(page, "frequency").fill("0.5")
    field(page, "cycles").fill("5")
    columns = saved(page)
    assert len(columns["t"]) == 5 * 400 + 1
    assert columns["dq"] == pytest.approx(0.7 * np.sin(np.pi * columns["t"]), abs=1e-12)
    slope = np.gradient(columns["q"], columns["t"])[1:-1]
    assert slope == pytest.approx(columns["dq"][1:-1], abs=1e-4)
    assert error(columns["tau"], expected(table1.laws[0], columns)) < SAME


def test_figures_are_those_of_the_last_cycle(page: "Page") -> None:
    slider(page, "c_h").fill("0.8")
    columns = saved(page)
    last = slice(-801, None)
    cells = page.locator(".live-figures td").all_inner_texts()
    for column, name in enumerate(("tau_fitted", "tau")):
        tau, power = columns[name][last], (columns[name] * columns["dq"])[last]
        assert float(cells[column]) == pytest.approx(np.max(np.abs(tau)), rel=1e-3)
        assert float(cells[2 + column]) == pytest.approx(np.trapezoid(power, dx=0.005), rel=1e-3)


@pytest.mark.parametrize(
    ("view", "column", "rows"),
    [("position", "q", 801), ("time", "t", 2401), ("velocity", "dq", 801)],
)
def test_views_can_be_switched(page: "Page", view: str, column: str, rows: int) -> None:
    page.get_by_role("radio", name=view).check(force=True)
    columns = saved(page)
    x = np.polyval(scale(page, "middle", "x"), columns[column][-rows:])
    curve = drawn(page, "fitted")
    assert (curve[:, 0].min(), curve[:, 0].max()) == pytest.approx((x.min(), x.max()), abs=0.35)
    assert view in page.locator(".plot-axis").first.text_content()
    assert f"over {view} of joint1" in page.locator(".live .plot title").text_content()


def refused(page: "Page") -> list[str]:
    settle(page)
    return page.get_by_role("alert").all_inner_texts()


def test_a_refused_step_is_shown_with_the_message_of_the_fmu(page: "Page") -> None:
    assert refused(page) == []
    field(page, "alpha").fill("300")
    assert "found 1.5 at dq[1] =" in refused(page)[0]
    assert page.locator(".live-figures td").all_inner_texts()[1::2] == ["–", "–"]
    assert np.isnan(saved(page)["tau"][2:]).all()
    field(page, "alpha").fill("11.37")
    assert refused(page) == []
    field(page, "alpha").fill("-1")  # a negative rate is treated as zero
    assert refused(page) == []
    assert np.isfinite(saved(page)["tau"]).all()


def test_non_finite_results_are_reported(page: "Page") -> None:
    for name in ("c_h", "c_0"):
        field(page, name).fill("1.7e308")
    assert re.search(r"tau\[1\] became inf at time [\d.e-]+\.$", refused(page)[0])
    page.get_by_role("button", name="Reset all").click()
    assert refused(page) == []
    assert len(drawn(page, "now")) > 300


def test_a_torque_beyond_every_axis_is_reported(page: "Page") -> None:
    field(page, "c_h").fill("1.7e308")
    assert refused(page) == ["The torque is too large to draw."]
    assert float(page.locator(".live-figures td").all_inner_texts()[1]) > 1e308


@pytest.mark.parametrize(
    ("name", "typed", "needed"),
    [
        ("c_h", "", "a number"),
        ("amplitude", "-1", "a number of at least 0 rad/s"),
        ("frequency", "0", "a number from 0.01 to 50 Hz"),
        ("frequency", "1e9", "a number from 0.01 to 50 Hz"),
        ("cycles", "2.5", "a whole number from 1 to 100"),
        ("cycles", "2.5e6", "a whole number from 1 to 100"),
    ],
)
def test_an_invalid_number_changes_nothing_and_is_reported(
    page: "Page", name: str, typed: str, needed: str
) -> None:
    before = drawn(page, "now")
    shown = field(page, name).input_value()
    field(page, name).fill(typed)
    assert field(page, name).get_attribute("aria-invalid") == "true"
    assert np.array_equal(drawn(page, "now"), before)
    assert refused(page) == ([f"{name} must be {needed}."] if typed else [])
    field(page, name).blur()
    assert refused(page) == [f"{name} is unchanged: it must be {needed}."]
    assert field(page, name).input_value() == shown
    assert field(page, name).get_attribute("aria-invalid") is None
    slider(page, "c_h").fill("0.6")
    assert refused(page) == []


def test_fields_of_a_motion_accept_values_beyond_their_sliders(
    page: "Page", table1: FrictionModel
) -> None:
    for name, typed in (("frequency", "10"), ("amplitude", "6.5"), ("cycles", "40")):
        assert float(typed) > {"frequency": 5.0, "amplitude": 2.4, "cycles": 10.0}[name]
        field(page, name).fill(typed)
        field(page, name).blur()
        assert float(field(page, name).input_value()) == float(typed)
        assert refused(page) == []
    columns = saved(page)
    assert len(columns["t"]) == 40 * 20 + 1
    assert columns["dq"] == pytest.approx(6.5 * np.sin(20.0 * np.pi * columns["t"]), abs=1e-11)
    assert error(columns["tau"], expected(table1.laws[0], columns)) < SAME


def test_speeds_beyond_training_are_noted(
    open_page: OpenPage, table1: FrictionModel, tmp_path: Path
) -> None:
    seen = TrainedRange(
        sample_time=0.005, dq=(-1.2, 1.2), q=(-1.0, 1.0), tau_load=(0.0, 0.0), tau=(-9.0, 9.0)
    )
    page = alive(open_page(written(tmp_path, {"one": replace(table1, trained=(seen,) * 3)})))
    note = page.locator(".live-beyond")
    assert not note.is_visible()
    field(page, "amplitude").fill("6")
    settle(page)
    assert note.inner_text() == "Faster than the training data: extrapolated."
    assert float(slider(page, "amplitude").input_value()) == 1.0
    field(page, "amplitude").fill("0")
    settle(page)
    assert not note.is_visible()
    assert len(drawn(page, "now")) > 0


COLOURS = """element => {
  const canvas = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
  const pixel = (...layers) => {
    for (const [colour, opacity] of layers) {
      canvas.globalAlpha = opacity;
      canvas.fillStyle = colour;
      canvas.fillRect(0, 0, 1, 1);
    }
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const of = (e, pseudo) => getComputedStyle(e, pseudo);
  const page = [of(document.body).backgroundColor, 1];
  const found = { page: { what: pixel(page), on: pixel(page) } };
  const plot = element.querySelector(".plot"), card = [of(plot).backgroundColor, 1];
  for (const path of plot.querySelectorAll("path")) {
    const { stroke, strokeOpacity } = of(path);
    const what = pixel(card, [stroke, strokeOpacity]);
    found[`path ${path.classList}`] = { what, on: pixel(card) };
  }
  for (const key of element.querySelectorAll(".live-key")) {
    const { borderTopColor, opacity } = of(key, "::before");
    const what = pixel(page, [borderTopColor, opacity]);
    found[`key ${key.classList}`] = { what, on: pixel(page) };
  }
  const controls = "select, button, input[type=number], .views input:not(:checked) + span";
  [...element.querySelectorAll(controls)].filter((e) => e.checkVisibility()).forEach((e, k) => {
    const { borderTopColor, borderTopWidth, backgroundColor } = of(e);
    if (parseFloat(borderTopWidth) < 1) throw new Error(`no border: ${e.outerHTML}`);
    const border = pixel(page, [borderTopColor, 1]);
    found[`${e.tagName} ${k} on the page`] = { what: border, on: pixel(page) };
    found[`${e.tagName} ${k} within`] = { what: border, on: pixel(page, [backgroundColor, 1]) };
  });
  return found;
}"""


def contrast(one: list[int], other: list[int]) -> float:
    """WCAG 2.2 contrast of two colours (red, green, blue)."""
    shares = np.array([one[:3], other[:3]]) / 255.0
    linear = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    low, high = sorted(linear @ [0.2126, 0.7152, 0.0722])
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_curves_and_borders_stand_out(open_page: OpenPage, unzipped: Path, scheme: str) -> None:
    """WCAG 1.4.11 requires 3:1."""
    page = alive(open_page(unzipped, color_scheme=scheme))
    slider(page, "c_h").fill("0.6")
    settle(page)
    found = page.locator(".live").evaluate(COLOURS)
    paper = found.pop("page")["what"]
    assert (min(paper[:3]) > 200) == (scheme == "light")
    names = {name.split()[0] for name in found}
    assert names == {"path", "key", "SELECT", "BUTTON", "INPUT", "SPAN"}
    assert len([name for name in found if name.startswith(("path", "key"))]) == 6
    ratios = {name: contrast(c["what"], c["on"]) for name, c in found.items()}
    assert {name: ratio for name, ratio in ratios.items() if ratio < 3.0} == {}
    assert contrast([0, 0, 0], [255, 255, 255]) == pytest.approx(21.0)


def test_sliders_have_accessible_names(page: "Page") -> None:
    knobs = page.locator(".live-knobs input")
    assert knobs.count() == 2 * (3 + 10 + 2)
    names = knobs.evaluate_all("all => all.map(e => e.getAttribute('aria-label'))")
    assert len(set(names)) == len(names)
    texts = page.get_by_role("slider").evaluate_all("all => all.map(e => e.ariaValueText)")
    assert "11.37 1/s" in texts
    assert page.get_by_role("img", name="Friction torque over velocity of joint1").count() == 1
    assert page.get_by_role("status").inner_text() == "All as fitted."


def test_disabled_scripts_are_reported(open_page: OpenPage, unzipped: Path) -> None:
    page = open_page(unzipped, java_script_enabled=False)
    said = page.locator("noscript p")
    assert said.is_visible()
    assert said.inner_text().endswith("requires scripts.")
    assert not page.locator(".live-app").is_visible()
    assert page.get_by_role("heading", name="Passivity audit").is_visible()


@pytest.mark.parametrize("missing", ["WebAssembly", "DecompressionStream"])
def test_an_unsuitable_browser_is_reported(
    open_page: OpenPage, unzipped: Path, missing: str
) -> None:
    page = open_page(unzipped, prepare=f"delete globalThis.{missing}")
    said = page.get_by_text("This browser cannot run the FMU's code")
    said.wait_for()
    assert missing in said.inner_text()
    assert not page.locator(".live-app").is_visible()


def test_the_page_fits_a_phone(open_page: OpenPage, unzipped: Path) -> None:
    page = alive(
        open_page(unzipped, viewport={"width": 390, "height": 844}, is_mobile=True, has_touch=True)
    )
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    last = page.locator(".live-knob").last
    last.evaluate("e => e.scrollIntoView({block: 'center'})")
    plot, knob = page.locator(".live .plot").bounding_box(), last.bounding_box()
    assert plot["y"] >= 0
    assert plot["y"] + plot["height"] < knob["y"] < 844


def test_dark_mode_and_print_are_readable(open_page: OpenPage, unzipped: Path) -> None:
    page = alive(open_page(unzipped, color_scheme="dark"))
    colour = "e => getComputedStyle(e).stroke"
    assert page.locator("path.plot-now").evaluate(colour) == "rgb(125, 184, 238)"
    page.emulate_media(media="print")
    assert page.locator("path.plot-now").evaluate(colour) == "rgb(0, 0, 0)"
    assert page.locator(".live .plot").is_visible()
    assert not page.locator(".live-knobs").is_visible()


def written(folder: Path, sections: Mapping[str, FrictionModel]) -> Path:
    """A page with several live sections, like a report."""
    parts = [live_section(live_of(model), key=key) for key, model in sections.items()]
    path = folder / "page.html"
    path.write_text(
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>x</title></head>\n'
        f"<body>{''.join(parts)}{live_assets()}</body></html>\n",
        encoding="utf-8",
    )
    return path


def test_load_and_position_are_offered_if_a_law_uses_them(
    open_page: OpenPage, tmp_path: Path
) -> None:
    own = [Coefficient(name=n, unit="1", description=n) for n in ("F_c", "mu", "a", "cycles")]
    f_c, mu, a, cycles = (c.symbol for c in own)
    form = LawForm(
        coefficients=tuple(own),
        output=(f_c + mu * absolute(TAU_LOAD)) * sgn(DQ) + a * sympy.cos(cycles * Q),
    )
    values = {"F_c": 3.0, "mu": 0.1, "a": 0.4, "cycles": 20.0}
    law = FrictionLaw(name="by_hand", form=form, values=values)
    model = FrictionModel(
        law="by_hand", robot="bench", joints=("j",), laws=(law,), sample_time=0.005
    )
    page = alive(open_page(written(tmp_path, {"one": model})))
    assert np.all(saved(page)["tau_load"] == 0.0)
    field(page, "load").fill("-12.5")
    field(page, "centre").fill("0.75")
    page.locator(".live-coefficients input[aria-label^='cycles,'][type=number]").fill("30")
    columns = saved(page)
    assert np.all(columns["tau_load"] == -12.5)
    q = columns["q"]
    assert 0.5 * (q.min() + q.max()) == pytest.approx(0.75, abs=1e-3)
    assert error(columns["tau"], expected(law, columns, cycles=30.0)) < SAME


def test_several_sections_with_escaped_names_work(
    open_page: OpenPage, table1: FrictionModel, tmp_path: Path
) -> None:
    hostile = '</script><script>console.error("run")</script><b>'
    other = replace(table1, joints=(hostile, "b", "c"))
    page = alive(open_page(written(tmp_path, {"one": table1, "two": other})))
    alive(page)
    second = page.locator("#two-section")
    second.get_by_role("radio", name="time").check(force=True)
    settle(page)
    assert second.get_by_role("combobox", name="Joint").inner_text().startswith(f"1: {hostile}")
    assert second.locator(".plot-axis").first.text_content() == "time [s]"
    assert page.locator("#one-section .plot-axis").first.text_content().startswith("velocity")
