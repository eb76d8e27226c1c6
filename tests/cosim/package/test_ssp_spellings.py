"""SSPs as other tools spell them: names of the system, units, paths, prefixes, values, loops."""

import io
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from containing import OneSentence
from small_study import Hesr

import hesr as interface
from cosim.systems.system import open_system
from fmu_src.run.archive import Archive
from fmu_src.run.variables import Variables, read_packed_description
from hesr_model.errors import SimulationError

SSP = "http://ssp-standard.org/SSP1/SystemStructure"
PARTS = ("Common", "Description", "ParameterValues")
DECLARED = "".join(
    f' xmlns:{prefix}="{SSP}{name}"'
    for prefix, name in zip(("ssc", "ssd", "ssv"), PARTS, strict=True)
)
SET = (
    f'<ssv:ParameterSet version="1.0" name="p"{DECLARED}><ssv:Parameters>'
    '<ssv:Parameter name="T"><ssv:Real value="0.25" unit="s"/></ssv:Parameter>'
    "</ssv:Parameters></ssv:ParameterSet>"
)
SSD = f"""<ssd:SystemStructureDescription version="1.0" name="made"{DECLARED}>
<ssd:System name="root"><ssd:Connectors>
<ssd:Connector name="doubled" kind="output"><ssc:Real unit="half"/></ssd:Connector>
<ssd:Connector name="plain" kind="output"><ssc:Real/></ssd:Connector></ssd:Connectors>
<ssd:Elements><ssd:Component name="a" source="resources/Lag.fmu"><ssd:Connectors>
<ssd:Connector name="u" kind="input"><ssc:Real unit="1"/></ssd:Connector>
<ssd:Connector name="y" kind="output"><ssc:Real unit="1"/></ssd:Connector></ssd:Connectors>
<ssd:ParameterBindings><ssd:ParameterBinding source="resources/own.ssv"/></ssd:ParameterBindings>
</ssd:Component></ssd:Elements><ssd:Connections>
<ssd:Connection startElement="a" startConnector="y" endElement="" endConnector="doubled"/>
<ssd:Connection startElement="a" startConnector="y" endConnector="plain"/>
</ssd:Connections></ssd:System>
<ssd:Units><ssc:Unit name="half"><ssc:BaseUnit factor="0.5"/></ssc:Unit>
<ssc:Unit name="1"><ssc:BaseUnit/></ssc:Unit></ssd:Units>
<ssd:DefaultExperiment startTime="0" stopTime="1"/></ssd:SystemStructureDescription>"""
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path, lag_fmu: Path) -> Write:
    """Write an SSP with a text of its files replaced, and folders separated by a mark."""

    def make(
        *changes: tuple[str, str], separator: str = "/", fmu: bytes = lag_fmu.read_bytes()
    ) -> Path:
        files = {"SystemStructure.ssd": SSD, "resources/own.ssv": SET}
        for old, new in changes:
            assert any(old in text for text in files.values())
            files = {name: text.replace(old, new) for name, text in files.items()}
        path = tmp_path / "made.ssp"
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in files.items():
                archive.writestr(name.replace("/", separator), text)
            archive.writestr(f"resources{separator}Lag.fmu", fmu)
        return path

    return make


def test_outputs_of_the_system_are_in_the_result(write: Write) -> None:
    signals = interface.simulate(write(), step=0.1).signals
    assert set(signals) == {"a.y", "doubled", "plain"}
    np.testing.assert_array_equal(signals["plain"], signals["a.y"])
    np.testing.assert_allclose(signals["doubled"], 2.0 * signals["a.y"], rtol=1e-15)
    assert np.ptp(signals["a.y"]) > 0.1


