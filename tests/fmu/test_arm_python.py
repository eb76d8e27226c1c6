"""The arm as a PythonFMU: same variables and results as the native one."""

import ctypes
import gc
import sys
from contextlib import ExitStack, nullcontext

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from mjcf_models import (
    HOME,
    PENDULUM,
    STEP,
    UF850,
    assert_sampled_within_steps,
    command,
    names,
    run,
)
from oracles.arm import Arm

from fmu_src.arm.native import export_mjcf
from fmu_src.arm.plant import Plant
from fmu_src.arm.python_arm.export import export_python_arm
from fmu_src.arm.python_arm.simulation import Simulation
from fmu_src.arm.signals import read_signals
from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import ConfigError, ExportError, SimulationError

MJCF, TABLE = UF850 / "uf850.xml", UF850 / "arm.toml"
CHANGED = {"payload": 1.5, "friction_scale": 1.3, "latency": 0.02, "noise_seed[2]": 7.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("arms")


@pytest.fixture(scope="module")
def native(folder):
    return export_mjcf(MJCF, folder / "Native.fmu", table=TABLE)


@pytest.fixture(scope="module")
def python(folder):
    return export_python_arm(MJCF, TABLE, folder / "Python.fmu")


@pytest.fixture
def simulation():
    return Simulation(read_signals(MJCF, TABLE))


def simulated(fmu, start, steps):
    with FmuInstance(fmu) as arm:
        arm.initialise(start=start)
        return run(arm, steps)


def test_the_variables_are_the_same(native, python):
    def shown(fmu):
        return [
            (v.name, v.valueReference, v.causality, v.variability, v.initial, v.start, v.unit)
            for v in read_model_description(str(fmu)).modelVariables
        ]

    assert shown(python) == shown(native)


def test_the_dependencies_are_the_same(native, python):
    def shown(fmu, part):
        unknowns = getattr(read_model_description(str(fmu)), part)
        return [(u.variable.name, [v.name for v in u.dependencies]) for u in unknowns]

    for part in ("outputs", "initialUnknowns"):
        assert shown(python, part) == shown(native, part)
    assert all(needed == [] for _, needed in shown(python, "outputs"))
    assert all("q0[1]" in needed for _, needed in shown(python, "initialUnknowns"))


def test_the_description_states_the_need_for_python(python):
    about = read_model_description(str(python)).coSimulation
    assert about.needsExecutionTool is True
    assert about.canInterpolateInputs is False


@pytest.mark.parametrize("start", [HOME, HOME | CHANGED, HOME | {"friction_scale": 0.0}])
def test_the_trajectory_is_the_same(start, native, python):
    expected, found = simulated(native, start, 600), simulated(python, start, 600)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_the_trajectory_matches_the_arm_without_fmi(simulation):
    arm = Arm(Plant.read(UF850 / "plant.toml"))
    quiet = {name: 0.0 for name in simulation.defaults if "_noise[" in name}
    state, row = arm.reset([0.0, 0.3, -1.9]), simulation.reset(HOME | quiet)
    for k in range(400):
        tau, expected = state.tau_meas, state.q
        np.testing.assert_allclose(row.reshape(6, 3)[[0, 1]], [expected, tau], rtol=0, atol=1e-9)
        state, row = arm.step(command(k), STEP), simulation.step(command(k), STEP)


def test_reading_a_simulation_is_repeatable(simulation):
    other = Simulation(read_signals(MJCF, TABLE))
    for k in range(20):
        row = simulation.step(command(k), STEP)
        other.step(command(k), STEP)
        for _ in range(3):
            np.testing.assert_array_equal(other.outputs(), row)


def test_a_simulation_returns_to_a_state(simulation):
    simulation.reset(HOME | CHANGED)
    for k in range(30):
        simulation.step(command(k), STEP)
    state = simulation.state()
    first = [simulation.step(command(k), STEP) for k in range(30, 60)]
    simulation.reset()
    simulation.restore(state)
    np.testing.assert_array_equal([simulation.step(command(k), STEP) for k in range(30, 60)], first)


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"latency": 0.051}, r"latency is 0\.051 s; .* hold 0\.05 s"),
        ({"payload": -1.0}, r"payload is -1; it must not be negative"),
        ({"payload": np.inf}, r"payload is inf; a finite number is needed"),
        ({"mass": 1.0}, r"there is no parameter 'mass'"),
    ],
)
def test_meaningless_parameters_are_refused(parameters, sentence, simulation):
    with pytest.raises(SimulationError, match=sentence):
        simulation.reset(parameters)


def test_meaningless_steps_and_inputs_are_refused(simulation):
    with pytest.raises(SimulationError, match="a multiple of the simulation's own"):
        simulation.step(np.zeros(3), 0.0055)
    with pytest.raises(SimulationError, match=r"dq_cmd\[2\] is 2e\+10; the largest is 1e\+10\."):
        simulation.step([0.0, 2e10, 0.0], STEP)
    with pytest.raises(SimulationError, match=r"dq_cmd\[1\] is nan"):
        simulation.step([np.nan, 0.0, 0.0], STEP)


