"""Cost of a step of the adaptive FMU compared with the friction FMU of the same laws."""

from pathlib import Path

import pytest
from adaptive_models import lugre, model, stops
from pytest_benchmark.fixture import BenchmarkFixture

from fmu_src.export.package import write_fmu
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.run.fmu import FmuInstance
from hesr.extras.adaptive.monitor import adaptive_content

STEP = 0.005


@pytest.mark.parametrize("law", [lugre, stops])
@pytest.mark.parametrize("adaptive", [False, True])
def test_adaptive_step(law, adaptive: bool, tmp_path: Path, benchmark: BenchmarkFixture) -> None:
    """Target: at most 1 us more than the friction FMU for three joints, dominated by the call."""
    benchmark.group = f"doStep of three joints through FMPy, {law().name}"
    own = model(law(), law(), law())
    fmu = tmp_path / "Friction.fmu"
    if adaptive:
        write_fmu(adaptive_content(own), fmu)
    else:
        export_bare(own, fmu)
    with FmuInstance(fmu) as component:
        more = {"tau_meas[1]": 18.0} if adaptive else {}
        component.initialise(start={"dq[1]": 0.3, "dq[2]": -0.4, "dq[3]": 0.2} | more)
        step, instance = component._instance.slave.fmi2DoStep, component._instance.slave.component
        counter = iter(range(10**9))
        benchmark(lambda: step(instance, next(counter) * STEP, STEP, True))
        assert component.get(["tau[1]"])[0] != 0.0
