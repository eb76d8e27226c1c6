"""ParFam-S as expressions: stops with symbolic bounds, an age, and viscous friction.

    x_i+ = clip(x_i + v dt / w_i, -s_i, s_i)    s_i >= 0: an expression of `BOUNDS`
    p'   = (psi(v) - p) / T                     psi = exp(-(v/v_s)^2)
    a    = min(p, P)                            the age of a bound; P: the largest in training
    tau  = sum_i F_i x_i + v f(v) + ripple + tau_0

Stribeck effect, lag and load act on bounds: a moving bound only dissipates.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Self

import numpy as np
import sympy
from pydantic import ConfigDict, NonNegativeFloat, PositiveInt, TypeAdapter, ValidationError

from hesr_model.equations.functions import absolute, cardinal_sine, clip, lowered, positive
from hesr_model.equations.memory import DT, Element, Relaxation, Stop
from hesr_model.errors import ArtifactError
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.laws.ripple import LAG
from hesr_model.laws.stribeck import SIGMA_2, TAU_0, V_S
from hesr_model.support.arrays import Array

DEFLECTIONS = np.geomspace(3e-5, 1e-2, 9)  # [rad; m] w of the stops
FINER = (1.0, 0.1, 0.01)  # scales of the grid; sliding joints may have the finer ones
WIDTHS = np.outer(FINER, DEFLECTIONS).ravel()

LOAD_SCALE = Coefficient(
    name="load_scale", unit="N.m", description="load torque that makes load bounds 1"
)
REST = Coefficient(name="T", unit="s", description="ageing time of contacts")
OLDEST = Coefficient(name="P", unit="1", description="largest age of contacts in training")

AGE = Relaxation(
    name="p",
    unit="1",
    drive=sympy.exp(-((DQ / V_S.symbol) ** 2)) / REST.symbol,
    rate=1 / REST.symbol,
)
"""Age of the contacts: 1 at rest, falling in motion."""

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
}
"""Bounds by name; none is negative, and none vanishes at rest alone."""

SHARES = {"a": 0.05, "b": 0.2, "c": 0.6}  # thinning speeds, of the largest speed
THINNING = {
    letter: Coefficient(name=f"v_{letter}", unit="rad/s", description="speed of shear thinning")
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
                name=f"sigma_{letter}", unit="N.m.s/rad", description="viscous friction that thins"
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
    def of(cls, data: Mapping[str, Any]) -> Self:
        """Return the structure of JSON data; raises ArtifactError if they are invalid."""
        try:
            found = TypeAdapter(cls).validate_python(dict(data))
        except ValidationError as error:
            raise ArtifactError(
                f"structure {dict(data)!r} is invalid for ParFam-S; allowed are the keys 'stops', "
                "'viscous', 'ripple', 'window' and 'limited'."
            ) from error
        for kind, node in found.stops:
            if kind not in BOUNDS or not 0 <= node < len(WIDTHS):
                raise ArtifactError(
                    f"stop {[kind, node]!r} is unknown; expected a bound of "
                    f"{', '.join(repr(k) for k in BOUNDS)} and a number from 0 to "
                    f"{len(WIDTHS) - 1}."
                )
        if unknown := [kind for kind in found.viscous if kind not in _VISCOUS]:
            raise ArtifactError(
                f"viscous term {unknown[0]!r} is unknown; known are "
                f"{', '.join(repr(k) for k in _VISCOUS)}."
            )
        return found

    @property
    def forces(self) -> tuple[str, ...]:
        """Names of the non-negative coefficients: of stops, then of f."""
        return (
            *(force(kind, node) for kind, node in self.stops),
            *(_VISCOUS[kind][0].name for kind in self.viscous),
        )

    @property
    def waves(self) -> tuple[str, ...]:
        """Names of the ripple amplitudes."""
        return tuple(f"ripple{n}_{part}" for n in self.ripple for part in ("cos", "sin"))

    def form(self) -> LawForm:
        """Return the expressions."""
        limit = _LIMITED if self.limited else {}
        terms: list[tuple[Coefficient, sympy.Expr]] = []
        stops: list[Element] = []
        for kind, node in self.stops:
            name = force(kind, node)
            x = Stop(
                name=name.replace("F", "x", 1),
                unit="1",
                velocity=DQ,
                deflection=float(f"{WIDTHS[node]:.4g}"),
                bound=BOUNDS[kind].xreplace(limit),
            )
            stops.append(x)
            terms.append((_torque(name, "torque of a stop at bound 1"), x.state))
        terms += [(c, DQ * factor) for c, factor in (_VISCOUS[kind] for kind in self.viscous)]
        # The mean over the part of a step beyond `window` certifies any step.
        beyond = positive(DT - sympy.Float(self.window))
        angle = Q - (LAG.symbol + beyond / 2) * DQ
        waves = product(self.ripple, (sympy.cos, sympy.sin))
        for name, (n, wave) in zip(self.waves, waves, strict=True):
            mean = cardinal_sine(n * DQ * beyond / 2)
            terms.append((_torque(name, "amplitude of torque ripple"), wave(n * angle) * mean))
        used = set().union(*(BOUNDS[kind].free_symbols for kind, _ in self.stops))
        return LawForm(
            coefficients=(
                *(coefficient for coefficient, _ in terms),
                TAU_0,
                *(THINNING[kind] for kind in self.viscous if kind in THINNING),
                *((V_S, REST) if AGE.state in used else ()),
                *((OLDEST,) if OLDEST.symbol in used else ()),
                *((LOAD_SCALE,) if TAU_LOAD in used else ()),
                *((LAG,) if self.ripple else ()),
            ),
            memory=(AGE, *stops) if AGE.state in used else tuple(stops),
            output=sum((c.symbol * factor for c, factor in terms), TAU_0.symbol),
        )


def _torque(name: str, description: str) -> Coefficient:
    return Coefficient(name=name, unit="N.m", description=description)


def force(kind: str, node: int) -> str:
    """Return the name of the force of a stop."""
    return f"F_{kind}_{node + 1}" if kind != "1" else f"F_{node + 1}"


def start_at_rest(form: LawForm) -> tuple[float, ...]:
    """Return the states at rest, with aged contacts; empty if all are 0."""
    memory = form.memory
    return tuple(1.0 if m == AGE else 0.0 for m in memory) if AGE in memory else ()


def viscous_at(structure: Structure, numbers: Mapping[str, float], speeds: Array) -> Array:
    """Return the (S, V) terms of f, without their coefficients, at speeds (S,) >= 0 [rad/s]."""
    known = {v.symbol: numbers[v.name] for k, v in THINNING.items() if k in structure.viscous}
    terms = [_VISCOUS[kind][1].subs(known) for kind in structure.viscous]
    found = lowered([DQ], terms)(speeds)
    columns = np.empty((len(speeds), len(terms)))
    for k, term in enumerate(found):
        columns[:, k] = term
    return columns