def test_a_diverging_simulation_keeps_its_last_state(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    mjcf = tmp_path / "bad.xml"
    mjcf.write_text(PENDULUM.replace('damping="0.1"', 'stiffness="-1e9"'))
    simulation = Simulation(read_signals(mjcf))
    simulation.reset({"start_pivot": 0.1})
    seen = []

    def go():
        for _ in range(100):
            seen.append(simulation.outputs())
            simulation.step([0.0], 0.1)

    with pytest.raises(SimulationError, match=r"^the simulation has diverged within 0\.1 s\.$"):
        go()
    np.testing.assert_array_equal(simulation.outputs(), seen[-1])
    assert [path.name for path in tmp_path.iterdir()] == ["bad.xml"]
    assert capfd.readouterr() == ("", "")


def listening(component):
    """PythonFMU logs nothing, including errors, unless requested."""
    component._instance.slave.fmi2SetDebugLogging(
        component._instance.slave.component, True, 0, None
    )
    return component


def test_any_step_ends_at_the_last_multiple_of_the_simulations_own(python):
    assert_sampled_within_steps(python)


def test_a_refused_step_gives_a_reason_and_can_be_repeated(python):
    with FmuInstance(python) as arm:
        listening(arm).initialise(start=HOME)
        arm.set({"dq_cmd[1]": 2e10})
        with pytest.raises(SimulationError, match=r"dq_cmd\[1\] is 2e\+10; the largest is 1e\+10"):
            arm.step(0.0, STEP)
        arm.set({"dq_cmd[1]": 0.0})
        arm.step(0.0, STEP)


def test_meaningless_parameters_are_refused_with_a_reason(python):
    with FmuInstance(python) as arm, pytest.raises(SimulationError, match="buffers hold"):
        listening(arm).initialise(start={"latency": 1.0})


@pytest.mark.parametrize("latency", [0.01, 1.0])
def test_an_instance_is_released_once(latency, python):
    """PythonFMU releases an instance that raises, and again when it is freed.

    An exception is fatal in PythonFMU, so that the instance must not be freed; it stays in memory.
    """

    def slaves():
        return [one for one in gc.get_objects() if type(one).__name__ == "PythonArm"]

    before = slaves()
    with ExitStack() as cleanup:
        arm = cleanup.enter_context(FmuInstance(python))
        [slave] = [one for one in slaves() if not any(one is other for other in before)]
        held = [slave, type(slave), slave.log_queue]
        counts = [sys.getrefcount(one) for one in held]
        with pytest.raises(SimulationError) if latency > 0.05 else nullcontext():
            listening(arm).initialise(start={"latency": latency})
    freed = latency <= 0.05
    assert [sys.getrefcount(one) for one in held] == [count - freed for count in counts]


def test_instances_are_independent_and_states_can_be_saved(python):
    with FmuInstance(python) as one, FmuInstance(python, name="other") as other:
        one.initialise(start=HOME | CHANGED)
        other.initialise(start=HOME)
        run(one, 20)
        run(other, 5)
        slave, state = one._instance.slave, ctypes.c_void_p()
        slave.fmi2GetFMUstate(slave.component, ctypes.byref(state))
        first = run(one, 20, 20)
        slave.fmi2SetFMUstate(slave.component, state)
        np.testing.assert_array_equal(run(one, 20, 20), first)
        data = slave.serializeFMUState(state)
        copy = other._instance.slave.deSerializeFMUstate(data)
        other._instance.slave.setFMUState(copy)
        np.testing.assert_array_equal(run(other, 20, 20), first)
        slave.fmi2FreeFMUstate(slave.component, ctypes.byref(state))


def test_a_reset_restores_the_start(python):
    with FmuInstance(python) as arm:
        arm.initialise(start=HOME | CHANGED)
        run(arm, 10)
        arm.reset()
        arm.initialise(start=HOME)
        found = run(arm, 30)
    np.testing.assert_array_equal(found, simulated(python, HOME, 30))


def test_the_fmu_is_valid_and_reproducible(python, tmp_path):
    assert validate_fmu(str(python)) == []
    again = export_python_arm(MJCF, TABLE, tmp_path / "Python.fmu")
    assert again.read_bytes() == python.read_bytes()


def test_the_table_is_optional(tmp_path):
    mjcf = tmp_path / "pendulum.xml"
    mjcf.write_text(PENDULUM)
    native = export_mjcf(mjcf, tmp_path / "Native.fmu")
    python = export_python_arm(mjcf, None, tmp_path / "Python.fmu")
    rows = []
    for fmu in (native, python):
        with FmuInstance(fmu) as pendulum:
            pendulum.initialise(start={"start_pivot": 0.4})
            assert names(pendulum, "input") == ["pivot"]
            rows.append(run(pendulum, 200, step=0.01))
    np.testing.assert_allclose(rows[1], rows[0], rtol=0, atol=1e-9)


def test_unsuitable_files_are_refused(tmp_path):
    with pytest.raises(ExportError, match=r"FMU ends in \.fmu"):
        export_python_arm(MJCF, TABLE, tmp_path / "Arm.zip")
    with pytest.raises(ConfigError, match="no such model file"):
        export_python_arm(tmp_path / "none.xml", None, tmp_path / "Arm.fmu")
    (tmp_path / "part.xml").write_text("<mujoco><asset/></mujoco>")
    whole = tmp_path / "whole.xml"
    whole.write_text(PENDULUM.replace("<option", '<include file="part.xml"/><option'))
    with pytest.raises(ConfigError, match="refers to other files"):
        export_python_arm(whole, None, tmp_path / "Arm.fmu")
    assert not (tmp_path / "Arm.fmu").exists()
