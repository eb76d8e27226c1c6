"""Purely mathematical C, compared with closed forms, multi-precision results and test vectors."""

import ctypes
from ctypes import POINTER, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint64

import mpmath
import numpy as np
import pytest
from pure_c import compiled, function

from hesr_model.logs.noise import standard_normal

# --- noise ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def normal(tmp_path_factory: pytest.TempPathFactory):
    text = """
#include "noise.h"
EXPORT double normal(uint64_t seed, uint64_t stream, uint64_t counter) {
    return standard_normal(seed, stream, counter);
}
"""
    library = compiled(tmp_path_factory.mktemp("noise"), text, "noise.h")
    return function(library, "normal", c_double, c_uint64, c_uint64, c_uint64)


@pytest.mark.parametrize(
    ("seed", "stream", "counter", "expected"),
    [
        (0, 0, 0, 1.9549744116420429),
        (1, 0, 0, 0.84212792483929511),
        (1, 2, 3, 0.96852403952840393),
        (2**64 - 1, 5, 1000000, 2.7082296607715115),
    ],
)
def test_noise_matches_its_definition(normal, seed, stream, counter, expected) -> None:
    assert normal(seed, stream, counter) == pytest.approx(expected, rel=1e-14, abs=0.0)


def test_noise_matches_python(normal) -> None:
    counters = np.arange(300)
    found = [normal(7, 3, int(c)) for c in counters]
    np.testing.assert_allclose(found, standard_normal(7, 3, counters), rtol=1e-13)


# --- functions of generated equations ---------------------------------------------------------


@pytest.fixture(scope="module")
def math(tmp_path_factory: pytest.TempPathFactory):
    """Call a function of law_math.h by name."""
    one = ("sgn", "square", "cube", "positive", "cardinal_sine", "cardinal_slope")
    two, three = ("exceeds", "clip", "decay"), ("share", "share_slope")
    arguments = {n: k for k, names in enumerate((one, two, three), start=1) for n in names}
    text = '#include "law_math.h"\n' + "".join(
        f"EXPORT double the_{name}({', '.join(f'double {x}' for x in 'abc'[:count])}) "
        f"{{ return {name}({', '.join('abc'[:count])}); }}\n"
        for name, count in arguments.items()
    )
    library = compiled(tmp_path_factory.mktemp("math"), text, "law_math.h")
    found = {
        n: function(library, f"the_{n}", c_double, *[c_double] * k) for n, k in arguments.items()
    }
    return lambda name, *values: found[name](*values)


def test_signs_powers_and_bounds_are_right(math) -> None:
    assert [math("sgn", x) for x in (-2.0, -1e-300, 0.0, 1e-300, 3.0)] == [-1, -1, 0, 1, 1]
    assert [math(name, -3.0) for name in ("square", "cube")] == [9.0, -27.0]
    assert [math("positive", x) for x in (-2.0, 0.0, 2.5, float("nan"))] == [0.0, 0.0, 2.5, 0.0]
    assert [math("exceeds", x, 1.0) for x in (0.5, 1.0, 1.5)] == [0.0, 0.0, 1.0]
    assert [math("clip", x, 2.0) for x in (-3.0, -1.0, 0.5, 2.0, 9.0)] == [-2, -1, 0.5, 2, 2]


@pytest.mark.parametrize("z", [1e-300, 1e-9, 1e-4, 0.99e-3, 1.01e-3, 0.02, 0.9, 7.0, 200.0])
def test_relaxation_factors_are_accurate(math, z: float) -> None:
    """exp(-z) - 1, (1 - exp(-z)) / z and its slope, on both sides of the switch to a series."""
    with mpmath.workdps(700):
        x = mpmath.mpf(z)
        left = mpmath.exp(-x)
        falls, taken = float(left - 1), float((1 - left) / x)
        slope = float((left * (x + 1) - 1) / x**2)
    e = math("decay", z, 0.0)
    assert e == pytest.approx(falls, rel=1e-15, abs=0.0)
    assert math("share", z, e, 0.0) == pytest.approx(taken, rel=1e-15, abs=0.0)
    # The quotient loses digits down to the switch.
    accuracy = 1e-15 if z < 1e-3 else 2e-10
    assert math("share_slope", z, e, 0.0) == pytest.approx(slope, rel=accuracy, abs=0.0)
    assert (math("decay", z, 1.0), math("share", z, -z, 1.0)) == (-z, 1.0)
    assert math("share_slope", z, -z, 1.0) == 0.0


