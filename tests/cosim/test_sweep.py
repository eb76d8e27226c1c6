"""Sweeps of one system: choice of runs, results, and recovery from interrupts."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from small_fmus import LAGS

from hesr.cli import main
from hesr.extras.sweep.job import replay, run_sweep
from hesr.extras.sweep.plan import design_inputs
from hesr.extras.sweep.study import SweepStudy
from hesr_model.errors import ArtifactError, ConfigError, LogError, SimulationError

STUDY = """
name = "lags"
system = "lags.toml"
design = "monte_carlo"
runs = 12
seed = 3
chunk = 5

[[inputs]]
variables = ["a.u"]
low = 1.0
high = 3.0

[[inputs]]
variables = ["a.T", "b.T"]
factor = true
values = [1.0, 2.0]

[[outputs]]
name = "end"
signal = "b.y"
measure = "final"

[[outputs]]
name = "difference"
signal = "a.y"
reference = "b.y"
measure = "max"
start = 0.2
"""


@pytest.fixture
def study(lag_fmu: Path, tmp_path: Path) -> Path:
    system = LAGS.replace("FMU", str(lag_fmu)).replace("step = 0.2", "start = { T = 0.3 }")
    (tmp_path / "lags.toml").write_text(system, encoding="utf-8")
    return written(tmp_path, STUDY)


def test_a_single_input_explains_all_variance(study: Path) -> None:
    before, after = STUDY.split('[[inputs]]\nvariables = ["a.T"')[0], STUDY[STUDY.index("[[out") :]
    one = (before + after).replace("monte_carlo", "sobol").replace("runs = 12", "runs = 16")
    found = run_sweep(written(study.parent, one), study.parent / "out", workers=1)
    for share in found.sensitivities:
        assert share.first == pytest.approx([1.0], abs=0.2)
        assert share.total == pytest.approx([1.0], abs=0.2)
        assert share.intervals.shape == (2, 1, 2)


def written(folder: Path, text: str, name: str = "study.toml") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def files(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def of(**more: object) -> SweepStudy:
    data = {
        "system": "s.toml",
        "design": "latin_hypercube",
        "runs": 64,
        "inputs": [{"variables": ["a.x"], "low": -1.0, "high": 3.0}],
        "outputs": [{"name": "y", "signal": "a.y"}],
    }
    return SweepStudy.from_data(Path("study.toml"), data | more)


# --- choice of runs ----------------------------------------------------------------------------


def test_a_latin_hypercube_has_one_run_in_each_stratum():
    values = design_inputs(of())[:, 0]
    assert sorted(np.floor((values + 1.0) / 4.0 * 64).astype(int)) == list(range(64))


def test_a_grid_has_every_combination():
    inputs = [
        {"variables": ["a.x"], "low": 0.0, "high": 1.0, "levels": 3},
        {"variables": ["a.seed"], "values": [4, 9]},
    ]
    found = design_inputs(of(design="grid", runs=None, inputs=inputs)).tolist()
    assert found == [[x, s] for x in (0.0, 0.5, 1.0) for s in (4.0, 9.0)]


def test_random_runs_have_the_requested_moments():
    covariance = [[4.0, 1.8], [1.8, 1.0]]
    together = [{"variables": ["a.p", "a.r"], "mean": [5.0, -2.0], "covariance": covariance}]
    inputs = [
        {"variables": ["a.x"], "mean": 1.0, "std": 0.5},
        {"variables": ["a.seed"], "low": 1, "high": 6, "integer": True},
    ]
    study = of(design="monte_carlo", runs=20_000, inputs=inputs, correlated=together)
    values = design_inputs(study)
    assert study.names == ("a.x", "a.seed", "a.p", "a.r")
    np.testing.assert_allclose(values.mean(axis=0), [1.0, 3.5, 5.0, -2.0], atol=0.05)
    np.testing.assert_allclose(np.cov(values[:, 2:].T), covariance, rtol=0.05)
    assert values[:, 0].std() == pytest.approx(0.5, rel=0.03)
    assert set(values[:, 1]) == {1.0, 2.0, 3.0, 4.0, 5.0, 6.0}


def test_a_sobol_design_changes_one_input_in_each_block():
    inputs = [{"variables": [f"a.{name}"], "low": 0.0, "high": 1.0} for name in "pqr"]
    a, b, *mixed = design_inputs(of(design="sobol", runs=8, inputs=inputs)).reshape(5, 8, 3)
    for k, block in enumerate(mixed):
        np.testing.assert_array_equal(block[:, k], b[:, k])
        np.testing.assert_array_equal(np.delete(block, k, 1), np.delete(a, k, 1))


def test_sensitivities_match_a_known_function():
    """Ishigami's function; indices by Sobol and Levitan (1999)."""
    from hesr.extras.sweep.plan import compute_sensitivities

    inputs = [{"variables": [f"a.{n}"], "low": -np.pi, "high": np.pi} for n in "pqr"]
    outputs = [{"name": name, "signal": f"a.{name}"} for name in ("y", "failed")]
    study = of(design="sobol", runs=2048, inputs=inputs, outputs=outputs)
    x = design_inputs(study)
    y = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    (one,) = compute_sensitivities(np.column_stack([y, np.full(len(y), np.nan)]), study)
    np.testing.assert_allclose(one.first, [0.3139, 0.4424, 0.0], atol=0.02)
    np.testing.assert_allclose(one.total, [0.5576, 0.4424, 0.2437], atol=0.02)
    assert np.all(one.intervals[1, :, 0] <= one.total)


