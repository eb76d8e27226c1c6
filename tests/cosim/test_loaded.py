"""FMUs that stay loaded: taken again while their file stays the same, freed where a call failed."""

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
    """Where FMUs are extracted."""
    place = tmp_path / "extracted"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


@pytest.fixture
def loaded():
    kept = FmuPool(most=2)
    yield kept
    kept.clear()


def test_one_that_went_well_is_taken_again_as_new(lag_fmu, loaded):
    with loaded.lend(lag_fmu, name="a") as first:
        first.initialise(start={"u": 5.0, "T": 3.0})
        first.step(0.0, 0.5)
    with loaded.lend(lag_fmu, name="a") as again:
        assert again is first
        assert (again.used, again.time, again.messages) == (False, 0.0, [])
        again.initialise()
        assert again.get(["x", "T"]).tolist() == [0.25, 0.5]


def test_one_is_lent_once_at_a_time_and_under_its_own_name(lag_fmu, loaded, folder):
    with loaded.lend(lag_fmu, name="a") as one, loaded.lend(lag_fmu, name="a") as other:
        assert one is not other
    assert len(list(folder.iterdir())) == 1
    with loaded.lend(lag_fmu, name="b") as third:
        assert third.name == "b"


def test_one_whose_call_failed_is_freed(lag_fmu, loaded, folder):
    with loaded.lend(lag_fmu, name="a") as first:
        first.initialise(start={"refused": 0.5})
        with pytest.raises(SimulationError):
            first.step(1.0, 0.5)
    assert not list(folder.iterdir())


def test_one_in_whose_use_anything_failed_is_freed(lag_fmu, loaded, folder):
    with pytest.raises(KeyError), loaded.lend(lag_fmu, name="a"):
        raise KeyError
    assert not list(folder.iterdir())


def test_a_file_that_was_written_again_is_loaded_again(lag_fmu, loaded, tmp_path):
    copy = tmp_path / "Lag.fmu"
    shutil.copy(lag_fmu, copy)
    with loaded.lend(copy, name="a") as first:
        pass
    (tmp_path / "new.fmu").write_bytes(lag_fmu.read_bytes())
    (tmp_path / "new.fmu").replace(copy)
    with loaded.lend(copy, name="a") as second:
        assert second is not first


def test_so_many_are_kept_and_all_can_be_freed(lag_fmu, folder):
    kept = FmuPool(most=2)
    for name in "abcd":
        with kept.lend(lag_fmu, name=name):
            pass
    assert len(list(folder.iterdir())) == 2
    kept.clear()
    assert not list(folder.iterdir())


def test_a_file_that_is_missing_is_said_as_ever(tmp_path, loaded):
    with (
        pytest.raises(SimulationError, match=r"no\.fmu: no such file"),
        loaded.lend(tmp_path / "no.fmu", name="a"),
    ):
        pass


def test_a_system_gives_the_same_bits_from_kept_fmus(lag_fmu, tmp_path, loaded):
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
