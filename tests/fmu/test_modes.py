"""Calls allowed in each mode of an instance, and values held between events in model exchange."""

import ctypes
import math

import pytest
from containing import Containing

from fmu_src.friction.friction_fmu import export_bare

OK, DISCARD, ERROR = 0, 2, 3
EXCHANGE, SLAVE = 0, 1

# Modes of the two state machines of the standard: instantiated, initialisation, event, continuous,
# step complete, terminated, error.
MODES = {EXCHANGE: "inectf", SLAVE: "instf"}


@pytest.fixture(scope="module")
def fmu_file(make_law, make_model, tmp_path_factory):
    """An FMU with two states and three indicators."""
    model = make_model(make_law("lugre"), make_law("viscous"), make_law("lugre"))
    return export_bare(model, tmp_path_factory.mktemp("modes") / "F.fmu")


@pytest.fixture
def fmu(fmu_file, load):
    return load(fmu_file)


def instance(fmu, kind, mode):
    c = fmu.instantiate(kind=kind)
    way = {"i": [], "n": ["EnterInitializationMode"]}.get(
        mode, ["EnterInitializationMode", "ExitInitializationMode"]
    )
    way = way + {"c": ["EnterContinuousTimeMode"], "t": ["Terminate"]}.get(mode, [])
    assert fmu("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == OK
    assert [fmu(function, c) for function in way] == [OK] * len(way)
    if mode == "f":
        assert fmu("SetReal", c, (ctypes.c_uint * 1)(9999), 1, (ctypes.c_double * 1)()) == ERROR
    return c


def content(fmu, c):
    state, size = ctypes.c_void_p(), ctypes.c_size_t()
    assert fmu("GetFMUstate", c, ctypes.byref(state)) == OK
    assert fmu("SerializedFMUstateSize", c, state, ctypes.byref(size)) == OK
    data = ctypes.create_string_buffer(size.value)
    assert fmu("SerializeFMUstate", c, state, data, size) == OK
    assert fmu("FreeFMUstate", c, ctypes.byref(state)) == OK
    return data.raw


def reals(n):
    return (ctypes.c_double * n)(*[0.5] * n)


# Each call with valid arguments, and the modes of model exchange and co-simulation that allow it
# according to the standard.
CALLS = {
    "SetDebugLogging": ((0, 0, None), "inectf", "instf"),
    "SetupExperiment": ((0, 0.0, 0.0, 0, 0.0), "i", "i"),
    "EnterInitializationMode": ((), "i", "i"),
    "ExitInitializationMode": ((), "n", "n"),
    "Terminate": ((), "ec", "s"),
    "Reset": ((), "inectf", "instf"),
    "GetReal": ((None, 0, None), "nectf", "nstf"),
    "GetInteger": ((None, 0, None), "nectf", "nstf"),
    "GetBoolean": ((None, 0, None), "nectf", "nstf"),
    "GetString": ((None, 0, None), "nectf", "nstf"),
    "SetReal": ((None, 0, None), "inec", "ins"),
    "SetInteger": ((None, 0, None), "inec", "ins"),
    "SetBoolean": ((None, 0, None), "inec", "ins"),
    "SetString": ((None, 0, None), "inec", "ins"),
    "GetFMUstate": ((ctypes.byref(ctypes.c_void_p()),), "inectf", "instf"),
    "FreeFMUstate": ((ctypes.byref(ctypes.c_void_p()),), "inectf", "instf"),
    "GetDirectionalDerivative": ((None, 0, None, 0, None, None), "nectf", "nstf"),
    "EnterEventMode": ((), "ec", ""),
    "NewDiscreteStates": ((ctypes.create_string_buffer(64),), "e", ""),
    "EnterContinuousTimeMode": ((), "e", ""),
    "CompletedIntegratorStep": (
        (1, ctypes.byref(ctypes.c_int()), ctypes.byref(ctypes.c_int())),
        "c",
        "",
    ),
    "SetTime": ((0.5,), "ec", ""),
    "SetContinuousStates": ((reals(2), 2), "c", ""),
    "GetDerivatives": ((reals(2), 2), "nectf", ""),
    "GetEventIndicators": ((reals(3), 3), "nectf", ""),
    "GetContinuousStates": ((reals(2), 2), "nectf", ""),
    "GetNominalsOfContinuousStates": ((reals(2), 2), "inectf", ""),
    "SetRealInputDerivatives": ((None, 0, None, None), "", "ins"),
    "GetRealOutputDerivatives": ((None, 0, None, None), "", "nstf"),
    "DoStep": ((0.0, 0.1, 1), "", "s"),
    "GetStatus": ((0, ctypes.byref(ctypes.c_int())), "", "stf"),
    "GetRealStatus": ((2, ctypes.byref(ctypes.c_double())), "", "stf"),
    "GetIntegerStatus": ((0, ctypes.byref(ctypes.c_int())), "", "stf"),
    "GetBooleanStatus": ((3, ctypes.byref(ctypes.c_int())), "", "stf"),
    "GetStringStatus": ((1, ctypes.byref(ctypes.c_void_p())), "", "stf"),
}


@pytest.mark.parametrize("kind", [EXCHANGE, SLAVE])
@pytest.mark.parametrize("function", list(CALLS))
def test_calls_are_accepted_in_the_modes_of_the_standard(fmu, function, kind):
    arguments, *allowed = CALLS[function]
    for mode in MODES[kind]:
        c = instance(fmu, kind, mode)
        before = content(fmu, c)
        fmu.messages.clear()
        status = fmu(function, c, *arguments)
        if mode in allowed[kind]:
            assert status in (OK, DISCARD), mode
            assert len(fmu.messages) == (status == DISCARD)
        else:
            assert status == ERROR, mode
            (message,) = fmu.messages
            assert f"fmi2{function} is not allowed in this" in message.text
            assert (message.status, message.category) == (ERROR, "logStatusError")
            assert content(fmu, c) == before
        fmu("FreeInstance", c)


@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        ("dq[1]", ("inec", "ins")),
        ("joint[1].sigma_0", ("ine", "ins")),
        ("z[1]", ("ec", "")),
        ("z_start[1]", ("in", "in")),
        ("tau[1]", ("", "")),
        ("dtau_ddq[1]", ("", "")),
        ("der(z[1])", ("", "")),
    ],
)
def test_variables_are_settable_in_the_modes_of_the_standard(fmu, name, allowed):
    for kind, modes in MODES.items():
        for mode in set(modes) - set("tf"):
            c = instance(fmu, kind, mode)
            fmu.messages.clear()
            assert fmu.set_all(c, {name: 0.5}) == (OK if mode in allowed[kind] else ERROR)
            texts = [Containing(f"fmi2SetReal: {name} cannot be set")]
            assert [m.text for m in fmu.messages] == ([] if mode in allowed[kind] else texts)


