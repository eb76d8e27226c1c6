"""Row-wise equations in C compared with NumPy and the stepped FMU, and their share of fits.

Ratios use the best of several interleaved rounds, so that other load slows both equally.
"""

import shutil
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from oracles import over_log
from registry_models import STUDIED
from threadpoolctl import threadpool_limits

from fmu_src import export_fmu
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr.extras.one_file.c_header import export_c
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.fit import fit_joint
from hesr_model.fitting.joint_rows import JointRows, non_negative_least_squares
from hesr_model.fitting.separable import Separable
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.compiler import compile_c

Tell = Callable[[str], None]
STEP, ROWS, JOINTS = 0.005, 20000, 6
NETWORKS = ("rbfnn_h", "mlp_h")  # with special kinds of fits


def seconds(*functions: Callable[[], object], rounds: int = 20) -> list[float]:
    """Return the best time of each function [s of CPU]."""
    best = [np.inf] * len(functions)
    for _ in range(rounds):
        for i, function in enumerate(functions):
            start = time.process_time()
            function()
            best[i] = min(best[i], time.process_time() - start)
    return best


@pytest.fixture(scope="module")
def joint(records: dict[str, list[FrictionRecord]]) -> Sequence[FrictionRecord]:
    """The logs of one joint, about 8,000 rows."""
    return [of_joints[0] for of_joints in records.values()]


@pytest.fixture(scope="module")
def fitted(joint: Sequence[FrictionRecord]) -> Callable[[str], FrictionLaw]:
    known: dict[str, FrictionLaw] = {}
    return lambda law: known.setdefault(law, fit_joint(law, joint, seed=0))


def motion() -> dict[str, np.ndarray]:
    t = STEP * np.arange(ROWS)
    joints = [0.9 * np.sin(t + i) * np.sin(2.3 * t) for i in range(JOINTS)]
    dq = np.stack(joints, axis=1)
    q = np.cumsum(dq, axis=0) * STEP
    return {"t": t, "dq": dq, "q": q, "tau_load": 20.0 * np.sin(q)}


@pytest.mark.parametrize("law", [law for law in STUDIED if law not in NETWORKS])
def test_torque_over_a_log(law: str, fitted: Callable[[str], FrictionLaw], tell: Tell) -> None:
    one = {name: values if values.ndim == 1 else values[:, 0] for name, values in motion().items()}
    own = fitted(law)

    def plainly() -> np.ndarray:
        return over_log.predicted(own, **one)

    in_c, oracle = seconds(lambda: predict(own, **one), plainly)
    tell(f"{law} over a log: {in_c / ROWS * 1e9:.1f} ns a row, NumPy {oracle / in_c:.1f} times")
    expected = plainly()
    assert np.abs(predict(own, **one) - expected).max() <= 1e-13 * np.abs(expected).max()


@pytest.mark.parametrize("law", STUDIED)
def test_a_batch_of_robots_compared_with_fmu_steps(
    law: str, fitted: Callable[[str], FrictionLaw], tmp_path: Path, tell: Tell
) -> None:
    """Target: 5 times with AVX2."""
    model = FrictionModel(
        law=law,
        robot="bench",
        joints=("j1", "j2", "j3"),
        laws=(fitted(law),) * 3,
        sample_time=STEP,
    )
    export_c(model, tmp_path / "law.h")
    source = tmp_path / "side_by_side.c"
    shutil.copy(Path(__file__).with_name(source.name), source)
    flags = ("-std=gnu99", "-O3", "-march=x86_64_v3", "-ffp-contract=off")
    compile_c(source, flags, tmp_path / "program", ("-lm",))
    t = STEP * np.arange(ROWS + 1)
    dq = np.sin(np.outer(t[:-1], [1.0, 1.3, 1.7]))
    q = np.cumsum(dq, axis=0) * STEP
    rows = np.stack([dq, q, 20.0 * np.sin(q)], axis=1).reshape(ROWS, -1)
    with FmuInstance(export_bare(model, tmp_path / "F.fmu")) as component:
        names = ("dq", "q", "tau_load")
        inputs = component.buffer([f"{name}[{i}]" for name in names for i in (1, 2, 3)])
        outputs = component.buffer([f"tau[{i}]" for i in (1, 2, 3)])
        component.initialise(start={})
        found: list[float] = []

        def side_by_side() -> None:
            told = subprocess.run(
                [tmp_path / "program", "4096"], capture_output=True, text=True, check=True
            )
            found.append(float(told.stdout))

        def stepped() -> None:
            component.reset()
            component.initialise(start={})
            step_rows(component, inputs, outputs, t[:-1], np.diff(t), rows)

        _, by_steps = seconds(side_by_side, stepped)
    alone = by_steps / ROWS * 1e9
    tell(
        f"{law}, three joints: {min(found):.1f} ns for one of 64 robots; set, step and get of "
        f"the FMU {alone:.0f} ns, {alone / min(found):.1f} times"
    )


