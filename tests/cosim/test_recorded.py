"""Reference results of all FMUs other than friction: contents and reproduction."""

import csv
import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from closed_loop import STEP, Bench
from small_study import Hesr, hesr_here

from cosim.loop.closed_loop import Scheme
from cosim.systems.system import ComponentSpec, SystemSpec
from fmu_src.export.package import zip_members
from fmu_src.run.reference_results import ROWS, TOLERANCE, Stimuli, result_files, verify
from hesr.extras.drive.drive_fmu import export_drive
from hesr.extras.ssp.contents import read_contents
from hesr.extras.ssp.ssp import write_ssp
from hesr.extras.ssp.ssp_results import _run_scheme, verify_ssp
from hesr.extras.ssp.ssp_results import result_files as result_files_of
from hesr_model.errors import SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.motions.trajectories import Fourier

EVERY = ("arm", "trajectory", "body", "controller", "velocity")
BOTH = {"hold": "hold", "shown": "shown"}


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def table(fmu: Path, kind: str) -> dict[str, np.ndarray]:
    """A table of co-simulation results in an FMU."""
    with zipfile.ZipFile(fmu) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith(f"co_simulation/{kind}"))
        head, *rows = csv.reader(io.StringIO(archive.read(name).decode()))
    columns = np.array([[float(cell) for cell in row] for row in rows]).T
    return dict(zip(head, columns, strict=True))


def vector(columns: dict[str, np.ndarray], name: str) -> np.ndarray:
    return np.column_stack([columns[f"{name}[{i}]"] for i in (1, 2, 3)])


@pytest.mark.parametrize("name", EVERY)
def test_the_fmus_of_a_loop_reproduce_their_results(bench: Bench, name: str) -> None:
    found = verify(getattr(bench.fmus, name))
    assert (found.problems, found.skipped, found.passed) == ([], [], BOTH)


def test_results_of_the_body_are_those_of_its_model(bench: Bench) -> None:
    given = table(bench.fmus.body, "inversedynamics_in.csv")
    motion = [vector(given, name) for name in ("q", "dq", "ddq")]
    right = bench.robot.torque(bench.robot.nominal_parameters, *motion)
    shown = vector(table(bench.fmus.body, "inversedynamics_shown.csv"), "tau")
    held = vector(table(bench.fmus.body, "inversedynamics_ref.csv"), "tau")
    size = np.abs(right).max()
    np.testing.assert_allclose(shown, right, atol=1e-11 * size)
    np.testing.assert_allclose(held[1:], right[:-1], atol=1e-11 * size)


def test_results_of_the_trajectory_are_those_of_its_motion(bench: Bench) -> None:
    parameters = table(bench.fmus.trajectory, "trajectory_parameters.csv")
    series = np.zeros((2, 3, 10))
    for name, value in parameters.items():
        if name[0] in "ab":
            i, k = map(int, name[2:-1].split(","))
            series["ab".index(name[0]), i - 1, k - 1] = value[0]
    period = float(parameters["period"][0])
    motion = Fourier(a=series[0], b=series[1], period=period, offset=np.zeros(3))
    found = table(bench.fmus.trajectory, "trajectory_ref.csv")
    ahead = float(parameters["preview"][0])
    assert period == ROWS * STEP
    for tail, t in (("", found["time"]), ("_ahead", found["time"] + ahead)):
        for name, right in zip(("q", "dq", "ddq"), motion.sample(t), strict=True):
            own = vector(found, name + tail)
            np.testing.assert_allclose(own, right, atol=1e-11 * np.abs(right).max())