@pytest.mark.parametrize(
    ("changes", "separator", "warning"),
    [
        ((), "\\", "backslashes separate"),
        ((("resources/own.ssv", r"resources\own.ssv"),), "/", ""),
        ((("ssd:Connect", "ssv:Connect"), ("<ssv:Real", "<ssd:Real")), "/", ""),
        ((("resources/Lag.fmu", r".\resources\Lag.fmu"),), "\\", "backslashes separate"),
        ((('unit="s"', 'unit="[s]"'),), "/", "'[s]' is not defined"),
        (((f' xmlns:ssv="{SSP}ParameterValues"', ""),), "/", ""),
    ],
)
def test_other_spellings_give_the_same_result(
    changes: tuple[tuple[str, str], ...],
    separator: str,
    warning: str,
    write: Write,
    hesr: Hesr,
    tmp_path: Path,
) -> None:
    results = []
    for path in (lambda: write(), lambda: write(*changes, separator=separator)):
        answer = hesr("simulate", path(), "-o", tmp_path / "x.csv")
        assert answer.code == 0, answer.err
        results.append((tmp_path / "x.csv").read_bytes())
    assert results[0] == results[1]
    assert (warning in answer.err) if warning else not answer.err


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("0.25", "0,25", "'0,25', which is not of type Real; write a decimal point."),
        ('Real value="0.25" unit="s"', 'Boolean value="Yes"', "is 'Yes'; write true or false."),
        ('startConnector="y" endElement', 'startConnector="yy" endElement', "did you mean 'y'"),
    ],
)
def test_values_that_cannot_be_read_are_refused(
    old: str, new: str, sentence: str, write: Write, hesr: Hesr, tmp_path: Path
) -> None:
    answer = hesr("simulate", write((old, new)), "-o", tmp_path / "x.csv")
    assert answer.code == 2
    assert answer.err == OneSentence(sentence)
    assert "files/" not in answer.err  # no folder where it was unpacked


ALGORITHM = """<ssd:DefaultExperiment startTime="0" stopTime="1"><ssd:Annotations>
<ssc:Annotation type="com.opensimulationplatform"><osp:FixedStepAlgorithm xmlns:osp="urn:osp"
baseStepSize="BASE"/></ssc:Annotation></ssd:Annotations></ssd:DefaultExperiment>"""
EXPERIMENT = '<ssd:DefaultExperiment startTime="0" stopTime="1"/>'
HINT = """<ssd:Annotations><ssc:Annotation type="com.opensimulationplatform"><osp:StepSizeHint
xmlns:osp="urn:osp" value="HINT"/></ssc:Annotation></ssd:Annotations></ssd:Component>"""
COUPLING = """<ssd:Annotations><ssc:Annotation type="hesr.coupling"><c:Coupling
xmlns:c="urn:hesr:coupling:1" order="random"/></ssc:Annotation></ssd:Annotations></ssd:System>"""


def set_steps(base: str, hint: str) -> tuple[tuple[str, str], ...]:
    """Return the changes of an SSD with a step [s] of the system and of its component."""
    steps = (EXPERIMENT, ALGORITHM.replace("BASE", base))
    return steps, ("</ssd:Component>", HINT.replace("HINT", hint))


@pytest.mark.parametrize(
    ("base", "hint", "count", "warning"),
    [
        ("0.1", "0.2", 11, ""),
        ("0.1", "0.25", 11, "is no multiple"),
        ("0.1", "0", 11, ""),
        ("0.3", "0.3", 4, "the run ends at 0.9 s"),
    ],
)
def test_systems_of_several_steps_run(
    base: str, hint: str, count: int, warning: str, write: Write, hesr: Hesr, tmp_path: Path
) -> None:
    output = tmp_path / "x.csv"
    answer = hesr("simulate", write(*set_steps(base, hint)), "-o", output)
    assert answer.code == 0, answer.err
    assert len(output.read_text(encoding="utf-8").splitlines()) == count + 1
    assert (warning in answer.err) if warning else not answer.err
    assert hesr("check", write(*set_steps(base, hint)), "--fail-on", "warning").code == 0


