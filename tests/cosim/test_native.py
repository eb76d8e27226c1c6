"""The stepping loop in C compared with Python: same calls, so the same bits and messages."""

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from closed_loop import Bench

import fmu_src.run.native
from cosim.loop.closed_loop import Scheme
from cosim.systems.signals import Signals
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec
from fmu_src.arm.python_arm.export import export_python_arm
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.master import PythonStepper
from fmu_src.run.native import NativeStepper, _is_supported, step_rows
from hesr_model.errors import ExportError, SimulationError
from hesr_model.support.files import models_folder


def both(spec: SystemSpec, runs: int = 1) -> tuple[Signals, Signals]:
    """The last of several runs in C and Python."""
    found = []
    for native, kind in ((True, NativeStepper), (False, PythonStepper)):
        with Master(spec, native=native) as master:
            assert type(master._stepper) is kind
            found.append([master.run() for _ in range(runs)][-1])
    return found[0], found[1]


def assert_same(one: Signals, other: Signals) -> None:
    assert one.t.tobytes() == other.t.tobytes()
    assert one.signals.keys() == other.signals.keys()
    for name, values in one.signals.items():
        assert values.tobytes() == other.signals[name].tobytes(), name
    assert str(one.failure) == str(other.failure)


def lags(fmu: Path, **more: object) -> SystemSpec:
    """Two lags of different rates in a loop."""
    data = {
        "step": 0.1,
        "stop": 60.0,
        "components": [
            {"name": "a", "fmu": fmu, "start": {"T": 0.5, "x_start": 0.25}},
            {"name": "b", "fmu": fmu, "start": {"T": 2.0, "x_start": 1.0}, "step": 0.3},
        ],
        "connections": {"a.u": "b.y", "b.u": "a.y"},
        "observe": ["b.y", "a.y"],
    }
    return SystemSpec.model_validate(data | more)


@pytest.mark.parametrize("order", ["gauss_seidel", "jacobi"])
def test_components_of_different_rates_agree(lag_fmu, order):
    one, other = both(lags(lag_fmu, order=order), runs=2)
    assert one.failure is None
    assert len(one.t) == 601
    assert np.ptp(one.signals["a.y"]) > 0.1
    assert_same(one, other)


def test_call_orders_differ(lag_fmu):
    one, other = (both(lags(lag_fmu, order=order))[0] for order in ("gauss_seidel", "jacobi"))
    assert np.abs(one.signals["b.y"] - other.signals["b.y"]).max() > 1e-3


@pytest.mark.parametrize("names", [("a.y", "b.y"), ("b.y", "a.y")])
def test_limits_agree(lag_fmu, names):
    limits = {"b.y": (0.5, 1.5), "a.y": (0.2, 0.6)}
    one, other = both(lags(lag_fmu, limits={name: limits[name] for name in names}))
    assert "a.y is 0." in str(one.failure)
    assert "outside its limits 0.2 to 0.6." in str(one.failure)
    assert_same(one, other)


@pytest.mark.parametrize("order", ["gauss_seidel", "jacobi"])
@pytest.mark.parametrize("component", [0, 1])
def test_a_failed_step_gives_the_same_error(lag_fmu, order, component):
    spec = lags(lag_fmu, order=order)
    spec.components[component].start["refused"] = 25.0
    one, other = both(spec)
    assert "at t = 2" in str(one.failure)
    assert_same(one, other)


def test_a_silent_failure_names_its_function_and_status(lag_fmu, monkeypatch):
    """Many FMUs log nothing."""
    monkeypatch.setattr(FmuInstance, "_log", lambda *_: None)
    spec = lags(lag_fmu)
    spec.components[0].start["refused"] = 25.0
    one, other = both(spec)
    assert "fmi2DoStep failed with status 2" in str(one.failure)
    assert_same(one, other)


def test_a_refused_input_gives_the_same_error(lag_fmu):
    """A value near the largest double overflows on its way."""
    start = {"T": 1e-3, "x_start": 1.7e308, "u": -1.7e308}
    spec = lags(
        lag_fmu,
        components=[
            {"name": "a", "fmu": lag_fmu, "start": start},
            {"name": "b", "fmu": lag_fmu},
        ],
        connections={"b.u": "a.y"},
    )
    one, other = both(spec)
    assert one.failure is not None
    assert_same(one, other)


@pytest.mark.parametrize("source", ["desired", "filtered"])
def test_the_default_closed_loop_agrees(bench: Bench, source):
    loop = bench.loop(Scheme(compensation="servo_inversion", Kx=5.0, source=source), stop=2.0)
    one, other = both(bench.system(loop))
    assert one.failure is None
    assert_same(one, other)


