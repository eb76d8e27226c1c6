"""FMI 3.0: the same component behind other functions, in FMPy's importer and fmi-sim."""

import re
import shutil
import subprocess
from collections.abc import Callable
from ctypes import byref, c_double, c_size_t, c_uint32, c_void_p
from itertools import permutations
from pathlib import Path
from xml.etree import ElementTree as ET
from zipfile import ZipFile

import numpy as np
import pytest
from containing import Containing
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave
from rust_engine import FMI_SIM, run_in_fmi_sim

from fmu_src.blocks.controller import controller, velocity
from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.blocks.trajectory import trajectory
from fmu_src.check.run import check
from fmu_src.export.package import Content, write_fmu
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.run.reference_results import Verified, verify
from hesr.extras.drive.drive_fmu import build_motors
from hesr.extras.drive.drive_fmu import content as drive
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

STEP = 0.004
BLOCKS: dict[str, Callable[..., Content]] = {
    "drive": lambda model: drive(
        model, build_motors(3, inertia=(3.0, 3.0, 0.6), stiffness=(1e4, 2e4, 1e4))
    ),
    "controller": lambda _: controller(3),
    "velocity": lambda _: velocity(3),
    "trajectory": lambda _: trajectory(3),
}


REGISTRY = pytest.param("registry", marks=pytest.mark.nightly("laws"))


@pytest.fixture(scope="module", params=["Table I", "laws", REGISTRY, *BLOCKS, "body"])
def pair(request, table1, make_model, make_law, tmp_path_factory) -> tuple[Path, Path]:
    """The FMU of a component in FMI 2.0 and in 3.0; one has every law of the registry."""
    folder = tmp_path_factory.mktemp("fmi3")
    files = {version: folder / f"F{version}.fmu" for version in (2, 3)}
    laws: FrictionModel | None = {"Table I": table1}.get(request.param)
    if request.param == "laws":  # with jumps, without own parameters, with several states
        laws = make_model(*map(make_law, ("viscous", "gaussians", "elements")))
    if request.param == "registry":
        models = request.getfixturevalue("registry_models")
        laws = make_model(*(model.laws[0] for model in models.values()))
    if laws:
        return tuple(export_bare(laws, file, fmi=version) for version, file in files.items())
    if request.param == "body":
        robot = Robot(RobotDescription.read(models_folder() / "uf850" / "robot.toml"))
        own = inverse_dynamics(robot, robot.nominal_parameters)
    else:
        own = BLOCKS[request.param](table1)
    return tuple(write_fmu(own, file, fmi=version) for version, file in files.items())


