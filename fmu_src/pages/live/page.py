"""HTML of interactive sections: any number per page, with one shared script and style."""

import re
from collections.abc import Mapping
from typing import Any

from fmu_src.pages.html import TEMPLATES, rendered


def live_section(data: Mapping[str, Any], key: str = "live") -> str:
    """Return the section of a friction model; `live_assets` must follow it on the page.

    The colours are the page's --ink, --soft, --line, --paper, --card and --accent. The key is the
    prefix of identifiers.
    """
    return rendered("live.html.j2", data=data, key=key)


def live_assets(*, log: bool = False) -> str:
    """Return the style and script of all interactive sections of a page, to follow them."""
    scripts = ["live_plot.js", "live.js"]
    if log:
        scripts += ["fit.js", "log_table.js", "log_motion.js", "log_score.js", "log.js"]
    style = "".join(_text(name) for name in ("live.css", *(["log.css"] if log else [])))
    whole = '(() => {\n"use strict";\n' + "\n".join(map(_text, scripts)) + "})();"
    return f"<style>\n{style}</style>\n<script>\n{whole}\n</script>\n"


def _text(name: str) -> str:
    bare = re.sub(r"/\*.*?\*/\n?", "", (TEMPLATES / name).read_text("utf-8"), flags=re.DOTALL)
    return re.sub(r"^\s+", "", bare, flags=re.MULTILINE)
