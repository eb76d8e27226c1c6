"""Mistakes of a host give an error with a reason, never a crash or a wrong number."""

import ctypes
import math

import pytest
from containing import Containing
from fmpy import simulate_fmu
from fmpy.fmi1 import FMICallException

from fmu_src import model_file
from fmu_src.friction.friction_fmu import export_bare
from hesr_model.friction.model import FrictionModel

OK, DISCARD, ERROR = 0, 2, 3


def told(fmu):
    """The single message since the last call of this function."""
    (message,) = fmu.messages
    fmu.messages.clear()
    return message


def assert_refused(fmu, text):
    message = told(fmu)
    said = message.text.replace("-nan", "nan")  # the sign of NaN depends on processor and compiler
    assert message._replace(text=said) == (
        4711,
        "one",
        Containing(text),
        DISCARD,
        "logStatusDiscard",
    )


def assert_failed(fmu, c, *parts):
    """Only reading, reset, restoring a state and freeing remain allowed."""
    assert told(fmu) == (4711, "one", Containing(*parts), ERROR, "logStatusError")
    assert fmu.step(c, 0.0, 0.005) == ERROR
    assert "fmi2DoStep is not allowed in this" in told(fmu).text
    assert fmu.set(c, dq=0.1) == ERROR
    assert fmu.get(c, "dq[1]") == [0.0]
    assert fmu("Reset", c) == OK
    assert fmu("EnterInitializationMode", c) == OK
    fmu.messages.clear()


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["dq[2]", "joint[3].alpha"])
def test_non_finite_values_are_refused(binary, name, value):
    c, other = binary.ready(), binary.ready()
    assert binary.set_all(c, {name: value}) == DISCARD
    assert_refused(binary, f"fmi2SetReal: {name} is {value:g}; a finite number is needed.")
    for each in (c, other):
        assert binary.set(each, dq=0.1) == OK
        assert binary.step(each, 0.0, 0.005) == OK
    outputs = ("dq[2]", "joint[3].alpha", "tau[1]", "tau[2]", "tau[3]")
    assert binary.get(c, *outputs) == binary.get(other, *outputs)


def test_a_call_sets_all_values_or_none(binary):
    c = binary.ready()
    assert binary.set_all(c, {"dq[1]": 0.5, "dq[2]": math.nan}) == DISCARD
    assert binary.get(c, "dq[1]") == [0.0]


@pytest.mark.parametrize("step", [0.0, -0.005, math.nan, math.inf])
def test_non_positive_steps_are_refused(binary, step):
    c = binary.ready()
    assert binary.step(c, 1.25, step) == ERROR
    text = f"fmi2DoStep: the step is {step:g} s from time 1.25 s; it must be positive."
    assert_failed(binary, c, text)


def slopes(fmu, c, value, name="dq[1]", order=1):
    arguments = ((ctypes.c_int * 1)(order), (ctypes.c_double * 1)(value))
    return fmu("SetRealInputDerivatives", c, fmu.references([name]), 1, *arguments)


def test_euler_refuses_long_steps(binary):
    """A shorter step may follow as if the long one had not been requested."""
    c, other = binary.ready(), binary.ready()
    for each in (c, other):
        assert binary.set(each, dq=0.4) == OK
        assert slopes(binary, each, 0.5) == OK
    for _ in range(2):
        assert binary.step(c, 0.0, 0.1) == DISCARD
        assert_refused(
            binary,
            "found 1.137 at dq[1] = 0.425",
        )
        time = ctypes.c_double(7.0)
        assert binary("GetRealStatus", c, 2, ctypes.byref(time)) == OK
        assert time.value == 0.0
    for each in (c, other):
        assert binary.step(each, 0.0, 0.005) == OK
    outputs = ("dq[1]", "h[1]", "der(h[1])", "tau[1]", "dtau_ddq[1]")
    assert binary.get(c, *outputs) == binary.get(other, *outputs)
    assert binary.get(c, "dq[1]") == [pytest.approx(0.4 + 0.5 * 0.005)]


def test_repeated_refusals_become_an_error(binary):
    """Hosts that repeat a discarded step would not end; those that shorten it continue."""
    c = binary.ready()
    for step in (0.1, 0.11, 0.1):
        for _ in range(10):
            assert binary.step(c, 0.0, step) == DISCARD
    binary.messages.clear()
    assert binary.step(c, 0.0, 0.1) == ERROR
    text = "found 1.137 at dq[1] = 0"
    assert_failed(binary, c, text, "This step has been requested 11 times.")


