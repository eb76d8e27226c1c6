"""documentation/index.html: well formed, self-contained and correct."""

import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from registry_models import SAMPLES

from fmu_src import export_fmu
from fmu_src.export import record
from fmu_src.export.description import Description
from fmu_src.friction import friction_component as friction
from fmu_src.pages.datasheet import EULER, RK4, figure, find_fastest_rates
from fmu_src.pages.friction_page import to_html
from fmu_src.pages.html import TEMPLATES
from fmu_src.pages.mathml import equations
from hesr.extras.modelica.modelica_package import TEMPLATES as MODELICA
from hesr_model.audit.properties import Properties
from hesr_model.errors import ExportError
from hesr_model.fitting.estimator import registry
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange

VOID = {"meta", "img", "br", "hr", "link", "input"}
HOSTILE = '<script>alert("x")</script> & \'"<img src=x onerror=y>'


class Page(HTMLParser):
    """A page whose elements must be closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words.append(data)

    def values(self, name: str) -> list[str]:
        return [value for _, attribute, value in self.attributes if attribute == name]


def page_of(model: FrictionModel, *, events: bool = True) -> str:
    about = Description(
        name=f"Friction of {model.robot} by {model.law}",
        identifier="friction_x",
        text="Joint friction torque from motion.",
        version="1.2.3",
        created="2026-03-04T05:06:07Z",
        step=model.sample_time,
        sources=("all.c",),
    )
    return to_html(model, friction.friction_equations(model, events=events)[0], about)


def check(text: str, *, alive: bool = False) -> Page:
    """A self-contained page; it has scripts only with a live section."""
    page = Page(text)
    assert page.tags.count("h1") == 1
    assert ("script" in page.tags) == alive
    assert "script" not in {tag for tag, name, _ in page.attributes if name == "src"}
    assert not {"link", "iframe", "object", "base", "form"} & set(page.tags)
    for place in ("src", "href", "action", "data", "poster", "srcset"):
        for value in page.values(place):
            assert ":" not in value, f"{place} leaves the page: {value}"
            assert not value.startswith("/")
    for name in ("http:", "https:", "url(", "@import"):
        assert name not in text
    anchors = {value[1:] for value in page.values("href") if value.startswith("#")}
    assert anchors <= set(page.values("id"))
    assert not [name for _, name, _ in page.attributes if name.startswith("on")]
    cells = [("page", *cell) for cell in re.findall(r"(<th\b[^>]*>)(</th>)?", text)]
    assert without_scope(cells) == []
    return page


def test_header_cells_have_a_scope() -> None:
    """In every page made from a template; no header cell is empty."""
    cells = [
        (template.name, *cell)
        for template in (*TEMPLATES.glob("*.j2"), *MODELICA.glob("*.j2"))
        for cell in re.findall(r"(<th\b[^>]*>)(</th>)?", template.read_text(encoding="utf-8"))
    ]
    assert len({name for name, *_ in cells}) == 5
    assert len(cells) == 11
    assert without_scope(cells) == []


def without_scope(cells: list[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    return [c for c in cells if not re.search(r'scope="(col|row)"', c[1]) or c[2]]


@pytest.mark.ci
@pytest.mark.parametrize(
    "names", [SAMPLES, pytest.param((), marks=pytest.mark.nightly("laws"))], ids=["some", "all"]
)
def test_pages_of_registered_laws_are_complete(
    names: tuple[str, ...], registry_models: dict[str, FrictionModel]
) -> None:
    for name in names or registry_models:
        model = registry_models[name]
        text = page_of(model)
        page = check(text)
        law = model.laws[0]
        assert page.tags.count("math") >= 1 + len(law.form.relaxations) + len(law.values), name
        assert registry()[name].title in page.text
        assert "nan" not in page.text.split(), name
        assert "/home" not in text
        assert "made.csv" in page.text
        if law.standard_errors:
            assert "±" in page.text
        assert len(text) < 120_000


def test_pages_of_hand_written_laws_are_complete(
    every_law: dict[str, FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    laws = [law for name, law in every_law.items() if not name.startswith("fitted_")]
    page = check(page_of(make_model(*laws)))
    assert page.text.count("As plain text") == len(laws)


def test_every_joint_has_its_equation(table1: FrictionModel) -> None:
    text = page_of(table1)
    for law in table1.laws:
        for line in equations(law):
            assert line in text
    assert Page(text).tags.count("math") > 30


def test_the_page_of_table_1_is_complete(table1: FrictionModel) -> None:
    page = check(page_of(table1))
    assert page.text.count("unknown") >= 4
    # The audit and the cost of held inputs, as measured earlier.
    for figures in ("12.4 J", "20.6 J", "−0.68 to 0.81", "6557", "−4730", "2282"):
        assert figures in page.text
    for cell in ("0.67 / 1.9", "1.43 / 4.5", "0.20 / 0.5", "0.00 / 0.00"):
        assert cell in page.text
    assert "event indicators are not needed" in page.text
    certificate = page.text.split("Certificate of passivity")[1]
    assert "the coefficients above; changing a coefficient voids it." in certificate
    assert "tested on 816 sequences " in certificate
    assert "two and three tones at once" in page.text
    assert "245 ms" in page.text
    assert "q[i] , tau_load[i] , which may remain unconnected" in page.text


def test_names_of_a_model_are_escaped(table1: FrictionModel) -> None:
    model = replace(
        table1,
        robot=HOSTILE,
        law=HOSTILE,
        joints=(HOSTILE, "b & c", 'd"e'),
        provenance={
            "source": HOSTILE,
            "note": HOSTILE,
            "files": [{"name": f"C:\\Users\\x\\{HOSTILE}", "sha256": HOSTILE}],
            "seed": HOSTILE,
            "versions": {HOSTILE: HOSTILE},
        },
    )
    text = page_of(model)
    page = check(text)
    assert "<script" not in text
    assert page.tags.count("img") == 1
    assert 'alert("x")' in page.text
    assert "Users" not in text


def test_events_are_those_of_the_law(
    make_law: Callable[[str], FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    smooth = check(page_of(make_model(make_law("parfam_tanh"))))
    assert "smooth in their inputs" in smooth.text
    model = make_model(make_law("viscous"), make_law("parfam_tanh"), make_law("lugre"))
    jumps = check(page_of(model))
    assert "axis_1: at the zeros of dq" in jumps.text
    assert "axis_2: at the zeros" not in jumps.text
    steep = check(page_of(model, events=False))
    assert "straight line" not in jumps.text
    assert "a straight line over ±0.001 rad/s" in steep.text
    assert "axis_1: at the zeros of dq (4.5 N.m)" in steep.text
    assert "axis_3: at the zeros of dq (0 N.m)" in steep.text


def test_unmeasurable_values_are_reported(
    make_law: Callable[[str], FrictionLaw], make_model: Callable[..., FrictionModel]
) -> None:
    stiff = replace(make_law("lugre"), discretisation="euler")
    page = check(page_of(make_model(stiff, sample_time=0.1)))
    assert "Not audited: Euler needs" in page.text
    assert "Not measured: Euler needs" in page.text
    law = make_law("parfam_exp")
    wild = replace(law, values={**law.values, "theta1_dq": 1e6})
    assert "Not audited" in check(page_of(make_model(wild))).text


def test_the_largest_rates_are_right(make_law: Callable[[str], FrictionLaw]) -> None:
    seen = TrainedRange(
        sample_time=0.01, dq=(-0.5, 1.5), q=(0.0, 1.0), tau_load=(0.0, 0.0), tau=(-1.0, 1.0)
    )
    # In fast sliding the level is that of Coulomb friction.
    assert find_fastest_rates(make_law("lugre"), seen)["z"] == pytest.approx(
        2.0e3 * 1.5 / 9.0, rel=1e-6
    )
    assert find_fastest_rates(make_law("elements"), seen) == pytest.approx({"x1": 90.0, "x2": 10.5})
    assert find_fastest_rates(make_law("viscous"), seen) == {}


@pytest.mark.parametrize(("limit", "stages"), [(RK4, 4), (EULER, 1)])
def test_step_limits_of_the_solvers_are_right(limit: float, stages: int) -> None:
    def grown(z: float) -> float:
        term = total = 1.0
        for k in range(1, stages + 1):
            term *= -z / k
            total += term
        return abs(total)

    assert grown(limit * 0.999) < 1.0 < grown(limit * 1.001)


@pytest.mark.parametrize(
    ("value", "shown"),
    [(None, "–"), (0.0, "0"), (-0.0, "0"), (250.4, "250"), (-2.128, "−2.13"), (1.0e-7, "1e−07")],
)
def test_figures_are_included(value: float | None, shown: str) -> None:
    assert figure(value, 3) == shown


def test_the_page_is_in_the_fmu_and_reproducible(
    table1: FrictionModel, table1_fmu: Path, tmp_path: Path
) -> None:
    with zipfile.ZipFile(table1_fmu) as archive:
        text = archive.read("documentation/index.html")
    check(text.decode(), alive=True)
    with zipfile.ZipFile(export_fmu(table1, tmp_path / "F.fmu")) as archive:
        assert archive.read("documentation/index.html") == text


def test_an_fmu_without_documentation_has_the_same_binary(
    table1: FrictionModel, tmp_path: Path
) -> None:
    with (
        zipfile.ZipFile(export_fmu(table1, tmp_path / "A.fmu")) as full,
        zipfile.ZipFile(export_fmu(table1, tmp_path / "B.fmu", no_documentation=True)) as bare,
    ):
        left = set(full.namelist()) - set(bare.namelist())
        assert {"model.png", "documentation/index.html"} <= left
        assert {name.split("/")[0] for name in left} == {"model.png", "documentation", "extra"}
        same = [name for name in bare.namelist() if name != record.MEMBER]
        assert all(full.read(name) == bare.read(name) for name in same)


def test_without_documentation_there_is_no_table_of_properties(
    table1: FrictionModel, tmp_path: Path
) -> None:
    none = Properties(law="parfam_h", robot="", tau_load=0.0, joints=())
    with pytest.raises(ExportError, match="are for the page; omit no_documentation"):
        export_fmu(table1, tmp_path / "F.fmu", no_documentation=True, properties=none)
