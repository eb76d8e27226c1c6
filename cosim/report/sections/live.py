"""Laws that move: the C of their FMUs in the page, with sliders."""

import json
import re
from pathlib import Path
from typing import Any

from markupsafe import Markup

from cosim.report.markup import Pictures, Section, joined, paragraph, render
from cosim.report.results import Results
from cosim.report.tables.table import title
from cosim.study.scores import REFERENCE
from fmu_src.pages.live.page import live_assets, live_section
from fmu_src.run.archive import Archive
from hesr_model.errors import ArtifactError
from hesr_model.friction.registry import papers_law

_PAGE = "documentation/index.html"
_DATA = re.compile(r'<script type="application/json">(.*?)</script>', re.DOTALL)


def section(results: Results, pictures: Pictures) -> Section | None:
    """Show the best law, the paper's and the reference law, one at a time."""
    del pictures
    laws = [
        law
        for law in dict.fromkeys((results.best, papers_law(), REFERENCE))
        if law in results.models
    ]
    found = {law: live_data(results.folder / "fmus" / f"{law}.fmu") for law in laws}
    lives = [
        (law, title(law), Markup(live_section(data, key=f"live-{law}")))
        for law, data in found.items()
        if data is not None
    ]
    if not lives:
        return None
    return Section(
        key="live",
        title="A law, live",
        html=joined(
            paragraph("The very code of the exported FMUs, in this page."),
            render("live_choice.html.j2", lives=lives),
            Markup(live_assets()),
        ),
    )


def live_data(fmu: Path) -> dict[str, Any] | None:
    """Return the data of the live section in an FMU's documentation; None where it has none."""
    try:
        with Archive(fmu) as archive:
            page = archive.read(_PAGE).decode("utf-8")
    except (ArtifactError, UnicodeDecodeError):
        return None
    match = _DATA.search(page)
    return json.loads(match[1]) if match else None
