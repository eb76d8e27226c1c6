"""A bench of one motor: robot file, logs, a body, laws with and without band, and an FMU."""

import json
from pathlib import Path

import numpy as np
from rotor import signals

import hesr


def write_bench(folder: Path) -> None:
    """Write the files of the bench."""
    hesr.new(folder, bench="rotary")
    write_log(folder / "run.csv", signals())
    write_log(folder / "second.csv", signals(seconds=70.0, seed=1))
    warming = signals(seconds=400.0, rate=50.0)
    warming["tau"] *= 1.0 + 0.5 * np.exp(-warming["t"] / 60.0)
    write_log(folder / "warming.csv", warming)
    robot = hesr.Robot(folder / "robot.toml")
    body = hesr.identify(folder / "run.csv", robot=robot, output=folder / "body.json")
    law = hesr.fit(
        folder / "run.csv",
        robot=robot,
        rigid_body=body,
        law="coulomb_viscous",
        output=folder / "law.json",
    )
    hesr.fit(
        folder / "run.csv",
        robot=robot,
        rigid_body=body,
        law="lugre",
        output=folder / "lugre.json",
    )
    bare_law = json.loads((folder / "law.json").read_text(encoding="utf-8"))
    for joint_law in bare_law["joints"]:
        del joint_law["band"]
    (folder / "bare.json").write_text(json.dumps(bare_law), encoding="utf-8")
    hesr.export(law, folder / "Friction.fmu")


def write_log(path: Path, values: dict[str, np.ndarray]) -> None:
    columns = {"t": "t", "q1": "q", "dq1": "dq", "tau1": "tau"}
    rows = np.column_stack([values[quantity] for quantity in columns.values()])
    np.savetxt(path, rows, "%.9g", ",", header=",".join(columns), comments="")
