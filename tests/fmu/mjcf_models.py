"""Models for the tests of FMUs that MuJoCo simulates, and bindings to these FMUs."""

import ctypes
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from binary import CALLBACK, Binary, Callbacks

from hesr_model.support.files import models_folder

UF850 = models_folder() / "uf850"
HOME = {"q0[1]": 0.0, "q0[2]": 0.3, "q0[3]": -1.9}
STEP = 0.005
OUTPUTS = ("q", "tau_meas", "q_true", "dq_true", "tau_true", "tau_f_true")
"""One value for each joint of the twin's arm."""

PENDULUM = """\
<mujoco model="pendulum">
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="pivot" damping="0.1"/>
      <geom name="bob" type="sphere" size="0.1" pos="0 0 -0.7" mass="1.3"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="pivot" joint="pivot" gear="2"/>
  </actuator>
  <sensor>
    <jointpos name="pivot" joint="pivot"/>
    <framepos name="bob at" objtype="geom" objname="bob"/>
    <jointactuatorfrc joint="pivot"/>
  </sensor>
</mujoco>
"""

CART_POLE = """\
<mujoco model="cart-pole">
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <joint name="slider" type="slide" axis="1 0 0" range="-1 1" limited="true"/>
      <geom type="box" size="0.2 0.1 0.1" mass="1"/>
      <body name="pole">
        <joint name="hinge" axis="0 1 0" damping="0.01"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.8" mass="0.3"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="left" joint="slider" gear="10"/>
    <motor name="right" joint="slider" gear="-4"/>
    <position name="spring" joint="hinge" kp="2"/>
  </actuator>
  <sensor>
    <jointpos name="x" joint="slider"/>
    <jointvel name="dx" joint="slider"/>
    <jointpos name="angle" joint="hinge"/>
    <accelerometer name="acc" site="top"/>
  </sensor>
</mujoco>
""".replace('<geom type="capsule"', '<site name="top" pos="0 0 0.8"/><geom type="capsule"')

CART_POLE_TABLE = """\
seed = 18446744073709551613
step = 0.01
payload = "pole"

[inputs.u]
unit = "N"
actuators = [["left", "right"], ["spring"]]

[outputs.mixed]
unit = "m"
sensors = [{ x = 1, angle = -0.5 }, { x = 2.5, dx = 1, angle = 3 }]
noise = [0.01, 0.0]
streams = [7, 3]

[outputs.angle]
unit = "rad"
sensors = [{ angle = 1 }]
noise = [0.2]

[start.begin]
unit = "1"
joints = ["hinge", "slider"]
"""


def names(component: Any, causality: str) -> list[str]:
    """Names of the variables of a causality in order."""
    variables = component.description.modelVariables
    return [v.name for v in variables if v.causality == causality]


def command(k: int, n: int = 3) -> np.ndarray:
    return 0.8 * np.sin(0.03 * k * np.array([0.6, 0.8, 1.1])[:n])


def run(component: Any, steps: int, first: int = 0, step: float = STEP) -> np.ndarray:
    """Outputs before and after each step of an initialised component."""
    inputs = component.buffer(names(component, "input"))
    outputs = component.buffer(names(component, "output"))
    rows = [outputs.read().copy()]
    for k in range(first, first + steps):
        inputs.values[:] = command(k, len(inputs.values))
        inputs.write()
        component.step(k * step, step)
        rows.append(outputs.read().copy())
    return np.array(rows)


