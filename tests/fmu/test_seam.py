"""The component interface suffices for other models than friction: forty lines of C and a table."""

import shutil
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from small_fmus import lag

from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import SimulationError


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return lag(tmp_path_factory.mktemp("lag"))


def expected(t):
    return 2.0 + (0.25 - 2.0) * np.exp(-t / 0.5)


def test_the_fmu_is_valid(fmu):
    assert validate_fmu(str(fmu)) == []


def test_co_simulation_is_right(fmu):
    with FmuInstance(fmu) as one:
        one.initialise(start={"u": 2.0})
        for k in range(50):
            assert one.get(["y"])[0] == pytest.approx(expected(0.01 * k), rel=1e-13, abs=0.0)
            one.step(0.01 * k, 0.01)


def test_model_exchange_is_right(fmu):
    result = fmpy.simulate_fmu(
        str(fmu),
        fmi_type="ModelExchange",
        stop_time=1.0,
        relative_tolerance=1e-9,
        start_values={"u": 2.0},
        output=["y"],
    )
    np.testing.assert_allclose(result["y"], expected(result["time"]), rtol=1e-7)


def test_a_failed_start_is_reported_with_a_reason(fmu):
    with (
        FmuInstance(fmu) as one,
        pytest.raises(SimulationError, match=r"T is -1 s; it must be positive"),
    ):
        one.initialise(start={"T": -1.0})


def test_flags_state_the_lack_of_derivatives(fmu):
    about = fmpy.read_model_description(str(fmu))
    assert about.modelExchange.providesDirectionalDerivative is False
    assert about.coSimulation.providesDirectionalDerivative is False


@pytest.mark.ci
@pytest.mark.skipif(
    shutil.which("gcc") is None or shutil.which("cmake") is None,
    reason="gcc and cmake, with which FMPy compiles sources, are not installed",
)
def test_an_importer_compiles_the_sources(fmu, tmp_path):
    own = Path(shutil.copy(fmu, tmp_path / "Lag.fmu"))
    subprocess.run([sys.executable, "-m", "fmpy", "compile", str(own)], check=True, cwd=tmp_path)
    assert own.read_bytes() != fmu.read_bytes()
    with FmuInstance(own) as one:
        one.initialise(start={"u": 2.0})
        one.step(0.0, 0.3)
        assert one.get(["y"])[0] == pytest.approx(expected(0.3), rel=1e-13, abs=0.0)
