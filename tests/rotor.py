"""Logs of a motor without a model, under the names of many loggers."""

from pathlib import Path

import numpy as np

from hesr_model.robots.robot import RobotDescription

Array = np.ndarray
URDF = """<robot name="bench"><link name="base"/>
<joint name="motor" type="continuous"><parent link="base"/><child link="rotor"/>
<axis xyz="0 0 1"/></joint>
<link name="rotor"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def signals(seconds: float = 10.0, rate: float = 200.0, seed: int = 0) -> dict[str, Array]:
    """Return signals of a motor with 0.3 N.m of Coulomb and 0.02 N.m.s/rad of viscous friction."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / rate)
    q = 6.0 * np.sin(2 * np.pi * 0.23 * t) + 4.0 * np.sin(2 * np.pi * 0.11 * t + 0.3)
    dq = np.gradient(q, t)
    ddq = np.gradient(dq, t)
    noise = rng.standard_normal(t.size)
    tau = 0.01 * ddq + 0.3 * np.tanh(dq / 0.05) + 0.02 * dq + 0.01 * noise
    return {
        "t": t,
        "ms": 1e3 * t,
        "us": np.rint(1e6 * t),
        "q": q,
        "deg": np.degrees(q),
        "counts": np.rint(q * 4096 / (2 * np.pi)),
        "command": q + 0.01 * rng.standard_normal(t.size),
        "error": 0.01 * noise,
        "dq": dq,
        "deg/s": np.degrees(dq),
        "rpm": dq * 30 / np.pi,
        "ddq": ddq,
        "tau": tau,
        "amperes": tau / 0.11,
        "volts": 3.0 * tau + 0.2 * dq,
        "size": np.abs(tau),
        "noise": np.cumsum(rng.standard_normal(t.size)),
        "warmth": 30.0 + 0.01 * t,
    }


def write_log(path: Path, header: str) -> Path:
    """Write a log with columns such as ``pos [deg]=deg``, separated by ``;``."""
    values = signals()
    pairs = [column.rpartition("=") for column in header.split(";")]
    table = np.column_stack([values[signal] for _, _, signal in pairs])
    names = ",".join(name for name, _, _ in pairs)
    np.savetxt(path, table, delimiter=",", header=names, comments="", fmt="%.9g")
    return path


def describe_rotor(folder: Path) -> RobotDescription:
    """Return a bench of one motor whose inertia is identified."""
    model = folder / "bench.urdf"
    model.write_text(URDF, encoding="utf-8")
    return RobotDescription(name="m", model=model, joints=("motor",), known=(), rotor_inertia=False)
