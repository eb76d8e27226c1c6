"""Pages in a headless Chromium, opened from files, without a network."""

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from browser_pages import OpenPage, start_chromium

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page


# Module scope: no other test can run an event loop during its life.
@pytest.fixture(scope="module")
def chromium() -> Iterator["Browser"]:
    with start_chromium() as browser:
        yield browser


@pytest.fixture
def open_page(chromium: "Browser") -> Iterator[OpenPage]:
    """Open a file as a page, with options of a browser context.

    At the end the page must have no console errors and no requests except for files.
    """
    contexts: list[BrowserContext] = []
    wrong: list[str] = []

    def open_one(path: Path, *, prepare: str = "", **options: Any) -> "Page":
        context = chromium.new_context(offline=True, **options)
        # Drawing is slow without a graphics card under load.
        context.set_default_timeout(120_000)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: wrong.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("requestfailed", lambda request: wrong.append(f"failed: {request.url}"))
        page.on(
            "request",
            lambda request: wrong.extend(
                [] if request.url.startswith("file:") else [f"asked for {request.url}"]
            ),
        )
        page.add_init_script(prepare)
        page.goto(path.as_uri())
        return page

    yield open_one
    for context in contexts:
        context.close()
    assert not wrong


@pytest.fixture(scope="module")
def axe() -> str:
    pytest.importorskip("axe_playwright_python", reason="axe-core is not installed")
    return (files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8")
