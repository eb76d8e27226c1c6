"""Speed of the product. Results are recorded next to their targets; none is a test.

Run by `make benchmark`; `make test` leaves this folder out.
"""

import json
import os
import resource
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from threadpoolctl import threadpool_limits

from fmu_src import model_file
from fmu_src.equations.c_functions import Functions
from fmu_src.export.toolchain import CFLAGS
from hesr_model.fitting.estimator import estimator
from hesr_model.fitting.fit import fit_joint
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.laws.parfam import evolve, refine
from hesr_model.laws.parfam.candidate import Candidate
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.files import models_folder

STEP, ROWS = 0.005, 4000

HESR_RUN = """
import json, resource, sys, time
from hesr.cli import main
start = time.perf_counter()
try:
    main()
except SystemExit as ended:
    code = ended.code
kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
print(json.dumps({
    "code": code,
    "seconds": time.perf_counter() - start,
    "MB": [resource.getrusage(kind).ru_maxrss / 1024 for kind in kinds],
    "CPU seconds": sum(resource.getrusage(kind).ru_utime for kind in kinds),
}))
"""


@pytest.fixture(scope="module")
def data() -> FrictionRecord:
    """20 s of joint 1 of Table I along a sweep, with the noise of its torque sensor."""
    law = FrictionModel.read(model_file("uf850-table1")).laws[0]
    t = STEP * np.arange(ROWS)
    dq = (0.75 + 0.45 * np.sin(2.0 * np.pi * t / 7.0)) * np.sin(
        2.0 * np.pi * (0.1 * t + 0.35 * t**2 / (2.0 * t[-1]))
    )
    tau = predict(law, t=t, dq=dq) + 1.5 * np.random.default_rng(0).normal(size=ROWS)
    zero = np.zeros(ROWS)
    return FrictionRecord(log="sweep", joint="joint1", t=t, dq=dq, q=zero, tau_load=zero, tau=tau)


@pytest.fixture(scope="module")
def features(data: FrictionRecord) -> HysteresisFeatures:
    samples = JointRows.from_records([data], coefficients=11)
    return HysteresisFeatures(rows=samples, discretisation="exact")


def candidate() -> Candidate:
    return Candidate(
        g="tanh",
        alpha=11.0,
        beta=200.0,
        c=np.array([-2.0, 0.1, 16.0, -0.2]),
        theta=np.array([0.06, 0.2, -0.6, 0.06]),
        gain=38.0,
        c_active=np.ones(4, bool),
        theta_active=np.ones(4, bool),
        cost=np.nan,
    )


def test_three_stage_fit_of_a_joint(
    benchmark: BenchmarkFixture, data: FrictionRecord, tell: Callable[[str], None]
) -> None:
    """Target: 1 s of CPU time at 4000 samples."""
    benchmark.extra_info["aim"] = "1 s of CPU time"
    start = time.process_time()
    rounds = 3
    law = benchmark.pedantic(
        fit_joint, args=("parfam_h", [data]), kwargs={"seed": 0}, rounds=rounds, warmup_rounds=1
    )
    runs = rounds + 1 if benchmark.enabled else 1
    seconds = (time.process_time() - start) / runs
    benchmark.extra_info["CPU seconds"] = seconds
    tell(f"three-stage fit of a joint: {seconds:.2f} s of CPU")
    assert law.name == "parfam_h"


@pytest.mark.parametrize("law", ["stribeck", "lugre", "rbfnn_h", "mlp_h"])
def test_fit_of_another_law(benchmark: BenchmarkFixture, data: FrictionRecord, law: str) -> None:
    fitted = benchmark.pedantic(fit_joint, args=(law, [data]), kwargs={"seed": 0}, rounds=3)
    assert fitted.name == law


def test_objective_with_gradient(benchmark: BenchmarkFixture, features: HysteresisFeatures) -> None:
    """Target: 75 us at 4000 samples (eq. 12 with one unit)."""
    benchmark.extra_info["aim"] = "75 us"
    x, tau = features.columns(11.0, 200.0), features.rows.tau
    scale = np.concatenate([[1.0], x[:, 1:].std(axis=0)])
    objective = evolve.Objective("tanh", x / scale, tau, 1e-3, np.ones(9, bool))
    point = np.random.default_rng(0).normal(size=9)
    with threadpool_limits(1):
        value, gradient = benchmark(objective, point)
    assert np.isfinite(value)
    assert gradient.shape == (9,)


def test_residual_and_jacobian_of_the_last_stage(
    benchmark: BenchmarkFixture, features: HysteresisFeatures
) -> None:
    problem = refine.Refinement(features, candidate())
    point = problem.pack()
    with threadpool_limits(1):
        jacobian, _ = benchmark(problem.slopes, point)
    assert jacobian.shape == (ROWS, 11)


@pytest.mark.parametrize(
    ("name", "structure"), [("rbfnn_h", {"centres": 40}), ("mlp_h", {"hidden": 16})]
)
def test_lowering_of_the_largest_networks(
    name: str, structure: dict[str, int], benchmark: BenchmarkFixture
) -> None:
    """Target: 2 s, to C with tangents."""
    form = estimator(name).form(structure)
    own = Functions(form.component, "law_1", tunable=False)
    text = benchmark.pedantic(lambda: own.step() + own.tangent())
    assert "law_1_tangent" in text


def test_prediction_over_a_log(benchmark: BenchmarkFixture, data: FrictionRecord) -> None:
    law = FrictionModel.read(model_file("uf850-table1")).laws[0]
    torque = benchmark(predict, law, t=data.t, dq=data.dq)
    assert torque.shape == (ROWS,)