def test_a_python_fmu_is_also_stepped_in_c(bench: Bench, tmp_path):
    folder = models_folder() / "uf850"
    arm = export_python_arm(folder / "uf850.xml", folder / "arm.toml", tmp_path / "Arm.fmu")
    mixed = replace(bench, fmus=replace(bench.fmus, arm=arm))
    one, other = both(mixed.system(bench.loop(Scheme(compensation="none"), stop=0.1)))
    assert_same(one, other)


def test_a_foreign_fmu_stays_in_its_process_and_is_stepped_in_python(lag_fmu, tmp_path):
    """An FMU that was not exported here: one changed byte makes it foreign."""
    foreign = tmp_path / "Lag.fmu"
    shutil.copy(lag_fmu, foreign)
    with zipfile.ZipFile(foreign, "a") as archive:
        archive.writestr("documentation/changed.txt", "by somebody")
    spec = lags(lag_fmu, stop=1.2)
    moved = spec.model_copy(
        update={
            "components": (
                spec.components[0].model_copy(update={"fmu": foreign}),
                spec.components[1],
            )
        }
    )
    with Master(moved) as master, Master(spec) as own:
        assert type(master._stepper) is PythonStepper
        assert_same(master.run().require_success(), own.run())


def test_python_steps_are_the_fallback_without_a_compiler(lag_fmu, monkeypatch, caplog):
    def refused(*_: object) -> bytes:
        raise ExportError("the C compiler cannot be run.")

    monkeypatch.setattr("fmu_src.export.toolchain.build", refused)
    fmu_src.run.native._library.cache_clear()
    with caplog.at_level("INFO"), Master(lags(lag_fmu)) as master:
        assert type(master._stepper) is PythonStepper
    assert "systems are stepped in Python (the C compiler cannot be run.)" in caplog.text
    fmu_src.run.native._library.cache_clear()


def rows_of_a_lag(fmu: Path, refused: float, count: int) -> tuple[bytes, str, float]:
    """Outputs, failure and time of a lag stepped through uneven rows."""
    sizes = np.tile([0.1, 0.25, 0.03], count)
    times = np.concatenate([[0.0], np.cumsum(sizes)[:-1]])
    with FmuInstance(fmu) as component:
        inputs, outputs = component.buffer(["u"]), component.buffer(["y", "x"])
        component.initialise(start={"T": 0.5, "refused": refused})
        try:
            found = step_rows(component, inputs, outputs, times, sizes, np.sin(times)[:, None])
        except SimulationError as error:
            return b"", str(error), component.time
        assert np.ptp(found[:, 0]) > 0.1
        assert found[:, 0].tobytes() == found[:, 1].tobytes()
        return found.tobytes(), "", component.time


@pytest.mark.parametrize("refused", [1e9, 5.0])
def test_rows_are_stepped_as_in_python(lag_fmu, refused, monkeypatch):
    own = rows_of_a_lag(lag_fmu, refused, 40)
    assert ("where it is refused" in own[1]) == (refused < 10.0)
    monkeypatch.setattr(fmu_src.run.native, "_library", lambda: None)
    assert rows_of_a_lag(lag_fmu, refused, 40) == own


def test_signals_are_handled_between_many_rows(lag_fmu, monkeypatch):
    whole = rows_of_a_lag(lag_fmu, 1e9, 40)
    monkeypatch.setattr(fmu_src.run.native, "_ROWS_PER_CALL", 7)
    assert rows_of_a_lag(lag_fmu, 1e9, 40) == whole


def test_a_refused_input_ends_the_rows(lag_fmu, monkeypatch):
    """NaN is refused when it is set, after the rows before it."""

    def found() -> tuple[str, float]:
        with FmuInstance(lag_fmu) as component:
            inputs, outputs = component.buffer(["u"]), component.buffer(["y"])
            component.initialise()
            rows = np.array([[1.0], [1.0], [np.nan], [1.0]])
            with pytest.raises(SimulationError) as error:
                step_rows(component, inputs, outputs, np.arange(4.0), np.ones(4), rows)
            return str(error.value), component.time

    own = found()
    assert own[1] == 2.0
    monkeypatch.setattr(fmu_src.run.native, "_library", lambda: None)
    assert found() == own


def test_steps_in_c_are_even_from_zero_with_held_outputs(lag_fmu: Path) -> None:
    with Master(lags(lag_fmu), native=True) as master:
        layout = master._layout
        assert _is_supported(layout)
        others = (
            {"begin": 0.5},
            {"times": np.array([0.0, 0.1, 0.3])},
            {"scheme": replace(layout.scheme, refreshed="all")},
        )
        for other in others:
            assert not _is_supported(replace(layout, **other))
