"""Saving and restoring covers the whole state, so that a simulation resumes bit for bit."""

import ctypes
import itertools
import math
import random
import struct

import pytest
from containing import Containing

from fmu_src.friction.friction_fmu import export_bare

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


def test_a_restored_state_resumes_bit_for_bit(binary):
    c = binary.ready()
    run(binary, c, 0, 20)
    state = saved(binary, c)
    first = run(binary, c, 20, 60)
    assert binary("SetFMUstate", c, state) == 0
    assert run(binary, c, 20, 60) == first
    assert binary("FreeFMUstate", c, ctypes.byref(state)) == 0
    assert state.value is None
    assert binary("FreeFMUstate", c, ctypes.byref(state)) == 0


def test_a_serialised_state_resumes_in_another_instance(binary):
    c = binary.ready()
    run(binary, c, 0, 20)
    data = serialised(binary, c, saved(binary, c))
    first = run(binary, c, 20, 60)
    other, state = binary.instantiate(name=b"other"), ctypes.c_void_p()
    assert binary("DeSerializeFMUstate", other, data, len(data), ctypes.byref(state)) == 0
    assert binary("SetFMUstate", other, state) == 0
    assert run(binary, other, 20, 60) == first


def test_a_short_buffer_is_refused(binary):
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


def test_restoring_an_earlier_state_clears_a_failure(binary):
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
        0.0,
        0.0,
        pytest.approx(table1.laws[0].values["c_0"]),
    ]
    assert binary("ExitInitializationMode", c) == 0
    assert run(binary, c, 0, 60) == first


def test_a_state_of_the_other_type_is_refused(binary):
    slave, exchanged = binary.ready(), binary.continuous()
    for one, other in ((slave, exchanged), (exchanged, slave)):
        binary.messages.clear()
        before = serialised(binary, one, saved(binary, one))
        assert binary("SetFMUstate", one, saved(binary, other)) == ERROR
        assert [m.text for m in binary.messages] == [
            Containing("fmi2SetFMUstate: the state is one")
        ]
        assert serialised(binary, one, saved(binary, one)) == before


def test_input_derivatives_are_part_of_a_state(binary):
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
    fmu = load(export_bare(make_model(make_law("viscous")), tmp_path / "F.fmu"))
    c = fmu.continuous({"dq[1]": 0.5})
    state = saved(fmu, c)
    fmu.event(c, {"dq[1]": -0.5})
    (torque,) = fmu.get(c, "tau[1]")
    assert fmu("SetFMUstate", c, state) == 0
    fmu.set_all(c, {"dq[1]": -0.5})
    assert fmu.get(c, "tau[1]") == [pytest.approx(torque + 2.0 * 4.5)]


def deserialised(binary, c, data):
    """Status of reading the bytes, and the resulting state."""
    state = ctypes.c_void_p()
    status = binary("DeSerializeFMUstate", c, data, len(data), ctypes.byref(state))
    return status, state


def refused(binary, c, data):
    status, state = deserialised(binary, c, data)
    return status == ERROR and state.value is None


def test_a_state_with_one_changed_byte_is_refused(binary):
    c = binary.ready()
    run(binary, c, 0, 20)
    data = serialised(binary, c, saved(binary, c))
    chance = random.Random(17)
    for place in range(len(data)):
        other = bytes([data[place] ^ chance.randrange(1, 256)])
        assert refused(binary, c, data[:place] + other + data[place + 1 :]), place
    assert {m.text.partition(": ")[0] for m in binary.messages} == {"fmi2DeSerializeFMUstate"}
    assert deserialised(binary, c, data)[0] == 0