def completed(fmu, c):
    event, end = ctypes.c_int(7), ctypes.c_int(7)
    assert fmu("CompletedIntegratorStep", c, 1, ctypes.byref(event), ctypes.byref(end)) == OK
    assert end.value == 0
    return bool(event.value)


def test_signs_are_held_between_events(fmu):
    c = fmu.continuous({"dq[2]": 0.5, "tau_load[2]": -8.0}, logging=1)

    def torque(sign, dq):
        return sign * (4.5 + 0.1 * 8.0) + 12.0 * dq**3 + 0.5

    assert fmu.get(c, "tau[2]")[0] == pytest.approx(torque(1.0, 0.5))
    assert min(fmu.numbers("GetEventIndicators", c, 3)) > 0.0
    assert not completed(fmu, c)
    fmu.set_all(c, {"dq[2]": -0.3})
    assert fmu.get(c, "tau[2]")[0] == pytest.approx(torque(1.0, -0.3))
    assert min(fmu.numbers("GetEventIndicators", c, 3)) == -0.3
    assert completed(fmu, c)
    fmu.messages.clear()
    fmu("SetTime", c, 1.5)
    fmu.event(c)
    assert [m.text for m in fmu.messages] == ["The sign of dq of joint 2 becomes -1. (1.5 s)"]
    assert fmu.get(c, "tau[2]")[0] == pytest.approx(torque(-1.0, -0.3))
    assert min(fmu.numbers("GetEventIndicators", c, 3)) > 0.0
    assert not completed(fmu, c)


def test_rest_is_a_narrow_band_around_zero(fmu):
    c = fmu.continuous({"dq[1]": 0.5})
    for dq, sign in ((9e-10, 0.0), (-9e-10, 0.0), (-1.1e-9, -1.0), (0.0, 0.0), (1.1e-9, 1.0)):
        fmu.set_all(c, {"dq[1]": dq})
        fmu.event(c)
        # The rate sigma_0 abs(dq) / g follows from the held sign.
        assert min(fmu.numbers("GetEventIndicators", c, 3)) > 0.0
        fmu.set_all(c, {"dq[1]": 1.0})
        assert completed(fmu, c) == (sign <= 0.0)


