"""`hesr simulate X.fmu`: FMUs of other tools by themselves, always in the sandbox."""

import csv
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pythonfmu.builder import FmuBuilder
from small_fmus import lag
from small_study import Hesr, hesr_here

import hesr
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.trust import remember
from hesr_model.errors import ConfigError, SimulationError


@pytest.fixture(scope="session")
def typed_fmu(shared: Any) -> Path:
    slave = Path(__file__).with_name("typed_slave.py")
    made: Path = shared("typed", lambda folder: FmuBuilder.build_FMU(slave, dest=folder))
    return made / "Typed.fmu"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def edited(fmu: Path, path: Path, *changes: tuple[str, str]) -> Path:
    """Copy an FMU with its description changed by patterns."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                text = data.decode()
                for pattern, to in changes:
                    text, count = re.subn(pattern, to, text, flags=re.DOTALL)
                    assert count
                data = text.encode()
            new.writestr(name, data)
    return path


def exact(t: Any) -> Any:
    """The lag T x' = u - x with T = 0.5 from 0.25, for u = 2."""
    return 2.0 + (0.25 - 2.0) * np.exp(-t / 0.5)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_both_versions_and_kinds_are_simulated(fmi: Any, kind: str, tmp_path: Path) -> None:
    whole = lag(tmp_path, fmi)
    other = {"CoSimulation": "ModelExchange", "ModelExchange": "CoSimulation"}[kind]
    fmu = edited(whole, tmp_path / "One.fmu", (rf"<{other} [^>]*(/>|>.*?</{other}>)", ""))
    found = hesr.simulate(fmu, stop=1.0, step=0.1, set=["u=2"])
    np.testing.assert_allclose(found.t[[0, -1]], [0.0, 1.0])
    tolerance = 1e-12 if kind == "CoSimulation" else 1e-3
    np.testing.assert_allclose(found.signals["y"], exact(found.t), rtol=tolerance)


def test_inputs_and_outputs_have_every_type(typed_fmu: Path, tmp_path: Path, run: Hesr) -> None:
    table = tmp_path / "in.csv"
    table.write_text("time,r,i,b\n0,0,1,0\n0.5,1,1,1\n1,2,7,1\n", encoding="utf-8")
    output = tmp_path / "out.csv"
    times = ("--start", "0", "--stop", "1", "--step", "0.25")
    values = ("--set", "gain=3", "--set", "s=some text")
    answer = run("simulate", typed_fmu, *times, *values, "--input", table, "-o", output)
    assert answer.code == 0, answer.err
    head, *rows = csv.reader(output.read_text(encoding="utf-8").splitlines())
    assert head == ["t", "ro", "io", "bo", "so"]
    columns = list(zip(*rows, strict=True))
    assert list(map(float, columns[0])) == [0.0, 0.25, 0.5, 0.75, 1.0]
    # Each step holds the inputs of its beginning; only Reals are interpolated.
    np.testing.assert_allclose(list(map(float, columns[1])), [0.0, 0.0, 1.5, 3.0, 4.5])
    assert columns[2] == ("0", "1", "1", "1", "1")
    assert columns[3] == ("false", "false", "false", "true", "true")
    assert set(columns[4][1:]) == {"some text"}


def test_values_of_every_type_are_read_in_this_process(typed_fmu: Path) -> None:
    remember(typed_fmu)
    with FmuInstance(typed_fmu) as typed:
        typed.set({"i": 7, "b": True, "s": "text"})
        typed.initialise()
        typed.step(0.0, 0.1)
        for kind, name, value in (
            ("Integer", "io", 7),
            ("Boolean", "bo", 1),
            ("String", "so", "text"),
        ):
            references = typed.variables.references([name], kind)
            assert typed._instance.get(kind, references) == [value]


def test_times_are_those_of_the_file(lag_fmu: Path, tmp_path: Path) -> None:
    own = (r"<DefaultExperiment.*?/>", '<DefaultExperiment startTime="1" stopTime="3"/>')
    found = hesr.simulate(edited(lag_fmu, tmp_path / "F.fmu", own))
    assert (found.t[0], found.end) == (1.0, 3.0)


def test_fmus_run_in_the_sandbox_alone(lag_fmu: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmu_src.run.single.SECONDS", 0.01)
    with pytest.raises(SimulationError, match=r"its simulation gave no answer within 0\.01 s"):
        hesr.simulate(lag_fmu)


FMI_1 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="1.0" modelName="L" modelIdentifier="L" guid="1"
  numberOfContinuousStates="0" numberOfEventIndicators="0"><ModelVariables><ScalarVariable name="y"
  valueReference="1" causality="output"><Real/></ScalarVariable></ModelVariables>
</fmiModelDescription>"""


def test_other_versions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "F.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", FMI_1)
    with pytest.raises(ConfigError, match=r"is of FMI 1\.0; export it for FMI 2\.0 or 3\.0\."):
        hesr.simulate(path)


def test_scheduled_execution_is_refused(tmp_path: Path) -> None:
    scheduled = '<ScheduledExecution modelIdentifier="lag"/>'
    kinds = (r"<ModelExchange .*?/>", ""), (r"<CoSimulation .*?/>", scheduled)
    path = edited(lag(tmp_path, 3), tmp_path / "F.fmu", *kinds)
    with pytest.raises(ConfigError, match=r"for scheduled execution only; export it for co-sim"):
        hesr.simulate(path)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"stop": -1.0}, "--stop is -1 s, not after the start, 0 s."),
        ({"step": 1e-9}, "--step is 1e-09 s; at most 1000000 steps are run."),
        ({"set": ["u"]}, "--set is 'u'; expected NAME=VALUE, such as gain=2."),
        ({"set": ["y=1"]}, "--set 'y' has no start value that can be set."),
        ({"set": ["v=1"]}, "there is no variable 'v'"),
        ({"set": ["u=x"]}, "'u' cannot be 'x'; it has no choices."),
        ({"input": "time,y\n0,1\n1,1\n"}, "--input has the column 'y', which is not an input."),
        ({"input": "t,u\n0,1\n1,1\n"}, "there is no variable 't'"),
        ({"input": "u\n0\n1\n"}, "--input has no column 'time'."),
        ({"input": "time,u\n1,0\n0,1\n"}, "--input has times that decrease."),
    ],
)
def test_wrong_options_are_refused(
    options: dict[str, Any], sentence: str, lag_fmu: Path, tmp_path: Path
) -> None:
    if "input" in options:
        (tmp_path / "in.csv").write_text(options["input"], encoding="utf-8")
        options = {"input": tmp_path / "in.csv"}
    with pytest.raises((ConfigError, SimulationError), match=re.escape(sentence)):
        hesr.simulate(lag_fmu, **options)


def test_failures_are_reported_by_one_sentence(lag_fmu: Path) -> None:
    with pytest.raises(SimulationError, match=r"failed with '"):
        hesr.simulate(lag_fmu, stop=1.0, step=0.1, set=["refused=0.35"])