def test_a_successful_step_resets_the_count_of_refusals(binary):
    c = binary.ready()
    for _ in range(3):
        for _ in range(6):
            assert binary.step(c, 0.0, 0.1) == DISCARD
        assert binary.step(c, 0.0, 0.005) == OK


def test_fmpy_ends_if_every_step_is_refused(tmp_path):
    fmu = export_bare(FrictionModel.read(model_file("uf850-table1")), tmp_path / "Friction.fmu")
    told = []
    with pytest.raises(FMICallException):
        simulate_fmu(
            str(fmu),
            output_interval=0.1,
            stop_time=1.0,
            fmi_type="CoSimulation",
            logger=lambda *message: told.append(message[-1]),
        )
    assert told[-1].endswith(b"This step has been requested 11 times.")


def test_negative_rates_are_treated_as_zero(binary):
    c = binary.ready()
    binary.set_all(c, {"dq[2]": 0.4})
    assert binary.step(c, 0.0, 0.005) == OK
    [before] = binary.get(c, "h[2]")
    binary.set_all(c, {"joint[2].alpha": -3.0, "dq[2]": 0.0})
    for k in range(1, 201):  # a rate of -3 would multiply it by e^3
        assert binary.step(c, 0.005 * k, 0.005) == OK
    assert binary.get(c, "h[2]", "der(h[2])") == [before, 0.0]


@pytest.fixture
def exploding(make_law, make_model, load, tmp_path):
    """An FMU whose output can overflow."""
    return load(export_bare(make_model(make_law("parfam_exp")), tmp_path / "F.fmu"))


def test_infinite_outputs_after_a_step_are_errors(exploding):
    c = exploding.ready()
    exploding.set(c, dq=1e4)
    assert exploding.step(c, 2.0, 0.005) == ERROR
    assert told(exploding).text == "tau[1] became inf at time 2.005."
    assert exploding.get(c, "dq[1]") == [1e4]
    values = (ctypes.c_double * 1)()
    assert exploding("GetReal", c, exploding.references(["tau[1]"]), 1, values) == ERROR
    assert told(exploding).text == "tau[1] became inf at time 2.005."
    assert exploding.set(c, dq=0.0) == ERROR


def test_infinite_outputs_at_the_start_are_errors(exploding):
    for kind in (0, 1):
        c = exploding.instantiate(kind=kind)
        exploding.set(c, dq=1e4)
        assert exploding("SetupExperiment", c, 0, 0.0, 2.0, 0, 0.0) == OK
        assert exploding("EnterInitializationMode", c) == OK
        values = (ctypes.c_double * 1)()
        assert exploding("GetReal", c, exploding.references(["tau[1]"]), 1, values) == DISCARD
        assert_refused(exploding, "tau[1] became inf at time 2.")
        assert exploding("ExitInitializationMode", c) == ERROR
        message = (4711, "one", "tau[1] became inf at time 2.", ERROR, "logStatusError")
        assert told(exploding) == message


def test_infinite_outputs_are_discarded_for_a_solver(exploding):
    """It can try a shorter step."""
    c = exploding.continuous({"dq[1]": 1.0})
    exploding.set(c, dq=1e4)
    values, direction = (ctypes.c_double * 1)(), (ctypes.c_double * 1)(1.0)
    tau, dq = (exploding.references([name]) for name in ("tau[1]", "dq[1]"))
    for call in (
        ("GetReal", c, tau, 1, values),
        ("GetDerivatives", c, values, 1),
        ("GetDirectionalDerivative", c, tau, 1, dq, 1, direction, values),
    ):
        assert exploding(*call) == DISCARD
        assert_refused(exploding, "tau[1] became inf at time 0.")
    exploding.set(c, dq=1.0)
    assert exploding("GetReal", c, tau, 1, values) == OK


@pytest.fixture
def steep(make_law, make_model, load, tmp_path):
    """An FMU with a finite torque and a non-finite slope: exp(-dq^2) dq is 0 times inf."""
    return load(export_bare(make_model(make_law("lugre")), tmp_path / "F.fmu"))


def derivative(fmu, c, direction, unknown="tau[1]"):
    result = (ctypes.c_double * 2)(4.0, 5.0)
    unknowns, known = fmu.references([unknown, "der(z[1])"]), fmu.references(["dq[1]"])
    seed = (ctypes.c_double * 1)(direction)
    return fmu("GetDirectionalDerivative", c, unknowns, 2, known, 1, seed, result), list(result)


