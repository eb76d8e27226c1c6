"""What a host does wrong ends in an error with a reason, never in a crash or a wrong number."""

import ctypes
import math
from dataclasses import replace

import pytest
import sympy

from fmu_src import export_fmu
from hesr_model.errors import ExportError
from hesr_model.friction.functions import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm, Relaxation

OK, DISCARD, ERROR = 0, 2, 3


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["dq[2]", "joint[3].alpha"])
def test_values_that_are_not_finite(binary, name, value):
    c = binary.ready()
    assert binary.set_all(c, {name: value}) == ERROR
    environment, instance, text = binary.messages[-1]
    assert text == f"fmi2SetReal: {name} is {value:g}; a finite number is needed."
    assert (environment, instance) == (4711, "one")
    assert binary.step(c, 0.0, 0.005) == ERROR  # the simulation has ended
    assert binary.get(c, "dq[2]") == [0.0]  # but the old value can be read


def test_a_call_takes_all_its_values_or_none(binary):
    c = binary.ready()
    assert binary.set_all(c, {"dq[1]": 0.5, "dq[2]": math.nan}) == ERROR
    assert binary.get(c, "dq[1]") == [0.0]


@pytest.mark.parametrize("step", [0.0, -0.005, math.nan, math.inf])
def test_steps_that_are_not_positive(binary, step):
    c = binary.ready()
    assert binary.step(c, 1.25, step) == ERROR
    assert "it must be positive" in binary.messages[-1][2]
    assert f"{step:g} s from time 1.25 s" in binary.messages[-1][2]


def test_euler_with_a_step_that_is_too_long(binary):
    c = binary.ready()
    binary.set(c, dq=0.4)
    assert binary.step(c, 0.0, 0.1) == ERROR
    assert binary.messages[-1][2] == (
        "h[1]: Euler needs rate * step < 1 but found 1.137 at dq[1] = 0.4; take a smaller step or "
        "the exact discretisation."
    )


def test_a_rate_that_is_negative(binary):
    c = binary.ready()
    binary.set_all(c, {"joint[2].alpha": -3.0})
    assert binary.step(c, 0.0, 0.005) == ERROR
    assert (
        "h[2]: the relaxation rate is -3 1/s at dq[2] = 0; it must not be"
        in (binary.messages[-1][2])
    )


def test_outputs_that_become_infinite(make_law, make_model, load, tmp_path):
    c = (fmu := load(export_fmu(make_model(make_law("parfam_exp")), tmp_path / "F.fmu"))).ready()
    fmu.set(c, dq=1e4)
    assert fmu.step(c, 2.0, 0.005) == ERROR
    assert fmu.messages[-1][2] == "tau[1] became inf at time 2.005."


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"guid": b"{}"}, "the GUID is not that of this binary"),
        ({"guid": b""}, "the GUID is not that of this binary"),
        ({"kind": 0}, "this FMU is for co-simulation"),
        ({"name": b""}, "the instance has no name"),
        ({"name": None}, "the instance has no name"),
    ],
)
def test_instantiation_that_is_refused(binary, change, reason):
    assert binary.instantiate(**change) is None
    assert reason in binary.messages[-1][2]
    assert binary.instantiate(host=None, **change) is None


def test_hosts_without_a_logger(binary):
    c = binary.ready(host=None)
    assert binary.set(c, dq=math.nan) == ERROR
    binary("FreeInstance", c)
    binary.host = type(binary.host)()
    c = binary.ready()
    assert binary.set(c, dq=math.nan) == ERROR


