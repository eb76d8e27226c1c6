"""Host calls of a drive FMU: steps and inner steps, rest, states, refusals."""

import ctypes
import json
import re
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy
from binary import Binary
from c_hosts import LINUX
from containing import Containing
from drive_runs import drive, model_of

from fmu_src.run.fmu import FmuInstance
from hesr.extras.drive.drive_fmu import export_drive
from hesr_model.errors import ExportError, SimulationError
from hesr_model.friction.inputs import DQ
from hesr_model.support.compiler import compile_c

DISCARD = 2
FUZZ = Path(__file__).parents[1] / "fuzz.c"
FLAGS = ("-std=c99", "-g", "-O1", "-I.", f"-I{FUZZ.parent}", "-fno-sanitize-recover=all")


@pytest.fixture(scope="module")
def fmu(make_law, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A law that jumps at rest, one with a bristle, and one with a scale instead of parameters."""
    laws = {name: make_law(name) for name in ("viscous", "lugre", "gaussians")}
    return drive(laws, tmp_path_factory.mktemp("drive"), [0.6, 3.0, 1.0])


@pytest.fixture
def binary(fmu: Path, load: Callable[[Path], Binary]) -> Binary:
    return load(fmu)


def everything(binary: Binary, c: ctypes.c_void_p) -> list[float]:
    return binary.get(c, *(v.name for v in binary.about.modelVariables if v.type == "Real"))


def ready(binary: Binary, **start: float) -> ctypes.c_void_p:
    c = binary.instantiate()
    values = {"substep" if name == "substep" else f"{name}[1]": v for name, v in start.items()}
    assert binary("EnterInitializationMode", c) == 0
    assert binary.set_all(c, values) == 0
    assert binary("ExitInitializationMode", c) == 0
    return c


def test_before_the_first_step_outputs_are_the_start_values(fmu: Path) -> None:
    with FmuInstance(fmu) as component:
        component.initialise(
            start={"q_start[2]": 0.3, "dq_start[2]": -0.2, "ratio[2]": 2.0, "start_mode": 2,
                   "z_start[2]": 1e-3,
                   "stiffness[2]": 50.0, "damping[2]": 4.0, "q_link[2]": 0.1, "dq_link[2]": 0.5}
        )  # fmt: skip
        q, dq, ddq, tau_f, tau_link, dz = component.get(
            ["q[2]", "dq[2]", "ddq[2]", "tau_f[2]", "tau_link[2]", "der(z[2])"]
        )
        level = 9.0 + 3.0 * np.exp(-((0.1 / 0.08) ** 2))
        assert (q, dq, ddq) == (0.3, -0.2, 0.0)
        assert dz == pytest.approx(-0.1 - 2e3 * 0.1 / level * 1e-3, rel=1e-12, abs=0.0)
        assert tau_f == pytest.approx(2e3 * 1e-3 + 1.5 * dz, rel=1e-12, abs=0.0)
        assert tau_link == pytest.approx(
            50.0 * (0.15 - 0.1) + 4.0 * (-0.1 - 0.5), rel=1e-12, abs=0.0
        )


def test_inputs_have_no_effect_before_the_next_step(binary: Binary) -> None:
    c = ready(binary, tau_motor=8.0)
    assert binary.step(c, 0.0, 0.01) == 0
    outputs = ("q[1]", "dq[1]", "ddq[1]", "tau_f[1]", "tau_link[1]")
    before = binary.get(c, *outputs)
    binary.set(c, tau_motor=-8.0, q_link=1.0)
    assert binary.get(c, *outputs) == before
    assert binary.step(c, 0.01, 0.01) == 0
    assert binary.get(c, *outputs) != before


def test_derivatives_are_those_at_the_end_of_the_step(binary: Binary, make_law) -> None:
    """Evaluated at the joint's speed and its states, before the first step and after each."""
    law = make_law("lugre")
    [element] = law.form.memory
    known = {c.symbol: law.values[c.name] for c in law.form.coefficients}
    c = binary.instantiate()
    assert binary("EnterInitializationMode", c) == 0
    assert binary.set_all(c, {"ratio[2]": 2.0, "dq_start[2]": 0.1}) == 0
    assert binary("ExitInitializationMode", c) == 0
    for k in range(3):
        dq, z, found = binary.get(c, "dq[2]", "z[2]", "der(z[2])")
        numbers = {s: sympy.Float(v) for s, v in {**known, DQ: 0.5 * dq, element.state: z}.items()}
        expected = float(element.express_derivative().xreplace(numbers))
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert binary.set_all(c, {"tau_motor[2]": 40.0}) == 0
        assert binary.step(c, 1e-3 * k, 1e-3) == 0
    assert dq != 0.1
    assert expected != 0.0


def test_a_long_step_equals_its_inner_steps(binary: Binary) -> None:
    one = ready(binary, tau_motor=8.0, substep=1.0 / 1024.0)
    many = ready(binary, tau_motor=8.0)
    binary.set_all(many, {"tau_motor[2]": 15.0})
    binary.set_all(one, {"tau_motor[2]": 15.0})
    for k in range(10):
        assert binary.step(one, k / 128.0, 1.0 / 128.0) == 0
        for n in range(8):
            assert binary.step(many, k / 128.0 + n / 1024.0, 1.0 / 1024.0) == 0
    assert everything(binary, one)[:-1] != [0.0]
    names = [v.name for v in binary.about.modelVariables if v.type == "Real"]
    differ = [
        n
        for n, a, b in zip(names, everything(binary, one), everything(binary, many), strict=True)
        if a != b
    ]
    assert differ == ["substep"]


@pytest.mark.parametrize(("step", "parts"), [(0.9, 3), (0.6, 2), (0.601, 3), (0.1, 1)])
def test_inner_steps_are_equal_and_minimal(binary: Binary, step: float, parts: int) -> None:
    """0.9 / 0.3 exceeds 3 by round-off."""
    start = {"tau_motor": 8.0, "inertia": 50.0}
    c, apart = ready(binary, substep=0.3, **start), ready(binary, substep=1.0, **start)
    assert binary.step(c, 0.0, step) == 0
    for n in range(parts):
        assert binary.step(apart, n * step / parts, step / parts) == 0
    assert binary.get(c, "q[1]", "dq[1]") == pytest.approx(binary.get(apart, "q[1]", "dq[1]"))


def test_coulomb_friction_holds_a_joint_at_rest(binary: Binary) -> None:
    """4.5 N.m and 0.5 N.m of ripple hold a joint; above that it breaks away, then stops in one
    step."""
    c = ready(binary, tau_motor=4.9)
    for k in range(100):
        assert binary.step(c, 0.01 * k, 0.01) == 0
        assert binary.get(c, "dq[1]", "q[1]", "tau_f[1]") == [0.0, 0.0, pytest.approx(4.9)]
    binary.set(c, tau_motor=-3.9)
    assert binary.step(c, 1.0, 0.01) == 0
    assert binary.get(c, "dq[1]", "tau_f[1]") == [0.0, pytest.approx(-3.9)]
    binary.set(c, tau_motor=-4.1)
    assert binary.step(c, 1.01, 0.01) == 0
    assert binary.get(c, "dq[1]")[0] < 0.0
    binary.set(c, tau_motor=0.0)
    assert binary.step(c, 1.02, 0.01) == 0
    assert binary.get(c, "dq[1]") == [0.0]


def test_a_scale_multiplies_friction(fmu: Path) -> None:
    speeds = []
    for scale in (0.0, 1.0, 2.0):
        with FmuInstance(fmu) as component:
            component.initialise(
                start={"coulomb_scale[3]": scale, "dq_start[3]": 0.5, "substep": 1.0}
            )
            component.step(0.0, 1e-4)
            dq, tau_f, ddq = component.get(["dq[3]", "tau_f[3]", "ddq[3]"])
            assert ddq == pytest.approx(-tau_f, rel=1e-9)
            speeds.append(dq - 0.5)
    assert speeds[0] == 0.0
    assert speeds[2] == pytest.approx(2.0 * speeds[1], rel=1e-2)


def test_a_restored_state_resumes_bit_for_bit(binary: Binary) -> None:
    def run(c: ctypes.c_void_p, first: int) -> list[list[float]]:
        rows = []
        for k in range(first, first + 40):
            binary.set_all(c, {f"tau_motor[{i}]": 12.0 * np.sin(0.3 * k) for i in (1, 2, 3)})
            assert binary.step(c, 0.01 * k, 0.01) == 0
            rows.append(everything(binary, c))
        return rows

    c, state, size = ready(binary), ctypes.c_void_p(), ctypes.c_size_t()
    run(c, 0)
    assert binary("GetFMUstate", c, ctypes.byref(state)) == 0
    assert binary("SerializedFMUstateSize", c, state, ctypes.byref(size)) == 0
    data = ctypes.create_string_buffer(size.value)
    assert binary("SerializeFMUstate", c, state, data, size) == 0
    first = run(c, 40)
    assert binary("SetFMUstate", c, state) == 0
    assert run(c, 40) == first
    other, restored = binary.instantiate(name=b"other"), ctypes.c_void_p()
    assert binary("DeSerializeFMUstate", other, data, size, ctypes.byref(restored)) == 0
    assert binary("SetFMUstate", other, restored) == 0
    assert run(other, 40) == first
    assert binary("Reset", other) == 0
    assert binary("EnterInitializationMode", other) == 0
    assert binary("ExitInitializationMode", other) == 0
    assert run(other, 0) == run(ready(binary), 0)


def assert_discards(binary: Binary, c: ctypes.c_void_p, step: float, text: str) -> None:
    """The whole step is discarded with a reason, and nothing moves."""
    before = everything(binary, c)
    assert binary.step(c, 0.0, step) == DISCARD
    assert everything(binary, c) == before
    assert re.search(text, binary.messages[-1].text), binary.messages[-1].text
    assert binary.messages[-1].category == "logStatusDiscard"


def test_a_step_without_a_root_is_discarded(binary: Binary) -> None:
    """Friction of the wrong sign accelerates beyond what the inertia allows."""
    c = ready(binary, tau_motor=8.0)
    assert binary.set_all(c, {"joint[1].sigma_2": -1e6, "tau_motor[2]": 20.0}) == 0
    assert_discards(
        binary,
        c,
        0.01,
        r"dq\[1\]: no speed .* step of 0\.001 s",
    )
    assert binary.set_all(c, {"joint[1].sigma_2": 12.0}) == 0
    assert binary.step(c, 0.0, 0.01) == 0
    assert min(binary.get(c, "dq[1]", "dq[2]")) > 0.0


def test_a_step_that_fails_midway_is_discarded_as_a_whole(binary: Binary) -> None:
    """Some inner steps succeed before no speed balances the torques; other joints do not move."""
    start = {"joint[1].sigma_2": -1e3, "tau_motor[1]": 10.0, "tau_motor[2]": 20.0}
    c, ahead = ready(binary), ready(binary)
    for instance in (c, ahead):
        assert binary.set_all(instance, start) == 0
    assert binary.step(ahead, 0.0, 0.02) == 0
    assert_discards(binary, c, 0.2, r"dq\[1\]: no speed was found .*")


def test_torques_that_overflow_are_discarded(binary: Binary) -> None:
    c = ready(binary)
    assert binary.set_all(c, {"tau_motor[2]": 1e308}) == 0
    assert_discards(
        binary, c, 0.01, r"dq\[2\]: the torques are not finite in a step of 0\.001 s; .*"
    )


def test_unstable_euler_steps_are_discarded(table1, tmp_path: Path, load) -> None:
    path = drive({"j1": table1.laws[0]}, tmp_path, [3.0])
    binary = load(path)
    c = ready(binary, substep=1.0)
    assert_discards(
        binary,
        c,
        0.2,
        r"found 2\.274 at dq\[1\] = \S+",
    )


def test_euler_stability_is_checked_at_the_final_speed(make_law, tmp_path: Path, load) -> None:
    law = replace(make_law("lugre"), discretisation="euler")
    binary = load(drive({"j1": law}, tmp_path, [3.0]))
    c = ready(binary, substep=1.0)
    assert binary.set_all(c, {"tau_motor[1]": 200.0}) == 0
    assert binary.step(c, 0.0, 0.05) == DISCARD
    said = re.search(r"but found (\S+) at dq\[1\] = (\S+);", binary.messages[-1].text)
    assert said
    found, speed = map(float, said.groups())
    assert abs(speed) > 0.01
    k = law.values
    bound = k["F_c"] + (k["F_s"] - k["F_c"]) * np.exp(-((speed / k["v_s"]) ** 2))
    assert found == pytest.approx(k["sigma_0"] * abs(speed) / bound * 0.05, rel=1e-4)


def test_steps_with_too_many_inner_steps_are_discarded(binary: Binary) -> None:
    assert_discards(
        binary,
        ready(binary, substep=1e-300),
        0.01,
        r"0\.01 s would be 1e\+298 .* 1e\+07",
    )


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("inertia[2]", 0.0, "inertia[2] is 0; it must be positive."),
        ("inertia[1]", -3.0, "inertia[1] is -3; it must be positive."),
        ("stiffness[3]", -1.0, "stiffness[3] is -1; it must not be negative."),
        ("stiffness[1]", -2.0, "stiffness[1] is -2; it must not be negative."),
        ("damping[1]", -0.5, "damping[1] is -0.5; it must not be negative."),
        ("damping[3]", -0.25, "damping[3] is -0.25; it must not be negative."),
        ("ratio[2]", 0.0, "ratio[2] is 0; it must not be zero."),
        ("substep", 0.0, "substep is 0; it must be positive."),
    ],
)
def test_invalid_motors_are_refused(fmu: Path, name: str, value: float, said: str) -> None:
    with FmuInstance(fmu) as component, pytest.raises(SimulationError, match=re.escape(said)):
        component.initialise(start={name: value})


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"inertia": [1.0]}, "drive: 'inertia' has 1 values"),
        (
            {"inertia": [1.0, 0.0]},
            "'inertia' of joint 2 is 0 kg.m2",
        ),
        (
            {"inertia": [float("inf"), 1.0]},
            "'inertia' of joint 1 is inf kg.m2",
        ),
        (
            {"inertia": [1.0, 1.0], "stiffness": [-1.0, 0.0]},
            "drive: 'stiffness' of joint 1 is -1 N.m/rad; expected a number that is not negative.",
        ),
        (
            {"inertia": [1.0, 1.0], "damping": [0.0, float("nan")]},
            "drive: 'damping' of joint 2 is nan N.m.s/rad; expected a number that is not negative.",
        ),
        (
            {"inertia": [1.0, 1.0], "ratio": [0.0, 1.0]},
            "drive: 'ratio' of joint 1 is 0 turns; expected a number other than zero.",
        ),
        (
            {"inertia": [1.0, 1.0], "ratio": [1.0]},
            "drive: 'ratio' has 1 values",
        ),
    ],
)
def test_impossible_exports_are_refused(make_law, tmp_path: Path, more, said: str) -> None:
    model = model_of({"a": make_law("lugre"), "b": make_law("bare")})
    with pytest.raises(ExportError) as caught:
        export_drive(model, tmp_path / "Drive.fmu", **more)
    assert str(caught.value) == Containing(said)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def sources(fmu: Path, tmp_path: Path) -> Path:
    """Sources of the FMU."""
    with zipfile.ZipFile(fmu) as archive:
        members = [name for name in archive.namelist() if name.startswith("sources/")]
        archive.extractall(tmp_path, members)
    return tmp_path / "sources"


@pytest.mark.ci
def test_call_sequences_have_no_undefined_behaviour(sources: Path) -> None:
    flags = (*LINUX, *FLAGS, "-fsanitize=undefined", "-fsanitize-trap=undefined")
    compile_c(sources / "all.c", flags, sources / "lives", (str(FUZZ), "-lm"))
    assert_lives(sources)


@pytest.mark.ci
@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_call_sequences_have_no_memory_errors(sources: Path) -> None:
    flags = (*FLAGS, "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsanitize=address,undefined")
    command = ["gcc", *flags, "-o", "lives", "all.c", str(FUZZ), "-lm"]
    subprocess.run(command, cwd=sources, check=True)
    assert_lives(sources)


def assert_lives(sources: Path) -> None:
    result = subprocess.run(
        [sources / "lives", "3000"], capture_output=True, text=True, check=False, timeout=300
    )
    assert (result.returncode, result.stderr) == (0, ""), result.stderr[-4000:]
    counts = json.loads(result.stdout)
    assert counts["steps"] > 10000
    assert counts["restored"] > 3000
    assert counts["refusals"] > 300