# --- results -----------------------------------------------------------------------------------


def test_each_run_uses_its_inputs(study: Path, tmp_path: Path):
    found = run_sweep(study, tmp_path / "out", workers=1)
    table = parquet.read_table(tmp_path / "out" / "runs")
    assert table.column_names == ["run", "a.u", "a.T", "end", "difference", "failure"]
    assert table.column("run").to_pylist() == list(range(12))
    u, factor, end = (table.column(n).to_numpy() for n in ("a.u", "a.T", "end"))
    assert set(factor) == {1.0, 2.0}
    for run in (0, 7, 11):
        plan, result = replay(study, run)
        assert plan.values[run].tolist() == [u[run], factor[run]]
        assert plan.task.measure_outputs(result).tobytes() == found.table.outputs[run].tobytes()
    # The lag T x' = u - x that drives the other one, in closed form.
    k = int(np.argmax(factor))
    _, result = replay(study, k)
    y = result.signals["a.y"]
    assert y[-1] == pytest.approx(u[k] + (0.25 - u[k]) * np.exp(-1.0), rel=2e-2)
    assert 0.0 < end[k] < u[k]


def test_the_same_seed_gives_the_same_bytes_for_any_workers(study: Path, tmp_path: Path):
    """Includes intervals of sensitivities."""
    text = STUDY.replace('"monte_carlo"', '"sobol"').replace("runs = 12", "runs = 4")
    study = written(study.parent, text)
    for name, workers in (("alone", 1), ("shared", 2)):
        run_sweep(study, tmp_path / name, workers=workers)
    assert files(tmp_path / "alone") == files(tmp_path / "shared")
    assert len(files(tmp_path / "alone")) == 6  # four chunks, their description and the page


def test_finished_runs_are_not_repeated(study: Path, tmp_path: Path):
    out = tmp_path / "out"
    assert run_sweep(study, out, workers=1).reused == 0
    before = files(out)
    (out / "runs" / "part-00000005.parquet").unlink()
    (out / "runs" / "part-00000010.parquet").write_bytes(b"PAR1 cut short")
    assert run_sweep(study, out, workers=1).reused == 5
    assert files(out) == before
    assert run_sweep(study, out, workers=1).reused == 12


@pytest.mark.ci
@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no kill -9")
def test_a_killed_sweep_resumes(study: Path, tmp_path: Path):
    study.write_text(STUDY.replace("runs = 12", "runs = 150"), encoding="utf-8")
    out, script = tmp_path / "out", "from hesr.cli import main; main()"
    command = (
        sys.executable,
        "-c",
        script,
        "simulate",
        study,
        "-o",
        out,
        "--workers",
        "1",
        "--quiet",
    )
    with subprocess.Popen(command) as process:
        for _ in range(6000):
            if len(list(out.glob("runs/part-*"))) > 3 or process.poll() is not None:
                break
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    left = run_sweep(study, out, workers=1)
    assert left.reused >= 15
    run_sweep(study, tmp_path / "whole", workers=1)
    assert files(out) == files(tmp_path / "whole")


