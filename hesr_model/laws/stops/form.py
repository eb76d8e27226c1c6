"""ParFam-S as expressions: stops with symbolic bounds, an age, and viscous friction.

    x_i+ = clip(x_i + v dt / w_i, -s_i, s_i)    s_i >= 0: an expression of `BOUNDS`
    p'   = (psi(v) - p) / T                     psi = exp(-(v/v_s)^2)
    a    = min(p, P)                            the age of a bound; P: the largest in training
    tau  = sum_i F_i x_i + v f(v) + ripple + tau_0

Stribeck effect, lag and load act on bounds: a moving bound only dissipates. Lagging ripple needs
f(v) >= sum_k A_k min(n_k c, 2 / |v|), where c is the mean time between the angle of the ripple and
that at the end of a step (derivation: `docs/methods.md`, *Ripple*).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Self

import numpy as np
import scipy
import sympy
from pydantic import ConfigDict, NonNegativeFloat, PositiveInt, TypeAdapter, ValidationError

from hesr_model.equations.functions import (
    absolute,
    cardinal_sine,
    clip,
    positive,
    to_numpy_function,
)
from hesr_model.equations.memory import DT, Element, Relaxation, Stop
from hesr_model.errors import ArtifactError
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.laws.ripple import LAG, describe_wave, name_waves
from hesr_model.laws.stribeck import SIGMA_2, TAU_0, V_S
from hesr_model.support.arrays import Array

DEFLECTIONS = np.geomspace(3e-5, 1e-2, 9)  # [rad; m] w of the stops
DEFLECTION_SCALES = (1.0, 0.1, 0.01)  # scales of the grid; sliding joints may have the finer ones
WIDTHS = np.outer(DEFLECTION_SCALES, DEFLECTIONS).ravel()

LOAD_SCALE = Coefficient(
    name="load_scale", unit="N.m", description="load torque that makes load bounds 1"
)
AGEING_TIME = Coefficient(name="T", unit="s", description="ageing time of contacts")
OLDEST = Coefficient(name="P", unit="1", description="largest age of contacts in training")

AGE = Relaxation(
    name="p",
    unit="1",
    drive=sympy.exp(-((DQ / V_S.symbol) ** 2)) / AGEING_TIME.symbol,
    rate=1 / AGEING_TIME.symbol,
)  # Age of the contacts: 1 at rest, falling in motion
_LOAD = TAU_LOAD / LOAD_SCALE.symbol
_LIMITED = {TAU_LOAD: LOAD_SCALE.symbol * clip(_LOAD, 1.001)}  # no training row is at the kink
BOUNDS: Mapping[str, sympy.Expr] = {
    "1": sympy.Integer(1),
    "age": clip(AGE.state, positive(OLDEST.symbol)),  # min(p, P)
    "p": AGE.state,  # of older files
    "load": absolute(_LOAD),
    "root": sympy.sqrt(absolute(_LOAD)),
    "plus": positive(_LOAD),
    "minus": positive(-_LOAD),
}  # bounds by name; none is negative, and none vanishes at rest alone
SHARES = {"a": 0.05, "b": 0.2, "c": 0.6}  # thinning speeds, of the largest speed
THINNING = {
    letter: Coefficient(
        name=f"v_{letter}", unit="rad/s", description=f"speed at which sigma_{letter} is halved"
    )
    for letter in SHARES
}
_VISCOUS = {
    "1": (SIGMA_2, sympy.Integer(1)),
    "v": (
        Coefficient(name="sigma_3", unit="N.m.s2/rad2", description="rise of viscous friction"),
        absolute(DQ),
    ),
    **{
        letter: (
            Coefficient(
                name=f"sigma_{letter}",
                unit="N.m.s/rad",
                description=f"viscous friction that thins, by half at v_{letter}",
            ),
            1 / (1 + absolute(DQ) / v.symbol),
        )
        for letter, v in THINNING.items()
    },
}


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Terms of a law."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    stops: tuple[tuple[str, int], ...] = ()  # bound and index of the deflection
    viscous: tuple[str, ...] = ()  # "1", "v" for |v|, "a" for 1 / (1 + |v| / v_a) ..
    ripple: tuple[PositiveInt, ...] = ()  # [1/rad] frequencies in the joint angle
    window: NonNegativeFloat = 0.0  # [s] longest step without averaging of ripple
    limited: bool = False  # bounds of the load end at the largest one in training

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Return the structure of JSON data; raises ArtifactError if they are invalid."""
        try:
            structure = TypeAdapter(cls).validate_python(dict(data))
        except ValidationError as error:
            raise ArtifactError(
                f"structure {dict(data)!r} is invalid for ParFam-S; allowed are the keys 'stops', "
                "'viscous', 'ripple', 'window' and 'limited'.",
                code="law.structure_keys",
                key="structure",
            ) from error
        for kind, node in structure.stops:
            if kind not in BOUNDS or not 0 <= node < len(WIDTHS):
                raise ArtifactError(
                    f"stop {[kind, node]!r} is unknown; expected a bound of "
                    f"{', '.join(repr(k) for k in BOUNDS)} and a number from 0 to "
                    f"{len(WIDTHS) - 1}.",
                    code="law.structure_stop",
                    key="structure.stops",
                )
        unknown = [kind for kind in structure.viscous if kind not in _VISCOUS]
        if unknown:
            raise ArtifactError(
                f"viscous term {unknown[0]!r} is unknown; known are "
                f"{', '.join(repr(k) for k in _VISCOUS)}.",
                code="law.structure_viscous",
                key="structure.viscous",
            )
        return structure

    @property
    def forces(self) -> tuple[str, ...]:
        """Names of the non-negative coefficients: of stops, then of f."""
        return (
            *(name_force(kind, node) for kind, node in self.stops),
            *(_VISCOUS[kind][0].name for kind in self.viscous),
        )

    @property
    def waves(self) -> tuple[str, ...]:
        """Names of the ripple amplitudes."""
        return name_waves(self.ripple)

    def form(self) -> LawForm:
        """Return the expressions."""
        stops = [self._build_stop(kind, node) for kind, node in self.stops]
        terms: list[tuple[Coefficient, sympy.Expr]] = []
        for (kind, node), stop in zip(self.stops, stops, strict=True):
            description = _describe_stop(kind, stop.deflection)
            terms.append((_torque(name_force(kind, node), description), stop.state))
        for kind in self.viscous:
            coefficient, factor = _VISCOUS[kind]
            terms.append((coefficient, DQ * factor))
        terms += self._build_wave_terms()
        output = TAU_0.symbol
        for coefficient, factor in terms:
            output += coefficient.symbol * factor
        bound_symbols = set().union(*(BOUNDS[kind].free_symbols for kind, _ in self.stops))
        memory: list[Element] = [*stops]
        if AGE.state in bound_symbols:
            memory.insert(0, AGE)
        return LawForm(
            coefficients=(
                *(coefficient for coefficient, _ in terms),
                TAU_0,
                *self._list_nonlinear(bound_symbols),
            ),
            memory=tuple(memory),
            output=output,
        )

    def _build_stop(self, kind: str, node: int) -> Stop:
        """Return the stop with a bound of `BOUNDS` and the deflection of a node of `WIDTHS`."""
        bound = BOUNDS[kind]
        if self.limited:
            bound = bound.xreplace(_LIMITED)
        return Stop(
            name=name_force(kind, node).replace("F", "x", 1),
            unit="1",
            velocity=DQ,
            deflection=float(f"{WIDTHS[node]:.4g}"),
            bound=bound,
        )

    def _build_wave_terms(self) -> list[tuple[Coefficient, sympy.Expr]]:
        """Return the amplitudes of the ripple, and the waves averaged over a step."""
        # The mean over the part of a step beyond `window` certifies any step.
        beyond = positive(DT - sympy.Float(self.window))
        angle = Q - (LAG.symbol + beyond / 2) * DQ
        terms = []
        waves = product(self.ripple, (sympy.cos, sympy.sin))
        for name, (n, wave) in zip(self.waves, waves, strict=True):
            mean = cardinal_sine(n * DQ * beyond / 2)
            terms.append((_torque(name, describe_wave(n, wave)), wave(n * angle) * mean))
        return terms

    def _list_nonlinear(self, bound_symbols: Collection[sympy.Symbol]) -> list[Coefficient]:
        """Return the coefficients in which the torque is not linear, of terms and of bounds."""
        coefficients = [THINNING[kind] for kind in self.viscous if kind in THINNING]
        if AGE.state in bound_symbols:
            coefficients += [V_S, AGEING_TIME]
        if OLDEST.symbol in bound_symbols:
            coefficients.append(OLDEST)
        if TAU_LOAD in bound_symbols:
            coefficients.append(LOAD_SCALE)
        if self.ripple:
            coefficients.append(LAG)
        return coefficients


