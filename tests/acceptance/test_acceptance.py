"""Everything that can be exported runs at its defaults, in every form and in engines of others.

The gate runs the cells that cover most pairs, `--nightly laws` all. The outcome of each cell is a
property `outcome` of its test in JUnit's report (`--junitxml FILE`).
"""

import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest
from acceptance.artefacts import (
    FILES,
    FMUS,
    LAWS,
    SCOPES,
    STEP,
    STRUCTURES,
    structures_of,
    write_loop,
)
from acceptance.engines import (
    compile_sources,
    corner_of,
    input_rows,
    require_valid,
    run_in_fmpy,
    run_in_libcosim,
)
from acceptance.matrix import Cell, chosen_cells, possible_cells
from compiled_header import CompiledHeader
from modelica_truth import open_compilers

from cosim.systems.simulation import Master
from hesr_model.friction.model import FrictionModel

GATE = 24
"""Cells of the gate."""

POSSIBLE = possible_cells({law: structures_of(law) for law in LAWS}, SCOPES)
CELLS = chosen_cells(POSSIBLE)


def marked_cells() -> Iterator[object]:
    for k, cell in enumerate(CELLS):
        marks = [] if k < GATE else [pytest.mark.nightly("laws")]
        yield pytest.param(cell, id=str(cell), marks=[pytest.mark.ci, *marks])


def test_every_pair_of_values_occurs() -> None:
    possible = {pair for cell in POSSIBLE for pair in cell.pairs}
    assert {pair for cell in CELLS for pair in cell.pairs} == possible
    values = {value for cell in POSSIBLE for value in cell}
    assert values >= {*LAWS, *STRUCTURES, *FMUS, *FILES, "loop"}


@pytest.mark.parametrize("cell", tuple(marked_cells()))
def test_an_artefact_runs(cell: Cell, tmp_path: Path, record_property) -> None:
    model = STRUCTURES[cell.structure](cell.law)
    if cell.format in FMUS:
        outcome = try_fmu(cell, model, tmp_path)
    elif cell.format == "loop":
        outcome = try_loop(model, tmp_path)
    else:
        path = FILES[cell.format](model, tmp_path)
        outcome = TRIALS[cell.format](model, path)
    record_property("outcome", outcome)


def try_fmu(cell: Cell, model: FrictionModel, folder: Path) -> str:
    """Run an FMU from a corner, alone and with all start values together, and compile it."""
    fmu = FMUS[cell.format](model, folder, 3 if cell.fmi == 3 else 2)
    require_valid(fmu)
    is_odd = len(str(cell)) % 2
    compile_sources(fmu, [("gcc", "clang")[is_odd], ("clang++", "g++")[is_odd]], folder / "c")
    corner = corner_of(fmu, cell.corner)
    starts: dict[str, float] = {}
    refused = []
    for name, value in corner.items():
        alone = run_in_fmpy(fmu, {name: value})
        if alone.outputs is None:
            assert name in alone.refusal, alone.refusal
            refused.append(name)
        else:
            assert np.isfinite(alone.outputs).all(), name
            starts[name] = value
    together = run_in_fmpy(fmu, starts)
    if together.outputs is None:
        assert starts, together.refusal
        return f"refused together: {together.refusal}"
    assert np.isfinite(together.outputs).all()
    if cell.fmi == 2 and find_spec("libcosimpy") is not None:
        elsewhere = run_in_libcosim(fmu, starts)
        scale = np.abs(together.outputs).max(axis=0) + 1e-3
        assert (np.abs(elsewhere - together.outputs) / scale).max() <= 1e-12
    return f"runs, {len(starts)} start values" + (f", refuses {refused}" if refused else "")


def try_loop(model: FrictionModel, folder: Path) -> str:
    with Master(write_loop(model, folder)) as master:
        result = master.run()
    assert all(np.isfinite(result.vector(name)).all() for name in ("arm.q_true",))
    return "runs"


def try_plugin(model: FrictionModel, path: Path) -> str:
    mujoco.mj_loadPluginLibrary(str(path))
    bodies = "".join(
        f'<body><joint name="{name}" axis="0 1 0" armature="0.5"/>'
        '<inertial pos="0.1 0 0.1" mass="2" diaginertia="1 1 1"/></body>'
        for name in model.joints
    )
    scene = mujoco.MjModel.from_xml_string(
        f'<mujoco><include file="{path.with_suffix(".xml")}"/>'
        f"<worldbody>{bodies}</worldbody></mujoco>"
    )
    data = mujoco.MjData(scene)
    for _ in range(40):
        mujoco.mj_step(scene, data)
    assert np.isfinite(data.qpos).all()
    assert np.abs(data.qfrc_passive).max() > 0.0
    return "runs in MuJoCo"


def try_header(model: FrictionModel, path: Path) -> str:
    header = CompiledHeader(model, path.parent)
    state = header.state()
    rows = input_rows(header.joints)
    found = [header.step(state, row, row, row, STEP) for row in rows]
    assert np.isfinite(np.array(found, dtype=float)).all()
    return "runs, compiled"


def try_modelica(_model: FrictionModel, path: Path) -> str:
    with open_compilers(path.parent) as open_compiler:
        rumoca = open_compiler("rumoca")
        text = path.read_text(encoding="utf-8")
        assert rumoca.Session().loads(text, model="Law.Joint1") is not None
    return "compiles in Rumoca"


def try_tensors(model: FrictionModel, path: Path, python: str, library: str) -> str:
    rows = input_rows(len(model.joints))
    np.savez(path.with_name("rows.npz"), dq=rows, q=rows, tau_load=rows, step=STEP, begins=[0, 20])
    host = Path(__file__).parents[1] / "tensor_host.py"
    answer = subprocess.run(
        [python, host, library, path.parent], capture_output=True, text=True, check=False
    )
    assert answer.returncode == 0, answer.stderr
    with np.load(path.with_name("torques.npz")) as torques:
        assert all(np.isfinite(torques[name]).all() for name in torques)
    return f"runs in {library}"


def try_torch(model: FrictionModel, path: Path) -> str:
    python = "/usr/bin/python3"
    if subprocess.run([python, "-c", "import torch"], capture_output=True, check=False).returncode:
        pytest.skip("Debian's python3-torch is not installed")
    return try_tensors(model, path, python, "torch")


def try_jax(model: FrictionModel, path: Path) -> str:
    if find_spec("jax") is None:
        pytest.skip("JAX is not installed: run `make jax` first")
    return try_tensors(model, path, sys.executable, "jax")


TRIALS = {
    "mujoco-plugin": try_plugin,
    "c": try_header,
    "modelica": try_modelica,
    "torch": try_torch,
    "jax": try_jax,
}