def test_failed_runs_are_listed_first(study: Path, tmp_path: Path):
    text = STUDY.replace(
        'variables = ["a.u"]\nlow = 1.0\nhigh = 3.0',
        'variables = ["b.refused"]\nvalues = [0.5, 9.0]',
    )
    found = run_sweep(written(tmp_path, text), tmp_path / "out", workers=1)
    failed = [k for k, text in enumerate(found.table.failures) if text]
    assert failed == np.flatnonzero(found.table.inputs[:, 0] == 0.5).tolist()
    assert np.isnan(found.table.outputs[failed]).all()
    assert found.find_worst_runs(0)[0] == failed[0]
    assert "Lag.fmu (" in found.table.failures[failed[0]]


# --- the command ------------------------------------------------------------------------------


def command(*words: object, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["hesr", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def test_the_command_summarises_and_replays(study: Path, tmp_path: Path, monkeypatch, capsys):
    text = STUDY.replace('"monte_carlo"', '"sobol"').replace("runs = 12", "runs = 8")
    study = written(tmp_path, text)
    monkeypatch.chdir(tmp_path)
    assert (
        command(
            "simulate", study, "-o", "out", "--workers", 1, "--verbose", monkeypatch=monkeypatch
        )
        == 0
    )
    said = capsys.readouterr().out
    assert "Shares of the variance of end" in said
    page = (tmp_path / "out" / "sweep.html").read_text(encoding="utf-8")
    assert "32 runs of 1 s, Saltelli" in page
    assert "<svg" in page
    run = said.split("Worst run by end: hesr simulate ")[1].split("--only ")[1].split()[0]
    assert f"hesr simulate study.toml --only {run} -o run{run}.csv" in page
    again = ("simulate", study, "--only", run, "-o", "worst.csv")
    assert command(*again, monkeypatch=monkeypatch) == 0
    largest = parquet.read_table(tmp_path / "out" / "runs").column("end").to_numpy().max()
    assert f"end: {largest:.9g}" in capsys.readouterr().out
    assert (tmp_path / "worst.csv").read_text().startswith('"t","b.y","a.y"')


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"a.u"', '"a.v"', "start values of 'a': "),
        ('"a.u"', '"c.u"', "there is no component 'c'"),
        ('"a.u"', '"a.y"', "'a.y' cannot be varied: its FMU"),
        ("low = 1.0", "low = 4.0", "'a.u' has a range from 4 to 3."),
        ("low = 1.0", "mean = 4.0", "'a.u' needs one of 'values', 'low'"),
        ('["a.T", "b.T"]', '["a.T", "a.T"]', "'a.T' is listed twice."),
        ('["a.T", "b.T"]', '["a.T", "a.u"]', "'a.u' is varied or measured twice."),
        ('["a.T", "b.T"]', '["b.refused"]', "'b.refused' is varied by a factor"),
        ("runs = 12", "", "the design 'monte_carlo' needs the key 'runs'."),
        ('"monte_carlo"', '"sobol"', "2 as 'runs', not 12"),
        ('"monte_carlo"', '"grid"', "grid determines the number of runs"),
        ("start = 0.2", "start = 2.0", "output 'difference' starts at 2 s"),
        ('"b.y"\nmeasure = "max"', '"b.z"\nmeasure = "max"', "observed 'b.z'"),
        ("seed = 3", "sed = 3", "unknown key 'sed'; did you mean 'seed'"),
    ],
)
def test_invalid_studies_are_refused(
    study: Path, tmp_path: Path, old: str, new: str, said: str, monkeypatch, capsys
):
    assert old in STUDY
    bad = written(tmp_path, STUDY.replace(old, new))
    assert command("simulate", bad, "-o", tmp_path / "out", monkeypatch=monkeypatch) == 2
    err = capsys.readouterr().err
    assert said in err.replace("\n", " ")
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"inputs": []}, "nothing is varied: give 'inputs'"),
        (
            {
                "design": "grid",
                "runs": None,
                "inputs": [{"variables": ["a.x"], "mean": 1, "std": 1}],
            },
            "grid needs 'values' or 'low'",
        ),
        (
            {"correlated": [{"variables": ["a.p", "a.r"], "mean": [1.0], "covariance": [[1.0]]}]},
            "2 correlated variables need 2 means",
        ),
        (
            {
                "correlated": [
                    {"variables": ["a.p", "a.r"], "mean": [0, 0], "covariance": [[1, 2], [2, 1]]}
                ]
            },
            "covariance of 'a.p' and others",
        ),
    ],
)
def test_impossible_designs_are_refused(more: dict[str, object], said: str):
    with pytest.raises(ConfigError) as error:
        of(**more)
    assert said in str(error.value)


