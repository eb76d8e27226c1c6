"""A NULL argument or instance gives an error with a reason, never a crash."""

import ctypes
from pathlib import Path

import pytest

OK, DISCARD, ERROR = 0, 2, 3


def some(kind, *values):
    return (kind * len(values))(*values)


def address(kind):
    return ctypes.byref(kind())


REFERENCE, REAL, INTEGER = (
    some(ctypes.c_uint, 0),
    some(ctypes.c_double, 0.1),
    some(ctypes.c_int, 1),
)

# Arguments after the instance; pointers are in lists, and each of them is NULL once.
IN_STEPS = {
    "SetDebugLogging": (1, 1, [some(ctypes.c_char_p, b"logAll")]),
    "SetupExperiment": (0, 0.0, 0.0, 0, 0.0),
    "EnterInitializationMode": (),
    "ExitInitializationMode": (),
    "Terminate": (),
    "Reset": (),
    "GetReal": ([REFERENCE], 1, [REAL]),
    "SetReal": ([REFERENCE], 1, [REAL]),
    "GetInteger": ([REFERENCE], 1, [INTEGER]),
    "SetInteger": ([REFERENCE], 1, [INTEGER]),
    "GetFMUstate": ([address(ctypes.c_void_p)],),
    "SetFMUstate": (["state"],),
    "SerializedFMUstateSize": (["state"], [address(ctypes.c_size_t)]),
    "SerializeFMUstate": (["state"], ["bytes"], "size"),
    "DeSerializeFMUstate": (["bytes"], "size", [address(ctypes.c_void_p)]),
    "GetDirectionalDerivative": ([REFERENCE], 1, [REFERENCE], 1, [REAL], [REAL]),
    "SetRealInputDerivatives": ([REFERENCE], 1, [INTEGER], [REAL]),
    "DoStep": (0.0, 0.1, 1),
    "CancelStep": (),
    "GetRealStatus": (2, [address(ctypes.c_double)]),
    "GetBooleanStatus": (3, [address(ctypes.c_int)]),
}
AT_EVENTS = {"NewDiscreteStates": ([ctypes.create_string_buffer(64)],)}
CONTINUOUS = {
    "EnterEventMode": (),
    "EnterContinuousTimeMode": (),
    "CompletedIntegratorStep": (1, [address(ctypes.c_int)], [address(ctypes.c_int)]),
    "SetTime": (0.5,),
    "SetContinuousStates": ([some(ctypes.c_double, 0, 0, 0)], 3),
    "GetDerivatives": ([some(ctypes.c_double, 0, 0, 0)], 3),
    "GetContinuousStates": ([some(ctypes.c_double, 0, 0, 0)], 3),
    "GetNominalsOfContinuousStates": ([some(ctypes.c_double, 0, 0, 0)], 3),
}
# Their pointers are ignored, since the count of values is zero.
WITHOUT_VALUES = {
    "GetBoolean": (None, 0, None),
    "SetBoolean": (None, 0, None),
    "GetString": (None, 0, None),
    "SetString": (None, 0, None),
    "GetRealOutputDerivatives": (None, 0, None, None),
    "GetEventIndicators": (None, 0),
    "FreeFMUstate": (None,),
    "GetStatus": (0, None),
    "GetIntegerStatus": (0, None),
    "GetStringStatus": (0, None),
}
EVERY = IN_STEPS | AT_EVENTS | CONTINUOUS | WITHOUT_VALUES


def test_the_tables_list_every_function(request):
    header = Path(request.config.rootpath, "fmu_src/c/fmi2.h").read_text(encoding="utf-8")
    declared = {part.split(")")[0] for part in header.split("FMI2_STATUS(fmi2")[1:]}
    assert declared == set(EVERY)
    # Except version, platform, instantiation and freeing.
    assert len(declared) == 40


@pytest.mark.parametrize("function", list(EVERY))
def test_a_missing_instance_is_an_error(binary, function):
    arguments = [None if isinstance(a, (list, str)) else a for a in EVERY[function]]
    assert binary(function, None, *arguments) == ERROR
    assert binary.messages == []


def test_freeing_null_is_allowed(binary):
    binary("FreeInstance", None)
    c, none = binary.ready(), ctypes.c_void_p()
    assert binary("FreeFMUstate", c, None) == OK
    assert binary("FreeFMUstate", c, ctypes.byref(none)) == OK


def with_state(binary, c, arguments):
    """The arguments with values of this instance inserted."""
    state, size = ctypes.c_void_p(), ctypes.c_size_t()
    assert binary("GetFMUstate", c, ctypes.byref(state)) == OK
    assert binary("SerializedFMUstateSize", c, state, ctypes.byref(size)) == OK
    data = ctypes.create_string_buffer(size.value)
    assert binary("SerializeFMUstate", c, state, data, size) == OK
    own = {"state": state, "bytes": data, "size": size}
    pointers = [i for i, a in enumerate(arguments) if isinstance(a, list)]
    plain = [a[0] if isinstance(a, list) else a for a in arguments]
    return [own[a] if isinstance(a, str) else a for a in plain], pointers


def has_pointers(function):
    return any(isinstance(a, list) for a in EVERY[function])


@pytest.mark.parametrize("function", [*filter(has_pointers, EVERY)])
def test_every_null_pointer_is_refused(binary, function):
    def make():
        if function in CONTINUOUS:
            return binary.continuous()
        return binary.ready(kind=function in IN_STEPS)

    _, pointers = with_state(binary, make(), EVERY[function])
    for i in pointers:
        c = make()
        arguments, _ = with_state(binary, c, EVERY[function])
        arguments[i] = None
        binary.messages.clear()
        assert binary(function, c, *arguments) == ERROR
        (message,) = binary.messages
        assert message.text == f"fmi2{function}: an argument is NULL."
        assert (message.status, message.category) == (ERROR, "logStatusError")
        assert len(binary.get(c, "tau[1]")) == 1
        assert binary("Reset", c) == OK


def test_unknown_statuses_are_refused(binary):
    c = binary.ready()
    for function, kind in (
        ("GetStatus", 0),
        ("GetStringStatus", 1),
        ("GetIntegerStatus", 0),
        ("GetRealStatus", 0),
        ("GetBooleanStatus", 0),
    ):
        binary.messages.clear()
        assert binary(function, c, kind, None) == DISCARD
        (message,) = binary.messages
        assert f"fmi2{function}: steps are never asynchronous" in message.text


def test_a_null_string_is_refused(binary):
    c = binary.ready()
    assert binary("SetDebugLogging", c, 1, 1, (ctypes.c_char_p * 1)(None)) == ERROR
    assert "a category is unknown" in binary.messages[-1].text
    assert binary("SetDebugLogging", c, 1, 0, None) == OK