def test_a_drive_carries_results_in_motion(table1: FrictionModel, tmp_path: Path) -> None:
    fmu = export_drive(table1, tmp_path / "Drive.fmu", inertia=[1.0, 1.0, 0.5])
    found = verify(fmu)
    assert (found.problems, found.passed) == ([], BOTH)
    dq = vector(table(fmu, "drive_parfam_h_ref.csv"), "dq")
    assert np.all(dq.max(axis=0) > 1e-3)
    changed = tmp_path / "Changed.fmu"
    with zipfile.ZipFile(fmu) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = "extra/co_simulation/drive_parfam_h_parameters.csv"
    assert name not in members
    results = "extra/co_simulation/drive_parfam_h_ref.csv"
    rows = members[results].decode().splitlines()
    cells = rows[50].split(",")
    cells[1] = f"{float(cells[1]) * (1.0 + 1e4 * TOLERANCE) + 1e-3:.14g}"
    rows[50] = ",".join(cells)
    members[results] = ("\n".join(rows) + "\n").encode()
    zip_members(changed, members, "1980-01-01T00:00:00Z")
    (experiment,) = verify(changed).problems
    assert experiment.startswith("experiment 'hold': q[1] is ")


def test_results_need_a_binary_for_this_machine(bench: Bench) -> None:
    with zipfile.ZipFile(bench.fmus.velocity) as archive:
        members = {n: archive.read(n) for n in archive.namelist() if not n.startswith("binaries/")}
    assert result_files(members, Stimuli(step=STEP)) == {}


WAYS = {"hold": "hold", "shown": "shown", "refreshed": "refreshed"}


@pytest.mark.ci  # checks five FMUs of a system
def test_an_ssp_carries_results_of_each_coupling(bench: Bench, tmp_path: Path, hesr: Hesr) -> None:
    spec = bench.system(bench.loop(Scheme(compensation="servo_inversion", Kx=5.0)))
    contents = read_contents(spec.model_copy(update={"name": "closed"}), Path("closed.toml"))
    ssp = write_ssp(contents, tmp_path / "closed.ssp")
    found = verify_ssp(ssp)
    assert (found.problems, found.skipped, found.passed) == ([], [], WAYS)
    with zipfile.ZipFile(ssp) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    results = {way: members[f"extra/results/system_{way}.csv"] for way in WAYS}
    assert len(set(results.values())) == 3  # engines differ
    answer = hesr("check", ssp, "--kind", "references")
    assert (answer.code, answer.out.partition("\n")[0]) == (0, f"{ssp}: passed, no finding.")
    # Results of another coupling do not belong to an engine.
    members["extra/results/system_hold.csv"] = results["refreshed"]
    swapped = tmp_path / "swapped.ssp"
    zip_members(swapped, members, "1980-01-01T00:00:00Z")
    (experiment,) = verify_ssp(swapped).problems
    assert experiment.startswith("experiment 'hold': ")


def test_an_ssp_is_not_run_by_a_hostile_master(tmp_path: Path, hesr: Hesr) -> None:
    answer = hesr("check", tmp_path / "a.ssp", "--kind", "hostile")
    assert answer.code == 2
    assert "a.ssp: an SSP supports --kind static and references only." in answer.err


def test_systems_of_foreign_fmus_carry_no_results(lag_fmu: Path, tmp_path: Path) -> None:
    # Judged by their hash: one additional byte changes it.
    foreign = tmp_path / "Lag.fmu"
    foreign.write_bytes(lag_fmu.read_bytes() + b"\0")
    lag = ComponentSpec(name="a", fmu=foreign, start={"u": 1.0})
    spec = SystemSpec(name="one", step=0.1, stop=1.0, components=(lag,), observe=("a.y",))
    assert result_files_of(read_contents(spec, Path("one.toml"))) == {}


def test_vectors_of_a_system_are_no_reference_results(bench: Bench) -> None:
    spec = bench.system(bench.loop(Scheme(compensation="servo_inversion", Kx=5.0)))
    vector = spec.observe[0].partition("[")[0]
    with pytest.raises(SimulationError, match=f"'{vector}' is a vector; reference results are"):
        _run_scheme(spec, [vector], np.zeros(3), "hold")
