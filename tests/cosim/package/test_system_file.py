"""Systems written as TOML: reading restores them, also after moving the folder."""

from pathlib import Path

import pytest

from cosim.systems.simulation import Master
from cosim.systems.system import ComponentSpec, SystemSpec, write_system
from hesr.extras.ssp.contents import SystemContents
from hesr_model.errors import ArtifactError


def test_a_system_is_read_back(either: SystemContents, tmp_path: Path) -> None:
    path = write_system(either.system, tmp_path / "new" / "system.toml")
    assert SystemSpec.read(path) == either.system


def test_all_settings_of_a_system_are_written(tmp_path: Path) -> None:
    spec = SystemSpec(
        name='with "quotes", ä and \\',
        step=0.001,
        stop=0.1 + 0.2,
        order="jacobi",
        components=(
            ComponentSpec(
                name="a",
                fmu=tmp_path / "fmus" / "A b.fmu",
                start={"on": True, "count": 3, "mode": "fast", "h[1]": 0.1, "tau": (1e-9, 2.0)},
                step=0.002,
            ),
            ComponentSpec(name="b", fmu=tmp_path / "B.fmu"),
        ),
        connections={"a.u[1]": "b.y"},
        observe=("a.q",),
        limits={"a.q": ((-1.0, 1.0), (0.0, 2.0)), "b.y": (-1.0, 1.0)},
    )
    path = write_system(spec, tmp_path / "system.toml")
    assert SystemSpec.read(path) == spec
    assert 'fmu = "fmus/A b.fmu"' in path.read_text(encoding="utf-8")


def test_the_folder_can_be_moved(opened: SystemContents, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    components = []
    for component in opened.system.components:
        fmu = here / f"{component.name}.fmu"
        fmu.write_bytes(component.fmu.read_bytes())
        components.append(component.model_copy(update={"fmu": fmu}))
    spec = opened.system.model_copy(update={"components": tuple(components), "stop": 0.5})
    write_system(spec, here / "system.toml")
    here.rename(there)
    moved = SystemSpec.read(there / "system.toml")
    assert [c.fmu for c in moved.components] == [there / c.fmu.name for c in components]
    with Master(moved, there / "system.toml") as master:
        master.run().require_success()


def test_an_unwritable_file_is_reported(opened: SystemContents, tmp_path: Path) -> None:
    path = tmp_path / "folder"
    path.mkdir()
    with pytest.raises(ArtifactError, match=r"folder: cannot be written there \(Is a directory\)"):
        write_system(opened.system, path)
