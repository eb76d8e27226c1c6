"""SSPs as other tools write them, by hand after the standard, against hand-wired systems."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from containing import OneSentence
from pythonfmu.builder import FmuBuilder

import hesr
from fmu_src.check.run import check
from hesr.extras.ssp.ssp_check import check_ssp
from hesr_model.errors import ConfigError

UNITS = """<ssd:Units><ssc:Unit name="1"><ssc:BaseUnit/></ssc:Unit>
<ssc:Unit name="%"><ssc:BaseUnit factor="0.01"/></ssc:Unit>
<ssc:Unit name="s"><ssc:BaseUnit s="1"/></ssc:Unit>
<ssc:Unit name="none"><ssc:BaseUnit factor="0"/></ssc:Unit></ssd:Units>"""
HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="1.0" name="made"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
  xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
  xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping">"""
SETS = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet version="1.0" name="p"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"><ssv:Parameters>"""
SET_END = """</ssv:Parameters><ssv:Units><ssc:Unit name="ms"><ssc:BaseUnit s="1" factor="0.001"/>
</ssc:Unit></ssv:Units></ssv:ParameterSet>"""
MAPPING = """<?xml version="1.0" encoding="UTF-8"?>
<ssm:ParameterMapping version="1.0"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping">"""


def connector(name: str, kind: str, unit: str = "", datatype: str = "Real") -> str:
    unit = f' unit="{unit}"' * bool(unit)
    return f'<ssd:Connector name="{name}" kind="{kind}"><ssc:{datatype}{unit}/></ssd:Connector>'


def lag(name: str, more: str = "", unit: str = "1", fmu: str = "resources/Lag.fmu") -> str:
    ends = connector("u", "input", unit) + connector("y", "output", "1")
    return (
        f'<ssd:Component name="{name}" type="application/x-fmu-sharedlibrary" source="{fmu}">'
        f"<ssd:Connectors>{ends}</ssd:Connectors>{more}</ssd:Component>"
    )


def wire(start: str, end: str, more: str = "", **attributes: str) -> str:
    parts = {}
    for side, text in (("start", start), ("end", end)):
        element, _, own = text.rpartition(".")
        parts |= {f"{side}Connector": own} | ({f"{side}Element": element} if element else {})
    said = " ".join(f'{key}="{value}"' for key, value in (parts | attributes).items())
    return f"<ssd:Connection {said}>{more}</ssd:Connection>"


def binding(source: str = "", more: str = "", prefix: str = "") -> str:
    source = f' source="{source}"' * bool(source) + f' prefix="{prefix}"' * bool(prefix)
    return f"<ssd:ParameterBinding{source}>{more}</ssd:ParameterBinding>"


def bindings(*parts: str) -> str:
    return f"<ssd:ParameterBindings>{''.join(parts)}</ssd:ParameterBindings>"


def system(
    *elements: str, wires: str = "", ends: str = "", more: str = "", name: str = "root"
) -> str:
    return (
        f'<ssd:System name="{name}">'
        + f"<ssd:Connectors>{ends}</ssd:Connectors>" * bool(ends)
        + more
        + f"<ssd:Elements>{''.join(elements)}</ssd:Elements>"
        + f"<ssd:Connections>{wires}</ssd:Connections>" * bool(wires)
        + "</ssd:System>"
    )


LATE = '<ssd:DefaultExperiment startTime="1" stopTime="3"/>'
EXPERIMENT = '<ssd:DefaultExperiment startTime="0" stopTime="1"/>'


@pytest.fixture
def ssp(lag_fmu: Path, tmp_path: Path) -> Any:
    def make(
        root: str, files: Mapping[str, str | Path] | None = None, end: str = EXPERIMENT
    ) -> Path:
        path = tmp_path / "made.ssp"
        text = f"{HEAD}{root}{UNITS}{end}</ssd:SystemStructureDescription>"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("SystemStructure.ssd", text)
            archive.write(lag_fmu, "resources/Lag.fmu")
            for name, content in (files or {}).items():
                data = content.read_bytes() if isinstance(content, Path) else content
                archive.writestr(name, data)
        return path

    return make