def slope_of(fmu, c):
    values = (ctypes.c_double * 2)(4.0, 5.0)
    return fmu("GetReal", c, fmu.references(["tau[1]", "dtau_ddq[1]"]), 2, values), list(values)


def test_non_finite_slopes_are_reported(steep):
    c = steep.ready()
    assert steep.step(c, 0.0, 0.005) == OK
    steep.set(c, dq=1e160)
    assert math.isfinite(steep.get(c, "tau[1]")[0])
    assert slope_of(steep, c) == (DISCARD, [4.0, 5.0])
    assert_refused(steep, "dtau_ddq[1] became nan at time 0.005.")
    assert derivative(steep, c, 1.0) == (DISCARD, [4.0, 5.0])
    assert_refused(
        steep, "fmi2GetDirectionalDerivative: the derivative of tau[1] is nan at time 0.005."
    )
    steep.set(c, dq=0.1)
    status, (_, slope) = slope_of(steep, c)
    assert (status, math.isfinite(slope)) == (OK, True)
    assert derivative(steep, c, 1.0)[0] == OK


def test_non_finite_slopes_are_discarded_for_a_solver(steep):
    c = steep.continuous({"dq[1]": 1e160})
    assert slope_of(steep, c) == (DISCARD, [4.0, 5.0])
    assert_refused(steep, "dtau_ddq[1] became nan at time 0.")
    steep.set(c, dq=0.1)
    assert slope_of(steep, c)[0] == DISCARD  # still that of the last event
    steep.messages.clear()
    assert derivative(steep, c, 1.0)[0] == OK
    steep.event(c)
    assert slope_of(steep, c)[0] == OK


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_non_finite_directions_are_refused(steep, value):
    c = steep.ready()
    assert derivative(steep, c, value) == (DISCARD, [4.0, 5.0])
    assert_refused(
        steep, f"fmi2GetDirectionalDerivative: dq[1] is {value:g}; a finite number is needed."
    )
    assert derivative(steep, c, 1.0)[0] == OK


def test_invalid_input_derivatives_are_refused(binary):
    for name, order in (("tau[1]", 1), ("joint[1].alpha", 1), ("dq[1]", 2), ("dq[1]", 0)):
        c = binary.ready()
        assert slopes(binary, c, 1.0, name, order) == ERROR
        assert_failed(
            binary,
            c,
            f"inputs can be set, not of {name}",
        )
    c = binary.ready()
    assert slopes(binary, c, 0.5) == OK
    assert slopes(binary, c, math.nan) == DISCARD
    text = "fmi2SetRealInputDerivatives: dq[1] is nan; a finite number is needed."
    assert_refused(binary, text)
    assert binary.step(c, 0.0, 0.005) == OK
    assert binary.get(c, "dq[1]") == [pytest.approx(0.0025)]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"guid": b"{}"}, "the GUID"),
        ({"guid": b""}, "the GUID"),
        ({"kind": 2}, "wanted type"),
        ({"kind": -1}, "wanted type"),
        ({"name": b""}, "the instance has no name"),
        ({"name": None}, "the instance has no name"),
    ],
)
def test_invalid_instantiation_is_refused(binary, change, reason):
    assert binary.instantiate(**change) is None
    assert reason in binary.messages[-1][2]
    assert binary.instantiate(host=None, **change) is None


def test_a_logger_is_optional(binary):
    c = binary.ready(host=None)
    assert binary.set(c, dq=math.nan) == DISCARD
    binary("FreeInstance", c)
    binary.host = type(binary.host)()
    c = binary.ready(logging=1)
    assert binary.set(c, dq=math.nan) == DISCARD
    assert binary.step(c, 0.0, 0.0) == ERROR


def test_integration_is_chosen_before_the_start(binary):
    vr, value = binary.references(["discretisation"]), (ctypes.c_int * 1)(3)
    c = binary.instantiate()
    assert binary("SetInteger", c, vr, 1, value) == ERROR
    assert binary.messages[-1][2] == "fmi2SetInteger: discretisation is 3; expected 1 to 2."
    c = binary.ready()
    value[0] = 1
    assert binary("SetInteger", c, vr, 1, value) == ERROR
    assert "discretisation cannot be set in this state" in binary.messages[-1][2]
    assert binary("GetInteger", c, vr, 1, value) == OK
    assert value[0] == 2


