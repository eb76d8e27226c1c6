"""SSPs of other tools: their units, URIs, and names that ours cannot have."""

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from containing import OneSentence
from fakes import description, variable
from small_study import Hesr

from cosim.systems.simulation import System
from cosim.systems.system import SystemSpec, open_system
from fmu_src.run.variables import SI, Variables
from hesr.extras.ssp.contents import SSD, read_contents
from hesr.extras.ssp.ssp import write_ssp
from hesr.extras.ssp.ssp_graph import Unit, convert_to_unit, safe_names

Write = Callable[..., Path]
Changes = Mapping[str, list[tuple[str, str]]]
Edit = Callable[..., Path]

A = "resources/a.ssv"
MS = (
    ('value="0.5" unit="s"', 'value="500" unit="ms"'),
    (
        "<ssv:Units>",
        '<ssv:Units><ssc:Unit name="ms"><ssc:BaseUnit s="1" factor="1e-3"/></ssc:Unit>',
    ),
)


def si(**given: float) -> tuple[float, ...]:
    """A unit in SI base units."""
    return tuple({"factor": 1.0, **given}.get(key, 0.0) for key in SI)


@pytest.fixture
def edited(lags: Write, tmp_path: Path) -> Edit:
    """Write the two lags as an SSP with texts of its members replaced and members renamed."""
    system = lags()
    whole = write_ssp(read_contents(SystemSpec.read(system), system), tmp_path / "whole.ssp")

    def file(changes: Changes, renamed: Mapping[str, str] | None = None) -> Path:
        path = tmp_path / "lags.ssp"
        with zipfile.ZipFile(whole) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                data = old.read(name)
                for before, after in changes.get(name, ()):
                    assert before.encode() in data
                    data = data.replace(before.encode(), after.encode())
                new.writestr((renamed or {}).get(name, name), data)
        return path

    return file


def test_start_values_in_other_units_are_converted(edited: Edit) -> None:
    """In a separate file and within the system description."""
    inline = f"""<ssd:ParameterBindings><ssd:ParameterBinding prefix="b."><ssd:ParameterValues>
<ssv:ParameterSet version="1.0" name="inside"><ssv:Parameters>
<ssv:Parameter name="T"><ssv:Real {MS[0][1]}/></ssv:Parameter></ssv:Parameters>
{MS[1][1]}</ssv:Units></ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding>
</ssd:ParameterBindings><ssd:Elements>"""
    path = edited({A: list(MS), SSD: [("<ssd:Elements>", inline)]})
    with open_system(path) as spec:
        assert [dict(c.start) for c in spec.components] == [
            {"u": 2.0, "T": pytest.approx(0.5, rel=1e-15, abs=0.0), "x_start": 0.25},
            {"T": pytest.approx(0.5, rel=1e-15, abs=0.0)},
        ]


UNITS = {
    "rad/s": SimpleNamespace(**dict(zip(SI, si(s=-1, rad=1), strict=True))),
    "degC": SimpleNamespace(**dict(zip(SI, si(K=1, offset=273.15), strict=True))),
    "turn": None,
}
DEGREES = "deg/s", si(s=-1, rad=1, factor=np.pi / 180)
FAHRENHEIT = "degF", si(K=1, factor=5 / 9, offset=459.67 * 5 / 9)


@pytest.mark.parametrize(
    ("unit", "relative", "given", "of", "value"),
    [
        ("rad/s", None, 180.0, DEGREES, np.pi),
        ("rad/s", None, 2.0, ("1/s*rad", si(s=-1, rad=1)), 2.0),
        ("rad/s", None, 2.0, ("rad/s", None), 2.0),
        ("degC", None, 300.0, ("K", si(K=1)), 26.85),
        ("degC", None, 50.0, FAHRENHEIT, 10.0),
        ("degC", True, 50.0, FAHRENHEIT, 50.0 * 5 / 9),
        ("turn", None, 3.0, ("turn", si(rad=1, factor=6.28)), 3.0),
        (None, None, 3.0, ("anything", None), 3.0),
    ],
)
def test_a_number_is_in_the_unit_of_its_variable(
    unit: str | None, relative: bool | None, given: float, of: Unit, value: float
) -> None:
    about = description(
        variable("x", "parameter", unit=unit, relativeQuantity=relative), units=UNITS
    )
    found = convert_to_unit(Variables(Path("F.fmu"), about), "x", given, of, "x")
    assert found == pytest.approx(value, rel=1e-12, abs=0.0)


