"""The adaptive friction FMU: the equations of Python, with all memory in its state."""

import ctypes
import re
import subprocess
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adaptive_models import lugre, model, motion, stops
from binary import Binary
from c_hosts import build_host
from fmpy import read_model_description
from fmpy.validation import validate_fmu

from cosim.workflow.export import export
from fmu_src.check.run import check
from fmu_src.run.fmu import FmuInstance, build_mixed_buffer
from hesr.extras.adaptive.monitor import Follower
from hesr_model.errors import ExportError, SimulationError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.thermal import Thermal
from hesr_model.laws.stribeck import Stribeck
from hesr_model.rigid_body.friction_record import FrictionRecord

WARM = Thermal(coulomb=0.004, viscous=0.02, resistance=0.5, time_constant=30.0)
MODEL = replace(model(lugre(), stops(), lugre()), thermal=(WARM,) * 3)
OUTPUTS = ("tau", "level", "viscosity", "offset", "level_sd", "viscosity_sd", "offset_sd", "drift",
           "shift", "health")  # fmt: skip


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(MODEL, tmp_path_factory.mktemp("adaptive") / "Adaptive.fmu", format="adaptive")


@pytest.fixture(scope="module")
def records() -> list[FrictionRecord]:
    """Random torques around changed friction, with a collision and a rest."""
    found, rng = [], np.random.default_rng(5)
    for k, joint in enumerate(MODEL.joints):
        t, dq, q, load = motion(8.0, seed=k)
        dq = np.where((t > 3.0) & (t < 4.0), 0.0, dq)
        tau = 15.0 * np.tanh(dq / 0.01) + 11.0 * dq + rng.normal(size=len(t))
        tau[(t > 5.0) & (t < 5.2)] += 60.0
        found.append(
            FrictionRecord(
                log="one",
                joint=joint,
                t=t,
                dq=dq,
                q=q,
                tau_load=load,
                tau=tau,
                # The last joint has no thermometer: its own friction heats it.
                temperature=None if k == 2 else 20.0 + 3.0 * t,
            )
        )
    return found


class Bench:
    """An FMU that receives the rows of records."""

    def __init__(self, fmu: FmuInstance, records: list[FrictionRecord]) -> None:
        self.fmu, self.records = fmu, records
        joints = range(1, len(records) + 1)
        self.outputs = [f"{name}[{i}]" for name in OUTPUTS for i in joints]

    def inputs(self, row: int) -> dict[str, float]:
        found = {"adapt": 1.0}
        for i, r in enumerate(self.records, start=1):
            values = {"dq": r.dq, "q": r.q, "tau_load": r.tau_load, "tau_rigid": r.tau_load,
                      "tau_meas": r.tau + r.tau_load}  # fmt: skip
            if r.temperature is not None:
                values["temperature"] = r.temperature
            found |= {f"{name}[{i}]": float(column[row]) for name, column in values.items()}
        return found

    def begin(self) -> None:
        read = {
            f"joint[{i}].thermometer": float(r.temperature is not None)
            for i, r in enumerate(self.records, start=1)
        }
        self.fmu.initialise(start=self.inputs(0) | read)

    def run(self, first: int, last: int) -> np.ndarray:
        rows = []
        for k in range(first, last):
            self.fmu.set(self.inputs(k))
            time = float(self.records[0].t[k - 1])
            self.fmu.step(time, float(self.records[0].t[k]) - time)
            rows.append(build_mixed_buffer(self.fmu, self.outputs).read())
        return np.array(rows)


@pytest.fixture
def bench(fmu: Path, records: list[FrictionRecord]) -> Iterator[Bench]:
    with FmuInstance(fmu) as component:
        yield Bench(component, records)


def test_the_fmu_matches_the_python_estimate(bench: Bench, records: list[FrictionRecord]) -> None:
    bench.begin()
    found = bench.run(1, len(records[0].t))
    followed = Follower(MODEL).follow(records)
    for i, joint in enumerate(followed):
        for k, name in enumerate(OUTPUTS):
            expected = joint.outputs[name][1:]
            worst = np.abs(found[:, k * len(records) + i] - expected).max()
            assert worst <= 1e-12 * max(1.0, float(np.abs(expected).max())), name
    assert len(np.unique(found[:, 2 * len(records) :])) > 100


def test_fmi_3_has_arrays_of_integers_and_booleans(
    fmu: Path, records: list[FrictionRecord], tmp_path: Path
) -> None:
    other = export(MODEL, tmp_path / "Adaptive.fmu", format="adaptive", fmi=3)
    found = {v.name: v for v in read_model_description(other).modelVariables}
    assert [found[n].type for n in ("drift", "shift", "health")] == ["Int32"] * 3
    assert (found["health"].shape, found["joint[3].thermometer"].type) == ((3,), "Boolean")
    rows = []
    for path in (fmu, other):
        with FmuInstance(path) as component:
            bench = Bench(component, records)
            bench.begin()
            rows.append(bench.run(1, 600))
    np.testing.assert_array_equal(*rows)
    health = rows[0][:, -3:]
    assert {0.0, 2.0, 4.0} <= set(np.unique(health))


