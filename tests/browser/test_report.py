"""The report in a browser: complete, interactive and accessible."""

import json
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from cosim.report.figures.style import SERIES, VARIABLES

if TYPE_CHECKING:
    from browser_pages import OpenPage
    from playwright.sync_api import Locator, Page

RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
TABLE = "trial & error: RMSE of the predicted torque [N.m] over all rows"


@pytest.fixture(scope="module")
def results(small_results: Path) -> Path:
    return small_results


@pytest.fixture
def report(results: Path) -> Path:
    return results / "report.html"


@pytest.fixture(scope="module")
def axe() -> str:
    pytest.importorskip("axe_playwright_python", reason="axe-core is not installed")
    return (files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8")


def unfold(page: "Page") -> None:
    page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")


def until(page: "Page", holds: str, arg: str | None = None) -> None:
    """Wait until a function of the page holds.

    Playwright's own wait asks again by eval, which the policy of the page forbids.
    """
    page.evaluate(
        f"""arg => new Promise((done, fail) => {{
            const holds = {holds}, end = Date.now() + 120_000;
            const ask = () => holds(arg) ? done()
                : Date.now() > end ? fail(new Error("never held")) : setTimeout(ask, 20);
            ask();
        }})""",
        arg,
    )


def opened(open_page: "OpenPage", report: Path, **options: Any) -> "Page":
    """The page with its sections unfolded."""
    page = open_page(report, **options)
    page.evaluate(
        "document.querySelectorAll('main > section > details').forEach(d => { d.open = true; })"
    )
    return page


def zoomed(page: "Page", key: str) -> "Locator":
    figure = page.locator(f"#figure-{key}")
    figure.get_by_role("button", name="Zoom in").click()
    figure.locator(".zoom .bk-Canvas").first.wait_for()
    figure.get_by_role("button", name="Back to the picture").wait_for()
    return figure


def ranges(page: "Page") -> list[list[float]]:
    """Start and end of the horizontal axis of every zoomable plot."""
    found: list[list[float]] = page.evaluate(
        """() => Bokeh.documents.flatMap(d => [...d.all_models])
             .filter(m => m.type === "Figure")
             .map(m => [m.x_range.start, m.x_range.end])"""
    )
    return found


def test_every_figure_is_drawn(open_page: "OpenPage", report: Path) -> None:
    page = open_page(report)
    unfold(page)
    drawings = page.locator(".drawing svg")
    assert drawings.count() == page.locator("figure.figure").count() > 10
    for drawing in drawings.all():
        box = drawing.bounding_box()
        assert box is not None
        assert box["width"] > 400
        assert box["height"] > 100
        assert drawing.locator("path").count() > 5
        inside = drawing.evaluate("e => { const b = e.getBBox(); return [b.width, b.height]; }")
        assert min(inside) > 100


FIRST = ("h1", ".pick", ".download", "#summary .fail, .left > p:last-of-type", "#summary table",
         "#figure-prediction .drawing", "nav")  # fmt: skip


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1440, 900), (1920, 1080)])
def test_the_first_layer_fits_the_first_screen(
    open_page: "OpenPage", report: Path, width: int, height: int
) -> None:
    page = open_page(report, viewport={"width": width, "height": height})
    for part in FIRST:
        box = page.locator(part).first.bounding_box()
        assert box is not None, part
        assert box["x"] >= 0, part
        assert box["x"] + box["width"] <= width, part
        assert box["y"] + box["height"] <= height, part
    shown = [figure for figure in page.locator("figure.figure").all() if figure.is_visible()]
    assert len(shown) == 1
    contents, main = (page.locator(part).bounding_box() for part in ("nav", "main"))
    assert contents is not None
    assert main is not None
    assert (contents["x"] + contents["width"] <= main["x"]) == (width > 1440)


def test_contents_stay_visible_and_mark_the_section(open_page: "OpenPage", report: Path) -> None:
    page = open_page(report)
    unfold(page)
    current = page.locator("nav a[aria-current]")
    assert current.all_inner_texts() == ["Summary"]
    for name in ("Physics checks", "Prediction", "Settings"):
        page.get_by_role("navigation").get_by_text(name, exact=True).click()
        until(
            page, "name => document.querySelector('nav a[aria-current]').textContent === name", name
        )
        assert current.count() == 1
        box = page.locator("nav").bounding_box()
        assert box is not None
        assert box["y"] == 0


def test_a_link_unfolds_its_section(open_page: "OpenPage", report: Path) -> None:
    page = open_page(report)
    drawing = page.locator("#figure-torque_1")
    assert drawing.is_hidden()
    page.get_by_role("navigation").get_by_text("Prediction", exact=True).click()
    drawing.wait_for()
    page.evaluate("location.hash = '#audit'")
    page.locator("#audit").wait_for()


