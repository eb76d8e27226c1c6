"""Default platforms of FMUs (Linux, Windows and this machine), and the lines that state them."""

import re
import zipfile
from pathlib import Path
from typing import Any

import pytest
from small_study import Hesr, Run, hesr_here, uf850

import fmu_src.export.toolchain
import hesr as library
from fmu_src.check.run import check
from fmu_src.export.toolchain import DEFAULT_PLATFORMS, HOST, TARGETS, host_platform
from hesr_model.friction.model import FrictionModel

LINUX, WINDOWS = "linux64", "win64"
FORMATS: dict[str, dict[str, Any]] = {
    "fmu": {},
    "drive": {"inertia": 3.0},
    "plant": {"robot": uf850("robot.toml")},
    "observer": {"robot": uf850("robot.toml")},
}


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def platforms(fmu: Path) -> list[str]:
    with zipfile.ZipFile(fmu) as archive:
        names = [name for name in archive.namelist() if name.startswith("binaries/")]
    return [name.split("/")[1] for name in names]


def test_the_default_has_this_machine_linux_and_windows() -> None:
    assert DEFAULT_PLATFORMS == (LINUX, WINDOWS)  # the tests run on Linux
    assert HOST == (LINUX,)


@pytest.mark.parametrize(
    ("system", "machine", "host"),
    [
        ("linux", "x86_64", LINUX),
        ("linux", "aarch64", "aarch64-linux"),
        ("win32", "AMD64", WINDOWS),
        ("darwin", "arm64", "darwin64"),
        ("linux", "riscv64", None),
    ],
)
def test_each_machine_has_its_own_platform(
    system: str, machine: str, host: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fmu_src.export.toolchain.sys, "platform", system)
    monkeypatch.setattr(fmu_src.export.toolchain.platform, "machine", lambda: machine)
    assert host_platform() == host
    assert host is None or host in TARGETS


@pytest.mark.parametrize(
    "form", [f if f in ("fmu", "drive") else pytest.param(f, marks=pytest.mark.ci) for f in FORMATS]
)
def test_every_format_of_a_law_has_them(form: str, tmp_path: Path, study_run: Run) -> None:
    law = study_run.law("parfam_h")
    fmu = library.export(law, tmp_path / "F.fmu", format=form, **FORMATS[form])
    assert platforms(fmu) == [LINUX, WINDOWS]
    report = check(fmu)
    assert (report.problems, report.platforms) == ((), (LINUX, WINDOWS))
    assert report.coverage == "linux64, win64; no binary for tools on macOS."


def test_a_run_states_its_platforms(study_run: Run) -> None:
    """Those of the run, and the arm with the library of MuJoCo for this machine alone."""
    found = {fmu.name: platforms(fmu) for fmu in (study_run.results / "fmus").iterdir()}
    internal = {"Arm.fmu", "true_friction.fmu"}
    for name, of_fmu in found.items():
        expected = [LINUX] if name in internal else [LINUX, WINDOWS]
        assert sorted(set(of_fmu)) == expected, name
    line = f"FMUs: {study_run.results}/fmus, for linux64, win64 (Arm.fmu with MuJoCo: linux64 only)"
    assert line in study_run.answer.out.splitlines()


def test_the_readme_states_the_size_of_an_fmu(study_run: Run) -> None:
    """Of three joints with these platforms, its pages and its physics checks."""
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    found = re.search(r"FMU of three\s+joints\s+is\s+(\d+)\s+to\s+(\d+)\s+KB", text)
    assert found is not None
    lowest, highest = map(int, found.groups())
    for law in ("stribeck", "parfam_h"):
        size = (study_run.results / "fmus" / f"{law}.fmu").stat().st_size / 1024.0
        assert 0.9 * lowest < size < highest, law


def test_one_platform_remains_selectable(table1: FrictionModel, tmp_path: Path) -> None:
    fmu = library.export(table1, tmp_path / "F.fmu", platform=[WINDOWS], no_documentation=True)
    assert platforms(fmu) == [WINDOWS]
    assert check(fmu).coverage == "win64; no binary for tools on Linux and macOS."
    fmu = library.export(table1, tmp_path / "G.fmu", platform=["all"], no_documentation=True)
    assert check(fmu).coverage == "linux64, win64, darwin64, aarch64-linux."
