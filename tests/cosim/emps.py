"""Logs in the format of the EMPS benchmark: a sliding axis under position control, as MATLAB files.

The benchmark (Janot, Gautier and Brunot 2019, "Data set and reference models of EMPS") has qm, qg,
vir, gtau and t at 1 kHz. Its files are not included: these are simulated with its published values.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.io import savemat

MASS, VISCOUS, COULOMB, OFFSET = 95.1, 203.5, 20.4, -3.2
"""Mass [kg], viscous [N.s/m], Coulomb and offset [N]."""
GAIN = 35.15
"""Force over voltage [N/V]."""
_KP, _KV = 160.2, 243.5

ROBOT = f"""
name = "EMPS"
model = "emps.xml"
joints = ["axis"]
rotor_inertia = false

[log]
sample_rate = 1000.0
filter_cutoff = 100.0
torque_per_ampere = [{GAIN}]
columns = {{ t = "t", q = ["qm"], dq = "", current = ["vir"] }}
"""

MODEL = """
<mujoco>
  <worldbody>
    <body name="carriage">
      <joint name="axis" type="slide" axis="1 0 0" range="-1 1"/>
      <inertial pos="0 0 0" mass="60" diaginertia="1 1 1"/>
    </body>
  </worldbody>
</mujoco>
"""


def friction(truth: str) -> Callable[[float, float, float], float]:
    """Return the velocity [m/s] after a step from free velocity, velocity before, and step [s]."""
    x = np.zeros(4)

    def coulomb(free: float, v: float, h: float) -> float:
        slid = np.sign(free) * max(abs(free) - h * COULOMB / MASS, 0.0)
        return float(slid / (1.0 + h * VISCOUS / MASS))

    def bristles(free: float, v: float, h: float) -> float:
        stiffness = COULOMB / 2e-4
        level = COULOMB * (1.0 + 0.4 * np.exp(-((v / 0.02) ** 2)))
        before, x[0] = x[0], (x[0] + h * v) / (1.0 + h * stiffness * abs(v) / level)
        force = stiffness * x[0] + 600.0 * (x[0] - before) / h
        return float((free - h * force / MASS) / (1.0 + h * VISCOUS / MASS))

    def stops(free: float, v: float, h: float) -> float:
        x[:] = np.clip(x + v * h / np.array([6e-5, 3e-4, 1.2e-3, 5e-3]), -1.0, 1.0)
        force = COULOMB * np.array([0.35, 0.25, 0.2, 0.2]) @ x
        return float((free - h * force / MASS) / (1.0 + h * VISCOUS / MASS))

    return {"coulomb": coulomb, "bristles": bristles, "stops": stops}[truth]


def write(
    path: Path,
    *,
    seconds: float,
    pulses: bool = False,
    seed: int = 0,
    truth: str = "coulomb",
    every: int = 1,
    speeds: tuple[float, float] | None = None,
) -> None:
    """Simulate the axis and write its log; with pulses, the voltage jumps by 0.5 V.

    Every so many of the rows at 1 kHz are logged; `speeds` [rad/s] are those of the two sines.
    """
    rng = np.random.default_rng(seed)
    t = 1e-3 * np.arange(round(1000 * seconds))
    slow, fast = speeds or (2.0, 4.1 if pulses else 3.3)
    wave = 0.08 * np.sin(slow * t) + 0.05 * np.sin(fast * t + 1.0)
    after = friction(truth)
    reference = wave - wave[0]
    jumps = 0.6 * np.sign(np.sin(2.0 * np.pi * 0.8 * t)) * pulses
    q = v = 0.0
    h = 1e-4
    places, volts = np.empty_like(t), np.empty_like(t)
    for k in range(len(t)):
        volt = np.clip(_KV / GAIN * (_KP * (reference[k] - q) - v) + jumps[k], -10.0, 10.0)
        places[k], volts[k] = q, volt
        for _ in range(10):
            v = after(v + h * (GAIN * volt - OFFSET) / MASS, v, h)
            q += h * v
    columns = {
        "qm": places + 1e-6 * rng.normal(size=len(t)),
        "qg": reference,
        "vir": volts + 0.01 * rng.normal(size=len(t)),
        "t": t,
    }
    savemat(
        path, {name: values[::every, None] for name, values in columns.items()} | {"gtau": GAIN}
    )
