"""Equations over rows in C against NumPy, function by function and form by form."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import mpmath
import numpy as np
import pytest
import sympy
from joint_data import law, training
from oracles import over_log
from oracles.over_log import StatesOverLog

from hesr_model.equations import rows as rows_module
from hesr_model.equations.functions import (
    absolute,
    cardinal_sine,
    clip,
    exceeds,
    larger,
    over,
    positive,
    sgn,
    to_numpy_function,
)
from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import Discretisation, Element, Relaxation, Stop
from hesr_model.errors import ArtifactError, ExportError, SimulationError
from hesr_model.fitting.joint_rows import JointRows, non_negative_least_squares
from hesr_model.fitting.separable import Separable
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.laws.lugre import LuGre, LuGreLoad
from hesr_model.laws.ripple import Ripple
from hesr_model.support.compiler import MISSING_COMPILER

U, V, K = sympy.symbols("u v k", real=True)
ROWS = 1000  # not a multiple of a block or a vector


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def rows_of(
    wanted: list[sympy.Expr],
    u: np.ndarray,
    v: np.ndarray | None = None,
    *,
    memory: tuple[Element, ...] = (),
    begins: np.ndarray | None = None,
    dt: float = 0.01,
    euler: bool = False,
    target: np.ndarray | None = None,
) -> KernelRun:
    return KernelRun(
        Kernel(memory, (K,), (U, V), wanted),
        (u, np.zeros_like(u) if v is None else v),
        np.full(len(u), dt),
        [0] if begins is None else np.flatnonzero(begins),
        euler=euler,
        target=target,
    )


def values(expression: sympy.Expr, u: np.ndarray, k: float = 1.0) -> np.ndarray:
    return rows_of([expression], u).evaluate(np.array([k]))[:, 0].copy()


# --- elementary functions ---------------------------------------------------------------------

EXACT: dict[str, tuple[Callable[..., sympy.Expr], Callable[..., mpmath.mpf], float]] = {
    "exp": (sympy.exp, mpmath.exp, 700.0),
    "tanh": (sympy.tanh, mpmath.tanh, 25.0),
    "sin": (sympy.sin, mpmath.sin, 1e6),
    "cos": (sympy.cos, mpmath.cos, 1e6),
    "cardinal sine": (cardinal_sine, lambda x: mpmath.sin(x) / x, 50.0),
}


@pytest.mark.parametrize("name", EXACT)
def test_elementary_functions_are_exact_to_the_last_digits(
    name: str, rng: np.random.Generator
) -> None:
    """1e-15 relative; for sines relative to 1, because they have no digits at their zeros."""
    function, exact, limit = EXACT[name]
    size = np.concatenate([np.geomspace(1e-300, limit, 700), rng.uniform(0.1, limit, 800)])
    u = size * rng.choice([-1.0, 1.0], len(size))
    expected = np.array([float(exact(mpmath.mpf(x))) for x in u])
    scale = np.abs(expected) if name in ("exp", "tanh") else 1.0
    error = np.abs(values(function(K * U), u) - expected) / scale
    assert error.max() < 1e-15


@pytest.mark.parametrize("wide", [1, 3])
def test_results_are_written_to_the_given_array(rng: np.random.Generator, wide: int) -> None:
    u = rng.normal(size=ROWS)
    kernel = Kernel((), (K,), (U, V), [K * U])
    room = np.full((ROWS + 8, wide), np.nan)
    rows = KernelRun(kernel, (u, u), np.full(ROWS, 0.01), [0], euler=False, output=room[4:-4, -1:])
    rows.evaluate(np.array([3.0]))
    np.testing.assert_array_equal(room[4:-4, -1], 3.0 * u)
    room[4:-4, -1] = np.nan
    assert np.isnan(room).all()


def test_exp_of_denormals_is_as_exact_as_they_allow() -> None:
    u = np.linspace(-746.0, -700.0, ROWS)
    expected = [float(mpmath.exp(mpmath.mpf(x))) for x in u]
    np.testing.assert_allclose(values(sympy.exp(K * U), u), expected, rtol=1e-15, atol=1e-323)


def test_infinities_and_nan() -> None:
    u = np.array([np.inf, -np.inf, np.nan, 1e6, -1e6, 0.0, 710.0, -750.0])
    with np.errstate(over="ignore", under="ignore"):
        np.testing.assert_array_equal(values(sympy.exp(K * U), u), np.exp(u))
    np.testing.assert_array_equal(values(sympy.tanh(K * U), u), np.tanh(u))
    np.testing.assert_array_equal(values(positive(K * U), u), np.where(u > 0.0, u, 0.0))


def test_relaxation_factors_match_rate_and_step(rng: np.random.Generator) -> None:
    """expm1 and the share of a step, from negligible rates to those that erase the state."""
    rates = np.concatenate([[0.0], np.geomspace(1e-12, 1e5, ROWS - 1)])
    x = Relaxation(name="x", unit="1", drive=U / U, rate=U)
    moved = [
        rows_of([x.state], np.array([1.0, r]), memory=(x,)).evaluate(
            np.ones(1), np.array([0.5]), settled=True
        )[1, 0]
        for r in rates
    ]
    z = [mpmath.mpf(r) * mpmath.mpf(0.01) for r in rates]
    share = [-mpmath.expm1(-s) / s if s else mpmath.mpf(1) for s in z]
    expected = [
        float(0.5 * mpmath.exp(-s) + mpmath.mpf(0.01) * p) for s, p in zip(z, share, strict=True)
    ]
    np.testing.assert_allclose(moved, expected, rtol=1e-15, atol=1e-16)


# --- expressions ------------------------------------------------------------------------------

EXPRESSIONS = {
    "sum": 3 * U - 2 * V + K - sympy.Rational(1, 3) - U * V,
    "negative sum": -U - V - K,
    "product": -2 * K * U**2 * V / (7 * (1 + V**2)),
    "powers": U**5 + V**-3 + sympy.sqrt(1 + U**2) + (1 + V**2) ** -2 + U**0,
    "numbers": sympy.pi * K + sympy.E + sympy.Float(0.1) * U,
    "bends": absolute(U) + sgn(V) + positive(U - K) + exceeds(U, V) - positive(-V),
    "bounds": clip(U, absolute(V)) + larger(U, V) + over(U, V, K),
    "shared": sympy.exp(-(U**2)) * V + K * sympy.exp(-(U**2)),
    "nested": sympy.tanh(sympy.sin(U) + sympy.cos(K * V) ** 2) / (1 + absolute(sympy.tanh(V))),
    "of a number alone": sympy.exp(K) * sympy.tanh(K),
    "an input": V,
    "a literal": sympy.Integer(2),
    "power functions": absolute(U) ** K + absolute(U) ** V + U**9 + positive(U) ** 1.5,
    "functions of the C library": sympy.log(1 + U**2) * sympy.log(K)
    + sympy.sinh(U)
    - sympy.cosh(V)
    + sympy.atan(U)
    + sympy.erf(2),
}


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_an_expression_equals_numpy(name: str, rng: np.random.Generator) -> None:
    u, v = rng.normal(size=(2, ROWS))
    v[::50] = 0.1
    expression, k = EXPRESSIONS[name], 0.7
    expected = np.broadcast_to(to_numpy_function((K, U, V), [expression])(k, u, v)[0], u.shape)
    found = rows_of([expression], u, v).evaluate(np.array([k]))[:, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def test_several_results_of_one_function(rng: np.random.Generator) -> None:
    """Registers are reused, except those of results; a result may be part of another."""
    u, v = rng.normal(size=(2, ROWS))
    every = list(EXPRESSIONS.values())
    wanted = [*every, sum(every[:3]), every[0], every[0] * every[1]]
    found = rows_of(wanted, u, v).evaluate(np.array([0.7])).copy()
    expected = to_numpy_function((K, U, V), wanted)(0.7, u, v)
    for column, e in zip(found.T, expected, strict=True):
        np.testing.assert_allclose(column, np.broadcast_to(e, u.shape), rtol=1e-12, atol=1e-12)
    again = rows_of(wanted, u, v)
    again.evaluate(np.array([3.0]))
    np.testing.assert_array_equal(again.evaluate(np.array([0.7])), found)


def test_an_unsupported_function_is_refused() -> None:
    with pytest.raises(ArtifactError, match=r"'erf\(u\)' uses the function 'erf', which cannot"):
        Kernel((), (K,), (U, V), [1 + sympy.erf(U)])


def test_large_angles_use_the_c_library() -> None:
    for function, exact in ((sympy.sin, math.sin), (sympy.cos, math.cos)):
        u = np.linspace(0.0, 1.0, ROWS)
        found = rows_of([function(K * U)], u).evaluate(np.array([1e9]))[:, 0]
        np.testing.assert_allclose(found, [exact(x) for x in 1e9 * u], rtol=0, atol=1e-15)
    found = rows_of([cardinal_sine(K * U)], u).evaluate(np.array([1e9]))[1:, 0]
    expected = [math.sin(x) / x for x in 1e9 * u[1:]]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-23)


def test_inputs_of_other_lengths_are_refused() -> None:
    """C would read past their end."""
    kernel = Kernel((), (K,), (U, V), [K * U + V])
    with pytest.raises(ValueError, match="broadcast"):
        KernelRun(kernel, (np.ones(ROWS - 1), np.ones(ROWS)), np.ones(ROWS), [0])
    with pytest.raises(ValueError, match="broadcast"):
        rows_of([K * U], np.ones(ROWS), target=np.ones(ROWS + 1))
    with pytest.raises(ValueError, match="broadcast"):
        predict(
            law(
                "lugre",
                {},
                sigma_0=3e3,
                sigma_1=20.0,
                sigma_2=6.0,
                F_c=9.0,
                F_s=12.0,
                v_s=0.1,
                tau_0=0.4,
            ),
            t=np.arange(5.0),
            dq=np.ones(4),
        )


def test_columns_of_a_table_are_read_in_place(rng: np.random.Generator) -> None:
    table = rng.normal(size=(ROWS, 3))
    found = rows_of([K * U + V], table[:, 0], table[:, 2]).evaluate(np.array([2.0]))[:, 0]
    np.testing.assert_array_equal(found, 2.0 * table[:, 0] + table[:, 2])
    halves = rows_of([K * U], table[::-1, 1]).evaluate(np.array([2.0]))[:, 0]
    np.testing.assert_array_equal(halves, 2.0 * table[::-1, 1])
    single = rows_of([K * U], np.full(ROWS, 1, dtype=np.float32)).evaluate(np.array([2.0]))[:, 0]
    np.testing.assert_array_equal(single, np.full(ROWS, 2.0))


# --- memory -----------------------------------------------------------------------------------

_x = Relaxation(name="x", unit="1", drive=K * U, rate=1 + absolute(5 * U))
_own = Relaxation(name="y", unit="1", drive=U, rate=3 + absolute(sympy.Symbol("y", real=True) * V))
_after = Relaxation(name="z", unit="1", drive=_x.state, rate=sympy.Integer(4) * positive(V))
_stop = Stop(name="s", unit="1", velocity=U, deflection=sympy.Float(0.02), bound=1 + V / 4)
_aged = Stop(name="w", unit="1", velocity=U, deflection=sympy.Float(0.05), bound=positive(_x.state))
MEMORY: dict[str, tuple[Element, ...]] = {
    "a relaxation": (_x,),
    "one whose rate sees it": (_own,),
    "one after the other": (_x, _after),
    "a stop": (_stop,),
    "a stop whose bound is a state": (_x, _aged, _stop),
    "all of them": (_x, _own, _after, _stop, _aged),
}


@pytest.mark.parametrize("discretisation", ["exact", "euler"])
@pytest.mark.parametrize("name", MEMORY)
def test_states_and_their_derivatives_equal_numpy(
    name: str, discretisation: Discretisation, rng: np.random.Generator
) -> None:
    memory = MEMORY[name]
    u, v = rng.normal(size=(2, ROWS))
    begins = np.isin(np.arange(ROWS), [0, 1, 127, 128, 500])
    states = [s for m in memory for s in (m.state, m.derivative)]
    rows = rows_of(states, u, v, memory=memory, begins=begins, euler=discretisation == "euler")
    start = np.linspace(0.1, 0.3, len(memory))
    found = rows.evaluate(np.array([2.0]), start, settled=True)
    oracle = StatesOverLog(memory, (K, U, V), states)
    expected = oracle((2.0, u, v), np.full(ROWS, 0.01), begins, list(start), discretisation)
    for column, e in zip(found.T, expected, strict=True):
        np.testing.assert_allclose(column, e, rtol=0, atol=1e-13 * max(1.0, np.abs(e).max()))


def test_initial_states_equal_numpy(rng: np.random.Generator) -> None:
    u, v = rng.normal(size=(2, 300))
    begins = np.isin(np.arange(300), [0, 40, 200])
    settling = clip(absolute(U), 1)
    for memory in MEMORY.values():
        kernel = Kernel(memory, (K,), (U, V), [m.state for m in memory], settling)
        rows = KernelRun(kernel, (u, v), np.full(300, 0.01), np.flatnonzero(begins))
        start = np.full(len(memory), 0.2)
        found = rows.evaluate(np.array([2.0]), start)[begins]
        oracle = StatesOverLog(memory, (K, U, V), [], settling)
        expected = oracle.beginning((2.0, u[begins], v[begins]), list(start))
        for column, e in zip(found.T, expected, strict=True):
            np.testing.assert_allclose(column, e, rtol=1e-13, atol=1e-13)


def test_an_unstable_euler_step_is_refused() -> None:
    rows = rows_of([_x.state], np.full(ROWS, 20.0), memory=(_x,), euler=True)
    with pytest.raises(SimulationError, match=r"\* step < 1, found 1\.01"):
        rows.evaluate(np.array([1.0]))
    values_of = {"sigma_0": 3000.0, "sigma_1": 20.0, "sigma_2": 6.0, "F_c": 9.0, "F_s": 12.0,
                 "v_s": 0.1, "tau_0": 0.4}  # fmt: skip
    made = FrictionLaw(name="made", form=LuGre.core({}), values=values_of, discretisation="euler")
    with pytest.raises(SimulationError, match=r"\* step < 1, found 33\.3"):
        predict(made, t=np.arange(50) * 0.1, dq=np.ones(50))


# --- machines ---------------------------------------------------------------------------------


@pytest.mark.parametrize("host", rows_module.HOSTS, ids=" ".join)
def test_every_machine_has_a_library(host: tuple[str, str], tmp_path: Path) -> None:
    data = rows_module.compile_rows(tmp_path, host).read_bytes()
    assert all(name in data for name in (b"run", b"solve", b"widest"))


def test_vector_width_does_not_change_a_bit(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    u, v, tau = rng.normal(size=(3, ROWS))
    wanted = [*EXPRESSIONS.values(), _x.state, _stop.state, _x.derivative]
    rows = rows_of(wanted, u, v, memory=(_x, _stop), target=tau)
    widest = rows_module.vectors()
    every = []
    for width in range(widest + 1):
        monkeypatch.setattr(rows_module, "vectors", lambda width=width: width)
        solved = rows.fit_factors(np.array([0.7]), non_negative=0, keep=True)
        every.append((rows.results.tobytes(), rows.gram.tobytes(), str(solved)))
    assert all(one == every[0] for one in every)


@pytest.fixture
def no_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    def fails(*_: object) -> None:
        raise ExportError(
            "the C compiler cannot be run (No such file or directory).", code=MISSING_COMPILER
        )

    monkeypatch.setattr(rows_module, "compile_c", fails)
    rows_module.library.cache_clear()
    yield
    rows_module.library.cache_clear()


@pytest.mark.usefixtures("no_compiler")
def test_a_missing_compiler_is_refused() -> None:
    made = law(
        "lugre", {}, sigma_0=3e3, sigma_1=20.0, sigma_2=6.0, F_c=9.0, F_s=12.0, v_s=0.1, tau_0=0.4
    )
    with pytest.raises(
        ExportError,
        match=r"'ziglang' is missing: .*No such file",
    ):
        predict(made, t=np.arange(5.0), dq=np.ones(5))


def test_an_unsupported_machine_is_refused(
    no_compiler: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    del no_compiler
    monkeypatch.setattr(rows_module, "HOSTS", {("linux", "x86_64"): ("x", ".so")})
    monkeypatch.setattr(rows_module.platform, "machine", lambda: "m68k")
    with pytest.raises(ExportError, match=r"cannot be run on .* m68k; supported are linux x86_64"):
        rows_module.library()


# --- least squares ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def samples() -> JointRows:
    made = law(
        "lugre", {}, sigma_0=3e3, sigma_1=20.0, sigma_2=6.0, F_c=9.0, F_s=12.0, v_s=0.1, tau_0=0.4
    )
    return JointRows.from_records(training(made, noise=0.1), coefficients=3)


def test_factors_solve_the_least_squares_problem(samples: JointRows) -> None:
    """With none, some and all factors constrained to be non-negative."""
    problem = Separable(LuGreLoad.core({}), LuGreLoad().space(), samples)
    point = problem.point({"deflection": 3e-3, "ratio": 0.7, "v_s": 0.2})
    columns = problem.columns(point)
    rows, held = problem._run, 0
    for non_negative in range(6):
        found = rows.fit_factors(problem.numbers(point), non_negative=non_negative)
        assert found is not None
        x, squares = non_negative_least_squares(columns, samples.tau, non_negative=non_negative)
        held += int(np.sum(x == 0.0))
        np.testing.assert_allclose(found[0], x, rtol=1e-9, atol=1e-9 * np.abs(x).max())
        assert math.isclose(found[1], squares, rel_tol=1e-9)
    assert held, "no factor was at its bound"


def test_rows_are_weighted(samples: JointRows) -> None:
    problem = Separable(LuGre.core({}), LuGre().space(), samples)
    point = problem.point({"deflection": 3e-3, "ratio": 1.4, "v_s": 0.1})
    weights = (samples.log_index == 0).astype(float)
    found = problem._residual(point, weights)
    columns, own = over_log.columns(problem, point), problem.space.non_negative
    x, _ = non_negative_least_squares(
        weights[:, None] * columns, weights * samples.tau, non_negative=own
    )
    expected = columns @ x - samples.tau
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    assert np.abs(found - problem._residual(point, np.ones_like(weights))).max() > 1e-3


def test_poorly_determined_factors_are_not_solved_for(rng: np.random.Generator) -> None:
    u, tau = rng.normal(size=(2, ROWS))
    twice = rows_of([K * U, U + U], u, target=tau)
    assert twice.fit_factors(np.ones(1), non_negative=0) is None
    nothing = rows_of([K * U, 0 * U], u, target=tau)
    assert nothing.fit_factors(np.ones(1), non_negative=0) is None


def test_a_search_ends_at_the_point_of_numpy(samples: JointRows) -> None:
    class InNumPy(Separable):
        def columns(self, point: np.ndarray) -> np.ndarray:
            return over_log.columns(self, point)

        def solve(self, point: np.ndarray) -> tuple[np.ndarray, float]:
            return non_negative_least_squares(
                self.columns(point), samples.tau, non_negative=self.space.non_negative
            )

        def _residual(self, point: np.ndarray, weights: np.ndarray | None) -> np.ndarray:
            assert weights is None
            return self.columns(point) @ self.solve(point)[0] - samples.tau

    def found(of: type[Separable]) -> np.ndarray:
        problem = of(LuGre.core({}), LuGre().space(), samples)
        point = problem.polish(problem.search(np.random.default_rng(0), effort=8))
        return np.concatenate([point, problem.solve(point)[0]])

    np.testing.assert_allclose(found(Separable), found(InNumPy), rtol=1e-5)


def test_ripple_at_large_angles_equals_numpy(samples: JointRows) -> None:
    waves = Ripple(gear_ratio=1e7, orders=(1,))
    plain = Separable(LuGre.core({}), LuGre().space(), samples)
    form, space = waves.extend(plain.form), waves.extend_space(plain.space)
    numbers = {"deflection": 3e-3, "ratio": 1.4, "v_s": 0.1, "lag": 1e-3, "smoothing": 1e-3}
    problem = Separable(form, space, samples)
    columns = problem.columns(problem.point(numbers))
    expected = over_log.columns(problem, problem.point(numbers))
    np.testing.assert_allclose(columns, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
