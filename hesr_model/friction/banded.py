"""The band of a law: between which torques the measured friction lies, with a given probability.

    w   = s(v, load) (ln(1 - coverage) / ln(1 - 0.95))^tail
    s^2 = floor^2 + slow^2 / (1 + (v/v_slow)^2) + rest^2 r + (fast v)^2 + (share load)^2
    r   = (1 - min((v/v_rest)^2, 1))^2, 1 at rest and 0 in motion

tau - w and tau + w bound it in motion. At rest friction is whatever holds the joint, so there the
band reaches from one torque at which it would break away to the other, those of the law as it
creeps at `law.MOVING`, and by the floor beyond, since what is measured has noise there, too: unless
the logs that it was calibrated on have shown what a rest holds.

The numbers are half-widths at 95 %, from `fitting.calibration`. Other probabilities follow from a
Weibull tail of the standardised error, whose exponent is 0.65 for a normal distribution.
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
import sympy
from numpy.typing import ArrayLike

from hesr_model.equations.component import Equation
from hesr_model.equations.functions import clip, larger, lowered_program
from hesr_model.equations.memory import DT
from hesr_model.equations.program import beginning, begun
from hesr_model.errors import ArtifactError
from hesr_model.friction.band import COVERAGE, GREATEST, LEAST, LEVEL, NUMBERS, shapes
from hesr_model.friction.inputs import DQ, INPUTS, TAU_LOAD
from hesr_model.friction.law import MOVING, TORQUE, FrictionLaw, LawForm
from hesr_model.friction.predict import numbers
from hesr_model.support.arrays import Array

LOWER, UPPER = "tau_lower", "tau_upper"
"""Names of the outputs."""

_TINY = sympy.Float(1e-24)
"""[(N.m)^2] Under the root: its derivative stays finite where all numbers are 0."""


def band_equations(form: LawForm) -> tuple[Equation, ...]:
    """Return the equations of a law's band: two outputs, and what they are made of.

    They read the law's torque by its name, the numbers of `NUMBERS` and `COVERAGE`.
    """
    floor, slow, slow_speed, rest, fast, load, tail, envelope = (q.symbol for q in NUMBERS)
    parts = shapes(DQ, TAU_LOAD, slow_speed, most=lambda a, b: clip(a, b))
    sizes = (floor, slow, rest, fast, load)
    variance = sympy.Add(*(size**2 * part for size, part in zip(sizes, parts, strict=True)))
    middle, reach = (GREATEST + LEAST) / 2, (GREATEST - LEAST) / 2
    wanted = middle + clip(COVERAGE.symbol - middle, reach)
    tailed = Equation(
        name="band_factor",
        expression=sympy.exp(tail * sympy.log(sympy.log(1 - wanted) / float(np.log(1 - LEVEL)))),
    )
    half = Equation(name="band", expression=sympy.sqrt(variance + _TINY) * tailed.symbol)
    torque, resting = sympy.Symbol(TORQUE, real=True), envelope * parts[2]
    ahead, behind = (sympy.Symbol(name, real=True) for name in ("ahead", "behind"))

    def side(name: str, sign: int, text: str) -> Equation:
        edge = torque + sign * half.symbol
        furthest = sign * (larger(sign * ahead, sign * behind) + floor * tailed.symbol)
        return Equation(
            name=name,
            unit="N.m",
            description=f"{text} end of the band of the measured friction {{effort}} of {{joint}}",
            expression=edge + resting * (furthest - edge),
            output=True,
        )

    return (
        tailed,
        half,
        *_creeping(form, "ahead", MOVING),
        *_creeping(form, "behind", -MOVING),
        side(LOWER, -1, "lower"),
        side(UPPER, 1, "upper"),
    )


def _creeping(form: LawForm, name: str, speed: float) -> Iterator[Equation]:
    """Yield the torque of a law that has crept at a speed for long, and the way to it."""
    at = {DQ: sympy.Float(speed)}
    memory = [m.subs(at) for m in form.memory]
    lines = beginning(memory, sympy.S.One)
    own = {symbol: sympy.Symbol(f"{name}_{symbol.name}", real=True) for symbol in lines}
    at |= {m.state: sympy.S.Zero for m in memory}  # from where those that seek it set out
    for symbol, expression in lines.items():
        yield Equation(name=own[symbol].name, expression=expression.xreplace(own | at))
    at |= {m.state: own[begun(m)] for m in memory} | {m.derivative: sympy.S.Zero for m in memory}
    yield Equation(name=name, expression=form.output.xreplace(at))


@lru_cache(maxsize=64)
def _function(form: LawForm) -> Any:
    """Return a NumPy function of coefficients, numbers, coverage, inputs, steps and torque."""
    own = band_equations(form)
    symbols = (*form.coefficients, *NUMBERS, COVERAGE)
    arguments = (*(q.symbol for q in symbols), *INPUTS, DT, sympy.Symbol(TORQUE, real=True))
    return lowered_program(arguments, {e.symbol: e.expression for e in own})


def predict_band(
    law: FrictionLaw,
    *,
    t: ArrayLike,
    dq: ArrayLike,
    q: ArrayLike | None = None,
    tau_load: ArrayLike | None = None,
    coverage: float = LEVEL,
    torque: Array,
) -> tuple[Array, Array]:
    """Return between which torques the measured friction of a joint lies over a log.

    Parameters
    ----------
    law : the law of one joint, with a band.
    t, dq, q, tau_load : (N,) as for `evaluate.predict`.
    coverage : share of the rows that the band is to hold, from 0.5 to 0.999.
    torque : (N,) that the law predicts [N.m].

    Returns
    -------
    Lower and upper end, (N,) each [N.m].

    Raises
    ------
    ArtifactError
        If the law has no band.
    """
    if law.band is None:
        raise ArtifactError(
            f"law '{law.name}' has no band; laws that are fitted with this version have one."
        )
    zero = np.zeros_like(torque)
    inputs = [zero if u is None else np.asarray(u, dtype=float) for u in (dq, q, tau_load)]
    time = np.asarray(t, dtype=float)
    steps = np.diff(time, prepend=time[0])
    *_, lower, upper = _function(law.form)(
        *numbers(law), *law.band.values, coverage, *inputs, steps, torque
    )
    return lower + zero, upper + zero
