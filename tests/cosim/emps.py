"""Logs in the format of the EMPS benchmark: a sliding axis under position control, as MATLAB files.

The benchmark (Janot, Gautier and Brunot 2019, "Data set and reference models of EMPS") has qm, qg,
vir, gtau and t at 1 kHz. Its files are not included: these are simulated with its published values.
"""

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


def write(path: Path, *, seconds: float, pulses: bool = False, seed: int = 0) -> None:
    """Simulate the axis and write its log; with pulses, the voltage jumps by 0.5 V."""
    rng = np.random.default_rng(seed)
    t = 1e-3 * np.arange(round(1000 * seconds))
    wave = 0.08 * np.sin(2.0 * t) + 0.05 * np.sin((4.1 if pulses else 3.3) * t + 1.0)
    reference = wave - wave[0]
    jumps = 0.6 * np.sign(np.sin(2.0 * np.pi * 0.8 * t)) * pulses
    q = v = 0.0
    h = 1e-4
    places, volts = np.empty_like(t), np.empty_like(t)
    for k in range(len(t)):
        volt = np.clip(_KV / GAIN * (_KP * (reference[k] - q) - v) + jumps[k], -10.0, 10.0)
        places[k], volts[k] = q, volt
        for _ in range(10):
            free = v + h * (GAIN * volt - OFFSET) / MASS
            slid = np.sign(free) * max(abs(free) - h * COULOMB / MASS, 0.0)
            v = slid / (1.0 + h * VISCOUS / MASS)
            q += h * v
    columns = {
        "qm": places + 1e-6 * rng.normal(size=len(t)),
        "qg": reference,
        "vir": volts + 0.01 * rng.normal(size=len(t)),
        "t": t,
    }
    savemat(path, {name: values[:, None] for name, values in columns.items()} | {"gtau": GAIN})
