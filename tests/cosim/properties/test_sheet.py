"""Physics checks in the documentation of an FMU."""

import zipfile
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
from subjects import bristle, model

from fmu_src import export_fmu
from hesr.extras.properties.battery import Subject, measure
from hesr.extras.properties.figures import draw_check
from hesr_model.audit.properties import EXPECTATIONS, Curve, Plot, Properties

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
    images = [attributes for _, attributes in found.tags if attributes.get("role") == "img"]
    assert sum(" over " in (attributes.get("aria-label") or "") for attributes in images) == drawn
    ids = [attributes["id"] for _, attributes in found.tags if "id" in attributes]
    assert len(ids) == len(set(ids))


def test_a_figure_names_curves_and_extremes() -> None:
    """Only curves of two points and more are drawn; the axes are named with their extremes."""
    rising = Curve(label="4 s", x=(-2.0, 0.0, 1.0), y=(-3.0, 0.0, 5.0))
    single = Curve(label="gone", x=(9.0,), y=(9.0,))
    plot = Plot(x="position", y="torque", units=("rad", "N.m"), curves=(rising, single))
    figure = draw_check(plot)
    assert figure is not None
    (axes,) = figure.axes
    assert {text.get_text() for text in axes.texts} == {
        "torque [N.m], −3 to 5",
        "−2",
        "position [rad]",
        "1",
    }
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["4 s"]
    curve, *zeros = axes.lines
    np.testing.assert_array_equal(curve.get_xydata(), np.column_stack([rising.x, rising.y]))
    assert len(zeros) == 2
    assert draw_check(replace(plot, curves=(single,))) is None


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