class Unpacked(Binary):
    """The functions of an FMU's binary inside its extracted archive, with its resources."""

    def __init__(self, fmu: Path, folder: Path) -> None:
        self.about = fmpy.read_model_description(fmu)
        self.vr = {v.name: v.valueReference for v in self.about.modelVariables}
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folder)
        self.library = folder / f"binaries/linux64/{self.about.coSimulation.modelIdentifier}.so"
        self.resources = folder / "resources"
        self._library = ctypes.CDLL(str(self.library))
        self.messages = []
        self.host = Callbacks()
        self.host.logger = CALLBACK(self._log)

    def at(self, location: str | None) -> ctypes.c_void_p | None:
        """Make an instance with the location of its resources."""
        f = self._library.fmi2Instantiate
        f.restype = ctypes.c_void_p
        place = None if location is None else location.encode()
        c = f(b"one", 1, self.about.guid.encode(), place, ctypes.byref(self.host), 0, 0)
        return None if c is None else ctypes.c_void_p(c)

    def instantiate(self, **_: Any) -> ctypes.c_void_p | None:
        return self.at(self.resources.as_uri())


def assert_sampled_within_steps(fmu: Path) -> None:
    """Steps of any length give the result of the simulation's whole steps so far."""
    from fmu_src.run.fmu import FmuInstance

    own, time, made, changed = 0.001, 0.0, 0, 0
    with FmuInstance(fmu) as hostile, FmuInstance(fmu, name="whole") as whole:
        silent = {n: 0.0 for n in names(hostile, "parameter") if "_noise[" in n}
        assert len(silent) == 6
        for arm in (hostile, whole):
            arm.initialise(start=HOME | silent)
            arm.set({"dq_cmd[1]": 0.3, "dq_cmd[3]": -0.2})
        outputs = hostile.buffer(names(hostile, "output")), whole.buffer(names(whole, "output"))
        before = outputs[1].read().copy()
        for step in (4e-4, 4e-4, 1e-14, 2e-4, 2**0.5 * 1e-3, 0.2e-3, 3e-3, 0.0173, 1e-5) * 20:
            hostile.step(time, step)
            time += step
            while made + 1 <= time / own + 1e-6:
                whole.step(made * own, own)
                made += 1
            now = outputs[0].read().copy()
            np.testing.assert_array_equal(now, outputs[1].read())
            changed += bool((now != before).any())
            before = now
    assert changed > 50


def steps(binary: Binary, c: Any, first: int, last: int) -> list[list[float]]:
    """Outputs after each of several steps of the twin's arm."""
    rows = []
    for k in range(first, last):
        inputs = {f"dq_cmd[{i}]": x for i, x in enumerate(command(k), start=1)}
        assert binary.set_all(c, inputs) == 0
        assert binary.step(c, STEP * k, STEP) == 0
        rows.append(binary.get(c, *(f"{name}[{i}]" for name in OUTPUTS for i in (1, 2, 3))))
    return rows


def started(binary: Binary, start: dict[str, float]) -> Any:
    """Make an instance and initialise it."""
    c = binary.instantiate()
    assert binary.set_all(c, start) == 0
    assert binary("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == 0
    assert binary("EnterInitializationMode", c) == 0
    assert binary("ExitInitializationMode", c) == 0
    return c


def assert_goes_on(binary: Binary, start: dict[str, float]) -> None:
    """A saved state resumes bit for bit, here and in a fresh instance."""
    c, state = started(binary, start), ctypes.c_void_p()
    steps(binary, c, 0, 50)
    assert binary("GetFMUstate", c, ctypes.byref(state)) == 0
    size = ctypes.c_size_t()
    assert binary("SerializedFMUstateSize", c, state, ctypes.byref(size)) == 0
    data = ctypes.create_string_buffer(size.value)
    assert binary("SerializeFMUstate", c, state, data, size) == 0
    first = steps(binary, c, 50, 150)
    assert binary("SetFMUstate", c, state) == 0
    assert steps(binary, c, 50, 150) == first
    other, copy = binary.instantiate(), ctypes.c_void_p()
    assert binary("DeSerializeFMUstate", other, data.raw, size, ctypes.byref(copy)) == 0
    assert binary("SetFMUstate", other, copy) == 0
    assert steps(binary, other, 50, 150) == first
    for instance, saved in ((c, state), (other, copy)):
        assert binary("FreeFMUstate", instance, ctypes.byref(saved)) == 0
        binary("FreeInstance", instance)
