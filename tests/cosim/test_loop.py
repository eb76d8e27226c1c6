"""Co-simulation compared with the same loop without FMI and with exact solutions."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from closed_loop import MOTION, Bench
from oracles.monolithic import run_loop
from scipy.linalg import expm

from cosim.loop.closed_loop import Scheme
from cosim.systems.signals import Signals
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec
from fmu_src import export_fmu
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.motions.trajectories import Sine, chirp


def run(spec: SystemSpec) -> Signals:
    with Master(spec) as master:
        return master.run().require_success()


def difference(bench: Bench, loop: Any) -> float:
    """Largest position difference between co-simulation and monolithic loop [rad]."""
    expected, result = run_loop(loop), run(bench.system(loop))
    np.testing.assert_allclose(result.t, expected.t, rtol=1e-15)
    np.testing.assert_allclose(result.vector("trajectory.q"), expected.q_d, atol=1e-12)
    np.testing.assert_allclose(result.vector("controller.dq_cmd"), expected.dq_cmd, atol=1e-8)
    error = np.abs(expected.q_d - expected.q_true)
    assert 1e-4 < error.max() < 0.2  # the loop follows a motion that is not trivial
    return float(np.abs(result.vector("arm.q_true") - expected.q_true).max())


@pytest.mark.parametrize(
    "scheme",
    [
        Scheme(compensation="none"),
        Scheme(compensation="none", Kx=5.0),
        Scheme(compensation="torque_error"),
        Scheme(compensation="torque_error", Kx=5.0),
        Scheme(compensation="servo_inversion"),
        Scheme(compensation="servo_inversion", Kx=5.0, friction_gain=0.8),
        Scheme(compensation="torque_error", source="measured"),
        Scheme(compensation="torque_error", source="filtered"),
        Scheme(compensation="servo_inversion", source="filtered"),
    ],
    ids=lambda scheme: scheme.name,
)
def test_ten_seconds_agree_with_the_loop_without_fmi(bench: Bench, scheme: Scheme) -> None:
    assert difference(bench, bench.loop(scheme)) <= 1e-10


@pytest.mark.parametrize("compensation", ["torque_error", "servo_inversion"])
@pytest.mark.parametrize(
    "motion",
    [
        Sine(offset=MOTION.offset, amplitude=np.array([0.8, 0.0, 0.9]), frequency=0.5, periods=9),
        chirp(
            start=MOTION.offset - 0.2,
            amplitude=np.array([0.5, 0.6, 0.7]),
            first=0.2,
            last=1.0,
            length=5.0,
        ),
    ],
    ids=["sine", "chirp"],
)
def test_other_motions_agree(bench: Bench, motion: Any, compensation: Any) -> None:
    """Their acceleration jumps at the end of the rest, at a time that rounding may miss."""
    loop = bench.loop(Scheme(compensation=compensation, Kx=5.0), motion=motion, stop=4.0)
    assert difference(bench, loop) <= 1e-10


@pytest.fixture(scope="module")
def lugre_bench(bench: Bench, tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """The loop with LuGre friction, whose state is much faster than a step."""
    units = {"sigma_0": "N.m/rad", "sigma_1": "N.m.s/rad", "F_c": "N.m"}
    own = tuple(Coefficient(name=n, unit=u, description=n) for n, u in units.items())
    sigma_0, sigma_1, level = (c.symbol for c in own)
    z = Relaxation(name="z", unit="rad", drive=DQ, rate=sigma_0 * absolute(DQ) / level)
    form = LawForm(
        coefficients=own, memory=(z,), output=sigma_0 * z.state + sigma_1 * z.derivative + DQ
    )
    laws = tuple(
        FrictionLaw(name="lugre", form=form, values={"sigma_0": s, "sigma_1": 1.5, "F_c": f})
        for s, f in ((2e4, 9.6), (3e4, 12.1), (1e4, 5.5))
    )
    model = FrictionModel(
        law="lugre",
        robot="uf850",
        joints=("joint1", "joint2", "joint3"),
        laws=laws,
        sample_time=0.005,
    )
    fmu = export_fmu(model, tmp_path_factory.mktemp("lugre") / "Friction.fmu")
    return replace(bench, friction=model, fmus=replace(bench.fmus, friction=fmu))


@pytest.mark.parametrize("source", ["desired", "filtered"])
def test_another_law_agrees(lugre_bench: Bench, source: Any) -> None:
    loop = lugre_bench.loop(Scheme(compensation="servo_inversion", source=source), stop=4.0)
    assert difference(lugre_bench, loop) <= 1e-10


def test_the_oracle_detects_a_gain_error(bench: Bench) -> None:
    """A gain error of 0.5 % exceeds the tolerance a hundred thousand times."""
    loop = bench.loop(Scheme(compensation="servo_inversion"), stop=2.0)
    spec = bench.system(loop)
    changed = {"Kv": (90.5 * 1.005, 150.8, 52.8)}
    with Master(spec) as master:
        result = master.run(start={"controller": changed}).require_success()
    assert np.abs(result.vector("arm.q_true") - run_loop(loop).q_true).max() > 1e-5


def test_runs_of_one_master_are_identical(bench: Bench) -> None:
    """Parameters of another run in between must not remain set."""
    spec = bench.system(bench.loop(Scheme(compensation="torque_error"), stop=1.0))
    with Master(spec) as master:
        first = master.run().require_success()
        other = master.run(start={"arm": {"noise_seed[1]": 7, "friction_scale": 1.3}})
        again = master.run().require_success()
    for name, values in first.signals.items():
        np.testing.assert_array_equal(values, again.signals[name])
    assert np.abs(other.vector("arm.q_true") - first.vector("arm.q_true")).max() > 1e-4


def test_a_loop_that_diverges_is_stopped_at_its_limits(bench: Bench) -> None:
    """Time and joint are named, and earlier rows are kept."""
    q = MOTION.sample(np.linspace(0.0, 10.0, 500))[0]
    limits = {"arm.q_true": tuple(zip(q.min(axis=0) - 0.1, q.max(axis=0) + 0.1, strict=True))}
    loop = bench.loop(Scheme(compensation="torque_error"))
    with Master(bench.system(loop, limits=limits)) as master:
        assert master.run().failure is None
        result = master.run(start={"controller": {"Kp": (0.0, 0.2, 0.0)}})
    assert re.search(
        r"\d\.\d+ s arm\.q_true\[2\] is -?\d\.\d+, outside",
        str(result.failure),
    )
    assert 10 < len(result.t) < 2001
    assert np.isfinite(result.vector("arm.q_true")).all()


# --- order of convergence ---------------------------------------------------------------------

LAGS = {"a": 0.5, "b": 0.3}
START = {"a": 1.0, "b": -0.4}


def lags(fmu: Any, step: float, order: str) -> SystemSpec:
    """Two coupled lags."""
    return SystemSpec.model_validate(
        {
            "step": step,
            "stop": 1.2,
            "order": order,
            "components": [
                {"name": name, "fmu": fmu, "start": {"T": LAGS[name], "x_start": START[name]}}
                for name in LAGS
            ],
            "connections": {"a.u": "b.y", "b.u": "a.y"},
            "observe": ["a.y", "b.y"],
        }
    )


@pytest.mark.parametrize("order", ["gauss_seidel", "jacobi"])
def test_couplings_hold_values_by_call_order(lag_fmu: Any, order: str) -> None:
    """Compared with the recurrence: with Jacobi, each lag uses the other's previous value."""
    step, count = 0.1, 12
    keep = {name: np.exp(-step / T) for name, T in LAGS.items()}
    a, b = [START["a"]], [START["b"]]
    for _ in range(count):
        before = a[-1]
        a.append(keep["a"] * a[-1] + (1.0 - keep["a"]) * b[-1])
        seen = before if order == "jacobi" else a[-1]
        b.append(keep["b"] * b[-1] + (1.0 - keep["b"]) * seen)
    result = run(lags(lag_fmu, step, order))
    np.testing.assert_allclose(result.signals["a.y"], a, atol=1e-14)
    np.testing.assert_allclose(result.signals["b.y"], b, atol=1e-14)


