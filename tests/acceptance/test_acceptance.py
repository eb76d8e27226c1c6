"""Everything that can be exported runs at its defaults, in every form and in engines of others.

The gate runs the cells that cover most pairs, `--nightly laws` all. The outcome of each cell is a
property `outcome` of its test in JUnit's report (`--junitxml FILE`).
"""

from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from acceptance.artefacts import (
    FMUS,
    LAWS,
    LOWERED,
    SCOPES,
    STEP,
    STRUCTURES,
    structures_of,
    write_loop,
)
from acceptance.cells import Cell, chosen_cells, possible_cells
from acceptance.engines import (
    STEPS,
    compile_sources,
    corner_of,
    postures_of,
    require_valid,
    run_in_fmpy,
    run_in_libcosim,
)
from lowerings import EVEN_ROWS, LOWERINGS, Case, Motion
from modelica_truth import open_compilers
from rust_engine import FMI_SIM, run_in_fmi_sim

from cosim.systems.simulation import Master
from fmu_src.run.fmu import FmuInstance
from hesr.extras.modelica.modelica_package import export_modelica
from hesr_model.friction.model import FrictionModel

GATE = 12
"""Cells of the gate."""

COMPILERS = (("gcc", "clang++"), ("clang", "g++"))
"""Those of C99 and of C++17, in turn."""

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
    assert values >= {*LAWS, *STRUCTURES, *FMUS, *LOWERED, "modelica", "loop"}


@pytest.mark.parametrize("cell", tuple(marked_cells()))
def test_an_artefact_runs(cell: Cell, tmp_path: Path, record_property) -> None:
    model = STRUCTURES[cell.structure](cell.law)
    if cell.format in FMUS:
        outcome = try_fmu(cell, model, tmp_path)
    elif cell.format == "loop":
        outcome = try_loop(model, tmp_path)
    elif cell.format == "modelica":
        outcome = try_modelica(model, tmp_path)
    else:
        outcome = try_lowering(LOWERED[cell.format], cell, model, tmp_path)
    record_property("outcome", outcome)


def try_fmu(cell: Cell, model: FrictionModel, folder: Path) -> str:
    """Run an FMU from a corner, alone and with all start values together, and compile it."""
    fmu = FMUS[cell.format](model, folder, 3 if cell.fmi == 3 else 2)
    require_valid(fmu)
    compilers = compile_sources(fmu, COMPILERS[len(str(cell)) % 2], folder / "c")
    with FmuInstance(fmu) as component:
        starts, refused = try_each_start(component, corner_of(component.description, cell.corner))
        for posture in postures_of(component.description):
            at_rest = run_in_fmpy(component, posture)
            assert at_rest.outputs is not None, (posture, at_rest.refusal)
    with FmuInstance(fmu) as component:
        together = run_in_fmpy(component, starts)
    if together.outputs is None:
        assert starts, together.refusal
        return f"refused together: {together.refusal}"
    assert np.isfinite(together.outputs).all()
    engines = ["FMPy"]
    if cell.fmi == 2 and find_spec("libcosimpy") is not None:
        elsewhere = run_in_libcosim(fmu, starts)
        scale = np.abs(together.outputs).max(axis=0) + 1e-3
        assert (np.abs(elsewhere - together.outputs) / scale).max() <= 1e-12
        engines.append("libcosim")
    if cell.fmi == 3 and cell.structure == "one joint" and FMI_SIM.exists():
        run_in_fmi_sim(fmu, STEP, STEPS)
        engines.append("fmi-sim")
    outcome = f"compiled by {compilers}, runs in {engines} from {len(starts)} start values"
    return f"{outcome}, refuses {refused}" if refused else outcome


def try_each_start(
    component: FmuInstance, corner: Mapping[str, float]
) -> tuple[dict[str, float], list[str]]:
    """Run from each start value alone; return those that work, and the names that are refused."""
    starts: dict[str, float] = {}
    refused: list[str] = []
    for name, value in corner.items():
        alone = run_in_fmpy(component, {name: value})
        if alone.outputs is None:
            assert name in alone.refusal, alone.refusal
            refused.append(name)
        else:
            assert np.isfinite(alone.outputs).all(), name
            starts[name] = value
    return starts, refused


def try_loop(model: FrictionModel, folder: Path) -> str:
    with Master(write_loop(model, folder)) as master:
        result = master.run()
    assert np.isfinite(result.vector("arm.q_true")).all()
    return "runs"


def try_lowering(name: str, cell: Cell, model: FrictionModel, folder: Path) -> str:
    """Compare the torques of a format with those of the law in Python."""
    lowering = LOWERINGS[name]
    case = Case(cell.law, model, folder / "unused.fmu")
    motion = Motion.reference(len(model.joints)).first_rows(EVEN_ROWS)
    [torques] = lowering.compute([case], [motion], folder / name)
    [expected] = LOWERINGS["python"].compute([case], [motion], folder / "python")
    difference = np.abs(torques.stepped - expected.stepped).max(axis=0)
    # A baseline may have no torque, which no error is relative to.
    size = np.abs(expected.stepped).max(axis=0)
    worst = float((difference / np.where(size > 0.0, size, 1.0)).max())
    assert worst <= max(lowering.tolerance, LOWERINGS["fmi2"].tolerance)
    return f"equals the law to {worst:.0e}"


def try_modelica(model: FrictionModel, folder: Path) -> str:
    path = export_modelica(model, folder / "Law.mo")
    with open_compilers(folder) as open_compiler:
        rumoca = open_compiler("rumoca")
        text = path.read_text(encoding="utf-8")
        assert rumoca.Session().loads(text, model="Law.Joint1") is not None
    return "compiles in Rumoca"
