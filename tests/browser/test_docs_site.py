"""Pages of the documentation, as `make docs` builds them in `site/`, or in the folder `SITE`."""

import os
import re
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

import pytest

if TYPE_CHECKING:
    from browser_pages import OpenPage

SITE = Path(os.environ.get("SITE", Path(__file__).resolve().parents[2] / "site"))
PAGES = sorted(p for p in SITE.rglob("*.html") if not p.relative_to(SITE).parts[0].startswith("_"))
# A page that leads to another may leave while it is looked at.
STAYING = [p for p in PAGES if 'http-equiv="refresh"' not in p.read_text(encoding="utf-8")]
WIDTHS = (390, 1440)

pytestmark = pytest.mark.skipif(not PAGES, reason="make docs has not built the site")

OVER = """() => {
  const width = document.documentElement.clientWidth;
  const over = document.documentElement.scrollWidth - width;
  return over > 1 ? `${over} px beyond ${width} px` : null;
}"""
CONTRAST = "axe.run({runOnly: ['color-contrast'], resultTypes: ['violations']})"
OVERLAP = """() => {
  const found = [], lines = [];
  for (const e of document.querySelectorAll("article p, article li, article h1, article h2")) {
    if (!e.checkVisibility() || e.closest("details:not([open])")) continue;
    const { top, bottom, left, right, height } = e.getBoundingClientRect();
    if (height) lines.push({ e, top, bottom, left, right });
  }
  for (let k = 1; k < lines.length; k++) {
    const [a, b] = [lines[k - 1], lines[k]];
    if (a.e.contains(b.e) || b.e.contains(a.e)) continue;
    const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
    if (high > 2 && wide > 2) found.push([a, b].map((l) => l.e.textContent.slice(0, 30)));
  }
  return found;
}"""


def links(page: Path) -> Iterator[tuple[Path, str]]:
    """Yield the file and the fragment of each link of a page to this site."""
    for text in re.findall(
        r'<(?:a|img|link|script)[^>]*? (?:href|src)="([^"]+)"', page.read_text()
    ):
        url = urlsplit(unescape(text))
        if not url.scheme and not url.netloc:
            target = page.parent / unquote(url.path) if url.path else page
            yield target.resolve(), url.fragment


def test_no_link_is_dead_and_no_diagram_raw() -> None:
    texts = {page: page.read_text(encoding="utf-8") for page in PAGES}
    dead = [
        f"{page.relative_to(SITE)}: {target.name}#{fragment}"
        for page in PAGES
        for target, fragment in links(page)
        if not target.exists()
        or (fragment and target in texts and f'id="{fragment}"' not in texts[target])
    ]
    assert dead == []
    assert [page for page, text in texts.items() if "mermaid" in text] == []


@pytest.mark.parametrize("page", STAYING, ids=lambda page: str(page.relative_to(SITE)))
def test_a_page_fits_its_window_and_its_text_has_contrast(
    open_page: "OpenPage", page: Path, axe: str
) -> None:
    """Without a network; level AA of WCAG 2.2, in light and dark."""
    opened = open_page(page)
    for width in WIDTHS:
        opened.set_viewport_size({"width": width, "height": 900})
        assert opened.evaluate(OVER) is None, width
        assert opened.evaluate(OVERLAP) == [], width
    opened.evaluate(axe)
    for scheme in ("light", "dark"):
        opened.emulate_media(color_scheme=scheme)
        opened.evaluate("theme => { document.body.dataset.theme = theme; }", scheme)
        found = opened.evaluate(CONTRAST)
        bad = [
            (n["html"][:90], n["failureSummary"][-160:])
            for v in found["violations"]
            for n in v["nodes"]
        ]
        assert bad == []
        assert found["passes"], "no text was checked"
