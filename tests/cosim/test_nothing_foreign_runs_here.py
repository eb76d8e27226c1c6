"""Whatever is done with a foreign FMU, its code runs in the sandbox only."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile import archived
from test_foreign_fmus import linux

import hesr
from cosim.systems.system import ComponentSpec, SystemSpec, write_system
from fmu_src.export.toolchain import TARGETS, build
from fmu_src.run.trust import remember
from hesr.extras.ssp.contents import read_contents
from hesr.extras.ssp.ssp import write_ssp

TELL = """
#include <stdio.h>

__attribute__((constructor)) static void leave_mark(void) {
    FILE *file = fopen("%s", "w"); /* fails in the sandbox */
    if (file) {
        fclose(file);
    }
}
"""
pytestmark = [linux, pytest.mark.ci]


@pytest.fixture
def marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], tuple[Path, Path]]:
    """Return a function that copies an FMU as a foreign one, and names what its loading writes."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))  # trust of this test

    def copied(fmu: Path) -> tuple[Path, Path]:
        mark = tmp_path / "loaded"
        folder = tmp_path / "code"
        folder.mkdir()
        with zipfile.ZipFile(fmu) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        for name, content in members.items():
            if name.startswith("sources/"):
                (folder / Path(name).name).write_bytes(content)
        code = folder / "all.c"
        code.write_text(TELL % mark + code.read_text(encoding="utf-8"), encoding="utf-8")
        library = next(name for name in members if name.startswith("binaries/linux64/"))
        members[library] = build(code, Path(library).stem, TARGETS["linux64"])
        return archived(members, tmp_path / "Foreign.fmu"), mark

    return copied


def system(fmu: Path, other: Path, folder: Path) -> Path:
    """Write a system of a foreign FMU and one of ours."""
    spec = SystemSpec(
        name="mixed",
        step=0.1,
        stop=0.5,
        components=(
            ComponentSpec(name="a", fmu=fmu, start={"u": 1.0}),
            ComponentSpec(name="b", fmu=other),
        ),
        connections={"b.u": "a.y"},
        observe=("b.y",),
    )
    return write_system(spec, folder / "mixed.toml")


def ssp(fmu: Path, other: Path, folder: Path) -> Path:
    """Write the same system as SSP."""
    path = system(fmu, other, folder)
    spec = SystemSpec.read(path)
    return write_ssp(read_contents(spec, path), folder / "mixed.ssp")


DEEDS: dict[str, Callable[[Path, Path, Path], Any]] = {
    "simulate": lambda fmu, _, __: hesr.simulate(fmu, stop=0.5),
    "simulate a system": lambda fmu, ours, into: hesr.simulate(system(fmu, ours, into)),
    "simulate foreign ones": lambda fmu, _, into: hesr.simulate(system(fmu, fmu, into)),
    "isolate": lambda fmu, ours, into: hesr.simulate(system(fmu, ours, into), isolate=True),
    "simulate an SSP": lambda fmu, ours, into: hesr.simulate(ssp(fmu, ours, into)),
    "check": lambda fmu, _, __: hesr.check(fmu),
    "check an SSP": lambda fmu, ours, into: hesr.check(ssp(fmu, ours, into)),
    "check all": lambda fmu, _, __: hesr.check(fmu, kind=("static", "references", "hostile")),
    "package": lambda fmu, ours, into: hesr.export(system(fmu, ours, into), into / "x.ssp"),
    "read": lambda fmu, _, __: hesr.Fmu(fmu).variables,
}


@pytest.mark.parametrize("deed", DEEDS)
def test_a_foreign_lag_is_loaded_in_the_sandbox_only(
    deed: str, marked: Callable[[Path], tuple[Path, Path]], lag_fmu: Path, tmp_path: Path
) -> None:
    fmu, mark = marked(lag_fmu)
    remember(lag_fmu)
    DEEDS[deed](fmu, lag_fmu, tmp_path)
    assert not mark.exists()


def test_foreign_friction_is_loaded_in_the_sandbox_only(
    marked: Callable[[Path], tuple[Path, Path]], friction_fmu: Path, tmp_path: Path
) -> None:
    """Replays, physics checks and the convention; at last the mark of a trusted one."""
    fmu, mark = marked(friction_fmu)
    t = 0.01 * np.arange(10)
    dq = np.outer(np.sin(t), np.ones(3))
    assert np.isfinite(hesr.Fmu(fmu).replay(t=t, dq=dq)).all()
    assert hesr.check(fmu, kind=("convention",)).result() is not None
    assert not mark.exists()
    hesr.Fmu(fmu, trust=True).replay(t=t, dq=dq)
    assert mark.exists()
