"""HTML of live sections: any number of them on a page, with one script and one style for all."""

import re
from collections.abc import Mapping
from typing import Any

from fmu_src.pages.html import TEMPLATES, rendered


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


def live_assets(*, log: bool = False) -> str:
    """Return the style and the script of all live sections of a page, to stand behind them.

    Parameters
    ----------
    log : whether there is a section that takes a log, too.
    """
    scripts = ["live_plot.js", "live.js"]
    if log:
        scripts += ["fit.js", "log_table.js", "log_motion.js", "log_score.js", "log.js"]
    style = "".join(_text(name) for name in ("live.css", *(["log.css"] if log else [])))
    # Nothing of the script is to be seen by others on the page.
    whole = '(() => {\n"use strict";\n' + "\n".join(map(_text, scripts)) + "})();"
    return f"<style>\n{style}</style>\n<script>\n{whole}\n</script>\n"


def _text(name: str) -> str:
    """Return a style or script without what only its authors read: every FMU carries it."""
    bare = re.sub(r"/\*.*?\*/\n?", "", (TEMPLATES / name).read_text("utf-8"), flags=re.DOTALL)
    return re.sub(r"^\s+", "", bare, flags=re.MULTILINE)