_BOUND_NAMES: Mapping[str, str] = {
    "1": "",
    "age": ", in proportion to the age of its contact",
    "p": ", in proportion to the age of its contact, without limit",
    "load": ", in proportion to the load",
    "root": ", in proportion to the root of the load",
    "plus": ", in proportion to positive load",
    "minus": ", in proportion to negative load",
}
"""Words for the bounds of stops."""


def _describe_stop(kind: str, deflection: float) -> str:
    # In rad, or in m for a sliding joint.
    return f"torque of the stop that slides from a deflection of {deflection:g}{_BOUND_NAMES[kind]}"


def _torque(name: str, description: str) -> Coefficient:
    return Coefficient(name=name, unit="N.m", description=description)


def name_force(kind: str, node: int) -> str:
    """Return the name of the force of a stop."""
    if kind == "1":
        return f"F_{node + 1}"
    return f"F_{kind}_{node + 1}"


def build_rest_states(form: LawForm) -> tuple[float, ...]:
    """Return the states at rest, with aged contacts; empty if all are 0."""
    if AGE not in form.memory:
        return ()
    return tuple(float(element == AGE) for element in form.memory)


def evaluate_viscous(structure: Structure, numbers: Mapping[str, float], speeds: Array) -> Array:
    """Return the (S, V) terms of f, without their coefficients, at speeds (S,) >= 0 [rad/s]."""
    thinning_speeds = {
        v.symbol: numbers[v.name] for k, v in THINNING.items() if k in structure.viscous
    }
    terms = [_VISCOUS[kind][1].subs(thinning_speeds) for kind in structure.viscous]
    viscous_terms = to_numpy_function([DQ], terms)(speeds)
    columns = np.empty((len(speeds), len(terms)))
    for k, term in enumerate(viscous_terms):
        columns[:, k] = term
    return columns