@pytest.mark.parametrize("x", [0.0, 1e-300, 1e-9, 0.99e-3, 1.01e-3, 0.02, 0.9, 3.0, 7.0, 200.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_cardinal_sine_and_its_slope_are_accurate(math, x: float, sign: float) -> None:
    with mpmath.workdps(700):
        z = mpmath.mpf(sign * x)
        sine = mpmath.sin(z) / z if x else mpmath.mpf(1)
        slope = (mpmath.cos(z) - sine) / z if x else mpmath.mpf(0)
    assert math("cardinal_sine", sign * x) == pytest.approx(float(sine), rel=1e-15, abs=0.0)
    # The quotient loses digits down to the switch.
    accuracy = 1e-14 if x < 1e-3 else 2e-10
    assert math("cardinal_slope", sign * x) == pytest.approx(float(slope), rel=accuracy, abs=0.0)


def test_a_zero_step_changes_nothing(math) -> None:
    assert [math("decay", 0.0, 0.0), math("share", 0.0, 0.0, 0.0)] == [0.0, 1.0]
    assert math("share_slope", 0.0, 0.0, 0.0) == -0.5


# --- the balance of torques -------------------------------------------------------------------


LAWS = """
#ifndef EQUATIONS_H
#define EQUATIONS_H
enum { JOINTS = 1, COUPLED = 0, BAND = 0, EULER = 2 };
enum { MAX_INPUTS = 4, MAX_STATES = 1, MAX_OUTPUTS = 1 };
static const double forward[1][1] = {{1.0}}, backward[1][1] = {{1.0}};
enum { INERTIA, RATIO, STIFFNESS, DAMPING, TAU_MOTOR, TAU_LOAD, Q_LINK, DQ_LINK, DISCRETISATION,
       FIRST, VARIABLES, SLOPES = DQ_LINK + 1 };
static const struct { const char *name; } variables[VARIABLES] = {{"inertia"}};
typedef struct { double v[VARIABLES], slope[SLOPES]; } Component;
typedef struct {
    const double *constants;
    int first_parameter, first_state, states, inputs, input[MAX_INPUTS];
    void (*attempt)(const double *k, const double *u, const double *x, double h, double euler,
                    const double *du, double *after, double *torque, double *slope);
    int outputs, output[MAX_OUTPUTS];
} Joint;
/* x grows by h k u, twice as much by Euler's; tau = x^2 + u q + 0.1 (load - link) */
static void attempt_of(const double *k, const double *u, const double *x, double h, double euler,
                       const double *du, double *after, double *torque, double *slope) {
    after[0] = x[0] + h * k[0] * u[0] * (1.0 + euler);
    torque[0] = after[0] * after[0] + u[0] * u[1] + 0.1 * (u[2] - u[3]);
    slope[0] = 2.0 * after[0] * h * k[0] * (1.0 + euler) * du[0] + du[0] * u[1] + u[0] * du[1];
}
static const double constants[] = {50.0};
static const Joint joints[] = {{CONSTANT ? constants : 0, FIRST, 0, 1, 4, {0, 0, TAU_LOAD, Q_LINK},
                                attempt_of, 1, {0}}};
#endif
"""
BALANCED = """
#define CONSTANT {constant}
#include "drive_step.h"
EXPORT void tried(const double *values, double h, double time, double v, double *found) {{
    Component component;
    Trial trial;
    for (int i = 0; i < VARIABLES; i++) {{
        component.v[i] = values[i];
    }}
    for (int i = 0; i < SLOPES; i++) {{
        component.slope[i] = values[VARIABLES + i];
    }}
    const Motion from = {{.q = 0.4, .dq = 1.5, .x = {{0.3}}}};
    const Step step = step_of(&component, 0, h, time);
    balance(&step, &from, v, &trial);
    const double all[] = {{trial.v, trial.residual, trial.slope, trial.size, trial.tau_f,
                          trial.tau_link, trial.x[0]}};
    for (int i = 0; i < 7; i++) {{
        found[i] = all[i];
    }}
}}
"""
GIVEN = {"inertia": 0.02, "ratio": 2.0, "stiffness": 30.0, "damping": 0.7, "tau_motor": 4.0,
         "tau_load": -6.0, "q_link": 0.1, "dq_link": 0.3}  # fmt: skip
SLOPES = {"tau_motor": 7.0, "tau_load": 11.0, "q_link": -5.0, "dq_link": 3.0}


@pytest.fixture(scope="module", params=[50.0, 20.0], ids=["constants", "parameters"])
def tried(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory):
    """(v, residual, slope, size, tau_f, tau_link, x) at a given speed, and the coefficient."""
    library = compiled(
        tmp_path_factory.mktemp("balance"),
        BALANCED.format(constant=int(request.param == 50.0)),
        "balance.h",
        "coupling.h",
        "drive_step.h",
        others={"equations.h": LAWS},
    )
    call = function(library, "tried", None, POINTER(c_double), *[c_double] * 3, POINTER(c_double))

    def tried(v: float, *, euler: bool, ratio: float = GIVEN["ratio"]) -> np.ndarray:
        last = [2.0 if euler else 1.0, 20.0]
        given = GIVEN | {"ratio": ratio}
        values = [*given.values(), *last, *(SLOPES.get(name, 0.0) for name in GIVEN), 9.0, 9.0]
        found = (c_double * 7)()
        call((c_double * 20)(*values), 0.01, 0.02, v, found)
        return np.array(found)

    return tried, request.param


@pytest.mark.parametrize("euler", [False, True])
@pytest.mark.parametrize("v", [-40.0, -3.0, -0.4, 0.0, 0.6, 5.0])
@pytest.mark.parametrize("ratio", [2.0, -2.0])
def test_the_torque_balance_matches_its_definition(
    tried, v: float, euler: bool, ratio: float
) -> None:
    """inertia (v - dq) / h - tau_motor + (tau_f + tau_link) / ratio at the end of the step."""
    run, k = tried
    h, time = 0.01, 0.02
    found = run(v, euler=euler, ratio=ratio)
    at = {name: value + time * SLOPES.get(name, 0.0) for name, value in GIVEN.items()}
    u, q = v / ratio, (0.4 + h * v) / ratio
    dx = k * u * (2.0 if euler else 1.0)
    tau_f = (0.3 + h * dx) ** 2 + u * q + 0.1 * (at["tau_load"] - at["q_link"])
    tau_link = 30.0 * (q - at["q_link"]) + 0.7 * (u - at["dq_link"])
    inert = 0.02 * (v - 1.5) / h
    residual = inert - at["tau_motor"] + (tau_f + tau_link) / ratio
    size = abs(inert) + abs(at["tau_motor"]) + (abs(tau_f) + abs(tau_link)) / 2.0
    expected = [v, residual, found[2], size, tau_f, tau_link, 0.3 + h * dx]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("euler", [False, True])
@pytest.mark.parametrize("v", [-3.0, -0.4, 0.6, 5.0])
def test_the_slope_of_the_balance_matches_its_residual(tried, v: float, euler: bool) -> None:
    run, _ = tried
    ends = [run(v + way * 1e-4, euler=euler)[1] for way in (1.0, -1.0)]
    assert run(v, euler=euler)[2] == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-8)


# --- roots ------------------------------------------------------------------------------------


BALANCE = """
#include <math.h>
#include <stdbool.h>
#include "component.h"
typedef struct { int switches_of_joint; } Joint;
typedef struct { const Joint *joint; double h, inertia, gear, tau_motor; } Step;
typedef struct { double dq; } Motion;
typedef struct { double v, residual, slope, size, tau_f, tau_link; } Trial;
static int trials;
static void (*torque)(double v, double *residual, double *slope);
static void balance(const Step *step, const Motion *from, double v, Trial *trial) {
    (void)step, (void)from;
    trials++;
    *trial = (Trial){.v = v, .size = 1.0, .tau_link = 0.25};
    torque(v, &trial->residual, &trial->slope);
    trial->size = fabs(trial->residual) + 1.0;
}
"""
ROOT = """
#include "root.h"
EXPORT bool find(double from, bool jumps, double h, void (*f)(double, double *, double *),
                 double *v, double *tau_f, int *count, char *said) {
    const Joint joint = {.switches_of_joint = jumps};
    const Step step = {.joint = &joint, .h = h, .inertia = 2.0, .gear = 4.0, .tau_motor = 3.0};
    const Motion motion = {.dq = from};
    Message why = {""};
    Trial trial;
    trials = 0;
    torque = f;
    const bool found = solve(&step, &motion, &trial, "dq", &why);
    *v = trial.v, *tau_f = trial.tau_f, *count = trials;
    snprintf(said, 256, "%s", why.text);
    return found;
}
"""
TORQUE = ctypes.CFUNCTYPE(None, c_double, POINTER(c_double), POINTER(c_double))


@pytest.fixture(scope="module")
def find(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("root")
    library = compiled(folder, ROOT, "root.h", others={"balance.h": BALANCE})
    search = function(
        library,
        "find",
        c_bool,
        c_double,
        c_bool,
        c_double,
        TORQUE,
        POINTER(c_double),
        POINTER(c_double),
        POINTER(c_int),
        c_char_p,
    )

    def found(residual, slope, start, *, jumps=False, h=0.01):
        """(speed, number of trials, friction torque, message)."""
        seen = []

        def torque(v, out, by_v):
            seen.append(v)
            out[0], by_v[0] = residual(v), slope(v)

        v, tau_f, count = c_double(), c_double(), c_int()
        said = ctypes.create_string_buffer(256)
        ok = search(start, jumps, h, TORQUE(torque), v, tau_f, count, said)
        assert count.value == len(seen)
        return (v.value if ok else None), count.value, tau_f.value, said.value.decode(), seen

    return found


def test_the_root_of_a_line_is_found_at_once(find) -> None:
    for start in (-3.0, 0.0, 5.0):
        v, trials, *_ = find(lambda v: 4.0 * (v - 1.5), lambda _: 4.0, start, h=100.0)
        assert (v, trials) == (1.5, 2)


@pytest.mark.parametrize(("start", "most"), [(-2.0, 47), (0.3, 16), (4.0, 56)])
def test_roots_of_curves_match_multi_precision_ones(find, start: float, most: int) -> None:
    """The number of trials is limited by curved strides, in 16 pieces each, and Newton steps."""
    v, trials, *_ = find(lambda v: v**3 + v - 3.0, lambda v: 3 * v**2 + 1, start, h=1.0)
    assert v == pytest.approx(1.2134116627622296, rel=1e-14, abs=0.0)
    assert trials <= most


def test_the_nearest_of_several_roots_is_found(find) -> None:
    def wave(v):
        return np.sin(3.0 * v) + 0.1 * v

    def slope(v):
        return 3.0 * np.cos(3.0 * v) + 0.1

    for start, low, high in (
        (-0.5, -0.5, 0.5),
        (0.4, -0.5, 0.4),
        (1.3, 1.0, 2.5),
        (-1.5, -2.5, -1),
    ):
        v, *_ = find(wave, slope, start, h=0.01)
        way = np.linspace(start, start - np.sign(wave(start)) * 4.0, 400001)
        first = way[np.argmax(np.sign(wave(way)) != np.sign(wave(start)))]
        assert v == pytest.approx(first, abs=2e-5), start
        assert abs(wave(v)) < 1e-14
        assert low < v < high


def test_the_zero_of_the_slope_between_two_pieces_is_tried(find) -> None:
    """A notch narrower than a piece: only the intersection of both tangents is below zero."""

    def notch(v):
        return min(1.0, 5.0 * abs(v - 0.53) - 0.02)

    def slope(v):
        return -5.0 * np.sign(v - 0.53) if notch(v) < 1.0 else 0.0

    v, _, _, _, seen = find(lambda v: -notch(v), slope, 0.0, h=2.0)
    assert v == pytest.approx(0.526, abs=1e-9)
    assert 0.53125 in seen


def test_a_stride_across_two_roots_is_retraced(find) -> None:
    """The residual is below zero only in a valley that one long stride skips."""

    def valley(v):
        return 1.0 - v - 1.2 * np.exp(-(((v - 0.5) / 0.05) ** 2)) if v < 0.8 else 0.2

    def residual(v):
        return -valley(v)

    def slope(v):
        return -(valley(v + 1e-7) - valley(v - 1e-7)) / 2e-7

    v, *_ = find(residual, slope, 0.0, h=1.0)
    assert residual(v) == pytest.approx(0.0, abs=1e-9)
    assert 0.4 < v < 0.5


@pytest.mark.parametrize("level", [0.2, 0.99, -0.5])
def test_coulomb_friction_holds_at_rest(find, level: float) -> None:
    """Coulomb friction of 1 against a smaller torque: zero speed, friction equals the torque."""
    v, trials, tau_f, *_ = find(
        lambda v: np.sign(v) + 0.1 * v - level, lambda _: 0.1, 0.4, jumps=True
    )
    assert v == 0.0
    # (tau_motor - inertia / h (v - dq)) / gear - tau_link
    assert tau_f == pytest.approx((3.0 + 2.0 / 0.01 * 0.4) / 4.0 - 0.25)
    assert trials < 20


def test_coulomb_friction_slides_above_its_limit(find) -> None:
    v, *_ = find(lambda v: np.sign(v) + 0.1 * v - 1.3, lambda _: 0.1, -0.4, jumps=True)
    assert v == pytest.approx(3.0, rel=1e-12, abs=0.0)
    v, *_ = find(lambda v: np.sign(v) + 0.1 * v + 1.3, lambda _: 0.1, 0.4, jumps=True)
    assert v == pytest.approx(-3.0, rel=1e-12, abs=0.0)


def test_a_missing_root_is_reported(find) -> None:
    v, trials, _, said, _ = find(lambda v: -1.0 - v**2, lambda v: -2.0 * v, 0.0)
    assert v is None
    assert said.startswith(
        ("dq: no speed was found that balances", "dq: the torques are not finite")
    )
    v, trials, _, said, _ = find(lambda _: float("nan"), lambda _: 1.0, 0.0)
    assert (v, trials) == (None, 1)
    assert said.startswith("dq: the torques are not finite in a step of 0.01 s; it keeps")


def test_strides_double_until_the_sign_changes(find) -> None:
    """If Newton's step exceeds h / inertia times the torque, or leads backwards."""
    _, _, _, _, seen = find(
        lambda v: np.arctan(v - 1.0),
        lambda v: -1.0 if v < 0.5 else 1.0 / (1.0 + (v - 1.0) ** 2),
        0.0,
        h=0.02,
    )
    first = 0.01 * np.arctan(1.0)
    for end in first * (2.0 ** np.arange(1, 6) - 1.0):
        assert min(abs(v - end) for v in seen) < 1e-12


# --- files ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def path_of(tmp_path_factory: pytest.TempPathFactory):
    text = """
#include "resource.h"
EXPORT bool place(const char *uri, const char *name, char *path, size_t size) {
    return path_of_resource(uri, name, path, size);
}
"""
    library = compiled(tmp_path_factory.mktemp("resource"), text, "resource.h")
    place = function(library, "place", c_bool, c_char_p, c_char_p, c_char_p, c_size_t)

    def path_of(uri: str | None, size: int = 64) -> str | None:
        path = ctypes.create_string_buffer(size)
        ok = place(None if uri is None else uri.encode(), b"m.mjb", path, size)
        return path.value.decode() if ok else None

    return path_of


@pytest.mark.parametrize(
    ("uri", "expected"),
    [
        ("file:/a/b", "/a/b/m.mjb"),
        ("file:///a/b", "/a/b/m.mjb"),
        ("file://localhost/a/b", "/a/b/m.mjb"),
        ("/a/b", "/a/b/m.mjb"),
        ("file:///a%20b%2Fc%2fd%7e", "/a b/c/d~/m.mjb"),
        ("file:///a%2", "/a%2/m.mjb"),
        ("file:///a%g0%0g", "/a%g0%0g/m.mjb"),
        ("/a%20b", "/a%20b/m.mjb"),
        ("file://localhost", None),
        ("file:", None),
        ("", None),
        (None, None),
    ],
)
def test_resource_paths_are_resolved(path_of, uri, expected) -> None:
    assert path_of(uri) == expected


@pytest.mark.parametrize(("size", "fits"), [(11, True), (10, False), (6, False), (4, False)])
def test_an_overlong_resource_path_is_refused(path_of, size: int, fits: bool) -> None:
    """ "/a/b/m.mjb" has ten characters and a terminator."""
    assert path_of("/a/b", size) == ("/a/b/m.mjb" if fits else None)