def test_help(benchmark: BenchmarkFixture) -> None:
    """Target: 0.3 s."""
    benchmark.extra_info["aim"] = "0.3 s"
    command = [sys.executable, "-c", "from hesr.cli import main; main()", "--help"]
    result = benchmark.pedantic(
        subprocess.run, args=(command,), kwargs={"capture_output": True}, rounds=5, warmup_rounds=1
    )
    assert result.returncode == 0


def ran(*arguments: str | Path, cache: Path) -> dict[str, Any]:
    """Return what a command in a new process took, with this folder of caches."""
    command = [sys.executable, "-c", HESR_RUN, *map(str, arguments)]
    home = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    done = subprocess.run(command, capture_output=True, text=True, env=home, check=True)
    measured: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    assert measured["code"] in (None, 0), done.stderr
    return measured


def test_export_compared_with_a_bare_compile(
    twin: Path, tmp_path: Path, tell: Callable[[str], None]
) -> None:
    """Target: 2.3 times a bare compile for new coefficients, 0.23 times if identical."""
    law, fmu = tmp_path / "law.json", tmp_path / "F.fmu"
    text = json.loads((twin / "laws" / "stribeck.json").read_text(encoding="utf-8"))
    times: dict[str, list[float]] = {}

    def take(name: str, *more: str) -> None:
        used = ran("export", law, "-o", fmu, *more, cache=tmp_path)["CPU seconds"]
        times.setdefault(name, []).append(used)

    for run in range(4):
        for more in ([], ["--no-documentation"]):
            for joint in text["joints"]:
                joint["coefficients"]["sigma_2"]["value"] *= 1.0001
            law.write_text(json.dumps(text), encoding="utf-8")
            take(" ".join(["new", *more]), *more)
        take("identical", "--no-documentation")
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(tmp_path / f"{run}")
        begin = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        flags = ("-target", "x86_64-linux-gnu.2.17", *CFLAGS, "-shared", "-fPIC", "-s", "-lm")
        source, library = tmp_path / f"{run}" / "sources" / "all.c", tmp_path / f"{run}.so"
        command = [sys.executable, "-m", "ziglang", "cc", *flags, "-o", str(library), str(source)]
        subprocess.run(command, check=True)
        taken = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - begin
        times.setdefault("bare", []).append(taken)
    bare = min(times.pop("bare"))
    shown = ", ".join(f"{name} {min(taken) / bare:.2f}" for name, taken in times.items())
    tell(f"export, in times of a bare compile of {bare:.2f} CPU s: {shown}")


def test_first_calls_compared_with_second_ones(
    twin: Path, tmp_path: Path, tell: Callable[[str], None]
) -> None:
    """Target: 1.3 times, with empty caches."""
    robot = models_folder() / "uf850" / "robot.toml"
    logs, body = twin / "logs", twin / "rigid_body.json"
    usual = ("--robot", robot)
    commands: dict[str, tuple[str | Path, ...]] = {
        "inspect": (logs / "sweep.csv", *usual),
        "identify": (logs / "excitation.csv", *usual, "-o", tmp_path / "body.json"),
        "fit": (
            logs / "sweep.csv",
            *usual,
            "--rigid-body",
            body,
            "--law",
            "lugre",
            "-o",
            tmp_path / "law.json",
        ),
    }
    for verb, arguments in commands.items():
        cache = tmp_path / verb
        cache.mkdir()
        first, second = (ran(verb, *arguments, cache=cache)["CPU seconds"] for _ in range(2))
        tell(f"{verb} with empty caches: {first:.2f} CPU s, {first / second:.2f} of the second")


def test_memory_of_identification(twin: Path, tmp_path: Path, tell: Callable[[str], None]) -> None:
    """Target: 600 MB for 10^7 rows with six joints; here the rise for each row of three joints."""
    head, *lines = (twin / "logs" / "excitation.csv").read_text(encoding="utf-8").splitlines()
    rows = np.array([line.split(",") for line in lines], float)
    robot, body = models_folder() / "uf850" / "robot.toml", tmp_path / "body.json"
    found: list[tuple[int, float, float]] = []
    for times in (20, 80):
        whole = np.tile(rows, (times, 1))
        whole[:, 0] = STEP * np.arange(len(whole))
        log = tmp_path / f"{times}.csv"
        np.savetxt(log, whole, delimiter=",", header=head, comments="", fmt="%.9g")
        measured = ran("identify", log, "--robot", robot, "-o", body, cache=tmp_path)
        found.append((len(whole), max(measured["MB"]), measured["CPU seconds"]))
    (few, low, quick), (many, high, slow) = found
    tell(
        f"identify of {many} rows: {high:.0f} MB, {1e3 * (high - low) / (many - few):.1f} kB a "
        f"row; {slow / quick:.1f} times the time of {few} rows"
    )


def test_whole_default_run(
    benchmark: BenchmarkFixture, tmp_path: Path, tell: Callable[[str], None]
) -> None:
    """Target: 60 s and at most 500 MB in any process."""
    command = [sys.executable, "-c", HESR_RUN, "run", "-o", str(tmp_path / "results")]
    result: subprocess.CompletedProcess[str] = benchmark.pedantic(
        subprocess.run, args=(command,), kwargs={"capture_output": True, "text": True}, rounds=1
    )
    assert result.returncode == 0, result.stderr
    measured = json.loads(result.stdout.splitlines()[-1])
    assert measured["code"] == 0
    benchmark.extra_info |= {"aim": "60 s, 500 MB a process", **measured}
    tell(
        f"default run: {measured['seconds']:.1f} s, {measured['CPU seconds']:.1f} s of CPU, "
        f"at most {max(measured['MB']):.0f} MB in a process"
    )
