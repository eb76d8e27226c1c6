"""Containers of FMUs of other tools against the same FMUs coupled one by one."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from couplings import refreshed
from pythonfmu.builder import FmuBuilder

from cosim.systems.container import write_container
from cosim.systems.contents import read_contents
from cosim.systems.system import ComponentSpec, SystemSpec
from fmu_src.run.archive import Archive
from fmu_src.run.fmu import FmuInstance


@pytest.fixture(scope="session")
def typed_fmu(shared: Any) -> Path:
    """A PythonFMU, with Python files as resources."""
    slave = Path(__file__).parents[1] / "typed_slave.py"
    made: Path = shared("typed", lambda folder: FmuBuilder.build_FMU(slave, dest=folder))
    return made / "Typed.fmu"


@pytest.mark.ci
def test_three_fmus_of_two_tools_equal_the_separate_run(
    typed_fmu: Path, lag_fmu: Path, tmp_path: Path
) -> None:
    bare = tmp_path / "Bare.fmu"
    with Archive(lag_fmu) as old, zipfile.ZipFile(bare, "w") as new:
        for name in old.names:
            if not name.startswith("resources/"):
                new.writestr(name, old.read(name))
    quiet = {"i": 0, "b": False, "s": ""}
    spec = SystemSpec(
        step=0.05,
        stop=1.0,
        components=(
            ComponentSpec(name="a", fmu=typed_fmu, start={"r": 1.5, "gain": 2.0, **quiet}),
            ComponentSpec(name="b", fmu=bare),
            ComponentSpec(name="c", fmu=typed_fmu, start={"gain": -3.0, **quiet}),
        ),
        connections={"b.u": "a.ro", "c.r": "b.y"},
        observe=("a.ro", "b.y", "c.ro"),
    )
    contents = read_contents(spec, tmp_path / "system.toml")
    path = write_container(contents, tmp_path / "Loop.fmu")
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    for component in "abc":  # the runtime passes NULL for a missing folder
        assert any(name.startswith(f"resources/{component}/resources/") for name in names)
    expected = refreshed(contents, contents.wiring.observed, 20)
    with FmuInstance(path) as fmu:
        fmu.initialise()
        rows = [fmu.get(spec.observe)]
        for k in range(20):
            fmu.step(k * 0.05, 0.05)
            rows.append(fmu.get(spec.observe))
    np.testing.assert_allclose(np.array(rows), expected, rtol=1e-12, atol=1e-15)
    assert np.ptp(expected[:, 2]) > 1.0
