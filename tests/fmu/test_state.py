"""Saving and restoring brings back everything, so that a simulation goes on bit for bit."""

import ctypes

import pytest

from fmu_src import export_fmu

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


def test_bytes_for_which_there_is_no_room(binary):
    c = binary.ready()
    state = saved(binary, c)
    size = len(serialised(binary, c, state))
    data = ctypes.create_string_buffer(b"x" * size, size)
    assert binary("SerializeFMUstate", c, state, data, size - 1) == ERROR
    assert binary.messages[-1].text == (
        f"fmi2SerializeFMUstate: {size - 1} bytes for a state of {size}."
    )
    assert data.raw == b"x" * size


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


def test_a_state_of_the_other_type_is_refused(binary):
    slave, exchanged = binary.ready(), binary.continuous()
    for one, other in ((slave, exchanged), (exchanged, slave)):
        binary.messages.clear()
        before = serialised(binary, one, saved(binary, one))
        assert binary("SetFMUstate", one, saved(binary, other)) == ERROR
        assert [m.text for m in binary.messages] == [
            "fmi2SetFMUstate: the state is one of the FMU's other type."
        ]
        assert serialised(binary, one, saved(binary, one)) == before


def test_slopes_of_inputs_are_part_of_a_state(binary):
    c = binary.ready()
    one, slope = (ctypes.c_int * 1)(1), (ctypes.c_double * 1)(0.5)
    assert binary("SetRealInputDerivatives", c, binary.references(["dq[1]"]), 1, one, slope) == 0
    state = saved(binary, c)
    ends = []
    for _ in range(2):
        assert binary("SetFMUstate", c, state) == 0
        assert binary.step(c, 0.0, 0.01) == 0
        ends.append(binary.get(c, "dq[1]", "h[1]", "tau[1]"))
    assert ends[0] == ends[1]
    assert ends[0][0] == pytest.approx(0.005)


def test_held_signs_are_part_of_a_state(make_law, make_model, load, tmp_path):
    fmu = load(export_fmu(make_model(make_law("viscous")), tmp_path / "F.fmu"))
    c = fmu.continuous({"dq[1]": 0.5})
    state = saved(fmu, c)
    fmu.event(c, {"dq[1]": -0.5})
    (torque,) = fmu.get(c, "tau[1]")
    assert fmu("SetFMUstate", c, state) == 0
    fmu.set_all(c, {"dq[1]": -0.5})
    assert fmu.get(c, "tau[1]") == [pytest.approx(torque + 2.0 * 4.5)]