@pytest.mark.parametrize(
    ("base", "hint", "key", "value"),
    [
        ("0.1", "0.25", "step", "0.05"),
        ("0.3", "0", "step", "0.25"),
        ("0.3", "0", "stop", "0.9"),
    ],
)
def test_printed_times_work(
    base: str, hint: str, key: str, value: str, write: Write, hesr: Hesr, tmp_path: Path
) -> None:
    """Each is the value that the warning describes."""
    system = write(*set_steps(base, hint))
    warning = hesr("simulate", system, "-o", tmp_path / "x.csv").err
    assert key in re.findall(r"'(stop|step)'", warning.partition(": give ")[2])
    answer = hesr("simulate", system, f"--{key}", value, "-o", tmp_path / "y.csv")
    assert (answer.code, answer.err) == (0, "")


NO_FMU = ((SSD[SSD.index("<ssd:Elements>") : SSD.index("</ssd:System>")], ""),)
REFUSALS: dict[str, tuple[tuple[tuple[str, str], ...], str]] = {
    "no FMU": (NO_FMU, "SystemStructure.ssd contains no FMU"),
    "base step": (set_steps("fast", "1"), "baseStepSize is 'fast'; it must be"),
    "hint": (set_steps("0.1", "slow"), "StepSizeHint of 'a' is 'slow'"),
    "times": ((('stopTime="1"', 'stopTime="-1"'),), "it stops at -1 s and"),
    "order": ((("</ssd:System>", COUPLING),), "its coupling is 'random'"),
    "infinite": ((("0.25", "INF"),), "parameter 'T' is 'INF'; it must be"),
}


@pytest.mark.parametrize(("changes", "sentence"), REFUSALS.values(), ids=REFUSALS)
def test_systems_that_cannot_run_are_refused_in_plain_words(
    changes: tuple[tuple[str, str], ...], sentence: str, write: Write, hesr: Hesr, tmp_path: Path
) -> None:
    path = write(*changes)
    answer = hesr("simulate", path, "-o", tmp_path / "x.csv")
    assert answer.code == 2
    assert answer.err == OneSentence(f"hesr: {path}: ", sentence)
    assert "nput should" not in answer.err  # words of a library


def edit_fmu(fmu: Path, *changes: tuple[str, str]) -> bytes:
    """Return an FMU without binaries and with its description changed by patterns."""
    content = io.BytesIO()
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(content, "w") as new:
        text = old.read("modelDescription.xml").decode()
        for pattern, replacement in changes:
            text = re.sub(pattern, replacement, text, flags=re.DOTALL)
        new.writestr("modelDescription.xml", text)
    return content.getvalue()


FMUS = {
    "no archive": (None, "not a readable FMU"),
    "no binary": ((), "has no binary for this platform"),
    "cut": (((r"<ModelVariables>.*", ""),), "not a readable FMU"),
    "identifier": (((r'modelIdentifier="\w+"', 'modelIdentifier="../x"'),), "is '../x'; expected"),
    "model exchange": (((r"<CoSimulation.*</CoSimulation>", ""),), "for model exchange only"),
}


@pytest.mark.parametrize(("changes", "sentence"), FMUS.values(), ids=FMUS)
def test_fmus_are_named_as_in_the_ssp(
    changes: tuple[tuple[str, str], ...] | None,
    sentence: str,
    lag_fmu: Path,
    write: Write,
    hesr: Hesr,
    tmp_path: Path,
) -> None:
    fmu = b"no archive" if changes is None else edit_fmu(lag_fmu, *changes)
    path = write(fmu=fmu)
    answer = hesr("simulate", path, "-o", tmp_path / "x.csv")
    assert answer.code == 2
    assert answer.err == OneSentence(f"hesr: {path}: ", sentence)
    assert "files/" not in answer.err  # no folder where it was unpacked


