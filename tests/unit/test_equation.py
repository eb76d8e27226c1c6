"""Laws as printed equations: the text computes the same as the law."""

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from joint_data import GEAR_RATIO, HX_BRISTLE, law

from hesr_model.friction.law import FrictionLaw, coefficient_lines, equations, find_held
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict

UNIT = {"g": "sin", "arguments": ["1", "dq", "h", "dh"]}

LAWS = {
    "stribeck": law("stribeck", {}, F_c=6.0, F_s=9.1234567, v_s=0.1, sigma_2=4.0, tau_0=-0.3),
    "lugre": law(
        "lugre", {}, sigma_0=2500.0, sigma_1=10.0, sigma_2=6.0, F_c=9.0, F_s=12.0, v_s=0.1,
        tau_0=0.3,
    ),
    "dahl": law(
        "dahl", {}, sigma_2=1.5, tau_0=0.1,
        **{f"F_{i}": 1.0 / i for i in range(1, 6)},
        **{f"kappa_{i}": 10.0**i for i in range(1, 6)},
    ),
    "parfam_hx": law(
        "parfam_hx",
        {
            **HX_BRISTLE,
            "linear": ["1", "dq", "h", "dh", "h_load"],
            "units": [UNIT],
            "ripple": {"gear_ratio": GEAR_RATIO, "orders": [2]},
        },
        c_0=0.4, c_dq=5.0, c_h=9.0, c_dh=0.02, c_h_load=-0.25, kappa=300.0, rho=1.3, v_s=0.1,
        c_g1=2.5, theta1_0=0.1, theta1_dq=-1.5, theta1_h=0.7, theta1_dh=1e-7,
        ripple2_cos=0.6, ripple2_sin=-0.5, lag=3e-3, smoothing=1e-3,
    ),
}  # fmt: skip

NAMES = {
    **{name: getattr(math, name) for name in ("tanh", "sin", "cos", "exp")},
    "abs": abs,
    "sgn": lambda x: float(np.sign(x)),
}


def run(lines: list[str], t: np.ndarray, dq: np.ndarray, q: float, load: float) -> list[float]:
    """Evaluate the printed lines: states by their exact steps, then the torque."""
    rates = {}
    for line in lines[1:]:
        name, drive, rate = re.fullmatch(r"(\w+)' = (.*) - \((.*)\)\*\1", line).groups()  # type: ignore[union-attr]
        rates[name] = (drive, rate)
    x, torque = dict.fromkeys(rates, 0.0), []
    for k, v in enumerate(dq):
        known: dict[str, Any] = {**NAMES, "dq": v, "q": q, "tau_load": load}
        primes = {}
        for name, (drive, rate) in rates.items():
            b, r = (eval(e, {}, known) for e in (drive, rate))
            dt = t[k] - t[k - 1] if k else 0.0
            if r * dt > 0.0:
                x[name] = b / r + (x[name] - b / r) * math.exp(-r * dt)
            primes[f"{name}_prime"] = b - r * x[name]
        text = lines[0].removeprefix("tau = ").replace("'", "_prime")
        torque.append(eval(text, {}, known | x | primes))
    return torque


@pytest.mark.parametrize("name", LAWS)
def test_the_text_matches_the_law_to_four_digits(name: str) -> None:
    one = LAWS[name]
    lines = equations(one)
    assert len(lines) == 1 + len(one.form.relaxations)
    t = 0.008 * np.arange(300)
    dq = 0.8 * np.sin(2.0 * t) + 0.3 * np.sin(9.0 * t)
    q, load = 0.3, -12.0
    expected = predict(one, t=t, dq=dq, q=np.full(300, q), tau_load=np.full(300, load))
    found = run(lines, t, dq, q, load)
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.ptp(expected))


def test_table_1_is_printed_as_in_the_paper() -> None:
    first, second, third = (equations(one) for one in FrictionModel.read("uf850-table1").laws)
    for number in ("16.24", "0.163", "2.128", "37.7", "0.193", "0.606", "0.064", "0.057"):
        assert number in first[0], number
    assert "tanh(" in first[0]
    assert "cos(" in second[0]
    assert "h'" in third[0]
    assert first[1] == "h' = 11.37*tanh(256.8*dq) - (11.37)*h"


def test_numbers_have_four_digits() -> None:
    for one in LAWS.values():
        for line in equations(one):
            for number in re.findall(r"\d+\.\d+", line):
                assert len(number.replace(".", "").strip("0")) <= 4, line


def test_own_functions_are_printed_under_their_usual_names() -> None:
    text = " ".join(line for one in LAWS.values() for line in equations(one))
    assert "absolute" not in text
    assert "abs(dq)" in text
    assert "sgn(dq)" in text
    assert re.search(r"\bdh\b", text) is None


# --- coefficients -----------------------------------------------------------------------------


def with_errors(one: FrictionLaw, **errors: float) -> FrictionLaw:
    return replace(one, standard_errors=errors)


def test_coefficients_have_interval_and_unit() -> None:
    one = with_errors(LAWS["stribeck"], F_s=0.25, v_s=0.01)
    assert coefficient_lines(one) == [
        "F_c = 6 N.m (held)",
        "F_s = 9.1235 +- 0.49 N.m",
        "v_s = 0.1 +- 0.02 rad/s",
        "sigma_2 = 4 N.m.s/rad (held)",
        "tau_0 = -0.3 N.m (held)",
    ]
    assert find_held(one) == ("F_c", "sigma_2", "tau_0")


def test_nothing_is_held_where_no_interval_is_known() -> None:
    """Intervals are not conditional on a chosen structure: it has none."""
    assert find_held(LAWS["stribeck"]) == ()
    assert not any("held" in line for line in coefficient_lines(LAWS["stribeck"]))


def test_dimensionless_coefficients_have_no_unit() -> None:
    lines = coefficient_lines(with_errors(LAWS["parfam_hx"], rho=0.1))
    assert "rho = 1.3 +- 0.2" in lines
    assert "c_h_load = -0.25 (held)" in lines
    assert len(lines) == len(LAWS["parfam_hx"].values)
