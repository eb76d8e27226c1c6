"""Every page passes the accessibility checker and is not clipped at any width."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from pages import PAGES

if TYPE_CHECKING:
    from browser_pages import OpenPage
    from playwright.sync_api import Page

RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
WIDTHS = (390, 1024, 1440, 1920)

CUT = """() => {
  const width = document.documentElement.clientWidth, found = [];
  if (document.documentElement.scrollWidth > width) found.push("the page scrolls sideways");
  for (const e of document.querySelectorAll("body, body *")) {
    if (!e.checkVisibility() || (e.closest("svg, math") && !e.matches("svg, math"))) continue;
    if (e.parentElement?.matches(".drawing")) continue;  // it scrolls in the figure's own box
    const { overflowX, position } = getComputedStyle(e), box = e.getBoundingClientRect();
    const about = `${e.tagName} "${e.textContent.trim().slice(0, 40)}"`;
    if (position !== "absolute" && box.width > 1 && (box.right > width + 1 || box.left < -1)) {
      found.push(`${about} from ${box.left} to ${box.right}`);
    }
    const cuts = overflowX !== "visible" && !e.matches(".drawing");
    if (cuts && e.clientWidth && e.scrollWidth > e.clientWidth + 1) {
      found.push(`${about}: ${e.scrollWidth} in ${e.clientWidth}`);
    }
  }
  return found;
}"""


@pytest.fixture(scope="module")
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    if request.param == "report":
        results: Path = request.getfixturevalue("small_results")
        return results / "report.html"
    return PAGES[request.param](tmp_path_factory.mktemp(request.param))


def unfold(page: "Page") -> None:
    """Unfold everything."""
    page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


@pytest.mark.parametrize("path", [*PAGES, "report"], indirect=True)
def test_nothing_is_clipped(open_page: "OpenPage", path: Path) -> None:
    page = open_page(path)
    unfold(page)
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        page.evaluate(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        assert page.evaluate(CUT)[:5] == [], width


LETTERS = """() => [...document.querySelectorAll(".drawing text")]
  .filter((e) => e.checkVisibility() && e.textContent.trim())
  .map((e) => parseFloat(getComputedStyle(e).fontSize) *
    e.ownerSVGElement.getBoundingClientRect().width / e.ownerSVGElement.viewBox.baseVal.width)"""
SMALL = 9.0  # [px]


@pytest.mark.parametrize("path", ["inspection", "monitor", "sweep", "report"], indirect=True)
def test_figures_are_readable_on_a_phone(open_page: "OpenPage", path: Path) -> None:
    page = open_page(path, viewport={"width": 390, "height": 844})
    unfold(page)
    letters = page.evaluate(LETTERS)
    assert letters
    assert min(letters) > SMALL
    boxes = page.locator(".drawing:not(.small)")
    for box in boxes.all():
        box.focus()
        assert box.evaluate("e => { e.scrollLeft = 9999; return e.scrollLeft; }") > 0


@pytest.mark.parametrize("path", ["inspection", "monitor", "sweep", "scores"], indirect=True)
def test_tables_are_printed(open_page: "OpenPage", path: Path) -> None:
    page = open_page(path)
    page.emulate_media(media="print")
    tables = page.locator("section > .table, section > div > .table")
    assert tables.count()
    assert all(table.is_visible() for table in tables.all())
    assert not page.locator("nav, button.copy").first.is_visible()


BESIDE = """() => [...document.querySelectorAll(".cards td.beside")]
  .filter((e) => e.textContent.trim())
  .map((e) => [e.textContent, getComputedStyle(e.previousElementSibling, "::after").content])"""


@pytest.mark.parametrize("path", ["scores"], indirect=True)
def test_an_interval_stays_with_its_number_on_a_phone(open_page: "OpenPage", path: Path) -> None:
    page = open_page(path, viewport={"width": 390, "height": 844})
    unfold(page)
    intervals = page.evaluate(BESIDE)
    assert len(intervals) > 5
    for text, shown in intervals:
        assert shown == f'"{text}"'


# test_report.py covers the page of a run, with a zoomable view.
@pytest.mark.parametrize("path", [*PAGES], indirect=True)
def test_the_accessibility_checker_finds_no_problem(
    open_page: "OpenPage", path: Path, axe: str
) -> None:
    page = open_page(path)
    unfold(page)
    page.evaluate(axe)
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        found: dict[str, Any] = page.evaluate(
            "rules => axe.run({runOnly: rules, resultTypes: ['violations']})", RULES
        )
        assert [(v["id"], v["nodes"][0]["html"]) for v in found["violations"]] == []
        assert "color-contrast" in {rule["id"] for rule in found["passes"]}
