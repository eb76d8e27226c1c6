"""Physics checks in the documentation of an FMU."""

import zipfile
from html.parser import HTMLParser
from pathlib import Path

from subjects import bristle, model

from fmu_src import export_fmu
from hesr.extras.properties.battery import Subject, measure
from hesr_model.audit.properties import EXPECTATIONS, Properties

PAGE = "documentation/index.html"


class Tags(HTMLParser):
    """Elements and text of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    def ids(self) -> set[str | None]:
        return {attributes.get("id") for _, attributes in self.tags}


def page(fmu: Path) -> Tags:
    with zipfile.ZipFile(fmu) as archive:
        return Tags(archive.read(PAGE).decode())


def test_table_and_plots_are_in_the_documentation(bristles: Properties, tmp_path: Path) -> None:
    made = model(bristle(), bristle(static=12.0, sigma_1=50.0, sigma_2=1.0))
    found = page(export_fmu(made, tmp_path / "with.fmu", properties=bristles))
    assert {"properties", *(f"property-{key}" for key in EXPECTATIONS)} <= found.ids()
    plots = [a for tag, a in found.tags if tag == "svg" and "viewbox" in a]
    drawn = sum(f.plot is not None for j in bristles.joints for f in j.findings.values())
    assert len(plots) == drawn == 2 * len(EXPECTATIONS)
    for e in EXPECTATIONS.values():
        assert e.title in found.text
        assert e.sources[0] in found.text
    assert "One first-order state cannot have non-local" in found.text
    for tag, attributes in found.tags:
        if tag == "polyline":
            points = [p.split(",") for p in (attributes["points"] or "").split()]
            assert all(0.0 <= float(x) <= 236.0 and 0.0 <= float(y) <= 148.0 for x, y in points)


def test_without_findings_there_is_no_such_section(tmp_path: Path) -> None:
    assert "properties" not in page(export_fmu(model(bristle()), tmp_path / "bare.fmu")).ids()


def test_skipped_checks_have_no_plot_and_names_are_escaped(tmp_path: Path) -> None:
    hostile = '<b onclick="x">'
    made = model(bristle())
    named = type(made)(
        law=made.law,
        robot=hostile,
        joints=(hostile,),
        laws=made.laws,
        trained=made.trained,
        sample_time=made.sample_time,
    )
    found = measure(Subject(name="hostile", model=named))
    sheet = page(export_fmu(named, tmp_path / "hostile.fmu", properties=found))
    assert not any(tag == "b" for tag, _ in sheet.tags)
    assert "inertia of the joints is unknown" in sheet.text
