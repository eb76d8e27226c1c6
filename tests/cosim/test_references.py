"""Reference results in FMUs: ours reproduce theirs, and differences are reported."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from containing import Containing

from fmu_src import export_fmu
from fmu_src.run.reference_results import (
    EXPERIMENTS,
    FOLDER,
    MANIFEST,
    ExperimentFiles,
    manifest_files,
    verify,
)
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Stop
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange

STEPS = "extra/steps"


def repacked(fmu: Path, target: Path, more: dict[str, bytes]) -> Path:
    """Copy an FMU with members changed or added."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(target, "w") as new:
        for name in {*old.namelist(), *more}:
            new.writestr(name, more.get(name) or old.read(name))
    return target


@pytest.fixture
def with_results(lag_fmu: Path, tmp_path: Path) -> Callable[..., Path]:
    """The lag T x' = u - x with given experiments: stimuli and results as text."""

    def make(stimuli: str, results: str, *, name: str = "own", step: float = 0.1) -> Path:
        members = {f"{STEPS}_in.csv": stimuli.encode(), f"{STEPS}_ref.csv": results.encode()}
        own = ExperimentFiles(
            runs=[(name, "", "ref")],
            t=np.array([0.0, 0.2]),
            step=step,
            tolerance=1e-9,
            stem=STEPS,
        )
        files = members | manifest_files([own], members)
        return repacked(lag_fmu, tmp_path / "Lag.fmu", files)

    return make


STIMULI = "time,u\n0,1\n0.1,2\n0.2,2\n"
AFTER = 0.8187307530779818  # exp(-0.1 / T), T = 0.5


def results(*inputs: float) -> str:
    """Results of the lag from x = 0.25 for inputs held over each step."""
    rows, x = [0.25], 0.25
    for u in inputs:
        x = u + (x - u) * AFTER
        rows.append(x)
    return "time,y\n" + "".join(f"{0.1 * k:g},{y:.17g}\n" for k, y in enumerate(rows))


def test_friction_fmus_reproduce_their_results(friction_fmu: Path) -> None:
    found = verify(friction_fmu)
    assert found.problems == []
    assert found.passed == {"hold": "hold", "shown": "shown"}
    assert found.skipped == [Containing("Experiment 'continuous': it has no step")]


@pytest.mark.parametrize(("way", "inputs"), [("hold", (1.0, 2.0)), ("direct", (2.0, 2.0))])
def test_the_input_convention_of_an_experiment_is_found(
    with_results: Callable[..., Path], way: str, inputs: tuple[float, ...]
) -> None:
    found = verify(with_results(STIMULI, results(*inputs)))
    assert (found.problems, found.passed) == ([], {"own": way})


def test_different_results_are_reported(with_results: Callable[..., Path]) -> None:
    found = verify(with_results(STIMULI, results(1.0, 3.0), name="hold"))
    assert found.passed == {}
    (text,) = found.problems
    assert text.startswith("experiment 'hold': y is ")
    assert text == Containing("0.859798 at 0.2 s", "tolerance of 1e-09")


@pytest.mark.parametrize(
    ("stimuli", "answers", "problem"),
    [
        ("u\n1\n", "time,y\n0,1\n", "'extra/steps_in.csv' is not a table over 'time'"),
        ("time,u\n0,x\n", "time,y\n0,1\n", "could not convert string to float: 'x'"),
        ("time,v\n0,1\n", "time,y\n0,1\n", "'v'"),
        (f"time,u\n0,{200_000 * '1'}\n", "time,y\n0,1\n", "field larger than field limit"),
    ],
)
def test_experiments_that_fail_are_reported(
    with_results: Callable[..., Path], stimuli: str, answers: str, problem: str
) -> None:
    (text,) = verify(with_results(stimuli, answers)).problems
    assert problem in text


def test_missing_and_broken_files_are_reported(
    with_results: Callable[..., Path], tmp_path: Path
) -> None:
    fmu = with_results(STIMULI, results(1.0, 2.0))
    with zipfile.ZipFile(fmu) as archive:
        manifest = archive.read(MANIFEST)
    other = {MANIFEST: manifest.replace(b"experiments.xml", b"other.xml")}
    found = verify(repacked(fmu, tmp_path / "Missing.fmu", other))
    assert found.problems == [f"{MANIFEST} names '{FOLDER}/other.xml', which is missing."]
    broken = {EXPERIMENTS: b"<Experiments>"}
    found = verify(repacked(fmu, tmp_path / "Broken.fmu", broken))
    assert found.problems[-1].startswith("its reference results cannot be read: no element found")
    broken = {EXPERIMENTS: b"<?xml version='1.0' encoding='nowhere'?><Experiments/>"}
    found = verify(repacked(fmu, tmp_path / "Broken.fmu", broken))
    assert found.problems[-1].endswith("cannot be read: unknown encoding: nowhere.")


def test_skipped_experiments_are_reported(with_results: Callable[..., Path], lag_fmu: Path) -> None:
    assert verify(lag_fmu).skipped == [f"Reference results: {MANIFEST} is missing."]
    later = results(1.0, 2.0).replace("0.2,", "0.3,")
    found = verify(with_results(STIMULI, later))
    assert found.skipped == [Containing("Experiment 'own': its results")]


def test_reading_outputs_does_not_move_stops(tmp_path: Path) -> None:
    """New inputs lower the bound; only the next step moves the stop there."""
    level = Coefficient(name="F", unit="N.m", description="level")
    stop = Stop(
        name="e", unit="1", velocity=DQ, deflection=2e-3, bound=1 / (1 + absolute(TAU_LOAD))
    )
    form = LawForm(coefficients=(level,), memory=(stop,), output=level.symbol * stop.state)
    law = FrictionLaw(name="own", form=form, values={"F": 8.0})
    seen = TrainedRange(
        dq=(-1.0, 1.0), q=(-1.0, 1.0), tau_load=(-9.0, 9.0), tau=(-8.0, 8.0), sample_time=0.01
    )
    model = FrictionModel(
        law="own", robot="bench", joints=("a",), laws=(law,), sample_time=0.01, trained=(seen,)
    )
    found = verify(export_fmu(model, tmp_path / "Stop.fmu"))
    assert (found.problems, found.passed) == ([], {"hold": "hold", "shown": "shown"})