def test_calls_out_of_sequence_are_refused_and_change_nothing(binary):
    c = binary.instantiate()
    assert binary.step(c, 0.0, 0.005) == ERROR
    assert binary.messages[-1][2] == "fmi2DoStep is not allowed in this state of the instance."
    assert binary("ExitInitializationMode", c) == ERROR
    assert binary("Terminate", c) == ERROR
    assert binary("EnterInitializationMode", c) == OK
    assert binary("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == ERROR
    assert binary("ExitInitializationMode", c) == OK
    assert binary("EnterInitializationMode", c) == ERROR
    assert binary.step(c, 0.0, 0.005) == OK
    assert binary("Terminate", c) == OK
    assert binary.step(c, 0.005, 0.005) == ERROR
    assert binary.set(c, dq=0.1) == ERROR
    assert binary("Reset", c) == OK
    assert binary("EnterInitializationMode", c) == OK


def test_no_instance_at_all(binary):
    assert binary.step(None, 0.0, 0.005) == ERROR
    assert binary("Reset", None) == ERROR
    binary("FreeInstance", None)


@pytest.mark.parametrize("name", ["tau[1]", "der(h[1])", "h[1]"])
def test_variables_that_cannot_be_set_now(binary, name):
    c = binary.ready()
    assert binary.set_all(c, {name: 0.1}) == ERROR
    assert f"{name} cannot be set in this state" in binary.messages[-1][2]


def test_integration_is_chosen_before_the_start_and_among_what_there_is(binary):
    vr, value = binary.references(["discretisation"]), (ctypes.c_int * 1)(3)
    c = binary.instantiate()
    assert binary("SetInteger", c, vr, 1, value) == ERROR
    assert binary.messages[-1][2] == "fmi2SetInteger: discretisation is 3; needed is 1 to 2."
    c = binary.ready()
    value[0] = 1
    assert binary("SetInteger", c, vr, 1, value) == ERROR
    assert "discretisation cannot be set in this state" in binary.messages[-1][2]
    assert binary("GetInteger", c, vr, 1, value) == OK
    assert value[0] == 2


def test_unknown_value_references_and_types(binary):
    values = (ctypes.c_double * 1)()
    for reference in (100000, 0xFFFFFFFF, binary.vr["discretisation"]):
        c = binary.ready()
        assert binary("GetReal", c, (ctypes.c_uint * 1)(reference), 1, values) == ERROR
        assert f"value reference {reference}." in binary.messages[-1][2]
    c = binary.ready()
    assert binary("GetReal", c, None, 1, values) == ERROR
    c = binary.ready()
    assert binary("GetBoolean", c, None, 0, None) == OK
    assert binary("GetString", c, (ctypes.c_uint * 1)(0), 1, None) == ERROR


def test_the_end_of_the_experiment(binary):
    c = binary.instantiate()
    binary("SetupExperiment", c, 0, 0.0, 0.0, 1, 0.3)
    binary("EnterInitializationMode", c)
    binary("ExitInitializationMode", c)
    time = 0.0
    for _ in range(3):  # 0.1 + 0.1 + 0.1 is more than 0.3
        assert binary.step(c, time, 0.1 * 0.5) == OK
        assert binary.step(c, time + 0.05, 0.05) == OK
        time += 0.1
    assert time > 0.3
    assert binary.step(c, time, 0.05) == ERROR
    assert "passes the end" in binary.messages[-1][2]


def test_an_experiment_that_ends_before_it_starts(binary):
    c = binary.instantiate()
    assert binary("SetupExperiment", c, 0, 0.0, 1.0, 1, 0.5) == ERROR
    assert "goes from 1 to 0.5" in binary.messages[-1][2]


def test_status_of_a_slave_that_is_never_asynchronous(binary):
    c = binary.ready()
    binary.step(c, 0.0, 0.005)
    time, ended = ctypes.c_double(), ctypes.c_int(7)
    assert binary("GetRealStatus", c, 2, ctypes.byref(time)) == OK
    assert time.value == 0.005
    assert binary("GetBooleanStatus", c, 3, ctypes.byref(ended)) == OK
    assert ended.value == 0
    assert binary("GetStatus", c, 0, ctypes.byref(ended)) == DISCARD
    assert binary("CancelStep", c) == ERROR


def test_joints_with_different_integration(make_law, make_model, tmp_path):
    one = make_law("parfam_tanh")
    model = make_model(one, replace(one, discretisation="euler"))
    with pytest.raises(ExportError, match="both exact and Euler"):
        export_fmu(model, tmp_path / "F.fmu")


@pytest.mark.parametrize(
    ("name", "unit", "reason"),
    [("a b", "1", "not a structured name"), ("a", "furlong", "'furlong' is unknown")],
)
def test_laws_that_fmi_cannot_name(make_model, tmp_path, name, unit, reason):
    own = Coefficient(name=name, unit=unit, description="odd")
    form = LawForm(coefficients=(own,), output=own.symbol * DQ)
    law = FrictionLaw(name="odd", form=form, values={name: 1.0})
    with pytest.raises(ExportError, match=reason):
        export_fmu(make_model(law), tmp_path / "F.fmu")


def test_states_that_are_named_as_the_output(make_model, tmp_path):
    state = Relaxation(name="tau", unit="1", drive=DQ, rate=sympy.Integer(1))
    form = LawForm(coefficients=(), relaxations=(state,), output=state.state)
    law = FrictionLaw(name="odd", form=form, values={})
    with pytest.raises(ExportError, match=r"'tau\[1\]' is used twice"):
        export_fmu(make_model(law), tmp_path / "F.fmu")