def test_a_state_with_two_changed_signs_is_refused(binary):
    """A product keeps the sign bit of a word in place, so that two could cancel in the sum."""
    c = binary.ready()
    run(binary, c, 0, 20)
    data = serialised(binary, c, saved(binary, c))
    signs = range(data.index(b"\0") // 8 * 8 + 15, len(data), 8)
    for first, second in itertools.pairwise(signs):
        changed = bytearray(data)
        changed[first] ^= 0x80
        changed[second] ^= 0x80
        assert refused(binary, c, bytes(changed)), first


def test_ten_thousand_corrupted_states_are_refused(binary):
    """Random bytes, reordered pieces, zeros, other sizes."""
    c = binary.ready()
    run(binary, c, 0, 20)
    data = serialised(binary, c, saved(binary, c))
    chance = random.Random(18)
    for k in range(10_000):
        changed = bytearray(data)
        first, last = sorted(chance.randrange(len(data) + 1) for _ in range(2))
        if k % 4 == 0:
            changed[first:last] = chance.randbytes(last - first)
        elif k % 4 == 1:
            changed[first:last] = bytes(last - first)
        elif k % 4 == 2:
            changed[first:last] = changed[first:last][::-1]
        else:
            del changed[first:last]
        if changed != data:
            assert refused(binary, c, bytes(changed)), (k, first, last)


def test_refused_bytes_leave_the_state_unchanged(binary):
    c = binary.ready()
    run(binary, c, 0, 20)
    state = saved(binary, c)
    data = serialised(binary, c, state)
    wrong = data[:-1] + bytes([data[-1] ^ 1])
    assert binary("DeSerializeFMUstate", c, wrong, len(wrong), ctypes.byref(state)) == ERROR
    assert binary.messages[-1].text == (
        "fmi2DeSerializeFMUstate: the state is refused: its checksum is wrong."
    )
    assert serialised(binary, c, state) == data
    run(binary, c, 20, 30)


def forged(data, place, value):
    """The bytes with one word of memory changed and the checksum updated, as in fmi2_state.c."""
    guid = data.index(b"\0") + 1
    version = -(-guid // 4) * 4
    sum_at = -(-(version + 4) // 8) * 8
    memory = sum_at + 8
    changed = bytearray(data)
    changed[memory + place : memory + place + len(value)] = value
    changed[sum_at:memory] = bytes(8)
    total = 14695981039346656037
    for (word,) in struct.iter_unpack("<Q", changed):
        total = ((total ^ word) * 1099511628211) % 2**64
        total ^= total >> 32
    changed[sum_at:memory] = struct.pack("<Q", total)
    return bytes(changed)


def test_an_impossible_state_is_refused(binary):
    """With a valid checksum, as from an attacker who knows the algorithm."""
    c = binary.ready()
    run(binary, c, 0, 20)
    data = serialised(binary, c, saved(binary, c))
    assert forged(data, 0, b"") == data
    nan = struct.pack("<d", float("nan"))
    (velocity,) = binary.references(["dq[1]"])
    (output,) = binary.references(["tau[1]"])
    guid = data.index(b"\0") + 1
    end = len(data) - (-(-(-(-guid // 4) * 4 + 4) // 8) * 8 + 8)  # the size of the memory
    integers = end - 24  # refusals, type, mode, sloped, stale, and padding
    for place, value, said in (
        (8 * velocity, nan, "dq[1] is nan"),
        (8 * output, nan, "tau[1] became nan"),
        (integers, struct.pack("<i", 99), "no instance can have this state"),
        (integers + 4, struct.pack("<i", 7), "no instance can have this state"),
        (integers + 8, struct.pack("<i", 0), "no instance can have this state"),
        (integers + 8, struct.pack("<i", 6), "no instance can have this state"),
        (integers + 8, struct.pack("<i", 8), "no instance can have this state"),
        (integers + 12, struct.pack("<i", 2), "no instance can have this state"),
        (integers + 16, struct.pack("<i", -1), "no instance can have this state"),
        (end - 40, nan, "no instance can have this state"),  # the end of the experiment
    ):
        assert refused(binary, c, forged(data, place, value)), (place, said)
        assert said in binary.messages[-1].text
    assert deserialised(binary, c, forged(data, 8 * velocity, struct.pack("<d", 0.1)))[0] == 0


@pytest.mark.parametrize(("kind", "derivatives"), [(0, True), (1, False)])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_each_value_that_must_be_finite_is_watched(binary, kind, derivatives, value):
    """Wherever it stands among the others; steps compute no derivatives."""
    c = binary.ready(kind=kind)
    data = serialised(binary, c, saved(binary, c))
    assert deserialised(binary, c, data)[0] == 0
    for i in (1, 2, 3):
        for name, watched in ((f"tau[{i}]", True), (f"der(h[{i}])", derivatives)):
            odd = forged(data, 8 * binary.vr[name], struct.pack("<d", value))
            assert refused(binary, c, odd) == watched, name
            if watched:
                said = binary.messages[-1].text.replace("-nan", "nan")
                assert f"{name} became {value:g} at time 0." in said


def test_large_values_are_finite_though_their_sum_is_not(binary):
    c = binary.ready()
    data = serialised(binary, c, saved(binary, c))
    for i in (1, 2, 3):
        data = forged(data, 8 * binary.vr[f"tau[{i}]"], struct.pack("<d", 1.7e308))
    assert deserialised(binary, c, data)[0] == 0


def test_accepted_forged_states_give_numbers_or_errors(binary):
    """With a valid checksum and arbitrary memory: results are finite if FMI returns OK."""
    c, other = binary.ready(), binary.ready(name=b"other")
    run(binary, c, 0, 20)
    data, new = serialised(binary, c, saved(binary, c)), saved(binary, other)
    guid = data.index(b"\0") + 1
    size = len(data) - (-(-(-(-guid // 4) * 4 + 4) // 8) * 8 + 8)
    chance = random.Random(19)
    odd = (0.0, -1.0, 5e-324, 1e-5, 1e15, 2.0**53, 1e100, 1e308, -1e308, float("inf"), float("nan"))
    accepted = 0
    for k in range(2000):
        value = chance.choice(
            (struct.pack("<d", chance.choice(odd)), chance.randbytes(8),
             struct.pack("<i", chance.choice((0, 1, 2, 4, 99, -1)))),
        )  # fmt: skip
        place = chance.randrange(size // len(value)) * len(value)
        status, state = deserialised(binary, other, forged(data, place, value))
        if status != 0:
            continue
        accepted += 1
        assert binary("SetFMUstate", other, state) == 0
        for i in range(3):
            if binary.step(other, 0.1 + 0.005 * i, 0.005) == 0:
                assert all(map(math.isfinite, binary.get(other, "tau[1]", "h[1]"))), (k, place)
        assert binary("FreeFMUstate", other, ctypes.byref(state)) == 0
        assert binary("Reset", other) == 0
        assert binary("SetFMUstate", other, new) == 0
    assert 200 < accepted < 2000


def test_a_state_after_a_failure_can_be_restored_and_reset(binary):
    c = binary.ready()
    run(binary, c, 0, 20)
    assert binary.step(c, 0.1, -1.0) == ERROR
    data = serialised(binary, c, saved(binary, c))
    other = binary.instantiate(name=b"other")
    status, state = deserialised(binary, other, data)
    assert status == 0
    assert binary("SetFMUstate", other, state) == 0
    assert binary.step(other, 0.1, 0.005) == ERROR
    assert binary("Reset", other) == 0
    assert binary("SetupExperiment", other, 0, 0.0, 0.0, 0, 0.0) == 0


def test_reset_repairs_any_mode(binary):
    """Bytes of a state in memory overwritten by something else."""
    c = binary.ready()
    state = saved(binary, c)
    size = len(serialised(binary, c, state))
    mode = ctypes.c_int.from_address(state.value + size - 16)
    assert mode.value == 4  # stepping
    mode.value = 4096
    assert binary("SetFMUstate", c, state) == 0
    assert binary.step(c, 0.0, 0.005) == ERROR
    assert binary("Reset", c) == 0
    assert binary("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == 0
    assert binary("EnterInitializationMode", c) == 0
    assert binary("ExitInitializationMode", c) == 0
    assert binary.step(c, 0.0, 0.005) == 0