def test_oversized_grids_are_refused():
    inputs = [{"variables": [f"a.x{k}"], "low": 0, "high": 1, "levels": 100} for k in range(4)]
    with pytest.raises(ConfigError, match=r"grid of 'sweep' has 1e\+08 runs"):
        design_inputs(of(design="grid", runs=None, inputs=inputs))


def test_folders_of_another_sweep_are_refused(study: Path, tmp_path: Path):
    out = tmp_path / "out"
    run_sweep(study, out, workers=1)
    before = files(out)
    other = written(tmp_path, STUDY.replace("seed = 3", "seed = 4"))
    with pytest.raises(ConfigError, match="holds results of another sweep; give"):
        run_sweep(other, out, workers=1)
    assert files(out) == before
    from filelock import FileLock

    with (
        FileLock(out / ".sweep-lock"),
        pytest.raises(ArtifactError, match="another sweep is writing here; wait"),
    ):
        run_sweep(study, out, workers=1)
    (tmp_path / "file").touch()
    with pytest.raises(ArtifactError, match=r"file: cannot be written there \("):
        run_sweep(study, tmp_path / "file", workers=1)


def test_the_first_error_is_reported_if_every_run_fails(study: Path, tmp_path: Path):
    text = STUDY.replace(
        'variables = ["a.u"]\nlow = 1.0\nhigh = 3.0', 'variables = ["b.refused"]\nvalues = [0.5]'
    )
    with pytest.raises(SimulationError, match="all 12 runs failed, the first because"):
        run_sweep(written(tmp_path, text), tmp_path / "out", workers=1)


def test_impossible_replays_are_refused(study: Path, tmp_path: Path, monkeypatch, capsys):
    assert command("simulate", study, "--only", 12, monkeypatch=monkeypatch) == 2
    assert "run 12 is not one" in capsys.readouterr().err
    assert command("simulate", study, "--only", 1, "-o", "x.txt", monkeypatch=monkeypatch) == 2
    assert "x.txt: results are written as .csv" in capsys.readouterr().err


def test_a_reference_of_another_size_is_refused(friction_fmu: Path, tmp_path: Path):
    system = f"""
step = 0.01
stop = 0.1
[[components]]
name = "friction"
fmu = "{friction_fmu}"
start = {{ q = 0.0, dq = 0.1, tau_load = 0.0 }}
"""
    written(tmp_path, system, "lags.toml")
    text = (
        STUDY.split("[[inputs]]")[0]
        + """
[[inputs]]
variables = ["friction.dq"]
low = -1.0
high = 1.0
[[outputs]]
name = "difference"
signal = "friction.tau"
reference = "friction.tau[1]"
"""
    )
    with pytest.raises(ConfigError) as error:
        run_sweep(written(tmp_path, text), tmp_path / "out", workers=1)
    assert "'friction.tau' has 3 elements and its reference 'friction.tau[1]' 1." in str(
        error.value
    )


def test_a_sweep_needs_pyarrow(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(LogError, match=r"need pyarrow: pip install '.+\[formats\]'"):
        run_sweep(study, tmp_path / "out")
    assert not (tmp_path / "out").exists()
