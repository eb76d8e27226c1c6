"""A plant with an elastic gear: a motor joint and a gear joint with a spring, in series."""

import math
from pathlib import Path

import numpy as np
import pytest

import hesr
from fmu_src.run.fmu import FmuInstance
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel

STEP, STEPS = 1e-3, 1500
FINE = 50  # steps of the reference in each step
STIFFNESS, DAMPING, ROTOR, LINK = 8000.0, 6.0, 0.05, 0.4
COULOMB, VISCOUS = 2.0, 3.0

AXIS = f"""\
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="rotor">
      <inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>
      <joint name="motor" axis="0 0 1" armature="{ROTOR}"/>
      <body name="link">
        <inertial pos="0 0 0" mass="1" diaginertia="{LINK} {LINK} {LINK}"/>
        <joint name="gear" axis="0 0 1" stiffness="{STIFFNESS}"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def law(coulomb: float, viscous: float) -> FrictionLaw:
    values = {"F_c": coulomb, "F_s": coulomb, "v_s": 0.1, "sigma_2": viscous, "tau_0": 0.0}
    return FrictionLaw(name="stribeck", form=estimator("stribeck").core({}), values=values)


def torques() -> np.ndarray:
    t = STEP * np.arange(STEPS)
    waves = 8.0 * np.sin(np.pi * t) + 6.0 * np.sin(10.0 * np.pi * t)
    return waves + 5.0 * np.sign(np.sin(2.6 * np.pi * t))


def reference() -> np.ndarray:
    """Motor angle and twist of the gear, (steps, 2), by small explicit steps."""
    h = STEP / FINE
    q = link = v = u = 0.0
    rows = []
    for tau in torques().tolist():
        for _ in range(FINE):
            gear = STIFFNESS * (q - link) + DAMPING * (v - u)
            free, stuck = v + h * (tau - gear - VISCOUS * v) / ROTOR, h * COULOMB / ROTOR
            v = math.copysign(max(abs(free) - stuck, 0.0), free)
            u += h * gear / LINK
            q, link = q + h * v, link + h * u
        rows.append((q, link - q))
    return np.array(rows)


def test_a_plant_with_an_elastic_gear_follows_a_fine_simulation(tmp_path: Path) -> None:
    (tmp_path / "axis.xml").write_text(AXIS)
    laws = (law(COULOMB, VISCOUS), law(0.0, DAMPING))
    model = FrictionModel(
        law="stribeck", robot="axis", joints=("motor", "gear"), laws=laws, sample_time=STEP
    )
    model.write(tmp_path / "law.json")
    plant = hesr.export(
        tmp_path / "law.json",
        tmp_path / "Axis.fmu",
        format="plant",
        platform=["linux64"],
        robot=tmp_path / "axis.xml",
    )
    expected = reference()
    for substep, share in ((1e-3, 0.03), (2.5e-4, 0.005)):
        found = []
        with FmuInstance(plant) as axis:
            axis.initialise(start={"substep": substep})
            for k, tau in enumerate(torques().tolist()):
                axis.set({"tau[1]": tau})
                axis.step(k * STEP, STEP)
                found.append(axis.get(["q[1]", "q[2]"]))
        error = np.sqrt(np.mean((np.array(found) - expected) ** 2, axis=0))
        assert np.all(error < share * np.std(expected, axis=0))
    assert np.std(expected[:, 1]) == pytest.approx(6e-4, rel=0.5)
