"""MuJoCo's steps in an FMU are minimal and bitwise equal to MuJoCo's own."""

import mujoco
import numpy as np
import pytest
from mjcf_models import CART_POLE, command, names

from fmu_src.arm.native import export_mjcf
from fmu_src.run.fmu import FmuInstance

DT = 0.01
LATE = 'delay="0.0155" nsample="9"'
ALL_LATE = CART_POLE.replace('gear="10"', f'gear="10" {LATE}').replace(
    'gear="-4"', f'gear="-4" {LATE}'
)
MODELS = {
    "implicit": CART_POLE,
    "Euler": CART_POLE.replace("implicitfast", "Euler"),
    "Runge-Kutta": CART_POLE.replace("implicitfast", "RK4"),
    "dry friction": CART_POLE.replace('damping="0.01"', 'damping="0.01" frictionloss="0.05"'),
    "late commands": CART_POLE.replace('gear="10"', 'gear="10" delay="0.02" nsample="9"'),
    "interpolated commands": ALL_LATE.replace(LATE, f'{LATE} interp="linear"'),
    "late sensors": CART_POLE.replace('name="x"', 'name="x" delay="0.02" nsample="9"'),
    "seldom read": CART_POLE.replace('name="dx"', 'name="dx" interval="0.02" nsample="3"'),
    "sleeping": CART_POLE.replace("/>", '><flag sleep="enable"/></option>', 1),
}


def in_python(mjcf, steps):
    """Results of MuJoCo with a state changed only by its own steps."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    data, seen = mujoco.MjData(model), mujoco.MjData(model)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
    state = np.empty(size)
    rows = []
    for k in range(steps + 1):
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_setState(model, seen, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(model, seen)
        rows.append(seen.sensordata.copy())
        data.ctrl[:] = command(k, model.nu)
        for _ in range(round(DT / model.opt.timestep)):
            mujoco.mj_step(model, data)
    return np.array(rows)


@pytest.mark.parametrize("name", MODELS)
def test_steps_are_those_of_mujoco(name, tmp_path):
    (tmp_path / "model.xml").write_text(MODELS[name])
    fmu = export_mjcf(tmp_path / "model.xml", tmp_path / "Model.fmu")
    expected = in_python(MODELS[name], 300)
    found = []
    with FmuInstance(fmu) as cart:
        outputs = names(cart, "output")
        cart.initialise(start={})
        for k in range(301):
            found.append(cart.get(outputs))
            assert np.array_equal(cart.get(outputs), found[-1])
            cart.set(dict(zip(names(cart, "input"), command(k), strict=True)))
            cart.step(k * DT, DT)
    assert np.ptp(expected[:, 0]) > 0.1
    np.testing.assert_array_equal(found, expected)
