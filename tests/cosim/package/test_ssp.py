"""Systems as SSP: valid, complete, and run by FMPy with the results of FMPy's own coupling."""

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy.ssp
import numpy as np
import pyssp_standard
import pytest
from couplings import delayed, error
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import Parameter, ParameterSet, read_ssd
from lxml import etree
from small_study import Hesr

from cosim.systems.simulation import System
from cosim.systems.system import SystemSpec, open_system
from fmu_src.export.record import MEMBER
from fmu_src.friction.friction_fmu import export_bare
from hesr.extras.ssp.contents import SystemContents, Version, read_contents
from hesr.extras.ssp.ssp import write_ssp
from hesr.extras.ssp.ssp_check import check_ssp
from hesr_model.errors import ConfigError
from hesr_model.friction.model import FrictionModel

Write = Callable[..., Path]

SCHEMAS: dict[Version, Path] = {
    "1.0": Path(fmpy.ssp.__file__).parent / "schema",
    "2.0": Path(pyssp_standard.__file__).parent / "resources/ssp2",
}
NAMES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
}


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def parsed(path: Path, name: str = "SystemStructure.ssd") -> etree._Element:
    return etree.fromstring(members(path)[name])


def start_values(path: Path) -> ParameterSet:
    """FMPy reads the parameter sets, but its runner needs a single one with full names."""
    parameters = [
        Parameter(name=f"{component.name}.{parameter.name}", value=parameter.value)
        for component in read_ssd(path).system.elements
        for binding in component.parameterBindings
        for values in binding.parameterValues
        for parameter in values.parameters
    ]
    return ParameterSet(parameters=parameters)


@pytest.mark.parametrize("version", SCHEMAS)
def test_the_files_are_valid(version: Version, either: SystemContents, tmp_path: Path) -> None:
    path = write_ssp(either, tmp_path / "system.ssp", version=version)
    schemas = {
        ".ssd": etree.XMLSchema(file=SCHEMAS[version] / "SystemStructureDescription.xsd"),
        ".ssv": etree.XMLSchema(file=SCHEMAS[version] / "SystemStructureParameterValues.xsd"),
    }
    files = [n for n in members(path) if not n.endswith(".fmu") and not n.startswith("extra/")]
    assert {Path(name).suffix for name in files} == set(schemas)
    for name in files:
        assert parsed(path, name).get("version") == version
        schemas[Path(name).suffix].assertValid(parsed(path, name))


def test_the_archive_is_complete(closed: SystemContents, tmp_path: Path) -> None:
    path = write_ssp(closed, tmp_path / "closed.ssp")
    names = ["arm", "trajectory", "body", "friction", "gravity", "controller"]
    fmus = {f"resources/{name}.fmu" for name in names}
    sets = {f"resources/{name}.ssv" for name in ("arm", "trajectory", "gravity", "controller")}
    found = {name: file for name, file in members(path).items() if not name.startswith("extra/")}
    assert found.keys() == {"SystemStructure.ssd"} | fmus | sets
    for component in closed.system.components:
        assert found[f"resources/{component.name}.fmu"] == component.fmu.read_bytes()
    root = parsed(path)
    assert [c.get("name") for c in root.iterfind(".//ssd:Component", NAMES)] == names
    connections = {
        (c.get("endElement"), c.get("endConnector")): (
            c.get("startElement"),
            c.get("startConnector"),
        )
        for c in root.iterfind(".//ssd:Connection", NAMES)
    }
    assert connections == closed.wiring.sources
    assert not root.findall("ssd:System/ssd:Connectors", NAMES)
    experiment = root.find("ssd:DefaultExperiment", NAMES)
    assert (experiment.get("startTime"), experiment.get("stopTime")) == ("0.0", "10.0")
    assert root.find(".//osp:FixedStepAlgorithm", NAMES).get("baseStepSize") == "0.005"
    assert root.find(".//oms:FixedStepMaster", NAMES).get("stepSize") == "0.005"
    assert root.find(".//osp:StepSizeHint", NAMES) is None


def test_every_connector_is_connected_or_observed(either: SystemContents, tmp_path: Path) -> None:
    """FMPy's runner treats the connection of another input as an unconnected one."""
    root = parsed(write_ssp(either, tmp_path / "system.ssp"))
    connectors = {
        (component.get("name"), connector.get("name")): connector.get("kind")
        for component in root.iterfind(".//ssd:Component", NAMES)
        for connector in component.iterfind(".//ssd:Connector", NAMES)
    }
    wiring = either.wiring
    assert {e for e, kind in connectors.items() if kind == "input"} == set(wiring.sources)
    assert {e for e, kind in connectors.items() if kind == "output"} == {
        *wiring.sources.values(),
        *wiring.observed,
    }