def test_a_step_back_across_zero_needs_no_event(fmu):
    c = fmu.continuous({"dq[1]": 0.5, "dq[2]": 0.5, "dq[3]": 0.5, "tau_load[2]": 1.0})
    first = fmu.get(c, "tau[2]", "der(z[1])")
    for dq in (-0.2, 0.0, 0.5):
        fmu.set_all(c, {"dq[1]": dq, "dq[2]": dq})
        assert completed(fmu, c) == (dq <= 0.0)
    assert fmu.get(c, "tau[2]", "der(z[1])") == first


def test_slope_is_discrete(fmu):
    c = fmu.continuous({"dq[2]": 0.5})
    at_event = fmu.get(c, "dtau_ddq[2]")
    assert at_event == [pytest.approx(36.0 * 0.5**2)]
    fmu.set_all(c, {"dq[2]": 0.7})
    assert fmu.get(c, "dtau_ddq[2]") == at_event
    fmu.event(c)
    assert fmu.get(c, "dtau_ddq[2]") == [pytest.approx(36.0 * 0.7**2)]


def test_parameters_change_at_events_without_changing_the_state(fmu):
    c = fmu.continuous({"dq[1]": 0.5, "dq[2]": 0.5})
    assert fmu("SetContinuousStates", c, (ctypes.c_double * 2)(2e-3, 1e-3), 2) == OK
    before = fmu.get(c, "tau[2]")[0]
    fmu.event(c, {"joint[1].sigma_0": 1.0e3, "joint[2].F_c": 5.5})
    assert fmu.numbers("GetContinuousStates", c, 2) == [2e-3, 1e-3]
    assert fmu.get(c, "tau[2]")[0] == pytest.approx(before + 1.0)
    z, dz, tau = fmu.get(c, "z[1]", "der(z[1])", "tau[1]")
    assert tau == pytest.approx(1.0e3 * z + 1.5 * dz)


def test_states_and_derivatives_are_arrays(fmu):
    c = fmu.continuous({"dq[1]": 0.5, "dq[3]": -0.25})
    assert fmu.numbers("GetDerivatives", c, 2) == [0.5, -0.25]
    assert fmu("SetContinuousStates", c, (ctypes.c_double * 2)(2e-3, -1e-3), 2) == OK
    assert fmu.numbers("GetContinuousStates", c, 2) == fmu.get(c, "z[1]", "z[3]") == [2e-3, -1e-3]
    rates = [2.0e3 * dq / (9.0 + 3.0 * math.exp(-((dq / 0.08) ** 2))) for dq in (0.5, 0.25)]
    expected = [pytest.approx(0.5 - rates[0] * 2e-3), pytest.approx(-0.25 + rates[1] * 1e-3)]
    assert fmu.numbers("GetDerivatives", c, 2) == expected
    assert fmu.get(c, "der(z[1])", "der(z[3])") == expected


def test_a_constant_indicator_is_available_to_hosts_that_need_one(table1, load, tmp_path):
    fmu = load(export_bare(table1, tmp_path / "F.fmu"))
    c = instance(fmu, EXCHANGE, "c")
    for speed in (-1.0, 0.0, 1.0):
        assert fmu.set_all(c, {"dq[1]": speed}) == OK
        assert fmu.numbers("GetEventIndicators", c, 1) == [1.0]


@pytest.mark.parametrize(
    "function",
    [
        "SetContinuousStates",
        "GetContinuousStates",
        "GetDerivatives",
        "GetNominalsOfContinuousStates",
        "GetEventIndicators",
    ],
)
def test_arrays_of_a_wrong_size_are_refused(fmu, function):
    right = 3 if function == "GetEventIndicators" else 2
    for n in (0, right - 1, right + 1):
        c = fmu.continuous()
        fmu.messages.clear()
        assert fmu(function, c, reals(8), n) == ERROR
        (message,) = fmu.messages
        assert message.text == f"fmi2{function}: the array has {n} elements; expected {right}."


@pytest.mark.parametrize("odd", [float("nan"), float("inf")])
def test_non_finite_states_are_refused(fmu, odd):
    c = fmu.continuous({"dq[1]": 0.5})
    before = content(fmu, c)
    fmu.messages.clear()
    assert fmu("SetContinuousStates", c, (ctypes.c_double * 2)(1e-3, odd), 2) == DISCARD
    (message,) = fmu.messages
    assert message.text == f"fmi2SetContinuousStates: z[3] is {odd:g}; a finite number is needed."
    assert (message.status, message.category) == (DISCARD, "logStatusDiscard")
    assert content(fmu, c) == before