def test_a_number_of_an_undefined_unit_stays_with_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    about = description(variable("x", "parameter", unit="[m]", relativeQuantity=None), units=UNITS)
    variables = Variables(Path("F.fmu"), about)
    assert convert_to_unit(variables, "x", 1.5, ("deg", si(rad=1)), "here") == 1.5
    assert "'[m]' is not defined" in caplog.text


REFUSED: list[tuple[Changes, str]] = [
    ({A: [MS[0], (MS[1][0], MS[1][1].replace('s="1"', 'm="1"'))]},
     "parameter 'T': ms cannot be converted"),
    ({A: [MS[0], (MS[1][0], MS[1][1].replace("1e-3", "tiny"))]},
     "component 'a': factor of unit 'ms'"),
    ({SSD: [('startElement="a"', 'startElement="c d"')]},
     "'c d' is not a component"),
    ({SSD: [('startConnector="y"', 'startConnector="y 1"')]},
     "there is no variable 'y 1'."),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "sentence"), REFUSED)
def test_unsupported_features_are_refused(
    changes: Changes, sentence: str, edited: Edit, tmp_path: Path, hesr: Hesr
) -> None:
    path = edited(changes)
    answer = hesr("simulate", path, "-o", tmp_path / "x.csv")
    head, _, tail = sentence.partition("{fmu}")
    assert answer.code == 2
    assert answer.err == OneSentence(f"hesr: {path}: ", head, tail)
    assert not (tmp_path / "x.csv").exists()


@pytest.mark.parametrize("source", ["resources/My Fric.fmu", "resources/My%20Fric.fmu"])
def test_a_source_is_a_uri(source: str, edited: Edit) -> None:
    """Some tools write the plain file name even where it needs escaping."""
    changes = {SSD: [('source="resources/a.fmu"', 'source="resources/My%20Fric.fmu"')]}
    with open_system(edited(changes, {"resources/a.fmu": source})) as spec:
        assert spec.components[0].fmu.is_file()


def test_foreign_names_are_converted(edited: Edit, lags: Write) -> None:
    """The same run under valid names; start values of the system follow them."""
    inline = """<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>
<ssv:ParameterSet version="1.0" name="inside"><ssv:Parameters>
<ssv:Parameter name="my-fric 1.T"><ssv:Real value="0.5"/></ssv:Parameter>
</ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding>
</ssd:ParameterBindings><ssd:Elements>"""
    path = edited({SSD: [
        ('name="a"', 'name="my-fric 1"'), ('Element="a"', 'Element="my-fric 1"'),
        ('name="b"', 'name="2nd"'), ('Element="b"', 'Element="2nd"'),
        ("<ssd:Elements>", inline),
    ]})  # fmt: skip
    opened = System.read(path)
    spec = opened.spec
    assert [c.name for c in spec.components] == ["my_fric_1", "_2nd"]
    assert dict(spec.connections) == {"_2nd.u": "my_fric_1.y"}
    assert spec.observe == ("my_fric_1.y", "_2nd.y")
    found = opened.run()
    expected = System.read(lags()).run()
    for (_, one), (_, other) in zip(found.signals.items(), expected.signals.items(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_converted_names_stay_distinct() -> None:
    names = ["my_fric", "my-fric", "my fric", "größe", "µ", "2nd", "a.b", "", "my_fric_2", "x²"]
    assert safe_names([*names, "µ"]) == {
        "my_fric": "my_fric",
        "größe": "größe",
        "my_fric_2": "my_fric_2",
        "my-fric": "my_fric_3",
        "my fric": "my_fric_4",
        "µ": "_",
        "2nd": "_2nd",
        "a.b": "a_b",
        "": "__2",
        "x²": "x_",
    }
