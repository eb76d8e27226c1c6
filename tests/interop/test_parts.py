"""Parts of the comparison, each tested without an engine."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import lugre, system
from interop.case import Alone, Case, Run, Together, deviation
from interop.control import controls
from interop.drive import driven
from interop.engine import Engine, SkippedError, Tools, describe
from interop.engines import ENGINES
from interop.matrix import compare, control_faults
from interop.reference import alone, together
from interop.table import notes, table
from small_fmus import lag

from cosim.systems.simulation import Master
from cosim.systems.system import ComponentSpec, SystemSpec, write_system
from fmu_src import export_fmu
from fmu_src.blocks.trajectory import trajectory
from fmu_src.export.package import write_fmu
from fmu_src.export.toolchain import TARGETS, build
from fmu_src.run.master import ExchangeScheme
from hesr_model.errors import SimulationError
from hesr_model.friction.predict import predict
from hesr_model.support.process import FailedError


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Alone:
    return driven(lag(tmp_path_factory.mktemp("lag")), name="lag")


def engine(run: Any, **more: Any) -> Engine:
    """An engine in this process."""
    return Engine(name="made up", install="take another", find=lambda _: "1", alone=run, **more)


def test_one_fmu_is_driven_like_the_law_in_python(tmp_path: Path) -> None:
    """The input of row k is held over the next step, so a log is one row later."""
    model = lugre()
    case = driven(export_fmu(model, tmp_path / "LuGre.fmu"))
    dq = case.inputs["dq[1]"]
    later = np.concatenate([dq[:1], dq[:-1]])
    expected = predict(model.laws[0], t=case.times, dq=later)
    found = alone(case)["tau[1]"]
    assert np.abs(dq).max() == pytest.approx(0.5, rel=1e-3)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_inputs_stay_within_their_limits_and_skip_given_ones(small: Alone) -> None:
    assert set(small.inputs) == {"u"}
    assert (small.step, small.steps, small.stop) == (0.01, 200, 2.0)
    assert set(driven(small.fmu, start={"u": 1.0}).inputs) == set()


def test_enumerations_are_integers_with_names(tmp_path: Path) -> None:
    """Maestro loads no FMU with an Enumeration, and libcosim cannot set one."""
    fmu = write_fmu(trajectory(1), tmp_path / "Trajectory.fmu")
    assert driven(fmu, start={"kind": "sweep"}).start == {"kind": 3.0}
    assert driven(fmu, start={"kind": 2}).start == {"kind": 2.0}
    with pytest.raises(
        SimulationError, match="'kind' cannot be 'fast'; it must be one of fourier, sine, sweep"
    ):
        driven(fmu, start={"kind": "fast"})


@pytest.mark.parametrize("refreshed", ["none", "shown"])
def test_systems_are_coupled_like_by_our_master(cases: dict[str, Case], refreshed: Any) -> None:
    """Outputs updated for new inputs change nothing else."""
    case = cases["closed"]
    assert isinstance(case, Together)
    changes = {"stop": 0.5, "order": "jacobi", "observe": tuple(case.signals)}
    spec = case.spec.model_copy(update=changes)
    found = together(replace(case, spec=spec), ExchangeScheme(refreshed=refreshed))
    with Master(spec) as master:
        expected = master.run().require_success().signals
    assert set(found) == set(expected)
    same = {name for name in expected if np.array_equal(found[name], expected[name])}
    held = {name for name in found if name.startswith(("arm.", "trajectory."))}
    assert same == set(expected) if refreshed == "none" else held <= same < set(expected)


def test_exchange_schemes_differ_by_far_more_than_the_tolerance(cases: dict[str, Case]) -> None:
    case = cases["closed"]
    assert isinstance(case, Together)
    short = replace(case, spec=case.spec.model_copy(update={"stop": 1.0}))
    ways = [
        ExchangeScheme(),
        ExchangeScheme(first="zero"),
        ExchangeScheme(refreshed="shown"),
        ExchangeScheme(refreshed="all"),
    ]
    found = [together(short, way) for way in ways]
    for i, one in enumerate(found):
        for other in found[:i]:
            assert deviation(Run(signals=one), other) > 1e3 * case.tolerance
    assert [describe(way) for way in ways] == [
        "Jacobi",
        "Jacobi, first inputs zero",
        "Jacobi, outputs of new inputs shown",
        "Jacobi, outputs of new inputs",
    ]


def test_deviations_are_relative_to_the_largest_value() -> None:
    expected = {"a[1]": np.array([0.0, 2.0, -4.0]), "a[2]": np.zeros(3), "b": np.zeros(3)}
    off = {"a[1]": np.array([0.0, 2.0, -4.0]), "a[2]": np.full(3, 1e-3), "b": np.full(3, 1e-5)}
    assert deviation(Run(signals=expected), expected) == 0.0
    assert deviation(Run(signals=off), expected) == pytest.approx(1e-3 / 4.0)
    assert deviation(Run(signals=off, without={"a[2]"}), expected) == pytest.approx(1e-5)
    later = {name: values[1:] for name, values in off.items()}
    assert deviation(Run(signals=later, first=1), expected) == pytest.approx(1e-3 / 4.0)
    assert deviation(Run(signals=later), expected) > 0.1  # shifted by one point
    for wrong in (np.zeros(1), np.zeros(4), np.array([0.0, np.nan, 0.0])):
        assert deviation(Run(signals=expected | {"b": wrong}), expected) == np.inf
    assert deviation(Run(signals={}), expected) == np.inf


def test_an_engine_with_different_results_fails(small: Alone) -> None:
    def off(_tools: Tools, case: Alone, _folder: Path) -> Run:
        return Run(signals={name: 1.0001 * v for name, v in alone(case).items()}, seconds=0.5)

    matrix = compare([small], Tools(), engines=[engine(off)])
    assert matrix.failing == [("made up", "lag")]
    cell = matrix.rows[0].cells["lag"]
    assert (cell.deviation, cell.seconds) == (pytest.approx(1e-4), 0.5)
    assert list(notes(matrix)) == ["made up: lag fails: it gives something else."]
    assert cell.tolerance == 1e-12


def test_a_broken_engine_fails_and_a_skipped_one_does_not(small: Alone) -> None:
    def breaks(*_: Any) -> Run:
        raise FailedError("it ended with code 1")

    def skips(*_: Any) -> Run:
        raise SkippedError("it does not like lags")

    matrix = compare([small], Tools(), engines=[engine(breaks), engine(skips)])
    assert matrix.failing == [("made up", "lag")]
    assert list(notes(matrix)) == [
        "made up: lag fails: it ended with code 1.",
        "made up: lag not run: it does not like lags.",
    ]
    assert len(table(matrix).rows) == 2


def test_systems_with_several_steps_are_left_out(small: Alone, tmp_path: Path) -> None:
    parts = (
        ComponentSpec(name="a", fmu=small.fmu, start={"u": 2.0}),
        ComponentSpec(name="b", fmu=small.fmu, start={"u": 2.0}, step=0.02),
    )
    spec = SystemSpec(name="lags", step=0.01, stop=0.5, components=parts, observe=("b.y",))
    chosen = [e for e in ENGINES if e.name == "FMPy"]
    case = system(write_system(spec, tmp_path / "SYSTEM.toml"), tmp_path)
    matrix = compare([case], Tools(), engines=chosen)
    assert matrix.rows[0].cells["lags"].skipped == (
        "engines take components with steps of their own in many ways"
    )


def test_missing_signals_fail(small: Alone) -> None:
    matrix = compare([small], Tools(), engines=[engine(lambda *_: Run(signals={}))])
    cell = matrix.rows[0].cells["lag"]
    assert (cell.fails, cell.deviation) == (True, np.inf)


def test_missing_engines_are_reported(small: Alone, tmp_path: Path) -> None:
    tools = Tools(folder=tmp_path / "none")
    chosen = [e for e in ENGINES if e.name in ("FMI4j", "Maestro", "OMSimulator", "PyFMI")]
    matrix = compare([small], tools, engines=chosen)
    assert not matrix.failing
    assert list(notes(matrix)) == [
        f"FMI4j: not run: there is no {tmp_path}/none/fmi4j: make interop, with Maven and a JDK.",
        f"Maestro: not run: there is no {tmp_path}/none/maestro: make interop, with Maven and "
        "Java.",
        "OMSimulator: not run: there is no library OMSimulator: build it from its project's "
        "sources; its library belongs into FOLDER/lib, or to where the system's loader looks.",
        "PyFMI: not run: there is no Python package pyfmi: conda install -c conda-forge pyfmi.",
    ]


def test_another_library_is_not_run(small: Alone, tmp_path: Path) -> None:
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "libOMSimulator.so").write_bytes(b"no library")
    chosen = [e for e in ENGINES if e.name == "OMSimulator"]
    [row] = compare([small], Tools(folder=tmp_path), engines=chosen).rows
    assert row.missing.startswith("it ended with code 1 and said '")
    assert "libOMSimulator.so" in row.missing


SUMS_STEPS = """
#include <string.h>
#pragma GCC visibility push(default)
static double h, stop, now;
const char *oms_getVersion(void) { return "stand-in"; }
int oms_setTempDirectory(const char *f) { return 0; }
int oms_importFile(const char *f, char **name) { *name = "model"; return 0; }
int oms_setResultFile(const char *m, const char *f, int n) { return 0; }
int oms_setStopTime(const char *m, double t) { stop = t; return strcmp(m, "model") ? 3 : 0; }
int oms_setFixedStepSize(const char *m, double t) { h = t; return strcmp(m, "model.two") ? 3 : 0; }
int oms_instantiate(const char *m) { return 0; }
int oms_initialize(const char *m) { return 0; }
int oms_doStep(const char *m) { now = now + h > stop ? stop : now + h; return STATUS; }
int oms_getTime(const char *m, double *t) { *t = now; return 0; }
int oms_getReal(const char *s, double *x) { *x = now; return strcmp(s, "model.two.a.y") ? 3 : 0; }
int oms_terminate(const char *m) { return 0; }
int oms_delete(const char *m) { return 0; }
"""


@pytest.mark.parametrize("status", [0, 3])
def test_omsimulator_is_driven_step_by_step(small: Alone, status: int, tmp_path: Path) -> None:
    """A library with its documented functions, whose sum of steps differs from their multiples."""
    (tmp_path / "lib").mkdir()
    source = tmp_path / "oms.c"
    source.write_text(SUMS_STEPS, encoding="utf-8")
    flags = ("-Wno-unused-parameter", f"-DSTATUS={status}")
    library = build(source, "oms", TARGETS["linux64"], flags)
    (tmp_path / "lib" / "libOMSimulator.so").write_bytes(library)
    spec = SystemSpec(
        name="two",
        step=0.001,
        stop=1.0,
        components=(ComponentSpec(name="a", fmu=small.fmu, start={"u": 1.0}),),
        observe=("a.y",),
    )
    case = Together(name="two", spec=spec, ssp=tmp_path / "none.ssp", signals=("a.y",))
    [chosen] = [e for e in ENGINES if e.name == "OMSimulator"]
    assert chosen.together is not None
    folder = tmp_path / "run"
    folder.mkdir()
    if status:
        with pytest.raises(FailedError, match="oms_doStep"):
            chosen.together(Tools(folder=tmp_path), case, folder)
        return
    found = chosen.together(Tools(folder=tmp_path), case, folder).signals["a.y"]
    steps = np.arange(1001) / 1000
    assert not np.array_equal(found, steps)
    assert np.abs(found - steps).max() < 1e-12


def test_a_fault_of_the_harness_is_none_of_the_engine(small: Alone, tmp_path: Path) -> None:
    """An engine that steps too far fails its control, and its cases are not judged."""
    fault = control_faults(controls(tmp_path))

    def ahead(_tools: Tools, case: Alone, _folder: Path) -> Run:
        return Run(signals=dict.fromkeys(case.outputs, case.times + case.step))

    def right(_tools: Tools, case: Alone, _folder: Path) -> Run:
        return Run(signals=alone(case))

    wrong = compare([small], Tools(), engines=[engine(ahead)], fault=fault)
    assert wrong.failing == [("made up", "lag")]
    (note,) = notes(wrong)
    assert note.startswith("made up: lag not run: our harness fails on its control: it deviates by")
    assert table(wrong).rows[0].cells[-1].text == "HARNESS"
    assert not compare(
        [small],
        Tools(),
        engines=[engine(right, coupling=ExchangeScheme(refreshed="all"))],
        fault=fault,
    ).failing


def test_every_engine_states_its_purpose_and_origin() -> None:
    names = [e.name for e in ENGINES]
    assert len(set(names)) == len(names)
    assert all(e.install for e in ENGINES)
    assert sum(e.together is not None for e in ENGINES) >= 4
    assert sum(e.alone is not None for e in ENGINES) >= 5