@pytest.mark.ci
def test_the_fmu_is_valid(fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []
    assert check(fmu).problems == ()
    description = read_model_description(fmu)
    assert description.modelExchange is None
    [adapt] = [v for v in description.modelVariables if v.name == "adapt"]
    assert (adapt.type, adapt.variability, adapt.start) == ("Boolean", "discrete", "true")
    assert {v.name for v in description.modelVariables if v.causality == "input"} == {
        "adapt", *(f"{n}[{i}]" for n in ("dq", "q", "tau_load", "tau_meas", "tau_rigid",
                                         "temperature")
                   for i in (1, 2, 3))
    }  # fmt: skip


def test_as_many_logical_values_are_set_as_are_given(
    fmu: Path, load: Callable[[Path], Binary]
) -> None:
    binary = load(fmu)
    c = binary.instantiate()
    assert binary("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == 0
    assert binary("EnterInitializationMode", c) == 0
    twice = (ctypes.c_uint * 2)(*[binary.vr["adapt"]] * 2)
    values, found = (ctypes.c_int * 2)(0, 1), (ctypes.c_int * 1)(1)
    assert binary("SetBoolean", c, twice, 1, values) == 0
    assert binary("GetBoolean", c, twice, 1, found) == 0
    assert found[0] == 0


def test_temperature_is_in_its_unit(fmu: Path) -> None:
    description = read_model_description(fmu)
    [unit] = [u for u in description.unitDefinitions if u.name == "degC"]
    assert (unit.baseUnit.K, unit.baseUnit.offset) == (1, 273.15)
    found = {v.name: v for v in description.modelVariables}
    assert (found["temperature[1]"].unit, found["temperature[1]"].start) == ("degC", "20.0")
    assert found["joint[1].thermometer"].start == "true"
    assert found["rise[1]"].unit == "K"


def test_temperature_from_friction_is_a_state(bench: Bench) -> None:
    bench.begin()
    bench.run(1, 300)
    heated = bench.fmu.get([f"rise[{i}]" for i in (1, 2, 3)])
    assert np.all((heated > 0.1) & (heated < 10.0))


@pytest.mark.soak
def test_cost_of_a_step_is_limited(fmu: Path, tmp_path: Path) -> None:
    """The target is 1 us for three joints including access to variables, and 4 KiB per instance."""
    description = read_model_description(fmu)
    places = {v.name: v.valueReference for v in description.modelVariables}
    with zipfile.ZipFile(fmu) as archive:
        [name] = [n for n in archive.namelist() if n.endswith(".so")]
        library = tmp_path / "library.so"
        library.write_bytes(archive.read(name))
    found = subprocess.run(
        [
            build_host("adaptive_host.c", tmp_path),
            library,
            description.guid,
            "3",
            *(str(places[f"{n}[1]"]) for n in ("tau_meas", "tau_rigid", "tau")),
            "20000",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    step, whole, size = found.stdout.split()
    # A soak test prints its measurements.
    print(f"three joints: {step} ns a step, {whole} ns with inputs and outputs, {size} B")  # noqa: T201
    assert int(size) <= 4 * 1024


def test_a_reset_instance_starts_afresh(bench: Bench) -> None:
    bench.begin()
    first = bench.run(1, 300)
    bench.fmu.reset()
    bench.begin()
    assert np.array_equal(bench.run(1, 300), first)


def test_instances_are_independent(fmu: Path, records: list[FrictionRecord]) -> None:
    with FmuInstance(fmu, name="a") as a, FmuInstance(fmu, name="b") as b:
        one, other = Bench(a, records), Bench(b, records[::-1])
        one.begin()
        other.begin()
        alone = one.run(1, 200)
        a.reset()
        one.begin()
        first = one.run(1, 100)
        assert not np.array_equal(other.run(1, 200), alone)
        assert np.array_equal(np.concatenate([first, one.run(100, 200)]), alone)


def test_a_saved_state_resumes_bit_for_bit(bench: Bench) -> None:
    """The state and its bytes include everything learned."""
    bench.begin()
    bench.run(1, 300)
    slave = bench.fmu._instance.slave
    state = ctypes.c_void_p()
    slave.fmi2GetFMUstate(slave.component, ctypes.byref(state))
    size = ctypes.c_size_t()
    slave.fmi2SerializedFMUstateSize(slave.component, state, ctypes.byref(size))
    assert size.value <= 4 * 1024
    data = ctypes.create_string_buffer(size.value)
    slave.fmi2SerializeFMUstate(slave.component, state, data, size)
    first = bench.run(300, 500)
    restored = ctypes.c_void_p()
    slave.fmi2DeSerializeFMUstate(slave.component, data, size, ctypes.byref(restored))
    slave.fmi2SetFMUstate(slave.component, restored)
    assert np.array_equal(bench.run(300, 500), first)


def test_non_finite_inputs_are_refused(bench: Bench) -> None:
    bench.begin()
    with pytest.raises(SimulationError, match="tau_meas"):
        bench.fmu.set({"tau_meas[1]": np.nan})


def test_after_an_error_numbers_that_are_not_finite_are_refused(bench: Bench) -> None:
    bench.fmu.initialise(start=bench.inputs(0))

    def overflow() -> None:
        for k in range(20):
            bench.fmu.set({"dq[1]": 1e300 * (-1) ** k, "tau_load[1]": 1e308, "tau_meas[1]": -1e308})
            bench.fmu.step(0.005 * k, 0.005)

    with pytest.raises(SimulationError) as raised:
        overflow()
    (bad,) = re.findall(r"(\S+) became -?(?:inf|nan)", str(raised.value))
    assert np.isfinite(bench.fmu.get(["dq[1]"])).all()
    with pytest.raises(SimulationError) as raised:
        bench.fmu.get([bad])
    assert f"{bad} became" in str(raised.value)


def test_a_law_without_bounds_leaves_no_file(tmp_path: Path) -> None:
    values = {"F_c": 1.0, "F_s": 1.0, "v_s": 0.1, "sigma_2": 1.0, "tau_0": 0.0}
    law = FrictionLaw(name="stribeck", form=Stribeck.form({}), values=values)
    with pytest.raises(ExportError, match="has neither stops nor bristles"):
        export(model(law), tmp_path / "Static.fmu", format="adaptive")
    assert not list(tmp_path.iterdir())