@pytest.fixture
def wired(lag_fmu: Path, tmp_path: Path) -> Any:
    """The same two lags, wired by hand: b takes `factor` y + `offset` of a."""

    def run(a: Mapping[str, float], b: Mapping[str, float], convert: Any = None) -> Any:
        lines = ['name = "w"', "step = 0.01", "stop = 1.0", 'observe = ["a.y", "b.y"]']
        for name, start in (("a", a), ("b", b)):
            lines += ["[[components]]", f'name = "{name}"', f'fmu = "{lag_fmu}"']
            lines += [f"start = {{ {', '.join(f'{k} = {v!r}' for k, v in start.items())} }}"]
        lines += ["[connections]", '"b.u" = "a.y"']
        if convert:
            lines += [
                "[conversions]",
                f'"b.u" = [{{ factor = {convert[0]!r}, offset = {convert[1]!r} }}]',
            ]
        path = tmp_path / "wired.toml"
        path.write_text("\n".join(lines), encoding="utf-8")
        return hesr.System.read(path).run().signals

    return run


def compared(found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    for (_, one), (_, other) in zip(found.items(), expected.items(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15)


U = '<ssv:Parameter name="u"><ssv:Real value="2"/></ssv:Parameter>'


def inline(parameters: str) -> str:
    body = (SETS + parameters + SET_END).partition("?>")[2]
    return f"<ssd:ParameterValues>{body}</ssd:ParameterValues>"


def test_units_are_converted_between_connectors(ssp: Any, wired: Any) -> None:
    """y in 1 becomes u in %; the FMU is shared, and the unconnected input keeps its start."""
    path = ssp(
        system(
            lag("a", bindings(binding(more=inline(U)))),
            lag("b", unit="%"),
            wires=wire("a.y", "b.u"),
        ),
        {"documentation/x.bin": "extra"},
    )
    compared(hesr.simulate(path, step=0.01).signals, wired({"u": 2.0}, {}, (100.0, 0.0)))
    kept = ssp(system(lag("a"), lag("b"), wires=wire("a.y", "b.u", suppressUnitConversion="true")))
    compared(hesr.simulate(kept, step=0.01).signals, wired({"u": 0.0}, {}))


def test_linear_transformations_follow_units(ssp: Any, wired: Any) -> None:
    linear = '<ssc:LinearTransformation factor="2" offset="-0.5"/>'
    parts = lag("a", bindings(binding(more=inline(U)))), lag("b", unit="%")
    # Start and end give no direction.
    path = ssp(system(*parts, wires=wire("b.u", "a.y", linear)))
    compared(hesr.simulate(path, step=0.01).signals, wired({"u": 2.0}, {}, (200.0, -0.5)))
    path = ssp(system(*parts, wires=wire("a.y", "b.u", linear, suppressUnitConversion="true")))
    compared(hesr.simulate(path, step=0.01).signals, wired({"u": 2.0}, {}, (2.0, -0.5)))


def test_nested_systems_and_their_connectors_become_one_level(ssp: Any, wired: Any) -> None:
    """a is two levels down, b one; values pass through connectors in other units."""
    deepest = system(
        lag("a"),
        ends=connector("in", "input", "%") + connector("out", "output"),
        wires=wire("in", "a.u") + wire("a.y", "out"),
        name="deepest",
    )
    inner = system(
        deepest,
        lag("b"),
        ends=connector("feed", "input", "1"),
        wires=wire("feed", "deepest.in") + wire("deepest.out", "b.u"),
        name="inner",
    )
    value = '<ssv:Parameter name="target"><ssv:Real value="2"/></ssv:Parameter>'
    path = ssp(
        system(
            inner,
            ends=connector("target", "input", "1"),
            wires=wire("target", "inner.feed"),
            more=bindings(binding(more=inline(value))),
        )
    )
    found = hesr.simulate(path, step=0.01)
    assert list(found.signals) == ["inner_deepest_a.y", "inner_b.y"]
    compared(found.signals, wired({"u": 2.0}, {}))
    compared(
        hesr.simulate(path, step=0.01, set=["target=3.0", "inner.b.T=0.25"]).signals,
        wired({"u": 3.0}, {"T": 0.25}),
    )


def test_sources_prefixes_and_mappings_are_applied(ssp: Any, wired: Any) -> None:
    """Later sources and outer systems win; a mapping applies its own names only."""
    millis = '<ssv:Parameter name="T"><ssv:Real value="250" unit="ms"/></ssv:Parameter>'
    other = '<ssv:Parameter name="u"><ssv:Real value="9"/></ssv:Parameter>' + millis
    outer = (
        '<ssv:Parameter name="level"><ssv:Real value="4"/></ssv:Parameter>'
        '<ssv:Parameter name="unused"><ssv:Real value="7"/></ssv:Parameter>'
    )
    mapped = (
        MAPPING + '<ssm:MappingEntry source="level" target="a.u"><ssc:LinearTransformation '
        'factor="0.5" offset="0.25"/></ssm:MappingEntry></ssm:ParameterMapping>'
    )
    files = {"own": other, "b": millis, "outer": outer}
    files = {f"resources/{name}.ssv": SETS + own + SET_END for name, own in files.items()}
    files["resources/map.ssm"] = mapped
    start = '<ssv:Parameter name="x_start"><ssv:Real value="0.75"/></ssv:Parameter>'
    own = bindings(binding("resources/own.ssv"), binding(more=inline(start)))
    top = bindings(
        binding("resources/b.ssv", prefix="b."),
        binding("resources/outer.ssv", '<ssd:ParameterMapping source="resources/map.ssm"/>'),
    )
    path = ssp(system(lag("a", own), lag("b"), wires=wire("a.y", "b.u"), more=top), files)
    expected = wired({"u": 2.25, "T": 0.25, "x_start": 0.75}, {"T": 0.25})
    compared(hesr.simulate(path, step=0.01).signals, expected)
    assert [f for f in check_ssp(path).problems if f.severity == "error"] == []


@pytest.fixture(scope="session")
def typed_fmu(shared: Any) -> Path:
    """A PythonFMU with inputs and outputs of every type; its Integers are an Enumeration."""
    slave = Path(__file__).parents[1] / "typed_slave.py"
    made: Path = shared("typed", lambda folder: FmuBuilder.build_FMU(slave, dest=folder))
    return made / "Typed.fmu"


def typed(name: str, more: str = "", integer: str = "Integer") -> str:
    ends = "".join(
        connector(n + end, kind, datatype=t)
        for n, t in (("r", "Real"), ("i", integer), ("b", "Boolean"), ("s", "String"))
        for end, kind in (("", "input"), ("o", "output"))
    )
    return (
        f'<ssd:Component name="{name}" source="resources/Typed.fmu" type="application/'
        f'x-fmu-sharedlibrary"><ssd:Connectors>{ends}</ssd:Connectors>{more}</ssd:Component>'
    )


VALUES = "".join(
    f'<ssv:Parameter name="{name}"><ssv:{kind} value="{value}"/></ssv:Parameter>'
    for name, kind, value in (("r", "Real", "1.5"), ("i", "Integer", "3"), ("b", "Boolean", "true"),
                              ("s", "String", "some text"))
)  # fmt: skip
TABLE = (
    '<ssc:{0}MappingTransformation><ssc:MapEntry source="{1}" target="{2}"/>'
    "</ssc:{0}MappingTransformation>"
)


def test_connectors_of_every_type_are_connected(ssp: Any, typed_fmu: Path) -> None:
    wires = (
        wire("a.ro", "b.r")
        + wire("a.io", "b.i", TABLE.format("Integer", "3", "-7"))
        + wire("a.bo", "b.b", TABLE.format("Boolean", "true", "false"))
        + wire("a.so", "b.s")
    )
    path = ssp(
        system(typed("a", bindings(binding(more=inline(VALUES)))), typed("b"), wires=wires),
        {"resources/Typed.fmu": typed_fmu},
    )
    found = hesr.simulate(path, step=0.5).signals
    last = {name: column[-1] for name, column in found.items()}
    assert last == {"a.ro": 1.5, "a.io": 3, "a.bo": True, "a.so": "some text",
                    "b.ro": 1.5, "b.io": -7, "b.bo": False, "b.so": "some text"}  # fmt: skip
    assert found["a.io"].dtype.kind == "i"
    assert found["b.bo"].dtype.kind == "b"


@pytest.mark.parametrize("source", ["true", "True", "TRUE", "1"])
def test_booleans_are_mapped_as_other_tools_write_them(
    source: str, ssp: Any, typed_fmu: Path
) -> None:
    table = TABLE.format("Boolean", source, "False")
    value = bindings(binding(more=inline(one("b", "Boolean", "true"))))
    path = ssp(
        system(
            typed("a", value),
            typed("b"),
            wires=wire("a.bo", "b.b", table),
        ),
        {"resources/Typed.fmu": typed_fmu},
    )
    found = hesr.simulate(path, step=0.5).signals
    assert (found["a.bo"][-1], found["b.bo"][-1]) == (True, False)


def test_types_that_do_not_fit_are_refused(ssp: Any, typed_fmu: Path) -> None:
    path = ssp(
        system(typed("a"), typed("b"), wires=wire("a.ro", "b.i")),
        {"resources/Typed.fmu": typed_fmu},
    )
    said = "Integer, the output of type Real"
    with pytest.raises(ConfigError, match=said):
        hesr.simulate(path)


def test_enumerations_are_mapped_by_name(ssp: Any, typed_fmu: Path, tmp_path: Path) -> None:
    items = '<Item name="{}" value="1"/><Item name="{}" value="2"/>'
    types = "".join(
        f'<SimpleType name="T"><Enumeration>{items.format(*names)}</Enumeration></SimpleType>'
        for names in [("low", "high")]
    )
    changed = rewritten(
        typed_fmu,
        tmp_path / "Typed.fmu",
        ("<ModelVariables>", f"<TypeDefinitions>{types}</TypeDefinitions><ModelVariables>"),
        ("<Integer", '<Enumeration declaredType="T"'),
    )
    value = '<ssv:Parameter name="i"><ssv:Enumeration value="low"/></ssv:Parameter>'
    own = typed("a", bindings(binding(more=inline(value))))
    path = ssp(
        system(
            own, typed("b"), wires=wire("a.io", "b.i", TABLE.format("Enumeration", "low", "high"))
        ),
        {"resources/Typed.fmu": changed},
    )
    found = hesr.simulate(path, step=0.5).signals
    assert (found["a.io"][-1], found["b.io"][-1]) == (1, 2)
    table = mapping("i", "i", TABLE.format("Enumeration", "lo", "high"))
    own = typed("a", bindings(binding(more=inline(value) + table)))
    with pytest.raises(ConfigError, match=r"has no 'low'; did you mean 'lo'\?"):
        hesr.simulate(ssp(system(own), {"resources/Typed.fmu": changed}))


def one(name: str, kind: str, value: str, unit: str = "") -> str:
    unit = f' unit="{unit}"' * bool(unit)
    return f'<ssv:Parameter name="{name}"><ssv:{kind} value="{value}"{unit}/></ssv:Parameter>'


def mapping(source: str, target: str, more: str) -> str:
    entry = f'<ssm:MappingEntry source="{source}" target="{target}">{more}</ssm:MappingEntry>'
    body = MAPPING.partition("?>")[2] + entry + "</ssm:ParameterMapping>"
    return f"<ssd:ParameterMapping>{body}</ssd:ParameterMapping>"


def test_parameters_of_systems_are_transformed_like_signals(ssp: Any, typed_fmu: Path) -> None:
    """Boolean sources may be 1 and 0; values outside a table are kept."""
    ends = {"flag": "Boolean", "kept": "Boolean", "n": "Integer", "text": "String"}
    wires = (
        wire("flag", "a.b", TABLE.format("Boolean", "1", "0"))
        + wire("kept", "b.b", TABLE.format("Boolean", "false", "true"))
        + wire("n", "a.i", TABLE.format("Integer", "3", "-7"))
        + wire("text", "a.s")
    )
    values = (
        one("flag", "Boolean", "true")
        + one("kept", "Boolean", "1")
        + one("n", "Integer", "3")
        + one("text", "String", "3")
    )
    path = ssp(
        system(
            typed("a"),
            typed("b"),
            ends="".join(connector(n, "parameter", datatype=t) for n, t in ends.items()),
            wires=wires,
            more=bindings(binding(more=inline(values))),
        ),
        {"resources/Typed.fmu": typed_fmu},
    )
    found = hesr.simulate(path, step=0.5).signals
    last = {name: found[name][-1] for name in ("a.bo", "b.bo", "a.io", "a.so")}
    assert last == {"a.bo": False, "b.bo": True, "a.io": -7, "a.so": "3"}


def test_a_mapping_is_applied_before_the_connections_of_its_target(ssp: Any, wired: Any) -> None:
    """200 ms are 0.2 s, with the mapping 0.6 s; the connection doubles that."""
    linear = '<ssc:LinearTransformation factor="{}" offset="{}"/>'
    own = binding(
        more=inline(one("t", "Real", "200", "ms")) + mapping("t", "lag", linear.format(2, 0.2))
    )
    path = ssp(
        system(
            lag("a", bindings(binding(more=inline(U)))),
            lag("b"),
            ends=connector("lag", "parameter", "s"),
            more=bindings(own),
            wires=wire("a.y", "b.u") + wire("lag", "b.T", linear.format(2, 0)),
        )
    )
    compared(hesr.simulate(path, step=0.01).signals, wired({"u": 2.0}, {"T": 1.2}))


def test_names_with_dots_and_relative_sources(ssp: Any) -> None:
    """The standard sets all variables of one hierarchical name."""
    dotted = lag("b.c", fmu="./resources/x/../Lag.fmu")
    value = bindings(binding(more=inline(one("b.c.T", "Real", "0.25"))))
    path = ssp(system(system(lag("c"), name="b"), dotted, lag("d"), more=value))
    found = hesr.simulate(path, step=0.01).signals
    assert list(found) == ["b_c.y", "b_c_2.y", "d.y"]
    np.testing.assert_array_equal(found["b_c.y"], found["b_c_2.y"])
    assert not np.array_equal(found["b_c.y"], found["d.y"])


def rewritten(fmu: Path, path: Path, *changes: tuple[str, str]) -> Path:
    """A copy of an FMU with other text in its description."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                for before, after in changes:
                    assert before.encode() in data
                    data = data.replace(before.encode(), after.encode())
            new.writestr(name, data)
    return path


def test_names_with_spaces_are_those_of_others(ssp: Any, lag_fmu: Path, tmp_path: Path) -> None:
    """In an FMU alone and in an SSP; FMI allows all characters but tabs and line ends."""
    name = "load torque, joint 1 (N.m)"
    spaced = rewritten(lag_fmu, tmp_path / "Spaced.fmu", ('name="y"', f'name="{name}"'))
    plain = hesr.simulate(lag_fmu, stop=1.0, step=0.1).signals["y"]
    np.testing.assert_array_equal(hesr.simulate(spaced, stop=1.0, step=0.1).signals[name], plain)
    first = lag("a", fmu="resources/Spaced.fmu").replace('"y"', f'"{name}"')
    connection = wire("a.Y", "b.u").replace('"Y"', f'"{name}"')
    path = ssp(system(first, lag("b"), wires=connection), {"resources/Spaced.fmu": spaced})
    signals = hesr.simulate(path, step=0.1).signals
    assert list(signals) == [f"a.{name}", "b.y"]
    np.testing.assert_array_equal(signals[f"a.{name}"], plain)


@pytest.mark.parametrize("relative", ["false", "true"])
def test_differences_are_converted_without_offset(
    relative: str, ssp: Any, wired: Any, lag_fmu: Path, tmp_path: Path
) -> None:
    """FMPy reads the attribute of types only."""
    unit = (
        '<Unit name="1">',
        '<Unit name="K"><BaseUnit K="1"/></Unit><Unit name="degC"><BaseUnit '
        'K="1" offset="273.15"/></Unit><Unit name="1">',
    )
    end = "</UnitDefinitions>"
    kind = f'<TypeDefinitions><SimpleType name="D"><Real relativeQuantity="{relative}"/>'
    types = (end, f"{end}{kind}</SimpleType></TypeDefinitions>")
    files = {}
    for name, variable, own in (("A", "y", "K"), ("B", "u", "degC")):
        text = f'<ScalarVariable name="{variable}"'
        with zipfile.ZipFile(lag_fmu) as archive:
            description = archive.read("modelDescription.xml").decode()
        begin = description.index(text)
        element = description[begin : description.index("</ScalarVariable>", begin)]
        other = element.replace('unit="1"', f'unit="{own}" declaredType="D"')
        assert other != element
        made = rewritten(lag_fmu, tmp_path / f"{name}.fmu", (element, other), unit, types)
        files[f"resources/{name}.fmu"] = made
    value = bindings(binding(more=inline(U)))
    parts = (
        lag(name, more, fmu=f"resources/{name.upper()}.fmu").replace(' unit="1"', "")
        for name, more in (("a", value), ("b", ""))
    )
    found = hesr.simulate(ssp(system(*parts, wires=wire("a.y", "b.u")), files), step=0.01)
    offset = 0.0 if relative == "true" else -273.15
    compared(found.signals, wired({"u": 2.0}, {}, (1.0, offset)))


def test_integers_that_do_not_fit_are_refused(ssp: Any, typed_fmu: Path) -> None:
    value = bindings(binding(more=inline(one("i", "Integer", "99999999999"))))
    path = ssp(system(typed("a", value)), {"resources/Typed.fmu": typed_fmu})
    said = r"'i' is of type Integer; it cannot be 99999999999; it must be an integer from -214748"
    with pytest.raises(ConfigError, match=said):
        hesr.simulate(path)


def test_transformations_that_do_not_fit_are_refused(ssp: Any, typed_fmu: Path) -> None:
    linear = '<ssc:LinearTransformation factor="2"/>'
    text = binding(more=inline(one("t", "String", "x")) + mapping("t", "a.s", linear))
    number = TABLE.format("Integer", "3", "x")
    table = binding(more=inline(one("n", "Integer", "3")) + mapping("n", "a.i", number))
    for root, said in (
        (
            system(typed("a"), typed("b"), wires=wire("a.so", "b.s", linear)),
            "does not fit the type String",
        ),
        (
            system(typed("a"), typed("b"), wires=wire("a.io", "b.i", linear)),
            "does not fit the type Integer",
        ),
        (
            system(typed("a"), more=bindings(text)),
            "component 'a': parameter 's': its transformation does not fit 'x'.",
        ),
        (
            system(typed("a"), more=bindings(table)),
            "system 'root': mapping of 'n': the map entry '3' = 'x'",
        ),
    ):
        path = ssp(root, {"resources/Typed.fmu": typed_fmu})
        with pytest.raises(ConfigError) as error:
            hesr.simulate(path)
        assert str(error.value) == OneSentence(f"{path}: ", said)


def test_times_default_to_those_of_the_file(ssp: Any) -> None:
    path = ssp(
        system(lag("a"), lag("b")), end='<ssd:DefaultExperiment startTime="1" stopTime="3"/>'
    )
    found = hesr.simulate(path)
    assert (found.t[0], found.end) == (1.0, 3.0)
    np.testing.assert_allclose(np.diff(found.t), 0.01, rtol=1e-9)  # of the FMUs
    assert hesr.simulate(path, start=2.0, stop=2.5, step=0.25).t.tolist() == [2.0, 2.25, 2.5]


REFUSED = {
    "element": (system(lag("a"), '<ssd:SignalDictionaryReference name="bus" dictionary="d"/>'),
                "element 'bus' is a SignalDictionaryReference, which is not supported."),
    "component": (system(lag("a", fmu="resources/b.ssd")),
                  "component 'a' is resources/b.ssd, no FMU, which is not supported."),
    "array": (system(lag("a").replace("<ssc:Real", '<ssd:Dimension size="2"/><ssc:Real', 1)),
              "connector 'a.u' is an array, which is not supported."),
    "index": (system(lag("a"), lag("b"), wires=wire("a.y", "b.u", endIndices="1")),
              "connection of 'b.u': an index is not supported."),
    "inside": (system(lag("a", bindings(binding("x.ssv").replace(
                   "source=", 'sourceBase="component" source=')))),
               "component 'a': a parameter source inside"),
    "value": (system(lag("a", bindings(binding(more=inline(U.replace("Real value", "Binary x")))))),
              "type Binary, which is not supported"),
    "binary": (system(lag("a", bindings(binding(more=inline(U.replace("Real", "Binary")))))),
               "type Binary, which is not supported"),
    "names": (system(lag("a"), lag("a")), "two elements are named 'a'."),
    "systems": (system(lag("a")) + system(lag("b")), "contains 2 systems"),
    "kind": (system(lag("a").replace('"output"', '"ouput"')),
             "connector 'a.y': kind is 'ouput'; did you mean 'output'"),
    "base": (system(lag("a", bindings(binding("x.ssv").replace(
                 "source=", 'sourceBase="componnt" source=')))),
             "component 'a': sourceBase is 'componnt'; did you mean 'component'?"),
    "no source": (system(lag("a", bindings(binding()))),
                  "component 'a': a parameter binding: attribute 'source' is missing."),
    "no mapping": (system(lag("a", bindings(binding(more=inline(U) + "<ssd:ParameterMapping/>")))),
                   "component 'a': a parameter mapping: attribute 'source' is missing."),
    "suppressed": (system(lag("a"), lag("b"),
                          wires=wire("a.y", "b.u", suppressUnitConversion="yes")),
                   "suppressUnitConversion is 'yes'; write true or false."),
    "other element": (system(lag("first"), lag("second"), wires=wire("frist.y", "second.u")),
                "a component of the system; did you mean 'first'?"),
    "connector": (system(lag("a"), ends=connector("speed", "input"), wires=wire("sped", "a.u")),
                  "the system has no such connector; did you mean 'speed'?"),
    "digits": (system(lag("a", bindings(binding(more=inline(one("T", "Real", "1_0")))))),
               "component 'a': parameter 'T' is '1_0', which is not of type Real."),
    "entry": (system(lag("a"), lag("b"), wires=wire("a.y", "b.u", TABLE.format(
                  "Boolean", "true", "x").replace(' target="x"', ""))),
              "the map entry 'true' = 'None' needs a source and a target."),
    "boolean": (system(lag("a"), lag("b"), wires=wire("a.y", "b.u", TABLE.format(
                    "Boolean", "true", "no"))),
                "the map entry 'true' = 'no': target is 'no'; write true or false."),
    "end": (system(lag("a"), wires=wire("c.y", "a.u")),
            "'c.y': 'c' is not a component"),
    "twice": (system(lag("a"), lag("b"), wires=wire("a.y", "b.u") + wire("b.y", "b.u")),
              "'b.u' is connected to 'a.y' and to 'b.y'."),
    "unit": (system(lag("a"), lag("b", unit="s"), wires=wire("a.y", "b.u")),
             "= 'a.y': 1 cannot be converted"),
    "zero": (system(lag("a"), lag("b", unit="none"), wires=wire("a.y", "b.u")),
             "= 'a.y': 1 cannot be converted"),
    "table": (system(lag("a"), lag("b"),
                     wires=wire("a.y", "b.u", TABLE.format("Integer", "x", "1"))),
              "the map entry 'x' = '1'"),
    "infinite": (system(lag("a"), lag("b"),
                        wires=wire("a.y", "b.u", '<ssc:LinearTransformation offset="1e999"/>')),
                 "connection 'b.u' = 'a.y': offset is '1e999'; it must be a number."),
    "factor": (system(lag("a"), lag("b"),
                      wires=wire("a.y", "b.u", '<ssc:LinearTransformation factor="x"/>')),
               "connection 'b.u' = 'a.y': factor is 'x'; it must be a number."),
}  # fmt: skip


@pytest.mark.parametrize(("root", "sentence"), REFUSED.values(), ids=REFUSED)
def test_other_parts_are_refused_by_name(root: str, sentence: str, ssp: Any) -> None:
    path = ssp(root)
    with pytest.raises(ConfigError) as error:
        hesr.simulate(path)
    assert str(error.value) == OneSentence(f"{path}: ", sentence)


def test_other_files_are_no_parameter_sets(ssp: Any) -> None:
    path = ssp(
        system(lag("a", bindings(binding("x.ssv")))), {"x.ssv": f"{MAPPING}</ssm:ParameterMapping>"}
    )
    with pytest.raises(
        ConfigError, match=r"x\.ssv is a ParameterMapping; it must be a ParameterSet"
    ):
        hesr.simulate(path)


def test_kinds_of_connectors_default_to_those_of_the_fmu(ssp: Any) -> None:
    """SSP 2.0 allows that."""
    path = ssp(
        system(
            lag("a").replace(' kind="output"', "").replace(' kind="input"', ""),
            lag("b"),
            wires=wire("b.u", "a.y"),
        )
    )
    assert list(hesr.simulate(path).signals) == ["a.y", "b.y"]


def test_unknown_names_and_missing_times_are_refused(ssp: Any) -> None:
    path = ssp(system(lag("a")))
    with pytest.raises(ConfigError, match=r"'set': 'a\.v' is not a variable"):
        hesr.simulate(path, set=["a.v=1"])
    path = ssp(system(lag("a")), end="")
    with pytest.raises(ConfigError, match="default experiment has no stopTime"):
        hesr.simulate(path)


def test_conversions_and_other_starts_are_not_exported(ssp: Any, tmp_path: Path) -> None:
    path = ssp(system(lag("a"), lag("b", unit="%"), wires=wire("a.y", "b.u")))
    with pytest.raises(ConfigError, match=r"connection of 'b\.u': a conversion cannot"):
        hesr.export(path, tmp_path / "x.ssp")
    path = ssp(system(lag("a")), end=LATE)
    with pytest.raises(ConfigError, match="starts at 1 s; exports"):
        hesr.export(path, tmp_path / "x.ssp")


@pytest.mark.ci  # starts many commands
def test_unsupported_and_contradicting_parts_are_findings(
    ssp: Any, lag_fmu: Path, tmp_path: Path
) -> None:
    assert check(lag_fmu).problems == ()
    path = ssp(system(lag("a"), '<ssd:SignalDictionaryReference name="bus" dictionary="d"/>'))
    assert [(f.check, f.severity) for f in check_ssp(path).problems] == [("ssp-support", "advice")]
    path = ssp(system(lag("a"), wires=wire("c.y", "a.u")))
    assert [(f.check, f.severity) for f in check_ssp(path).problems] == [("ssp-structure", "error")]
