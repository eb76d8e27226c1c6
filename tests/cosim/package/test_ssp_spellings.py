"""SSPs as other tools spell them: names of the system, units, paths, prefixes, values, loops."""

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from containing import OneSentence
from small_study import Hesr

import hesr as interface

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

    def make(*changes: tuple[str, str], separator: str = "/") -> Path:
        files = {"SystemStructure.ssd": SSD, "resources/own.ssv": SET}
        for old, new in changes:
            assert any(old in text for text in files.values())
            files = {name: text.replace(old, new) for name, text in files.items()}
        path = tmp_path / "made.ssp"
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in files.items():
                archive.writestr(name.replace("/", separator), text)
            archive.writestr(f"resources{separator}Lag.fmu", lag_fmu.read_bytes())
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
