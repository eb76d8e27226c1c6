"""Objects of `import hesr` for FMUs, systems and signals."""

import doctest
import gc
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from small_fmus import LAGS

import hesr
from fmu_src.run.trust import is_trusted
from hesr.extras.ssp.contents import read_contents
from hesr.extras.ssp.ssp import write_ssp
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.logs.tables import read_table


@pytest.fixture
def system(tmp_path: Path, lag_fmu: Path) -> Path:
    """Return a system of two lags, called ``loop.toml``."""
    path = tmp_path / "loop.toml"
    path.write_text(LAGS.replace("FMU", str(lag_fmu)), encoding="utf-8")
    return path


@pytest.fixture
def foreign(tmp_path: Path, lag_fmu: Path) -> Path:
    """Return a foreign lag: its hash is changed."""
    path = tmp_path / "Foreign.fmu"
    path.write_bytes(lag_fmu.read_bytes() + b"\0")
    return path


@pytest.mark.parametrize("name", ["Fmu", "System", "Signals", "simulate"])
def test_the_docstring_examples_run(
    name: str, system: Path, friction_fmu: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(system.parent)
    Path("Friction.fmu").symlink_to(friction_fmu)
    examples = doctest.DocTestFinder(recurse=False).find(getattr(hesr, name), name)
    tried = [doctest.DocTestRunner().run(example) for example in examples]
    assert sum(one.attempted for one in tried) > 1
    assert not any(one.failed for one in tried)


# --- FMUs -------------------------------------------------------------------------------------


def test_an_fmu_gives_typed_variables_and_its_model(friction_fmu: Path, lag_fmu: Path) -> None:
    fmu = hesr.Fmu(friction_fmu)
    assert repr(fmu) == f"Fmu('{friction_fmu}', FMI 2.0, {len(fmu.variables)} variables)"
    speed = fmu.variables["dq[1]"]
    assert (speed.type, speed.causality, speed.unit) == ("Real", "input", "rad/s")
    assert fmu.model is not None
    assert fmu.model.law == "parfam_h"
    html = fmu._repr_html_()
    assert all(name in html for name in fmu.variables)
    lag = hesr.Fmu(str(lag_fmu))
    assert lag.model is None
    assert lag.variables["T"].start == "0.5"
    assert os.fspath(lag) == str(lag_fmu)


def test_an_fmu_replays_a_log_as_its_model_predicts(friction_fmu: Path) -> None:
    t = 0.005 * np.arange(400)
    dq = np.column_stack([np.sin(t), np.cos(2 * t), -np.sin(3 * t)])
    fmu = hesr.Fmu(friction_fmu)
    assert fmu.model is not None
    expected = fmu.model.predict(t=t, dq=dq)
    error = np.abs(fmu.replay(t=t, dq=dq) - expected).max(axis=0)
    assert np.all(error <= 1e-12 * np.abs(expected).max(axis=0))
    with pytest.raises(SimulationError, match="'tau_load' has the shape"):
        fmu.replay(t=t, dq=dq, tau_load=dq[:, :1])


def test_an_fmu_is_accepted_as_a_path(friction_fmu: Path) -> None:
    fmu = hesr.Fmu(friction_fmu)
    assert hesr.check(fmu).passed
    assert [law.fmu for law in hesr.test(fmu).laws] == [friction_fmu]


@pytest.mark.parametrize("trust", [False, True])
def test_an_instance_is_freed_on_every_exit(
    foreign: Path, empty_cache: Path, trust: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = empty_cache / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    fmu = hesr.Fmu(foreign, trust=trust)
    assert is_trusted(foreign) is trust
    with fmu.instance() as lag:
        lag.initialise(start={"u": 2.0, "x_start": 0.25})
        lag.step(0.0, 0.5)
        assert lag.get(["y"]) == pytest.approx([2.0 - 1.75 * np.exp(-1.0)])
        assert list(temporary.iterdir())
    assert list(temporary.iterdir()) == []
    with (
        pytest.raises(SimulationError, match="T is -1 s; it must be positive"),
        fmu.instance() as lag,
    ):
        lag.initialise(start={"T": -1.0})
    assert list(temporary.iterdir()) == []


def test_files_other_than_fmus_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match=r"none\.fmu: no such file\.$"):
        hesr.Fmu(tmp_path / "none.fmu", trust=True)
    with pytest.raises(ConfigError, match="an FMU is given as int; expected a path"):
        hesr.Fmu(3)  # type: ignore[arg-type]  # the mistake


# --- systems ----------------------------------------------------------------------------------


def test_a_system_returns_signals(system: Path, tmp_path: Path) -> None:
    read = hesr.System.read(str(system))
    assert repr(read) == "System('lags', 2 components, 1 s in steps of 0.1 s)"
    signals = read.run()
    assert repr(signals) == "Signals(2 signals, 11 samples to 1 s)"
    a = signals.signals["a.y"]
    np.testing.assert_allclose(a, 2.0 - 1.75 * np.exp(-signals.t / 0.5), rtol=1e-12)
    assert "a.y" in signals._repr_html_()
    frame = signals.to_pandas()
    pd.testing.assert_index_equal(frame.index, pd.Index(signals.t, name="t"))
    np.testing.assert_array_equal(frame["a.y"], a)
    signals.write(str(tmp_path / "signals.csv"))
    table = read_table(tmp_path / "signals.csv")
    assert table.names == ("t", "a.y", "b.y")
    np.testing.assert_array_equal(table.numbers(["a.y"])[:, 0], a)


def test_simulate_gives_the_same_signals(system: Path, tmp_path: Path) -> None:
    expected = hesr.System.read(system).run()
    for found in (hesr.simulate(system), hesr.simulate(system, output=tmp_path / "signals.csv")):
        assert isinstance(found, hesr.Signals)
        for name, values in expected.signals.items():
            np.testing.assert_array_equal(found.signals[name], values)


def test_the_fmus_of_an_ssp_live_as_long_as_the_system(
    system: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = hesr.System.read(system)
    ssp = write_ssp(read_contents(read.spec, system), tmp_path / "lags.ssp")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    opened = hesr.System.read(ssp)
    for _ in range(2):
        found = opened.run()
        for name, values in read.run().signals.items():
            np.testing.assert_array_equal(found.signals[name], values)
    assert list(temporary.iterdir())
    del opened
    gc.collect()
    assert list(temporary.iterdir()) == []


def test_a_failure_is_raised(system: Path) -> None:
    text = system.read_text(encoding="utf-8").replace("u = 2.0", "u = 2.0, refused = 0.45")
    system.write_text(text, encoding="utf-8")
    with pytest.raises(SimulationError, match=r"^Lag\.fmu \('a'\) at t = 0\.4 s: The step passes"):
        hesr.System.read(system).run()
    with pytest.raises(ConfigError, match=r"loop\.csv: no such file\.$"):
        hesr.System.read(system.with_suffix(".csv"))