def orders(errors: list[float]) -> np.ndarray:
    """Order of convergence between runs with halved steps."""
    return -np.diff(np.log2(errors))


@pytest.mark.parametrize("order", ["gauss_seidel", "jacobi"])
def test_coupled_lags_converge(lag_fmu: Any, order: str) -> None:
    """At least first order towards the exact solution of the coupled system."""
    matrix = np.array([[-1.0, 1.0], [1.0, -1.0]]) / np.array(list(LAGS.values()))[:, None]
    errors = []
    for step in (0.1, 0.05, 0.025, 0.0125, 0.00625):
        result = run(lags(lag_fmu, step, order))
        exact = np.array([expm(matrix * t) @ list(START.values()) for t in result.t])
        found = np.column_stack([result.signals["a.y"], result.signals["b.y"]])
        errors.append(float(np.abs(found - exact).max()))
    assert errors[-1] < 0.01
    assert orders(errors).min() > 0.9, errors


QUIET = {"q_noise": (0.0, 0.0, 0.0), "tau_meas_noise": (0.0, 0.0, 0.0)}


@pytest.mark.parametrize("compensation", ["none", "torque_error"])
def test_the_closed_loop_converges(bench: Bench, compensation: Any) -> None:
    """At least first order towards the loop at the arm's own step, without noise."""
    motion = Sine(offset=MOTION.offset, amplitude=np.array([0.8, 0.7, 0.9]), frequency=0.5)

    def positions(step: float) -> np.ndarray:
        gains = bench.loop(Scheme(compensation=compensation)).gains
        without_rate = gains.model_copy(update={"Kd": (0.0, 0.0, 0.0)})
        loop = bench.loop(
            Scheme(compensation=compensation, Kx=5.0),
            motion=motion,
            step=step,
            stop=2.0,
            gains=without_rate,
        )
        with Master(bench.system(loop)) as master:
            result = master.run(start={"arm": QUIET}).require_success()
        return result.vector("arm.q_true")[:: round(0.016 / step)]

    fine = positions(0.001)
    errors = [float(np.abs(positions(step) - fine).max()) for step in (0.016, 0.008, 0.004)]
    assert errors[-1] < 5e-3
    assert orders(errors).min() > 0.9, errors
