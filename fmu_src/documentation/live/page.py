"""HTML of live sections: any number of them on a page, with one script and one style for all."""

from collections.abc import Mapping
from typing import Any

from fmu_src.html import TEMPLATES, rendered


def live_section(data: Mapping[str, Any], key: str = "live") -> str:
    """Return the section of a friction model; `live_assets` must stand behind it on the page.

    It needs no network, and nothing beside the page. Without scripts it says why it is not live.
    Its colours are the page's: --ink, --soft, --line, --paper, --card and --accent.

    Parameters
    ----------
    data : from `section.live_data`.
    key : by which the identifiers of its elements begin, different for each section of a page.
    """
    return rendered("live.html.j2", data=data, key=key)


def live_assets() -> str:
    """Return the style and the script of all live sections of a page, to stand behind them."""
    style, plot, script = (
        (TEMPLATES / name).read_text("utf-8") for name in ("live.css", "live_plot.js", "live.js")
    )
    # Nothing of the script is to be seen by others on the page.
    whole = f'(() => {{\n"use strict";\n{plot}\n{script}}})();'
    return f"<style>\n{style}</style>\n<script>\n{whole}\n</script>\n"
