"""`hesr simulate X.fmu`: an FMU as a system of one component."""

import csv
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile import archived, infected
from pythonfmu.builder import FmuBuilder
from small_fmus import lag
from small_study import Hesr, hesr_here

import hesr
from fmu_src.export.toolchain import TARGETS, build
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.instance import _Fmi3
from fmu_src.run.trust import remember
from hesr_model.errors import ArgumentError, ConfigError, SimulationError


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


@pytest.mark.parametrize("text", ["true", "false"])
def test_the_words_of_a_boolean_are_its_values(text: str, typed_fmu: Path) -> None:
    found = hesr.simulate(typed_fmu, stop=0.2, step=0.1, set=[f'b="{text}"'])
    assert found.signals["bo"][-1] == (text == "true")


@pytest.mark.parametrize(("stop", "has_stop"), [(None, False), (2.0, True)])
def test_an_experiment_of_fmi_3_has_no_tolerance(stop: float | None, has_stop: bool) -> None:
    """A tolerance of 0 would be one that no solver can keep."""
    calls: list[tuple[Any, ...]] = []
    _Fmi3().enter(lambda *arguments: calls.append(arguments), 0.5, stop)
    ((name, *experiment),) = calls
    assert name == "fmi3EnterInitializationMode"
    values = [getattr(value, "value", value) for value in experiment]
    assert values == [False, 0.0, 0.5, has_stop, stop or 0.0]


def test_times_are_those_of_the_file(lag_fmu: Path, tmp_path: Path) -> None:
    own = (r"<DefaultExperiment.*?/>", '<DefaultExperiment startTime="1" stopTime="3"/>')
    found = hesr.simulate(edited(lag_fmu, tmp_path / "F.fmu", own))
    assert (found.t[0], found.end) == (1.0, 3.0)


