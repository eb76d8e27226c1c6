"""Containers of FMUs of other tools against the same FMUs coupled one by one."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from couplings import refreshed
from fmpy import simulate_fmu
from pythonfmu.builder import FmuBuilder

from cosim.systems.system import ComponentSpec, SystemSpec
from fmu_src.run.archive import Archive
from fmu_src.run.fmu import FmuInstance
from hesr.extras.ssp.container import write_container
from hesr.extras.ssp.contents import read_contents
from hesr_model.errors import ConfigError


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


@pytest.mark.ci
def test_connections_of_every_type_pass_values(typed_fmu: Path, tmp_path: Path) -> None:
    start = {"r": 1.5, "i": 3, "b": True, "s": "text", "gain": 2.0}
    quiet = {"r": 0.0, "i": 0, "b": False, "s": "", "gain": 1.0}
    spec = SystemSpec(
        step=0.05,
        stop=1.0,
        components=(
            ComponentSpec(name="a", fmu=typed_fmu, start=start),
            ComponentSpec(name="b", fmu=typed_fmu, start=quiet),
        ),
        connections={f"b.{kind}": f"a.{kind}o" for kind in "ribs"},
        observe=tuple(f"b.{kind}o" for kind in "ribs"),
    )
    path = write_container(read_contents(spec, tmp_path / "system.toml"), tmp_path / "Loop.fmu")
    run = simulate_fmu(str(path), stop_time=1.0, output_interval=0.05, output=spec.observe[:3])
    assert list(run[-1])[1:] == [3.0, 3, True]


def test_an_integer_is_not_connected_to_a_real_input(typed_fmu: Path, tmp_path: Path) -> None:
    spec = SystemSpec(
        step=0.05,
        stop=1.0,
        components=tuple(
            ComponentSpec(name=n, fmu=typed_fmu, start={"i": 0, "b": False, "s": "", "r": 0.0})
            for n in "ab"
        ),
        connections={"b.r": "a.io"},
        observe=("b.ro",),
    )
    contents = read_contents(spec, tmp_path / "system.toml")
    wanted = r"connection of 'b.r': FMPy's container runtime does not connect Integer and Real\."
    with pytest.raises(ConfigError, match=wanted):
        write_container(contents, tmp_path / "Loop.fmu")
    assert not (tmp_path / "Loop.fmu").exists()


@pytest.mark.ci
def test_an_fmu_of_sources_is_built(table1_fmu: Path, tmp_path: Path) -> None:
    bare = tmp_path / "Sources.fmu"
    with Archive(table1_fmu) as old, zipfile.ZipFile(bare, "w") as new:
        for name in old.names:
            if not name.startswith("binaries/"):
                new.writestr(name, old.read(name))
    start = {f"{name}[{i}]": 0.1 * i for name in ("dq", "q", "tau_load") for i in (1, 2, 3)}
    spec = SystemSpec(
        step=0.005,
        stop=1.0,
        components=(ComponentSpec(name="f", fmu=bare, start=start),),
        connections={},
        observe=("f.tau[1]", "f.tau[2]"),
    )
    path = write_container(read_contents(spec, tmp_path / "system.toml"), tmp_path / "Loop.fmu")
    with FmuInstance(path) as inside, FmuInstance(table1_fmu) as alone:
        inside.initialise()
        alone.initialise(start=start)
        for k in range(5):
            inside.step(0.005 * k, 0.005)
            alone.step(0.005 * k, 0.005)
        # The sources are built without our flags for contractions.
        expected = alone.get(["tau[1]", "tau[2]"])
        np.testing.assert_allclose(inside.get(spec.observe), expected, rtol=1e-12)