SPEEDS = np.concatenate([[0.0], np.geomspace(1e-4, 1e6, 241)])
"""[rad/s] for the condition in a fit; in between all terms are monotonic"""


def distance(lag: float, window: float) -> float:
    """Return c [s]: the largest mean of |lag - u| over u in (0, h), for any h up to the window."""
    if window <= 0.0:
        return abs(lag)
    if lag <= 0.0 or lag >= window:
        end_distance = abs(lag - window / 2.0)
    else:
        end_distance = (lag**2 + (window - lag) ** 2) / (2.0 * window)
    return max(abs(lag), end_distance)


def compute_required_viscosity(frequencies: Sequence[int], lag: float, window: float) -> Array:
    """Return (S, K): smallest f at each of `SPEEDS` per N.m of each wave [s/rad]."""
    speeds = np.maximum(SPEEDS, 1e-300)[:, None]
    return np.asarray(np.minimum(np.asarray(frequencies) * distance(lag, window), 2.0 / speeds))


def constrain_coefficients(
    gram: Array, moment: Array, x: Array, viscous: Array, waves: Array, *, free: int
) -> Array:
    """Return the least-squares coefficients that satisfy the condition, a cone problem.

    The last `free` of the unconstrained solution `x` have any sign and end in cosines and sines;
    those of `viscous` (S, V) precede them. `waves` (S, W) is the result of
    `compute_required_viscosity`.
    """
    # Bounds between neighbouring speeds: all columns are monotonic, and waves fall.
    viscous = np.minimum(viscous[:-1], viscous[1:])
    waves = waves[:-1]
    first = len(x) - free
    f = slice(first - viscous.shape[1], first)
    a = slice(len(x) - 2 * waves.shape[1], len(x))

    def sides(y: Array) -> tuple[Array, Array]:
        return viscous @ y[f], waves @ np.hypot(*y[a].reshape(-1, 2).T)

    def margin(y: Array) -> Array:
        available, required = sides(y)
        return available - required

    def share(y: Array) -> float:
        available, required = sides(y)
        return max(float(np.min(available / np.maximum(required, 1e-300))), 0.0)

    if margin(x).min() >= 0.0:
        return x
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    # Start at half the allowed ripple: the root is differentiable there.
    start = x.copy()
    start[a] *= 0.5 * share(x)

    def slope(y: Array) -> Array:
        jacobian = np.zeros((len(viscous), len(y)))
        jacobian[:, f] = viscous
        pairs = y[a].reshape(-1, 2)
        unit = pairs / np.maximum(np.hypot(*pairs.T), 1e-12)[:, None]
        jacobian[:, a] = -(waves[:, :, None] * unit).reshape(len(viscous), -1)
        return jacobian

    size = max(float(x @ gram @ x), np.finfo(float).tiny)
    best = scipy.optimize.minimize(
        lambda z: float(scale * z @ gram @ (scale * z) / 2.0 - moment @ (scale * z)) / size,
        start / scale,
        jac=lambda z: scale * (gram @ (scale * z) - moment) / size,
        bounds=[(0.0, None)] * first + [(None, None)] * free,
        constraints={
            "type": "ineq",
            "fun": lambda z: margin(scale * z),
            "jac": lambda z: slope(scale * z) * scale,
        },
        method="SLSQP",
        options={"maxiter": 200, "ftol": 1e-10},
    )
    y = np.asarray(scale * best.x)
    y[:first] = np.maximum(y[:first], 0.0)
    y[a] *= min(1.0, share(y)) * (1.0 - 1e-9)
    return y