def test_a_view_zooms_and_all_panels_follow(open_page: "OpenPage", report: Path) -> None:
    page = opened(open_page, report)
    figure = zoomed(page, "torque_1")
    assert not figure.locator(".drawing").is_visible()
    before = ranges(page)
    assert len(before) == 6
    assert before[0][1] - before[0][0] > 4.5
    frame = figure.locator(".bk-Canvas").first
    frame.scroll_into_view_if_needed()
    box = frame.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.4 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.7 * box["height"], steps=8)
    page.mouse.up()
    until(
        page,
        "() => { const f = [...Bokeh.documents[0].all_models].find(m => m.type === 'Figure');"
        " return f.x_range.end - f.x_range.start < 2.5; }",
    )
    assert all(found == ranges(page)[0] for found in ranges(page))
    assert ranges(page)[0][0] > before[0][0] + 0.5
    figure.get_by_role("button", name="Back to the picture").click()
    assert figure.locator(".drawing").is_visible()
    assert page.evaluate("Bokeh.documents.flatMap(d => d.roots()).length") == 0


def test_a_name_hides_its_lines(open_page: "OpenPage", report: Path) -> None:
    page = opened(open_page, report)
    figure = zoomed(page, "torque_1")
    shown = """() => [...Bokeh.documents[0].all_models]
        .filter(m => m.type === "GlyphRenderer" && m.name === "Stribeck").map(m => m.visible)"""
    assert page.evaluate(shown) == [True] * 6
    figure.get_by_role("button", name="Stribeck").click()
    assert page.evaluate(shown) == [False] * 6
    assert figure.get_by_role("button", name="Stribeck").get_attribute("aria-pressed") == "false"


def test_every_view_zooms(open_page: "OpenPage", report: Path) -> None:
    page = open_page(report)
    unfold(page)
    buttons = page.get_by_role("button", name="Zoom in")
    count = buttons.count()
    assert count == page.locator("script[id^=zoom-]").count() - 1 == 5  # one is the library
    page.evaluate("document.querySelectorAll('.to-zoom').forEach(button => button.click())")
    page.get_by_role("button", name="Back to the picture").nth(count - 1).wait_for()
    until(page, f"() => globalThis.Bokeh?.documents.flatMap(d => d.roots()).length === {count}")


def test_clicks_while_a_view_opens_are_not_lost(open_page: "OpenPage", report: Path) -> None:
    page = opened(open_page, report)
    figure = page.locator("#figure-torque_1")
    twice = """figure => { const button = figure.querySelector(".to-zoom");
        button.click(); button.click(); }"""
    figure.evaluate(twice)
    figure.get_by_role("button", name="Zoom in").wait_for()
    until(page, "() => globalThis.Bokeh !== undefined")
    figure.locator(".drawing").wait_for()
    figure.locator(".zoom").wait_for(state="hidden")
    zoomed(page, "torque_1")
    assert figure.locator(".drawing").is_hidden()
    figure.evaluate(twice)
    figure.locator(".zoom .bk-Canvas").first.wait_for()
    assert figure.get_by_role("button", name="Back to the picture").is_visible()


def test_a_dark_page_has_dark_views(open_page: "OpenPage", report: Path) -> None:
    page = opened(open_page, report, color_scheme="dark")
    zoomed(page, "torque_1")
    colour = """() => { const m = [...Bokeh.documents[0].all_models]
        .find(m => m.type === "Title"); return JSON.stringify(m.text_color); }"""
    assert "#e3e8ef" in page.evaluate(colour)


def copied_rows(text: str) -> list[list[str]]:
    return [line.split(",") for line in text.strip().splitlines()]


def copy(page: "Page") -> None:
    page.get_by_role("button", name=f"Copy as CSV: {TABLE}").click()
    page.get_by_role("status").get_by_text("Copied as CSV.").wait_for()


def require_scores(text: str, results: Path) -> None:
    """The CSV has every saved digit."""
    scores = json.loads((results / "evaluation.json").read_text())["trial & error"]
    rows = {row[0]: row[1:] for row in copied_rows(text)}
    assert rows["law"][::2] == ["J1", "J2", "J3", "zero phase"]
    stribeck = [float(cell) for cell in rows["Stribeck"][:6:2]]
    assert stribeck == scores["laws"]["stribeck"]["rmse"]


def test_a_table_is_copied(open_page: "OpenPage", report: Path, results: Path) -> None:
    page = opened(open_page, report)
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    copy(page)
    require_scores(page.evaluate("navigator.clipboard.readText()"), results)


