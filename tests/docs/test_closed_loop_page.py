"""The page of the closed loop: its equations are those of the code, and its script is the loop."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from documents import ROOT, block

import hesr
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec
from fmu_src.blocks.controller import (
    COMPENSATION,
    controller,
    controller_equations,
    velocity_equations,
)
from fmu_src.blocks.trajectory import KIND
from fmu_src.pages.block_page import equation_lines

PAGE = (ROOT / "docs" / "closed-loop.md").read_text(encoding="utf-8")


def test_the_equations_are_those_of_the_code() -> None:
    lines = equation_lines(controller_equations(0.005))
    assert "".join(f"    {line}\n" for line in lines) in PAGE
    filtered = next(
        line for line in equation_lines(velocity_equations()) if line.startswith("dq =")
    )
    assert f"    {filtered}\n" in PAGE


def test_gains_have_their_units_and_choices_their_integers() -> None:
    component = controller_equations(0.005)
    for gain in (*component.parameters, *component.shared[1:]):
        assert f"| `{gain.name}` | {gain.unit} |" in PAGE
    for items in (COMPENSATION.items, KIND.items):
        for number, (name, _) in enumerate(items, start=1):
            assert f"{number} = {name}" in PAGE


@pytest.mark.parametrize("gain", ["Kp", "Kd", "lambda", "Kv", "Ki", "Kx", "friction_gain"])
def test_gains_act_in_the_schemes_that_are_named(gain: str) -> None:
    component = controller_equations(0.005)
    command = next(e for e in component.equations if e.name == "dq_cmd").expression
    compensation = next(e for e in component.equations if e.name == "dq_comp").expression
    torque = next(e for e in component.equations if e.name == "tau_d").expression
    cases = dict(zip(("torque_error", "servo_inversion"), compensation.args, strict=False))
    names = {n for n, case in cases.items() if gain in map(str, case.expr.free_symbols)}
    common = gain in map(str, command.free_symbols | torque.free_symbols)
    row = re.search(rf"(?m)^\| `{gain}` \|.*\| (.*) \|$", PAGE)
    assert row is not None
    assert row[1] == ("all" if common else ", ".join(sorted(names)))


def test_every_connection_of_the_script_is_in_the_table() -> None:
    table = PAGE.partition("## Connections")[2].partition("At each sample")[0]
    links = re.search(r'(?s)LINKS = """(.*?)"""', PAGE)
    assert links is not None
    for link in links[1].split():
        target, source = link.split("=")
        row = next(row for row in table.splitlines() if f"`{target}`" in row)
        block_name, signal = source.split(".")
        assert f"`{source}`" in row or f"`{signal}`" in row
        assert block_name in row


def test_the_script_is_short_and_needs_fmpy_and_numpy_only() -> None:
    script = block("closed-loop.md", "python")
    lines = [line for line in script.splitlines() if line.strip()]
    assert len(lines) <= 45
    imports = re.findall(r"(?m)^(?:from|import) (\w+)", script)
    assert set(imports) <= {"fmpy", "numpy", *sys.stdlib_module_names}


@pytest.mark.ci
def test_the_script_is_the_loop(
    small_results: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Its error is that of HESR with the same start values, digit for digit."""
    folder = hesr.export(small_results, tmp_path / "loop", format="loop")
    monkeypatch.chdir(folder)
    names: dict[str, object] = {"__name__": "__main__"}
    exec(compile(block("closed-loop.md", "python"), "closed-loop.md", "exec"), names)
    printed = capsys.readouterr().out.split("[mrad]: ")[1].split()

    spec = SystemSpec.read(folder / "closed_loop.toml")
    known = {component.name: component.start for component in spec.components}
    # The numbers of the page are those of the export.
    assert [known["trajectory"]["preview"]] == names["MOTION"]["preview"]
    assert [known["trajectory"]["rest_time"]] == names["MOTION"]["rest_time"]
    assert known["controller"]["compensation"] == "servo_inversion"
    for gain in ("Kv", "Ki"):
        assert list(known["controller"][gain]) == names["CONTROL"][gain]
    assert known["controller"]["sample_time"] == spec.step
    components = tuple(
        component if component.name == "gravity" else component.model_copy(update={"start": {}})
        for component in spec.components
    )
    spec = spec.model_copy(update={"components": components, "stop": names["STOP"]})
    start = {
        "trajectory": names["MOTION"] | {"kind": "sine"},
        "controller": names["CONTROL"] | {"compensation": "servo_inversion"},
        "arm": {},
    }
    for _ in range(2):  # the first run gives the start of the motion
        with Master(spec) as master:
            run = master.run(start=start).require_success()
        start["arm"] = {"q0": run.vector("trajectory.q")[0].tolist()}
    error = (run.vector("trajectory.q") - run.vector("arm.q_true"))[1:]
    rmse = 1e3 * np.sqrt(np.mean(error**2, axis=0))
    assert [float(text) for text in printed] == np.round(rmse, 3).tolist()
    assert rmse.max() < 1.0


def test_the_pages_of_the_blocks_hold_the_equations() -> None:
    page = controller(3).members["documentation/index.html"].decode()
    for line in equation_lines(controller_equations(0.005)):
        assert line.replace("<", "&lt;").replace(">", "&gt;") in page
    assert "rad/(s.N.m)" in page
    assert "3 = servo_inversion" in page
