"""Long logs of a chain of links, whose motion repeats itself."""

from pathlib import Path

import numpy as np
from fleets import urdf

from hesr_model.robots.robot import Robot, RobotDescription

RATE = 250.0  # [Hz]
_PERIOD = 25_000  # rows after which the motion repeats itself


def write_robot(folder: Path, joints: int) -> Path:
    """Write a chain with rotors, whose logs may be tables without names; return its file."""
    (folder / "chain.urdf").write_text(urdf(joints), encoding="utf-8")
    names = ["t", *(f"{what}{k}" for what in ("q", "dq", "tau") for k in range(1, joints + 1))]
    file = folder / "robot.toml"
    file.write_text(
        f'name = "chain"\nmodel = "chain.urdf"\njoints = {[f"j{k + 1}" for k in range(joints)]}\n'
        f"rotor_inertia = true\n[log]\ncolumns = {names}\n",
        encoding="utf-8",
    )
    return file


def long_table(robot: Path, rows: int, seed: int = 0) -> np.ndarray:
    """Return time, position, velocity and torque (rows, 1 + 3 n) [SI] of a noisy log."""
    model, rng = Robot(RobotDescription.read(robot)), np.random.default_rng(seed)
    t = np.arange(min(rows, _PERIOD)) / RATE
    orders = np.arange(5, 60, 5)[:, None, None]
    w = 2.0 * np.pi * RATE / _PERIOD * orders
    sizes, phases = rng.uniform(0.02, 0.12, (2, len(orders), 1, model.n)) * [[[[1.0]]], [[[50.0]]]]
    angle = w * t[:, None] + phases
    q, dq, ddq = (
        np.sum(sizes * shape, axis=0)
        for shape in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle))
    )
    tau = model.torque(model.nominal_parameters, q, dq, ddq) + 2.0 * np.tanh(dq / 0.01) + dq
    noise = np.repeat([1e-5, 1e-3, 0.2], model.n)
    table = np.empty((rows, 1 + 3 * model.n))
    for first in range(0, rows, _PERIOD):
        block = table[first : first + _PERIOD]
        block[:, 0] = (first + np.arange(len(block))) / RATE
        block[:, 1:] = np.hstack([q, dq, tau])[: len(block)]
        block[:, 1:] += noise * rng.standard_normal((len(block), len(noise)))
    return table