def test_a_check_lists_the_platforms_of_all_fmus(
    opened: SystemContents, table1: FrictionModel, tmp_path: Path
) -> None:
    path = write_ssp(opened, tmp_path / "open.ssp")
    assert check_ssp(path).coverage == "linux64; no binary for tools on Windows and macOS."
    both = export_bare(table1, tmp_path / "Friction.fmu", platforms=["linux64", "win64"])
    trajectory, friction = opened.system.components
    components = (trajectory, friction.model_copy(update={"fmu": both}))
    spec = opened.system.model_copy(update={"components": components})
    path = write_ssp(read_contents(spec, opened.path), tmp_path / "open.ssp")
    assert check_ssp(path).platforms == ("linux64",)
    windows = export_bare(table1, tmp_path / "Friction.fmu", platforms=["win64"])
    components = (trajectory, friction.model_copy(update={"fmu": windows}))
    spec = opened.system.model_copy(update={"components": components})
    path = write_ssp(read_contents(spec, opened.path), tmp_path / "open.ssp")
    assert check_ssp(path).coverage == "none that all its FMUs share."


def test_the_record_of_a_system_refers_to_those_of_its_fmus(
    opened: SystemContents, tmp_path: Path
) -> None:
    path = write_ssp(opened, tmp_path / "open.ssp")
    content = members(path)
    record = json.loads(content[MEMBER])
    assert set(record["records"]) == {name for name in content if name.endswith(".fmu")}
    for name, member in record["records"].items():
        fmu = zipfile.ZipFile(io.BytesIO(content[name]))
        assert (member in fmu.namelist()) if member else (MEMBER not in fmu.namelist())
        assert record["sha256"][name] == hashlib.sha256(content[name]).hexdigest()
    assert record["records"]["resources/friction.fmu"] == MEMBER
    assert check_ssp(path).record

    content["resources/more.txt"] = b"more"
    changed_path = tmp_path / "changed.ssp"
    with zipfile.ZipFile(changed_path, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    report = check_ssp(changed_path)
    assert not report.record
    assert "archive-changed" in {finding.check for finding in report.problems}


def test_units_are_those_of_the_fmus(closed: SystemContents, tmp_path: Path) -> None:
    path = write_ssp(closed, tmp_path / "closed.ssp")
    for name in ("SystemStructure.ssd", "resources/controller.ssv"):
        root = parsed(path, name)
        defined = {u.get("name"): dict(u[0].attrib) for u in root.iterfind(".//ssc:Unit", NAMES)}
        used = {node.get("unit") for node in root.iter() if node.get("unit")}
        assert used == defined.keys()
    parameter = parsed(path, "resources/controller.ssv").find(".//*[@name='Kv[2]']/ssv:Real", NAMES)
    assert dict(parameter.attrib) == {"value": "150.8", "unit": "N.m.s/rad"}
    assert defined["N.m.s/rad"] == {"kg": "1", "m": "2", "s": "-1", "rad": "-1"}


def test_an_enumeration_becomes_an_integer(closed: SystemContents, tmp_path: Path) -> None:
    root = parsed(write_ssp(closed, tmp_path / "closed.ssp"), "resources/controller.ssv")
    assert root.find(".//*[@name='compensation']/ssv:Integer", NAMES).get("value") == "3"


def test_a_component_step_is_a_hint(lags: Write, tmp_path: Path) -> None:
    path = lags()
    contents = read_contents(SystemSpec.read(path), path)
    root = parsed(write_ssp(contents, tmp_path / "lags.ssp"))
    hints = {
        component.get("name"): hint.get("value")
        for component in root.iterfind(".//ssd:Component", NAMES)
        for hint in component.iterfind(".//osp:StepSizeHint", NAMES)
    }
    assert hints == {"b": "0.2"}


def test_the_export_is_reproducible(closed: SystemContents, tmp_path: Path) -> None:
    again = read_contents(closed.system, closed.path)
    one, other = (
        write_ssp(contents, tmp_path / f"{i}.ssp") for i, contents in enumerate((closed, again))
    )
    assert one.read_bytes() == other.read_bytes()
    dates = {entry.date_time[:3] for entry in zipfile.ZipFile(one).infolist()}
    newest = max(d.generationDateAndTime for d in closed.descriptions.values())
    assert dates == {tuple(map(int, newest[:10].split("-")))}
    assert parsed(one).get("generationDateAndTime") == newest


@pytest.mark.parametrize(
    "either", ["opened", pytest.param("closed", marks=pytest.mark.ci)], indirect=True
)
def test_fmpy_runs_the_system(either: SystemContents, tmp_path: Path) -> None:
    """FMPy accumulates its steps, so round-off of its times affects a motion."""
    path = write_ssp(either, tmp_path / "system.ssp")
    step = either.system.step
    got = simulate_ssp(
        path, step_size=step, stop_time=10.0 - 0.5 * step, parameter_set=start_values(path)
    )
    assert len(got) == 2000
    observed = either.wiring.observed
    found = np.column_stack([got[".".join(element)] for element in observed])
    assert error(found, delayed(either, observed, len(got))) <= 1e-9


def test_an_ssp_is_read_back(either: SystemContents, tmp_path: Path) -> None:
    path = write_ssp(either, tmp_path / "system.ssp")
    with open_system(path) as spec:
        back = read_contents(spec, path)
        assert write_ssp(back, tmp_path / "again.ssp").read_bytes() == path.read_bytes()
        got = System(spec.model_copy(update={"stop": 1.0}), path).run()
    expected = System(either.system.model_copy(update={"stop": 1.0}), path).run()
    for name, values in expected.signals.items():
        np.testing.assert_array_equal(got.signals[name], values)


def with_coupling(path: Path, changed: Path, coupling: bytes) -> Path:
    """Copy an SSP with another element in the place of its coupling."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name.endswith(".ssd"):
                content, count = re.subn(rb"<hesr:Coupling [^>]*/>", coupling, content)
                assert count == 1
            new.writestr(name, content)
    return changed


@pytest.mark.parametrize("order", ["gauss_seidel", "jacobi"])
def test_the_declared_coupling_is_read_back(
    order: str, lags: Write, tmp_path: Path, hesr: Hesr
) -> None:
    """TOML and SSP give the same rows, other ones than the other order."""
    path = lags(("step = 0.1", f'step = 0.1\norder = "{order}"'))
    ssp = tmp_path / "lags.ssp"
    assert hesr("export", path, "-o", ssp).code == 0
    expected = System.read(path)
    assert expected.spec.order == System.read(ssp).spec.order == order
    rows = expected.run().signals["b.y"]
    np.testing.assert_array_equal(System.read(ssp).run().signals["b.y"], rows)
    swapped = {"gauss_seidel": b"jacobi", "jacobi": b"gauss_seidel"}[order]
    element = b'<hesr:Coupling order="' + swapped + b'" />'
    other = System.read(with_coupling(ssp, tmp_path / "other.ssp", element)).run()
    assert np.abs(other.signals["b.y"] - rows).max() > 1e-3


def test_an_unknown_coupling_is_refused(lags: Write, tmp_path: Path) -> None:
    path = lags()
    ssp = write_ssp(read_contents(SystemSpec.read(path), path), tmp_path / "lags.ssp")
    waveform = b'<hesr:Coupling order="waveform" />'
    changed = with_coupling(ssp, tmp_path / "other.ssp", waveform)
    with pytest.raises(ConfigError, match=r"its coupling is 'waveform'.*gauss_seidel.*jacobi"):
        System.read(changed)
    with pytest.raises(ConfigError, match=r"attribute 'order' is missing"):
        System.read(with_coupling(ssp, changed, b"<hesr:Coupling />"))


def test_the_coupling_of_other_tools_is_gauss_seidel(lags: Write, tmp_path: Path) -> None:
    """SSP does not define it; the order is that of the components in the file."""
    path = lags(("step = 0.1", 'step = 0.1\norder = "jacobi"'))
    ssp = write_ssp(read_contents(SystemSpec.read(path), path), tmp_path / "lags.ssp")
    assert System.read(with_coupling(ssp, tmp_path / "o.ssp", b"")).spec.order == "gauss_seidel"


def test_an_ssp_is_simulated(lags: Write, tmp_path: Path, hesr: Hesr) -> None:
    """Run from another folder, without any file of the system next to it."""
    path = lags()
    ssp = tmp_path / "elsewhere" / "lags.ssp"
    answer = hesr("export", path, "-o", ssp)
    assert answer.code == 0
    assert answer.out.endswith(f"Written: {ssp}\n")
    results = [tmp_path / "toml.csv", tmp_path / "ssp.csv"]
    for system, result in zip((path, ssp), results, strict=True):
        assert hesr("simulate", system, "-o", result).code == 0
        path.unlink(missing_ok=True)
    assert results[0].read_bytes() == results[1].read_bytes()


def test_omissions_of_an_ssp_are_reported(lags: Write, tmp_path: Path, hesr: Hesr) -> None:
    path = lags(
        ('"b.y"]', '"b.y", "b.u", "a.u", "a.T", "a.x"]\nlimits = { "a.y" = [-9.0, 9.0] }'),
        ("step = 0.2\n", ""),
    )
    answer = hesr("export", path, "-o", tmp_path / "lags.ssp")
    assert (answer.code, answer.err) == (
        0,
        "hesr: The SSP observes outputs only, not 'b.u', 'a.u', 'a.T', 'a.x', and has no limits of "
        "'a.y'.\n",
    )
