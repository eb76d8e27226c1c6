"""Cached FMUs: reused while their file is unchanged, freed after a failed call."""

import shutil
import tempfile

import numpy as np
import pytest
from small_fmus import LAGS

from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec
from fmu_src.run.fmu import FmuPool
from hesr_model.errors import SimulationError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Folder of extracted FMUs."""
    place = tmp_path / "extracted"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


@pytest.fixture
def loaded():
    kept = FmuPool(max_idle=2)
    yield kept
    kept.clear()


def test_an_fmu_is_reused_in_its_initial_state(lag_fmu, loaded):
    with loaded.lend(lag_fmu, name="a") as first:
        first.initialise(start={"u": 5.0, "T": 3.0})
        first.step(0.0, 0.5)
    with loaded.lend(lag_fmu, name="a") as again:
        assert again is first
        assert (again.used, again.time, again.messages) == (False, 0.0, [])
        again.initialise()
        assert again.get(["x", "T"]).tolist() == [0.25, 0.5]


def test_an_instance_has_one_user_at_a_time_and_its_own_name(lag_fmu, loaded, folder):
    with loaded.lend(lag_fmu, name="a") as one, loaded.lend(lag_fmu, name="a") as other:
        assert one is not other
    assert len(list(folder.iterdir())) == 1
    with loaded.lend(lag_fmu, name="b") as third:
        assert third.name == "b"


def test_an_fmu_is_freed_after_a_failed_call(lag_fmu, loaded, folder):
    with loaded.lend(lag_fmu, name="a") as first:
        first.initialise(start={"refused": 0.5})
        with pytest.raises(SimulationError):
            first.step(1.0, 0.5)
    assert not list(folder.iterdir())


def test_an_fmu_is_freed_after_an_error_of_its_user(lag_fmu, loaded, folder):
    with pytest.raises(KeyError), loaded.lend(lag_fmu, name="a"):
        raise KeyError
    assert not list(folder.iterdir())


def test_a_rewritten_file_is_reloaded(lag_fmu, loaded, tmp_path):
    copy = tmp_path / "Lag.fmu"
    shutil.copy(lag_fmu, copy)
    with loaded.lend(copy, name="a") as first:
        pass
    (tmp_path / "new.fmu").write_bytes(lag_fmu.read_bytes())
    (tmp_path / "new.fmu").replace(copy)
    with loaded.lend(copy, name="a") as second:
        assert second is not first


def test_the_cache_is_limited_and_can_be_cleared(lag_fmu, folder):
    kept = FmuPool(max_idle=2)
    for name in "abcd":
        with kept.lend(lag_fmu, name=name):
            pass
    assert len(list(folder.iterdir())) == 2
    kept.clear()
    assert not list(folder.iterdir())


def test_a_missing_file_gives_the_usual_error(tmp_path, loaded):
    with (
        pytest.raises(SimulationError, match=r"no\.fmu: no such file"),
        loaded.lend(tmp_path / "no.fmu", name="a"),
    ):
        pass


def test_cached_fmus_give_bitwise_equal_results(lag_fmu, tmp_path, loaded):
    path = tmp_path / "lags.toml"
    path.write_text(LAGS.replace("FMU", str(lag_fmu)), encoding="utf-8")
    spec = SystemSpec.read(path)
    with Master(spec, path) as master:
        fresh = master.run().require_success()
    for _ in range(2):
        with Master(spec, path, loaded=loaded) as master:
            kept = master.run().require_success()
        for name, values in fresh.signals.items():
            np.testing.assert_array_equal(kept.signals[name], values)