def test_unknown_value_references_and_types_are_refused(binary):
    values = (ctypes.c_double * 1)()
    for reference in (100000, 0xFFFFFFFF, binary.vr["discretisation"]):
        for function in ("GetReal", "SetReal"):
            c = binary.ready()
            assert binary(function, c, (ctypes.c_uint * 1)(reference), 1, values) == ERROR
            assert_failed(
                binary,
                c,
                f"type with value reference {reference}",
            )
    for function in ("GetBoolean", "GetString", "SetBoolean", "SetString"):
        c = binary.ready()
        assert binary(function, c, None, 0, None) == OK
        assert binary(function, c, (ctypes.c_uint * 1)(0), 1, values) == ERROR
        assert_failed(binary, c, f"fmi2{function}: there are no variables")


def test_steps_beyond_the_end_of_the_experiment_are_refused(binary):
    c = binary.instantiate()
    binary("SetupExperiment", c, 0, 0.0, 0.0, 1, 0.3)
    binary("EnterInitializationMode", c)
    binary("ExitInitializationMode", c)
    time = 0.0
    for _ in range(3):  # 0.1 + 0.1 + 0.1 exceeds 0.3
        assert binary.step(c, time, 0.1 * 0.5) == OK
        assert binary.step(c, time + 0.05, 0.05) == OK
        time += 0.1
    assert time > 0.3
    assert binary.step(c, time, 0.05) == ERROR
    assert_failed(
        binary,
        c,
        "fmi2DoStep: the step from 0.30000000000000004 s to "
        "0.35000000000000003 s passes the end, 0.29999999999999999 s.",
    )


@pytest.mark.parametrize(
    ("beyond", "status"), [(0.0009, OK), (0.0011, ERROR), (0.5, ERROR), (0.99, ERROR)]
)
def test_a_step_may_pass_the_end_by_a_thousandth(binary, beyond, status):
    c = binary.instantiate()
    binary("SetupExperiment", c, 0, 0.0, 0.0, 1, 0.25)
    binary("EnterInitializationMode", c)
    binary("ExitInitializationMode", c)
    assert binary.step(c, 0.245 + beyond * 0.005, 0.005) == status


def test_an_experiment_must_not_end_before_it_starts(binary):
    c = binary.instantiate()
    assert binary("SetupExperiment", c, 0, 0.0, 1.0, 1, 0.5) == ERROR
    assert "goes from 1 to 0.5" in binary.messages[-1][2]


def test_status_is_that_of_a_synchronous_slave(binary):
    c = binary.ready()
    binary.step(c, 0.0, 0.005)
    time, ended = ctypes.c_double(), ctypes.c_int(7)
    assert binary("GetRealStatus", c, 2, ctypes.byref(time)) == OK
    assert time.value == 0.005
    assert binary("GetBooleanStatus", c, 3, ctypes.byref(ended)) == OK
    assert ended.value == 0
    assert binary("GetStatus", c, 0, ctypes.byref(ended)) == DISCARD
    assert binary("CancelStep", c) == ERROR


def test_event_messages_are_optional(binary):
    def run(c):
        binary.messages.clear()
        for function in ("EnterInitializationMode", "ExitInitializationMode", "Terminate", "Reset"):
            assert binary(function, c) == OK
        return [(m.text, m.status, m.category) for m in binary.messages]

    def choose(c, on, *names):
        array = (ctypes.c_char_p * len(names))(*names)
        return binary("SetDebugLogging", c, on, len(names), array)

    everything = [
        ("Initialised at 0 s.", OK, "logEvents"),
        ("Terminated at 0 s.", OK, "logEvents"),
        ("Reset to the start values.", OK, "logEvents"),
    ]
    c, quiet = binary.instantiate(logging=1), binary.instantiate()
    assert (run(c), run(quiet)) == (everything, [])
    for names in ((), (b"logEvents",), (b"logAll",), (b"logStatusError", b"logEvents")):
        assert choose(c, 0, *names) == choose(quiet, 1, *names) == OK
        assert (run(c), run(quiet)) == ([], everything)
        assert choose(c, 1, *names) == choose(quiet, 0, *names) == OK
        assert (run(c), run(quiet)) == (everything, [])
    # Errors are always logged.
    assert choose(quiet, 0, b"logStatusError", b"logStatusDiscard") == OK
    assert binary("Terminate", quiet) == ERROR
    assert told(binary).category == "logStatusError"
    assert choose(quiet, 1, b"logEvents", b"logOdd") == ERROR
    assert told(binary).text == (
        "fmi2SetDebugLogging: a category is unknown; known are logEvents, logStatusDiscard, "
        "logStatusError and logAll."
    )
    assert run(quiet) == []