@pytest.mark.parametrize(
    "law", ["lugre", "lugre_load", "parfam_hx", "parfam_h", "parfam_s_v", "parfam_v"]
)
def test_a_whole_log_compared_with_single_steps(
    law: str, fitted: Callable[[str], FrictionLaw], tmp_path: Path, tell: Tell
) -> None:
    """Target: 5 times compared with steps in C; equal torque to 1e-14 of its largest value."""
    model = FrictionModel(
        law=law,
        robot="bench",
        joints=tuple(f"j{i}" for i in range(JOINTS)),
        laws=(fitted(law),) * JOINTS,
        sample_time=STEP,
    )
    data = motion()
    names = [f"{name}[{i + 1}]" for name in ("dq", "q", "tau_load") for i in range(JOINTS)]
    rows = np.hstack([data[name] for name in ("dq", "q", "tau_load")])
    first = dict(zip(names, map(float, rows[0]), strict=True))
    t = data["t"]
    with FmuInstance(export_fmu(model, tmp_path / "F.fmu")) as component:
        inputs = component.buffer(names)
        outputs = component.buffer([f"tau[{i + 1}]" for i in range(JOINTS)])
        found = []

        def stepped() -> None:
            component.reset()
            component.initialise(start=first)
            found[:] = [step_rows(component, inputs, outputs, t[:-1], np.diff(t), rows[1:])]

        at_once, by_steps = seconds(lambda: model.predict(**data), stepped)
    torque = model.predict(**data)[1:]
    off = np.abs(torque - found[0]).max() / np.abs(torque).max()
    tell(
        f"{law}, {JOINTS} joints at once: {at_once / ROWS * 1e9:.0f} ns a row, steps of the FMU "
        f"{by_steps / at_once:.1f} times; they differ by {off:.0e} of the largest torque"
    )
    assert off < 1e-14


@pytest.mark.parametrize("law", [law for law in STUDIED if issubclass(registry()[law], OneForm)])
def test_an_evaluation_of_a_fit(law: str, joint: Sequence[FrictionRecord], tell: Tell) -> None:
    entry = registry()[law]
    assert issubclass(entry, OneForm)
    samples = JointRows.from_records(joint, coefficients=3)
    problem = Separable(entry.core({}), entry().space(), samples)
    point, own = problem.bounds.mean(axis=1), problem.space.non_negative

    def plainly() -> object:
        columns = over_log.columns(problem, point)
        return non_negative_least_squares(columns, samples.tau, non_negative=own)

    with threadpool_limits(1):
        in_c, by_numpy = seconds(lambda: problem.solve(point), plainly)
    rows = len(samples.tau)
    tell(f"{law}, columns solved: {in_c / rows * 1e9:.0f} ns a row, NumPy {by_numpy / in_c:.1f}")


@pytest.mark.parametrize(
    ("law", "aim"),
    [("lugre", 0.2), ("lugre_load_ripple", None), ("parfam_hx", 1.2), ("parfam_h", None)],
)
def test_a_fit(law: str, aim: float | None, joint: Sequence[FrictionRecord], tell: Tell) -> None:
    [spent] = seconds(lambda: fit_joint(law, joint, seed=0), rounds=3)
    goal = f" (aim: {aim} s)" if aim else ""
    rows = sum(len(record.t) for record in joint)
    tell(f"fit of {law}, {rows} rows: {spent:.2f} s{goal}")


@pytest.mark.parametrize(("law", "aim"), [("parfam_s", 1.5), ("parfam_s_load", None)])
def test_a_fit_of_stops_compared_with_lugre(
    law: str, aim: float | None, joint: Sequence[FrictionRecord], tell: Tell
) -> None:
    own, lugres = seconds(
        lambda: fit_joint(law, joint, seed=0), lambda: fit_joint("lugre", joint, seed=0)
    )
    goal = f" (aim: {aim})" if aim else ""
    tell(f"fit of {law}: {own / lugres:.2f} of LuGre's{goal}")