class Old:
    """Access to an FMU of FMI 2.0 by name."""

    def __init__(self, fmu: Path, folder: Path) -> None:
        about = read_model_description(str(fmu))
        self.variables = {v.name: v for v in about.modelVariables}
        self.fmu = FMU2Slave(
            guid=about.guid,
            unzipDirectory=extract(str(fmu), str(folder)),
            instanceName="two",
            modelIdentifier=about.coSimulation.modelIdentifier,
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()

    def get(self, names: list[str]) -> list[float]:
        return self.fmu.getReal([self.variables[n].valueReference for n in names])

    def set(self, names: list[str], values: list[float]) -> None:
        self.fmu.setReal([self.variables[n].valueReference for n in names], values)


class New:
    """Access to an FMU of FMI 3.0 by name."""

    def __init__(
        self,
        fmu: Path,
        folder: Path,
        kind: type = FMU3Slave,
        *,
        events: bool = False,
        early: bool = False,
    ) -> None:
        about = read_model_description(str(fmu))
        self.variables = {v.name: v for v in about.modelVariables}
        interface = about.coSimulation if kind is FMU3Slave else about.modelExchange
        self.said: list[str] = []
        self.fmu = kind(
            guid=about.guid,
            unzipDirectory=extract(str(fmu), str(folder)),
            instanceName="three",
            modelIdentifier=interface.modelIdentifier,
        )
        more = {"eventModeUsed": events, "earlyReturnAllowed": early} if kind is FMU3Slave else {}
        self.fmu.instantiate(logMessage=lambda *said: self.said.append(said[3].decode()), **more)
        self.fmu.enterInitializationMode(startTime=0.0)

    def size(self, name: str) -> int:
        return int(np.prod([int(d.start) for d in self.variables[name].dimensions] or [1]))

    def get(self, name: str) -> list[float]:
        reference = self.variables[name].valueReference
        return list(self.fmu.getFloat64([reference], nValues=self.size(name)))

    def set(self, name: str, values: list[float]) -> None:
        self.fmu.setFloat64([self.variables[name].valueReference], values)


def elements(new: New, name: str) -> list[str]:
    """Names in FMI 2.0 of the elements of a variable."""
    shape = [int(d.start) for d in new.variables[name].dimensions]
    if not shape:
        return [name]
    return [f"{name}[{','.join(str(i + 1) for i in at)}]" for at in np.ndindex(*shape)]


def both(pair: tuple[Path, Path], folder: Path) -> tuple[Old, New]:
    return Old(pair[0], folder / "two"), New(pair[1], folder / "three")


def numbers(new: New, *causalities: str) -> list[str]:
    return [
        name
        for name, v in new.variables.items()
        if v.causality in causalities and v.type == "Float64" and name != "event_indicator"
    ]


def test_every_variable_occurs_once(pair, tmp_path) -> None:
    old, new = both(pair, tmp_path)
    known = [
        e
        for name in new.variables
        if name not in ("time", "event_indicator")
        for e in elements(new, name)
    ]
    assert sorted(known) == sorted(old.variables)


def test_steps_are_bitwise_equal(pair, tmp_path) -> None:
    old, new = both(pair, tmp_path)
    inputs, computed = numbers(new, "input"), numbers(new, "output", "local")
    rng = np.random.default_rng(5)
    moved = set()
    for name in new.variables:  # otherwise a trajectory stays at rest
        if name.removesuffix("[1,1]") in ("a", "amplitude"):
            values = [0.3] * new.size(name)
            old.set(elements(new, name), values)
            new.set(name, values)
    for k in range(300):
        for name in inputs if k % 3 == 0 else []:
            values = (0.3 * rng.normal(size=new.size(name))).tolist()
            old.set(elements(new, name), values)
            new.set(name, values)
        if k == 0:
            old.fmu.exitInitializationMode()
            new.fmu.exitInitializationMode()
        for name in computed:
            found = new.get(name)
            assert found == old.get(elements(new, name)), name
            if any(found):
                moved.add(name)
        old.fmu.doStep(k * STEP, STEP)
        assert new.fmu.doStep(k * STEP, STEP)[:3] == (False, False, False)
    assert new.get("time") == [pytest.approx(300 * STEP)]
    assert moved & set(numbers(new, "output"))
    new.fmu.terminate()


def test_a_state_is_restored_from_its_bytes(pair, tmp_path) -> None:
    _, new = both(pair, tmp_path)
    new.fmu.exitInitializationMode()
    outputs = numbers(new, "output")
    new.fmu.doStep(0.0, STEP)
    state = new.fmu.getFMUState()
    saved = new.fmu.serializeFMUState(state)
    new.fmu.doStep(STEP, STEP)
    after = [new.get(name) for name in outputs]
    new.fmu.setFMUState(new.fmu.deserializeFMUState(saved))
    new.fmu.doStep(STEP, STEP)
    assert [new.get(name) for name in outputs] == after


@pytest.fixture(scope="module")
def friction3(table1, tmp_path_factory) -> Path:
    return export_bare(table1, tmp_path_factory.mktemp("friction") / "F3.fmu", fmi=3)


def test_arrays_are_described(friction3) -> None:
    about = read_model_description(str(friction3), validate=True)
    shapes = {v.name: [d.start for d in v.dimensions] for v in about.modelVariables}
    assert [shapes[n] for n in ("dq", "q", "tau_load", "tau")] == [[3]] * 4
    [dq] = (v for v in about.modelVariables if v.name == "dq")
    assert (dq.declaredType.unit, dq.start) == ("rad/s", "0.0 0.0 0.0")
    assert dq.description == "velocity of joint1, joint2, joint3"
    with ZipFile(friction3) as archive:
        names = archive.namelist()
    assert "binaries/x86_64-linux/friction_parfam_h.so" in names
    assert "sources/buildDescription.xml" in names


def test_derivatives_and_model_exchange_agree(friction3, table1_fmu, tmp_path) -> None:
    """Derivatives and directional derivatives equal those of the FMI 2.0 FMU."""
    old, new = Old(table1_fmu, tmp_path / "two"), New(friction3, tmp_path / "three", FMU3Model)
    speed = [0.3, -0.4, 0.5]
    new.set("dq", speed)
    old.set(elements(new, "dq"), speed)
    new.fmu.exitInitializationMode()
    old.fmu.exitInitializationMode()
    assert new.fmu.updateDiscreteStates()[:5] == (False, False, False, False, False)
    new.fmu.enterContinuousTimeMode()
    rates = [f"der(h[{i}])" for i in (1, 2, 3)]
    assert [new.get(name)[0] for name in rates] == old.get(rates)
    seed, (tau, dq) = [1.0, 2.0, 3.0], (new.variables[n].valueReference for n in ("tau", "dq"))
    found = (c_double * 3)()
    new.fmu.fmi3GetDirectionalDerivative(
        new.fmu.component,
        (c_uint32 * 1)(tau),
        1,
        (c_uint32 * 1)(dq),
        1,
        (c_double * 3)(*seed),
        3,
        found,
        3,
    )
    names = (*elements(new, "tau"), *elements(new, "dq"))
    reference = [old.variables[n].valueReference for n in names]
    assert list(found) == old.fmu.getDirectionalDerivative(reference[:3], reference[3:], seed)


@pytest.mark.parametrize("pair", ["laws"], indirect=True)
def test_event_indicators_are_also_read_with_other_variables(pair, tmp_path) -> None:
    """In any order, with the time; a wrong number of values is refused and nothing is overrun."""
    new = New(pair[1], tmp_path, FMU3Model)
    speed = [0.3, -0.4, 0.5]
    new.set("dq", speed)
    new.fmu.exitInitializationMode()
    new.fmu.updateDiscreteStates()
    new.fmu.enterContinuousTimeMode()
    new.fmu.setTime(0.25)
    count = new.size("event_indicator")
    assert count > 1
    alone = (c_double * count)()
    new.fmu.fmi3GetEventIndicators(new.fmu.component, alone, count)
    assert len(set(alone)) == count
    known = {"dq": speed, "event_indicator": list(alone), "time": [0.25]}
    assert new.get("event_indicator") == list(alone)
    unset = 4711.0
    for names in permutations(known):
        expected = [value for name in names for value in known[name]]
        references = (c_uint32 * len(names))(*(new.variables[n].valueReference for n in names))

        def read(size: int, references=references) -> list[float]:
            values = (c_double * 20)(*[unset] * 20)
            try:
                new.fmu.fmi3GetFloat64(new.fmu.component, references, len(references), values, size)
            finally:
                assert list(values)[size:] == [unset] * (20 - size)
            return list(values)[:size]

        assert read(len(expected)) == expected
        for size in (*range(len(expected)), len(expected) + 1):
            with pytest.raises(Exception, match="failed with status 3"):
                read(size)


@pytest.mark.parametrize("pair", ["laws", "Table I"], indirect=True)
def test_counts_are_those_of_the_description(pair, tmp_path) -> None:
    new = New(pair[1], tmp_path, FMU3Model)
    indicators = 0
    if "event_indicator" in new.variables:
        indicators = new.size("event_indicator")
    states = sum(variable.derivative is not None for variable in new.variables.values())
    assert states > 0
    for name, expected in (("EventIndicators", indicators), ("ContinuousStates", states)):
        function = new.fmu.dll[f"fmi3GetNumberOf{name}"]
        found = c_size_t(4711)
        assert function(c_void_p(new.fmu.component), byref(found)) == 0
        assert found.value == expected
        assert function(c_void_p(), byref(found)) == 3
        assert function(c_void_p(new.fmu.component), c_void_p()) == 3


def test_a_solver_runs_the_fmu(friction3, table1_fmu) -> None:
    t = np.arange(0.0, 1.0, STEP)
    speed = np.column_stack([np.sin(6 * t + i) for i in range(3)])
    three = np.array(
        list(zip(t, map(tuple, speed), strict=True)), dtype=[("time", float), ("dq", float, (3,))]
    )
    two = np.array(
        [(a, *b) for a, b in zip(t, speed, strict=True)],
        dtype=[("time", float), *((f"dq[{i}]", float) for i in (1, 2, 3))],
    )
    options = {"fmi_type": "ModelExchange", "stop_time": 0.9, "output_interval": STEP}
    new = simulate_fmu(str(friction3), input=three, output=["tau"], **options)
    old = simulate_fmu(str(table1_fmu), input=two, output=["tau[1]", "tau[2]", "tau[3]"], **options)
    expected = np.column_stack([old[f"tau[{i}]"] for i in (1, 2, 3)])
    np.testing.assert_array_equal(new["tau"], expected)


def test_invalid_arguments_are_refused(friction3, tmp_path) -> None:
    new = New(friction3, tmp_path)
    for name, values in (("dq", [0.1]), ("h[1]", [0.1, 0.2])):
        with pytest.raises(Exception, match="failed with status 3"):
            new.set(name, values)
    with pytest.raises(Exception, match="failed with status 3"):
        new.fmu.getFloat64([10**6], nValues=1)
    with pytest.raises(Exception, match="failed with status 3"):
        new.fmu.getFloat64([new.variables["dq"].valueReference], nValues=2)
    for reference in (10**6, len(new.variables) + 100):  # for any stated buffer size
        with pytest.raises(Exception, match="failed with status 3"):
            new.fmu.fmi3GetFloat64(
                new.fmu.component, (c_uint32 * 1)(reference), 1, (c_double * 1)(), 2**64 - 1
            )
        assert "fmi3GetFloat64: 18446744073709551615 values for variables" in new.said[-1]
    assert new.get("dq") == [0.0, 0.0, 0.0]


TYPES = ("Float32", "Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64", "Boolean",
         "String", "Binary")  # fmt: skip
OF_CLOCKS = ("Clock", "IntervalDecimal", "IntervalFraction", "ShiftDecimal", "ShiftFraction")
NEVER = ("EvaluateDiscreteStates", "EnterConfigurationMode", "ExitConfigurationMode",
         "GetNumberOfVariableDependencies", "GetVariableDependencies")  # fmt: skip


def test_calls_for_unused_features_are_handled(friction3, tmp_path) -> None:
    """They do nothing without variables and are errors with any, or without an instance."""
    new = New(friction3, tmp_path)
    functions = [way + kind for kind in (*TYPES, *OF_CLOCKS) for way in ("Get", "Set")]
    nothing = [c_void_p()] * 5

    def call(name: str, instance: object, n: int) -> int:
        function = new.fmu.dll[f"fmi3{name}"]  # without FMPy's declaration of argument types
        return int(function(c_void_p(instance), c_void_p(), c_size_t(n), *nothing))

    for name in functions:
        said = len(new.said)
        assert (name, call(name, new.fmu.component, 0)) == (name, 0)
        assert len(new.said) == said
        assert (name, call(name, new.fmu.component, 1)) == (name, 3)
        assert new.said[-1].endswith(f"{name}: this FMU does not support it.")
        assert (name, call(name, None, 0)) == (name, 3)
    for name in NEVER:
        assert (name, call(name, new.fmu.component, 0)) == (name, 3)
        assert new.said[-1].endswith(f"{name}: this FMU does not support it.")


@pytest.mark.ci
@pytest.mark.skipif(not FMI_SIM.exists(), reason="fmi-sim is not there: run `make interop` first")
def test_fmi_sim_runs_one_joint_without_messages(make_model, make_law, tmp_path) -> None:
    fmu = export_bare(make_model(make_law("viscous")), tmp_path / "F.fmu", fmi=3)
    run_in_fmi_sim(fmu, step=0.005, steps=20)


@pytest.mark.ci
def test_c_compiles_with_other_compilers(friction3, tmp_path) -> None:
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed")
    with ZipFile(friction3) as archive:
        archive.extractall(tmp_path)
    flags = ["-std=c99", "-O1", "-fPIC", "-shared", "-Wall", "-Wextra", "-Werror"]
    command = [gcc, *flags, "sources/all.c", "-o", "x.so", "-lm"]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


# --- events of a drive ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drive3(make_model, make_law, tmp_path_factory) -> Path:
    own = drive(
        make_model(make_law("viscous"), make_law("viscous")), build_motors(2, inertia=(0.5, 0.5))
    )
    return write_fmu(own, tmp_path_factory.mktemp("drive") / "D3.fmu", fmi=3)


def stepper(fmu: Path, folder: Path, *, events: bool, early: bool) -> New:
    """A drive whose first motor starts at 1 rad/s against a torque that reverses it."""
    new = New(fmu, folder, events=events, early=early)
    new.set("dq_start", [1.0, 0.0])
    new.set("tau_motor[1]", [-20.0])
    new.fmu.exitInitializationMode()
    if events:
        assert new.fmu.updateDiscreteStates()[:5] == (False, False, False, False, False)
        new.fmu.enterStepMode()
    return new


def test_a_step_ends_at_the_reversal_of_a_motor(drive3, tmp_path) -> None:
    """At the end of the inner step with the reversal, if the host allows it; bitwise equal."""
    whole = stepper(drive3, tmp_path / "whole", events=False, early=False)
    assert whole.fmu.doStep(0.0, 0.1) == (False, False, False, 0.1)
    new = stepper(drive3, tmp_path / "new", events=True, early=True)
    event, end, early, reached = new.fmu.doStep(0.0, 0.1)
    assert (event, end, early) == (True, False, True)
    assert 0.0 < reached < 0.1
    assert reached == pytest.approx(round(reached, 3), abs=1e-12)
    assert new.get("time") == [reached]
    assert -0.1 < new.get("dq")[0] < 0.0
    new.fmu.enterEventMode()
    assert new.fmu.updateDiscreteStates()[:5] == (False, False, False, False, False)
    new.fmu.enterStepMode()
    assert new.fmu.doStep(reached, 0.1 - reached)[:3] == (False, False, False)
    np.testing.assert_allclose(new.get("dq"), whole.get("dq"), rtol=1e-12)
    np.testing.assert_allclose(new.get("q"), whole.get("q"), rtol=1e-12)


def test_an_event_at_the_end_of_a_step_is_reported_without_early_return(drive3, tmp_path) -> None:
    new = stepper(drive3, tmp_path / "new", events=True, early=True)
    reached = new.fmu.doStep(0.0, 0.1)[3]
    again = stepper(drive3, tmp_path / "again", events=True, early=False)
    assert again.fmu.doStep(0.0, reached) == (True, False, False, reached)
    silent = stepper(drive3, tmp_path / "silent", events=False, early=False)
    assert silent.fmu.doStep(0.0, reached) == (False, False, False, reached)


def test_calls_out_of_sequence_around_events_are_refused(drive3, tmp_path) -> None:
    without = stepper(drive3, tmp_path / "without", events=False, early=False)
    for call in (
        without.fmu.enterEventMode,
        without.fmu.enterStepMode,
        without.fmu.updateDiscreteStates,
    ):
        with pytest.raises(Exception, match="failed with status 3"):
            call()
    new = stepper(drive3, tmp_path / "new", events=True, early=True)
    new.fmu.enterEventMode()
    with pytest.raises(Exception, match="failed with status 3"):
        new.fmu.doStep(0.0, 0.1)
    assert new.said[-1] == "fmi3DoStep is not allowed in event mode."
    saved = new.fmu.getFMUState()
    new.fmu.enterStepMode()
    new.fmu.setFMUState(saved)  # is in event mode again
    new.fmu.enterStepMode()
    assert new.fmu.doStep(0.0, 0.1)[0]


def results_in(fmu: Path) -> dict[str, bytes]:
    with ZipFile(fmu) as archive:
        return {n: archive.read(n) for n in archive.namelist() if re.match(r"extra/.*csv$", n)}


def test_components_contain_the_results_of_fmi_2(pair) -> None:
    old, new = map(results_in, pair)
    assert new == old
    found = verify(pair[1])
    assert found.problems == []
    assert set(found.passed) == ({"hold", "shown"} if new else set())


def test_a_drive_contains_results(drive3) -> None:
    assert results_in(drive3)
    assert verify(drive3) == Verified(passed={"hold": "hold", "shown": "shown"})


def test_each_joint_of_a_drive_has_a_flange(drive3) -> None:
    """The schema and the rules report no problem."""
    with ZipFile(drive3) as archive:
        root = ET.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
    found = {
        flange.get("name"): {e.get("memberName"): e.get("variableName") for e in flange}
        for flange in root.iter("Terminal")
    }
    assert found == {
        f"flange[{i}]": {"phi": f"q_link[{i}]", "tau": f"tau_link[{i}]"} for i in (1, 2)
    }
    report = check(drive3)
    assert report.problems == ()
    assert report.skipped == (Containing("FMI 2.0, this is FMI 3.0"),)


def test_messages_name_the_functions_of_fmi_3(drive3, tmp_path) -> None:
    new = stepper(drive3, tmp_path / "new", events=False, early=False)
    with pytest.raises(Exception, match="failed with status 2"):
        new.set("tau_motor[1]", [float("nan")])
    assert new.said[-1] == "fmi3SetFloat64: tau_motor[1] is nan; a finite number is needed."
    with pytest.raises(Exception, match="failed with status 3"):
        new.fmu.doStep(0.0, -1.0)
    assert new.said[-1].startswith("fmi3DoStep: the step is -1 s from time 0 s")
