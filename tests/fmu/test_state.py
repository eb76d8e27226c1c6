"""Saving and restoring brings back everything, so that a simulation goes on bit for bit."""

import ctypes

import pytest

ERROR = 3


def run(binary, c, first, last):
    rows = []
    for k in range(first, last):
        binary.set(c, dq=0.3 * (-1) ** (k // 7) + 0.01 * k)
        assert binary.step(c, 0.005 * k, 0.005) == 0
        rows.append(binary.get(c, "tau[1]", "h[1]", "der(h[1])"))
    return rows


def saved(binary, c):
    state = ctypes.c_void_p()
    assert binary("GetFMUstate", c, ctypes.byref(state)) == 0
    return state


def serialised(binary, c, state):
    size = ctypes.c_size_t()
    assert binary("SerializedFMUstateSize", c, state, ctypes.byref(size)) == 0
    data = ctypes.create_string_buffer(size.value)
    assert binary("SerializeFMUstate", c, state, data, size) == 0
    return data.raw


def test_a_restored_state_goes_on_bit_for_bit(binary):
    c = binary.ready()
    run(binary, c, 0, 20)
    state = saved(binary, c)
    first = run(binary, c, 20, 60)
    assert binary("SetFMUstate", c, state) == 0
    assert run(binary, c, 20, 60) == first
    assert binary("FreeFMUstate", c, ctypes.byref(state)) == 0
    assert state.value is None
    assert binary("FreeFMUstate", c, ctypes.byref(state)) == 0


def test_a_serialised_state_goes_on_in_another_instance(binary):
    c = binary.ready()
    run(binary, c, 0, 20)
    data = serialised(binary, c, saved(binary, c))
    first = run(binary, c, 20, 60)
    other, state = binary.instantiate(name=b"other"), ctypes.c_void_p()
    assert binary("DeSerializeFMUstate", other, data, len(data), ctypes.byref(state)) == 0
    assert binary("SetFMUstate", other, state) == 0
    assert run(binary, other, 20, 60) == first


def test_equal_instances_have_equal_states(binary):
    instances = [binary.ready(name=name) for name in (b"a", b"b")]
    for c in instances:
        run(binary, c, 0, 20)
    first, second = (serialised(binary, c, saved(binary, c)) for c in instances)
    assert first == second


def test_states_of_other_models_are_refused(binary):
    c = binary.ready()
    data = serialised(binary, c, saved(binary, c))
    state = ctypes.c_void_p()
    for wrong in (data[:-1], b"x" + data[1:], b""):
        result = binary("DeSerializeFMUstate", c, wrong, len(wrong), ctypes.byref(state))
        assert result == ERROR
        assert "not a state of this model" in binary.messages[-1][2]
        assert state.value is None


def test_a_state_from_before_a_failure_mends_it(binary):
    c = binary.ready()
    run(binary, c, 0, 20)
    state = saved(binary, c)
    assert binary.step(c, 0.1, -1.0) == ERROR
    assert binary.step(c, 0.1, 0.005) == ERROR
    assert binary("SetFMUstate", c, state) == 0
    run(binary, c, 20, 60)


def test_reset_restores_all_start_values(table1, binary):
    c = binary.ready()
    first = run(binary, c, 0, 60)
    binary.set_all(c, {"joint[1].c_0": 5.0})
    assert binary("Reset", c) == 0
    assert binary("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == 0
    assert binary("EnterInitializationMode", c) == 0
    assert binary.get(c, "dq[1]", "h[1]", "joint[1].c_0") == [
        0.0, 0.0, pytest.approx(table1.laws[0].values["c_0"]),
    ]  # fmt: skip
    assert binary("ExitInitializationMode", c) == 0
    assert run(binary, c, 0, 60) == first