def test_a_page_without_a_clipboard_says_so(open_page: "OpenPage", report: Path) -> None:
    page = opened(open_page, report, prepare="delete Navigator.prototype.clipboard")
    page.get_by_role("button", name=f"Copy as CSV: {TABLE}").click()
    page.get_by_role("status").get_by_text("This browser does not let the page copy.").wait_for()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_accessibility_checker_finds_no_problem(
    open_page: "OpenPage", report: Path, axe: str, scheme: str
) -> None:
    page = opened(open_page, report, color_scheme=scheme)
    zoomed(page, "torque_1")
    unfold(page)
    page.evaluate(axe)
    found: dict[str, Any] = page.evaluate(
        "rules => axe.run({runOnly: rules, resultTypes: ['violations']})", RULES
    )
    assert [(v["id"], v["nodes"][0]["html"]) for v in found["violations"]] == []
    passed = {rule["id"] for rule in found["passes"]}
    assert {"color-contrast", "document-title", "html-has-lang", "svg-img-alt"} & passed
    assert "color-contrast" in passed


FOCUS = """() => {
  const focused = document.activeElement, contents = document.querySelector("nav");
  if (!document.querySelector("main").contains(focused)) return null;
  const box = focused.getBoundingClientRect(), bar = contents.getBoundingClientRect();
  const covers = bar.right > box.left && bar.bottom > box.top;
  return [covers, focused.outerHTML.slice(0, 80)];
}"""


@pytest.mark.parametrize("width", [390, 1280, 1920])
def test_the_contents_cover_nothing_that_has_focus(
    open_page: "OpenPage", report: Path, width: int
) -> None:
    """Backwards, since the browser then scrolls up to what is next."""
    page = open_page(report, viewport={"width": width, "height": 800})
    unfold(page)
    page.locator("main a, main button, main summary").last.focus()
    count = 0
    covered = []
    while (focus := page.evaluate(FOCUS)) is not None:
        is_covered, html = focus
        if is_covered:
            covered.append(html)
        count += 1
        page.keyboard.press("Shift+Tab")
    assert covered == []
    assert count > 100


def luminance(colour: str) -> float:
    parts = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_lines_and_text_of_figures_have_contrast(
    open_page: "OpenPage", report: Path, scheme: str
) -> None:
    """The checker does not inspect figures."""
    page = open_page(report, color_scheme=scheme)
    colour = "name => getComputedStyle(document.documentElement).getPropertyValue(name).trim()"
    found = {name: page.evaluate(colour, name) for name in (*VARIABLES.values(), "--paper")}
    paper = (
        found["--paper"].replace("#fff", "#ffffff")
        if len(found["--paper"]) == 4
        else found["--paper"]
    )
    for k in range(len(SERIES)):
        assert contrast(found[f"--c{k + 1}"], paper) >= 3.0, k
    assert contrast(found["--ink"], paper) >= 4.5
    assert contrast(found["--soft"], paper) >= 4.5


def test_the_report_fits_a_phone(open_page: "OpenPage", report: Path) -> None:
    page = open_page(report, viewport={"width": 390, "height": 844}, is_mobile=True, has_touch=True)
    unfold(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    zoomed(page, "rigid_body")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_the_printout_has_the_first_layer_and_the_summary_tables(
    open_page: "OpenPage", report: Path
) -> None:
    page = open_page(report)
    page.emulate_media(media="print")
    assert page.locator("#figure-prediction .drawing svg").is_visible()
    tables = [table for table in page.locator("table").all() if table.is_visible()]
    assert len(tables) == page.locator(".brief").count() == 5
    for part in ("nav", "button.copy", "button.to-zoom", "#figure-torque_1", "#body", "#laws"):
        assert not page.locator(part).first.is_visible(), part
    assert len(page.pdf(format="A4")) > 50_000


def test_the_report_is_readable_without_scripts(open_page: "OpenPage", report: Path) -> None:
    page = open_page(report, java_script_enabled=False)
    page.get_by_role("heading", name="Prediction").click()
    assert page.locator("#figure-torque_1 .drawing svg").is_visible()


@pytest.fixture
def live(open_page: "OpenPage", report: Path) -> "Page":
    page = opened(open_page, report)
    page.locator(".live-app").first.wait_for()
    return page


def test_a_selected_law_is_interactive(live: "Page") -> None:
    names = live.locator("#live-law").locator("option").all_inner_texts()
    assert "ParFam-H" in names
    live.locator("#live-law").select_option(label="ParFam-H")
    law = live.locator('.live-law[data-law="parfam_h"]')
    law.locator(".live-app").wait_for()
    assert live.locator(".live-law:visible").count() == 1
    before = law.locator("path.plot-now").get_attribute("d")
    law.locator(".live-coefficients input[type=range]").first.fill("0.9")
    until(
        live,
        "before => document.querySelector('.live-law[data-law=parfam_h] path.plot-now')"
        ".getAttribute('d') !== before",
        before,
    )
