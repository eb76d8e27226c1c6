"""Exports of measured robots by name: laws, body and logs of their studies."""

import re
import shutil
from pathlib import Path

import pytest
from small_study import Hesr, hesr_here

import cosim.study.ready_model
import cosim.study.shipped_studies
import hesr
from cosim.study.ready_model import build_ready_model
from cosim.study.shipped_studies import find_measured_studies
from hesr_model.support.files import models_folder


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def test_the_measured_robots_have_names() -> None:
    assert set(find_measured_studies()) == {"ur10", "fretting", "cylinder"}


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the study of a shipped robot with one law and two logs, under the name of `small`."""
    folder = tmp_path / "small"
    shutil.copytree(models_folder() / "cylinder", folder)
    path = folder / "study.toml"
    text = re.sub(r"laws = .*", 'laws = ["stribeck"]', path.read_text(encoding="utf-8"))
    path.write_text(text.replace('"cylinder_2.csv", "cylinder_3.csv", ', ""), encoding="utf-8")
    monkeypatch.setattr(
        cosim.study.shipped_studies, "find_measured_studies", lambda: {"small": path}
    )
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return path


def test_a_robot_is_exported_by_name(study: Path, tmp_path: Path, cli: Hesr) -> None:
    """The numbers are those of the study's law, body and logs, given one by one."""
    output = tmp_path / "numbers.xml"
    said = cli("export", "small", "--format", "mjcf-joint", "-o", output)
    assert said.code == 0, said.err
    assert "that were not used for" in output.read_text(encoding="utf-8")
    ready = build_ready_model(study, lambda *_: None)
    assert [log.name for log in ready.training] == ["cylinder_1", "cylinder_4"]
    assert [log.name for log in ready.tests] == ["cylinder_5"]
    again = hesr.export(
        ready.model,
        tmp_path / "again.xml",
        format="mjcf-joint",
        robot=study.parent / "robot.toml",
        rigid_body=ready.body,
        log=ready.training,
        test_log=ready.tests,
    )
    assert again.read_bytes() == output.read_bytes()
    # Options that are set stay.
    other = tmp_path / "other.xml"
    judged = study.parent / "cylinder_4.csv"
    said = cli("export", "small", "--format", "mjcf-joint", "--test-log", judged, "-o", other)
    assert said.code == 0, said.err
    assert other.read_bytes() != output.read_bytes()


def test_laws_are_fitted_once(
    study: Path, tmp_path: Path, cli: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = cli("export", "small", "--format", "c", "-o", tmp_path / "small.h")
    assert said.code == 0, said.err
    monkeypatch.setattr(cosim.study.ready_model, "fit_chosen_laws", None)
    (tmp_path / "again").mkdir()
    said = cli("export", "small", "--format", "c", "-o", tmp_path / "again" / "small.h")
    assert said.code == 0, said.err
    again = (tmp_path / "again" / "small.h").read_bytes()
    assert again == (tmp_path / "small.h").read_bytes()
