"""The user-defined component and log format of the pages in docs."""

import csv
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from documents import block
from plugin_packages import lay_package
from small_study import Hesr, hesr_here

from fmu_src.blocks.block import block as write_block
from fmu_src.run.fmu import FmuInstance
from hesr_model.equations import component as equations
from hesr_model.equations.component import Equation
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ExportError, LogError
from hesr_model.logs.readers import formats
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import RobotDescription


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def test_the_documented_component_follows_its_equation(
    tmp_path: Path, table1_fmu: Path, hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(block("add-a-component.md", "python"), "warming.py", "exec"), {})
    checked = hesr("check", "--kind", "references", "Warming.fmu")
    assert checked.code == 0, checked.out
    Path("Friction.fmu").write_bytes(table1_fmu.read_bytes())
    Path("warm.toml").write_text(block("add-a-component.md", "toml"), encoding="utf-8")
    ran = hesr("simulate", "warm.toml", "-o", "warm.csv")
    assert ran.code == 0, ran.err
    with Path("warm.csv").open(encoding="utf-8", newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    assert rows[0]["warming.rise[1]"] == 0.0
    for joint in (1, 2, 3):
        watts = 0.5 * np.abs([row[f"friction.tau[{joint}]"] for row in rows])
        rise, kept = 0.0, np.exp(-0.1 / 600.0)
        for held in watts[5::5]:  # in steps of 0.1 s, one step after friction
            rise = kept * rise + (1.0 - kept) * 0.5 * held
        assert rise > 0.01
        assert rows[-1][f"warming.rise[{joint}]"] == pytest.approx(rise, rel=1e-9)
    with FmuInstance(Path("Warming.fmu")) as fmu:
        fmu.initialise(start={"T": 300.0, "R[2]": 2.0})
        fmu.set({"dq[1]": -2.0, "dq[2]": 2.0, "dq[3]": 0.0})
        fmu.set({f"tau[{k}]": 4.0 for k in (1, 2, 3)})
        fmu.step(0.0, 120.0)
        rises = fmu.get([f"rise[{k}]" for k in (1, 2, 3)])
    assert rises == pytest.approx(
        8.0 * np.array([0.5, 2.0, 0.0]) * (1.0 - np.exp(-0.4)), rel=1e-12, abs=0.0
    )


def test_a_block_with_states_is_refused() -> None:
    heat = Relaxation(name="warmth", unit="K", drive=1.0, rate=0.1)
    warm = Equation(name="rise", unit="K", expression=heat.state, output=True)
    component = equations.Component(memory=(heat,), equations=(warm,))
    message = "block 'Warm': state 'warmth'"
    with pytest.raises(ExportError, match=message):
        write_block(component, 1, name="Warm", text="", step=0.1, example={})


@pytest.fixture
def own_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Install the package of the docs page."""
    project = tomllib.loads(block("add-a-log-format.md", "toml"))["project"]
    points = project["entry-points"]["hesr.logs"]
    module = next(iter(points.values())).partition(":")[0]
    modules = {module: block("add-a-log-format.md", "python")}
    site = lay_package(tmp_path, {"hesr.logs": points}, name=project["name"], modules=modules)
    monkeypatch.syspath_prepend(str(site))
    formats.formats.cache_clear()
    yield
    formats.formats.cache_clear()


def recording(path: Path, log: Log, *, joints: int = 3) -> Path:
    rows = np.hstack([1e6 * log.t[:, None], log.q, log.dq, log.tau])
    path.write_bytes(b"ARMREC" + bytes([joints]) + rows.astype("<f8").tobytes())
    return path


@pytest.mark.usefixtures("own_format")
def test_the_documented_format_is_read_and_inspected(
    tmp_path: Path, arm: RobotDescription, arm_log: Log, hesr: Hesr
) -> None:
    path = recording(tmp_path / "run.rec", arm_log)
    log = Log.read(path, arm)
    np.testing.assert_allclose(log.t, arm_log.t, rtol=1e-14, atol=0)
    for name in ("q", "dq", "tau"):
        np.testing.assert_array_equal(getattr(log, name), getattr(arm_log, name))
    robot, study = tmp_path / "robot.toml", tmp_path / "study.toml"
    said = hesr("inspect", path, "--robot", arm.model, "--write", robot, "--study", study)
    assert said.code == 0, said.err
    assert Log.read(path, RobotDescription.read(robot)).rate == pytest.approx(arm_log.rate)


@pytest.mark.usefixtures("own_format")
def test_errors_in_a_file_of_the_format_are_one_sentence(
    tmp_path: Path, arm: RobotDescription, arm_log: Log, hesr: Hesr
) -> None:
    six = recording(tmp_path / "six.rec", arm_log, joints=6)
    said = hesr("inspect", six, "--robot", arm.model)
    assert (said.code, said.err) == (2, f"hesr: {six}: is not a recording of 3 joints.\n")
    holed = arm_log.q.copy()
    holed[7, 1] = np.nan
    path = recording(tmp_path / "holed.rec", Log(**(vars(arm_log) | {"q": holed})))
    with pytest.raises(LogError, match=r"record 8: q of joint 'j2' is nan; numbers up to"):
        Log.read(path, arm)
    dropping = arm.model_copy(update={"log": arm.log.model_copy(update={"missing": "drop"})})
    assert Log.read(path, dropping).dropped == 1