def test_calls_have_the_timeout_of_systems(
    lag_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    foreign = edited(lag_fmu, tmp_path / "F.fmu", ("A first-order lag", "A foreign lag"))
    # Shorter than any answer of a process.
    monkeypatch.setattr("cosim.systems.simulation.SECONDS", 1e-6)
    with pytest.raises(SimulationError, match="within 1e-06 s and was ended"):
        hesr.simulate(foreign)


@pytest.fixture(scope="session")
def hostile_lag(lag_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return infected(lag_fmu, tmp_path_factory.mktemp("hostile") / "Lag.fmu")


@pytest.mark.parametrize("status", [-77, -1, 2, 3, 4, 6])
@pytest.mark.parametrize("call", ["fmi2GetReal", "fmi2DoStep"])
def test_statuses_that_are_no_success_end_the_command(
    call: str, status: int, hostile_lag: Path, run: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DEED", f"{call} status {status}")
    answer = run("simulate", hostile_lag, "--stop", "1", "--step", "0.1")
    assert answer.code == 2
    assert f"{call} failed with status {status} " in " ".join(answer.err.split())


def test_outputs_that_are_not_finite_end_the_command(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DEED", "fmi2GetReal nan")
    with pytest.raises(SimulationError, match=r"fmu\.y is not a finite number"):
        hesr.simulate(hostile_lag, stop=1.0, step=0.1)


ENDS_EARLY = {
    2: {
        "fmi2_step.c": (
            ("*value = fmi2False;", "*value = fmi2True;"),
            (r"\(fmi2DoStep\)[^;{]*\{", r"\g<0> if (time > 0.25) { return fmi2Discard; }"),
        )
    },
    3: {
        "fmi3_step.c": (
            ("*last = component->time;", "*last = component->time; *terminate = time > 0.25;"),
        )
    },
}
"""Changes of C sources by which the step that begins at 0.3 s ends the simulation."""


def rebuild(whole: Path, changed_files: Mapping[str, Any], path: Path) -> Path:
    """Write an FMU from one of ours with changed C sources, patterns with replacements."""
    with zipfile.ZipFile(whole) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    folder = path.with_suffix("")
    folder.mkdir()
    for name, content in members.items():
        if name.startswith("sources/"):
            (folder / Path(name).name).write_bytes(content)
    for name, changes in changed_files.items():
        text = (folder / name).read_text(encoding="utf-8")
        for pattern, to in changes:
            text, count = re.subn(pattern if "\\(" in pattern else re.escape(pattern), to, text)
            assert count
        (folder / name).write_text(text, encoding="utf-8")
    library = next(n for n in members if n.startswith("binaries/") and n.endswith(".so"))
    members[library] = build(folder / "all.c", "lag", TARGETS["linux64"])
    return archived(members, path)


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_that_ends_its_run_early_says_so(fmi: Any, tmp_path: Path, run: Hesr) -> None:
    early = rebuild(lag(tmp_path, fmi), ENDS_EARLY[fmi], tmp_path / "Early.fmu")
    output = tmp_path / "out.csv"
    answer = run("simulate", early, "--stop", "1", "--step", "0.1", "-o", output)
    said = " ".join(answer.err.split())
    assert answer.code == 2
    assert f"at t = 0.3 s: fmi{fmi}DoStep requested termination; the results so far" in said
    assert len(output.read_text(encoding="utf-8").splitlines()) == 5  # heading, 0 to 0.3 s


LOGS_AND_FAILS = {
    "fmi2_step.c": (
        (
            r"\(fmi2DoStep\)[^;{]*\{",
            r"""\g<0> if (time > 0.25) {
                Instance *failed = c;
                failed->host.logger(failed->host.componentEnvironment, "a", STATUS, "info",
                                    "Valve 7 is stuck.");
                return fmi2Error;
            }""",
        ),
    )
}
"""A change of C sources by which the step that begins at 0.3 s logs with a status, then fails."""


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        ("fmi2Error", "Valve 7 is stuck."),
        (
            "fmi2OK",
            "fmi2DoStep failed with status 3 (error); its last message is: Valve 7 is stuck.",
        ),
    ],
)
@pytest.mark.parametrize("trust", [True, False])
def test_a_failed_call_shows_the_message_of_the_fmu(
    trust: bool, status: str, reason: str, lag_fmu: Path, tmp_path: Path
) -> None:
    ((pattern, failure),) = LOGS_AND_FAILS["fmi2_step.c"]
    changed_files = {"fmi2_step.c": ((pattern, failure.replace("STATUS", status)),)}
    fmu = rebuild(lag_fmu, changed_files, tmp_path / "Failing.fmu")
    with pytest.raises(SimulationError) as error:
        hesr.simulate(fmu, stop=1.0, step=0.1, trust=trust)
    assert str(error.value).startswith(f"Failing.fmu ('fmu') at t = 0.3 s: {reason}")


INTEGERS = {
    "Int8": (-128, 127),
    "UInt8": (0, 255),
    "Int16": (-32768, 32767),
    "UInt16": (0, 65535),
    "Int32": (-(2**31), 2**31 - 1),
    "UInt32": (0, 2**32 - 1),
    "Int64": (-(2**63), 2**63 - 1),
    "UInt64": (0, 2**64 - 1),
}
TYPED_3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="L" instantiationToken="1">
<CoSimulation modelIdentifier="L"/>
<TypeDefinitions><EnumerationType name="Mode"><Item name="slow" value="1"/>
<Item name="fast" value="3"/></EnumerationType></TypeDefinitions><ModelVariables>
<Float64 name="Float64" valueReference="1" causality="input" start="0"/>
<Float32 name="Float32" valueReference="2" causality="input" start="0"/>
<Boolean name="Boolean" valueReference="3" causality="input" start="false"/>
<String name="String" valueReference="4" causality="input"><Start value=""/></String>
<Enumeration name="Enumeration" valueReference="5" causality="input" declaredType="Mode" start="1"/>
<Float64 name="vector" valueReference="6" causality="input" start="0 0"><Dimension start="2"/>
</Float64><Clock name="Clock" valueReference="7" causality="input" intervalVariability="triggered"/>
INTEGERS</ModelVariables><ModelStructure/></fmiModelDescription>""".replace(
    "INTEGERS",
    "".join(
        f'<{kind} name="{kind}" valueReference="{i}" causality="input" start="0"/>'
        for i, kind in enumerate(INTEGERS, start=8)
    ),
)


@pytest.fixture(scope="session")
def typed_3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU of FMI 3.0 with an input of every type, and no binary."""
    path = tmp_path_factory.mktemp("typed") / "Typed3.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", TYPED_3)
    return path


WRONG = [
    *((f"{kind}={value}", f"an integer from {low} to {high}.")
      for kind, (low, high) in INTEGERS.items() for value in (low - 1, high + 1)),
    *((f"{kind}={value}", "it must be an integer from") for kind in INTEGERS
      for value in ("1.5", "nan", "inf", "-inf", "1e300")),
    *((f"{kind}={value}", "it must be a finite number up to") for kind in ("Float64", "Float32")
      for value in ("nan", "inf", "-inf")),
    ("Float32=1e39", "finite number up to 3.403e+38"),
    ("Float64=true", "'Float64' is of type Float64; it cannot be True."),
    ("Int8=false", "'Int8' is of type Int8; it cannot be False."),
    *((f"Boolean={value}", "it must be true or false.") for value in ("2", "-1", "0.5", "nan")),
    ("Boolean=yes", "'Boolean' cannot be 'yes'; it must be one of true, false."),
    ("Enumeration=2", "it must be one of 1 = slow, 3 = fast."),
    ("Enumeration=turbo", "it must be one of slow, fast."),
    ("String=5", "'String' is of type String; it cannot be 5."),
    ("vector=[1]", "'vector' has 2 elements; 1 values are given."),
    ("vector=[1,2,3]", "'vector' has 2 elements; 3 values are given."),
    ("vector=[1,nan]", "'vector[2]' is of type Float64; it cannot be nan"),
    ("vector=[[1,2],[3,4]]", "'vector[1]' is of type Float64; it cannot be [1, 2]."),
    ("Float64={a=1}", "'Float64' is of type Float64; it cannot be {'a': 1}."),
    ("Float64=2020-01-01", "it cannot be datetime.date(2020, 1, 1)."),
    ("Clock=1", "Clock, which has no start value"),
]  # fmt: skip


@pytest.mark.parametrize(("pair", "sentence"), WRONG, ids=[pair[:30] for pair, _ in WRONG])
def test_values_that_a_type_lacks_are_refused(pair: str, sentence: str, typed_3: Path) -> None:
    with pytest.raises(SimulationError, match=re.escape(sentence)) as caught:
        hesr.simulate(typed_3, set=[pair])
    assert f"'{pair.partition('=')[0]}" in str(caught.value)


@pytest.mark.parametrize("kind", INTEGERS)
def test_values_at_the_ends_of_a_type_are_taken(kind: str, typed_3: Path) -> None:
    for value in INTEGERS[kind]:
        with pytest.raises(SimulationError, match="has no binary for this platform"):
            hesr.simulate(typed_3, set=[f"{kind}={value}"])


@pytest.mark.parametrize("attribute", ["startTime", "stopTime", "stepSize"])
@pytest.mark.parametrize("text", ["INF", "-INF", "NaN", "soon"])
def test_times_of_a_file_that_are_not_finite_are_refused(
    text: str, attribute: str, lag_fmu: Path, tmp_path: Path
) -> None:
    own = (r"<DefaultExperiment.*?/>", f'<DefaultExperiment {attribute}="{text}"/>')
    with pytest.raises(ConfigError, match=f"its {attribute} is '{text}'; give --"):
        hesr.simulate(edited(lag_fmu, tmp_path / "F.fmu", own))


@pytest.mark.parametrize("text", ["-1", "0", "-1e300"])
def test_ends_before_the_start_are_refused(text: str, lag_fmu: Path, tmp_path: Path) -> None:
    own = (r"<DefaultExperiment.*?/>", f'<DefaultExperiment stopTime="{text}"/>')
    with pytest.raises(ConfigError, match=r"s, not after the start, 0 s\."):
        hesr.simulate(edited(lag_fmu, tmp_path / "F.fmu", own))


def test_inputs_off_the_grid_have_their_own_rows(typed_fmu: Path, tmp_path: Path) -> None:
    table = tmp_path / "in.csv"
    table.write_text("time,r,i\n0,0,1\n0.4,1,1\n0.4,3,2\n1,3,2\n", encoding="utf-8")
    found = hesr.simulate(typed_fmu, start=0.0, stop=0.9, step=0.25, input=table)
    np.testing.assert_allclose(found.t, [0.0, 0.25, 0.4, 0.5, 0.75, 0.9])
    # Of two samples at 0.4 s the step that begins there takes the last.
    np.testing.assert_allclose(found.signals["ro"], [0.0, 0.0, 0.625, 3.0, 3.0, 3.0])
    assert found.signals["io"].tolist() == [0, 1, 1, 2, 2, 2]


WITHOUT_CO_SIMULATION = (r"<CoSimulation [^>]*(/>|>.*?</CoSimulation>)", "")
"""A change of the description that leaves model exchange only."""


@pytest.mark.parametrize("fmi", [2, 3])
def test_models_follow_inputs_between_rows(fmi: Any, tmp_path: Path) -> None:
    """u = t gives x = t - T + (x_0 + T) exp(-t / T)."""
    model = edited(lag(tmp_path, fmi), tmp_path / "Model.fmu", WITHOUT_CO_SIMULATION)
    table = tmp_path / "in.csv"
    table.write_text("time,u\n0,0\n1,1\n", encoding="utf-8")
    found = hesr.simulate(model, stop=1.0, step=0.25, input=table)
    expected = found.t - 0.5 + 0.75 * np.exp(-found.t / 0.5)
    np.testing.assert_allclose(found.signals["y"], expected, rtol=1e-3)


ENDLESS = {
    "info->nextEventTimeDefined = fmi2True;"
    "info->nextEventTime = instance->memory.component.time + 1e-9;": "more than 10000 events",
    "info->newDiscreteStatesNeeded = fmi2True;": "iteration of its events",
}
"""Changes of C sources that make events endless, with words of the refusal."""


@pytest.mark.ci
@pytest.mark.parametrize("added", ENDLESS, ids=["one after the other", "at one time"])
def test_a_model_whose_events_never_end_is_refused(
    added: str, lag_fmu: Path, tmp_path: Path
) -> None:
    cleared = "memset(info, 0, sizeof *info);"
    changes = {"fmi2_continuous.c": ((cleared, cleared + added),)}
    whole = rebuild(lag_fmu, changes, tmp_path / "Whole.fmu")
    fmu = edited(whole, tmp_path / "Endless.fmu", WITHOUT_CO_SIMULATION)
    with pytest.raises(SimulationError, match=ENDLESS[added]):
        hesr.simulate(fmu, stop=1.0, step=0.25).require_success()


FMI_1 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="1.0" modelName="L" modelIdentifier="L" guid="1"
  numberOfContinuousStates="0" numberOfEventIndicators="0"><ModelVariables><ScalarVariable name="y"
  valueReference="1" causality="output"><Real/></ScalarVariable></ModelVariables>
</fmiModelDescription>"""


def test_other_versions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "F.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", FMI_1)
    with pytest.raises(ConfigError, match=r"FMI 1\.0; export it for FMI"):
        hesr.simulate(path)


def test_scheduled_execution_is_refused(tmp_path: Path) -> None:
    scheduled = '<ScheduledExecution modelIdentifier="lag"/>'
    kinds = (r"<ModelExchange .*?/>", ""), (r"<CoSimulation .*?/>", scheduled)
    path = edited(lag(tmp_path, 3), tmp_path / "F.fmu", *kinds)
    with pytest.raises(ConfigError, match="scheduled execution only"):
        hesr.simulate(path)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"stop": -1.0}, "'stop' is -1 s, not"),
        ({"step": 1e-9}, "'step' is 1e-09 s; at most 1000000"),
        ({"set": ["u"]}, "'set' is 'u'; expected NAME=VALUE, such"),
        ({"set": ["y=1"]}, "'set': 'y' has no start value"),
        ({"set": ["v=1"]}, "there is no variable 'v'"),
        ({"set": ["u=x"]}, "'u' cannot be 'x'; it has no choices."),
        ({"input": "time,y\n0,1\n1,1\n"}, "'y', which is not an input"),
        ({"input": "t,u\n0,1\n1,1\n"}, "there is no variable 't'"),
        ({"input": "u\n0\n1\n"}, "'input' has no column 'time'."),
        ({"input": "time,u\n1,0\n0,1\n"}, "'input' has times that decrease."),
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


@pytest.mark.parametrize(
    ("options", "owner"),
    [
        ({"input": "in.csv"}, "'input' is for an FMU, not"),
        ({"stop": 1.0}, "'stop' is for an FMU or SSP, not"),
        ({"set": ["u=1"]}, "'set' is for an FMU or SSP, not"),
    ],
)
def test_a_system_file_refuses_options_of_others(
    options: dict[str, Any], owner: str, tmp_path: Path
) -> None:
    system = tmp_path / "system.toml"
    system.write_text('name = "none"\n', encoding="utf-8")
    with pytest.raises(ArgumentError, match=owner):
        hesr.simulate(system, **options)


def test_failures_are_reported_by_one_sentence(lag_fmu: Path) -> None:
    with pytest.raises(SimulationError, match=r"at t = 0\.3 s: The step passes 0\.35 s, where"):
        hesr.simulate(lag_fmu, stop=1.0, step=0.1, set=["refused=0.35"])