TYPED = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="1">
<CoSimulation modelIdentifier="m"/><TypeDefinitions><EnumerationType name="Mode">
<Item name="slow" value="1"/><Item name="very fast" value="5000000000"/></EnumerationType>
</TypeDefinitions><ModelVariables>
<Float64 name="u" valueReference="1" causality="input" start="0"/>
<Float64 name="y" valueReference="2" causality="output"/>
<Enumeration name="T" valueReference="3" causality="parameter" variability="fixed"
  declaredType="Mode" start="1"/></ModelVariables><ModelStructure/></fmiModelDescription>"""


def read_start(path: Path, values: dict[str, str]) -> dict[str, float | str]:
    """Return the start values of the only component as its FMU takes them."""
    with open_system(path, {}, values) as system:
        (component,) = system.components
        with Archive(component.fmu) as archive:
            description, declared = read_packed_description(archive)
        return Variables(component.fmu, description, declared).expand_values(component.start)


@pytest.mark.parametrize(
    ("value", "number"),
    [("slow", 1), ("very fast", 5000000000), ("1", 1), ("5000000000", 5000000000)],
)
def test_enumerations_of_fmi_3_are_set_by_name_or_number(
    value: str, number: int, write: Write
) -> None:
    """By a parameter set, and by the user."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("modelDescription.xml", TYPED)

    def name_choice(choice: str) -> Path:
        named = f'<ssv:Enumeration value="{choice}"/>'
        return write(('<ssv:Real value="0.25" unit="s"/>', named), fmu=content.getvalue())

    assert read_start(name_choice(value), {}) == {"T": number}
    assert read_start(name_choice("slow"), {"a.T": value}) == {"T": number}
    with pytest.raises(SimulationError, match="cannot be 'fast'; it must be one of slow, very"):
        read_start(name_choice("fast"), {})


LOOP = """
name = "loop"
step = 0.1
stop = 1.0
observe = ["a.y", "b.y"]
[[components]]
name = "a"
fmu = "{fmu}"
start = {{ x_start = 2.0 }}
[[components]]
name = "b"
fmu = "{fmu}"
[connections]
"b.u" = "a.y"
"a.u" = "b.y"
"""


def test_loops_of_undeclared_dependencies_run_in_an_order(
    lag_fmu: Path, tmp_path: Path, hesr: Hesr
) -> None:
    """Without its dependencies, each output of the lag could depend on the input at once."""
    undeclared = tmp_path / "Undeclared.fmu"
    with zipfile.ZipFile(lag_fmu) as old, zipfile.ZipFile(undeclared, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                text = data.decode()
                outputs = re.search(r"<Outputs>.*?</Outputs>", text, re.DOTALL)
                assert outputs is not None
                bare = re.sub(r' dependencies(Kind)?="[^"]*"', "", outputs[0])
                assert bare != outputs[0]
                data = text.replace(outputs[0], bare).encode()
            new.writestr(name, data)
    for name, fmu in (("known", lag_fmu), ("loop", undeclared)):
        (tmp_path / f"{name}.toml").write_text(LOOP.format(fmu=fmu), encoding="utf-8")
    refusal = hesr("simulate", tmp_path / "loop.toml", "-o", tmp_path / "x.csv")
    assert refusal.code == 2
    assert refusal.err == OneSentence("algebraic loop", "--order")
    results = {}
    for order in ("jacobi", "gauss_seidel"):
        for name in ("known", "loop"):
            output = tmp_path / f"{name}_{order}.csv"
            system = tmp_path / f"{name}.toml"
            answer = hesr("simulate", system, "--order", order, "-o", output)
            assert answer.code == 0, answer.err
            results[name, order] = output.read_bytes()
        assert results["loop", order] == results["known", order]
    assert results["loop", "jacobi"] != results["loop", "gauss_seidel"]
    single = hesr("simulate", undeclared, "--order", "jacobi", "-o", tmp_path / "x.csv")
    assert (single.code, "--order" in single.err) == (2, True)
