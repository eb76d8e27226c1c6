"""Cost of each input convention, measured on an FMU."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from containing import OneSentence
from rich.console import Console
from small_study import Hesr, hesr_here

from cosim.report.tables.laws import convention
from cosim.report.tables.table import ResultTable
from cosim.report.tables.terminal import TerminalTable
from cosim.workflow.check import check
from fmu_src import model_file
from fmu_src.friction.convention import measure, run
from fmu_src.friction.embedded_model import EMBEDDED_MODEL
from fmu_src.friction.reference import SETTINGS, reference_motion, torques
from fmu_src.friction.replay import replay
from hesr.extras.drive.drive_fmu import export_drive
from hesr_model.errors import HesrError, SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.typed_files import to_json

BEST_FIRST = ("direct", "linear", "hold")


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def test_held_inputs_cost_accuracy_for_table_1(friction_fmu: Path) -> None:
    found = measure(friction_fmu)
    assert found.joints == ("joint1", "joint2", "joint3")
    assert found.step == 0.005
    assert found.speeds == pytest.approx((1.2, 1.2, 1.2))
    held = found.replay["hold"]
    assert [e.rmse for e in held] == pytest.approx([0.67, 1.43, 0.20], abs=0.005)
    for error in held:
        assert error.rmse_reversal is not None
        assert 2.5 < error.rmse_reversal / error.rmse < 3.5
    for direct, linear, hold in zip(*map(found.replay.get, BEST_FIRST), strict=True):
        assert direct.rmse < 1e-12
        assert linear.rmse < 0.5 * hold.rmse
    for error in found.continuous["direct"]:
        assert error.rmse > 0.05


def test_the_fmu_matches_its_law_in_each_setting(friction_fmu: Path) -> None:
    model = FrictionModel.read(model_file("uf850-table1"))
    motion = reference_motion(model, frequency=0.8, periods=2.0, phase=0.4)
    for setting in SETTINGS:
        expected = torques(model, motion, setting)
        np.testing.assert_allclose(
            run(friction_fmu, motion, setting),
            expected,
            rtol=0.0,
            atol=1e-11 * np.abs(expected).max(),
        )


def test_the_direct_setting_is_the_replay_of_a_log(friction_fmu: Path) -> None:
    motion = reference_motion(FrictionModel.read(model_file("uf850-table1")), periods=1.0)
    np.testing.assert_array_equal(
        run(friction_fmu, motion, "direct"),
        replay(friction_fmu, motion.t, motion.dq, motion.q, motion.tau_load),
    )


def test_an_fmu_without_a_model_is_refused(friction_fmu: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare.fmu"
    with zipfile.ZipFile(friction_fmu) as old, zipfile.ZipFile(bare, "w") as new:
        for name in old.namelist():
            if name != EMBEDDED_MODEL:
                new.writestr(name, old.read(name))
    with pytest.raises(HesrError) as caught:
        measure(bare)
    assert f"{bare}: contains no friction model" in str(caught.value)
    with pytest.raises(HesrError, match="no such file"):
        measure(tmp_path / "missing.fmu")


@pytest.fixture(scope="module")
def drive_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = FrictionModel.read(model_file("uf850-table1"))
    return export_drive(model, tmp_path_factory.mktemp("drive") / "Drive.fmu", inertia=[3.0] * 3)


def test_an_fmu_with_other_connectors_is_refused_before_it_is_checked(
    friction_fmu: Path, drive_fmu: Path, hesr: Hesr
) -> None:
    sentence = "one has no input 'dq[1]'"
    with pytest.raises(SimulationError) as caught:
        measure(drive_fmu)
    assert str(caught.value) == OneSentence(f"{drive_fmu}: ", sentence)
    answer = hesr("check", "--kind", "convention", friction_fmu, drive_fmu, "--json", "-")
    assert (answer.code, answer.out, answer.err) == (
        2,
        "",
        OneSentence(f"hesr: {drive_fmu}: ", sentence),
    )


def test_a_friction_fmu_with_a_broken_description_is_still_checked(
    friction_fmu: Path, tmp_path: Path, hesr: Hesr
) -> None:
    broken = tmp_path / "broken.fmu"
    with zipfile.ZipFile(friction_fmu) as old, zipfile.ZipFile(broken, "w") as new:
        for name in old.namelist():
            new.writestr(name, b"<" if name == "modelDescription.xml" else old.read(name))
    answer = hesr("check", "--kind", "convention", broken)
    assert (answer.code, answer.err) == (1, "")
    assert "modelDescription.xml:" in answer.out
    assert f"not run: Convention: {broken}: not a readable FMU (" in answer.out


def test_each_file_has_its_table(friction_fmu: Path) -> None:
    report = check(friction_fmu, kind="convention")
    (shown,) = (table for table in report.tables() if isinstance(table, ResultTable))
    assert friction_fmu.name in shown.caption
    assert report.result()[0]["convention"]["replay"]["hold"]


def test_results_are_given_as_table_and_json(friction_fmu: Path) -> None:
    found = measure(friction_fmu, periods=1.0)
    console = Console(width=80, record=True)
    console.print(TerminalTable(convention("[x].fmu", found)))
    text = console.export_text()
    assert "[x].fmu" in text
    for setting, meaning in SETTINGS.items():
        assert f"{setting}: " in " ".join(text.split())
        assert meaning in " ".join(text.split())
    assert f"{found.replay['hold'][1].rmse:.3f}" in text
    data = to_json(found)
    assert data["replay"]["hold"][0]["rmse"] == found.replay["hold"][0].rmse
