"""What a friction law is: a few first-order relaxations and an output map, as SymPy expressions.

    x_i' = b_i(v, u) - r_i(v, u) x_i        drive b, rate r >= 0
    tau  = f(v, x, x', u)

v is the joint velocity, u are optional further inputs (`functions.INPUTS`). Everything that runs a
law (NumPy over a log, Python or C step by step) and everything that shows it is lowered from this
description; no law is written a second time.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite
from typing import Any, Literal

import sympy

from hesr_model.errors import ArtifactError
from hesr_model.friction.functions import INPUTS
from hesr_model.units import unit_of_joint

Discretisation = Literal["exact", "euler"]


@dataclass(frozen=True, kw_only=True)
class Coefficient:
    """A named constant of a law, with its SI unit in FMI's spelling ("1" if dimensionless)."""

    name: str
    unit: str
    description: str

    @property
    def symbol(self) -> sympy.Symbol:
        """SymPy symbol under which the law's expressions use it."""
        return sympy.Symbol(self.name, real=True)


@dataclass(frozen=True, kw_only=True)
class Relaxation:
    """One state x' = drive - rate x, with rate >= 0 for every input."""

    name: str
    unit: str
    drive: sympy.Expr
    rate: sympy.Expr

    @property
    def state(self) -> sympy.Symbol:
        """Symbol of the state x."""
        return sympy.Symbol(self.name, real=True)

    @property
    def derivative(self) -> sympy.Symbol:
        """Symbol of x' = drive - rate x, taken after the state was updated (as in eq. 10)."""
        return sympy.Symbol(f"d{self.name}", real=True)


@dataclass(frozen=True, kw_only=True)
class LawForm:
    """The expressions of a law, without numbers.

    Raises
    ------
    ArtifactError
        If an expression uses a symbol that is neither an input, a coefficient nor a state, or two
        of these have one name.
    """

    coefficients: tuple[Coefficient, ...]
    relaxations: tuple[Relaxation, ...] = ()
    output: sympy.Expr

    def __post_init__(self) -> None:
        known = {*INPUTS, *(c.symbol for c in self.coefficients)}
        states = [s for r in self.relaxations for s in (r.state, r.derivative)]
        own = set(states)
        names = Counter([*INPUTS, *(c.symbol for c in self.coefficients), *states])
        if twice := [symbol for symbol, count in names.items() if count > 1]:
            raise ArtifactError(
                f"friction law: '{twice[0]}' stands twice among its inputs, coefficients and "
                "states."
            )
        inner = {s for r in self.relaxations for e in (r.drive, r.rate) for s in e.free_symbols}
        unknown = (inner - known) | (self.output.free_symbols - known - own)
        if unknown:
            raise ArtifactError(
                f"friction law: symbol '{min(map(str, unknown))}' is neither an input, "
                "a coefficient nor a state of the law."
            )

    @cached_property
    def inputs(self) -> tuple[sympy.Symbol, ...]:
        """Those of `INPUTS` that the law really uses, in their order."""
        expressions = [self.output, *(e for r in self.relaxations for e in (r.drive, r.rate))]
        used = set().union(*(e.free_symbols for e in expressions))
        return tuple(symbol for symbol in INPUTS if symbol in used)

    @cached_property
    def sliding(self) -> "LawForm":
        """The same equations for a joint that slides: in other units, with force for torque."""
        return replace(
            self,
            coefficients=tuple(
                replace(
                    c,
                    unit=unit_of_joint(c.unit, slides=True),
                    description=c.description.replace("torque", "force"),
                )
                for c in self.coefficients
            ),
            relaxations=tuple(
                replace(r, unit=unit_of_joint(r.unit, slides=True)) for r in self.relaxations
            ),
        )


@dataclass(frozen=True, kw_only=True)
class FrictionLaw:
    """A frozen law of one joint: a form, its numbers and its discretisation.

    Attributes
    ----------
    name : name in the registry, from which `form` is rebuilt together with `structure`.
    structure : JSON data that select one form of a family (empty where there is only one).
    form : the expressions.
    values : value of every coefficient of `form`, in its order and unit.
    discretisation : "exact" integrates each relaxation exactly for inputs held over a step;
        "euler" is eq. 10 and requires 0 <= rate * dt < 1.
    start : value of each state before the first sample, zero by default.
    start_samples : how many measured torques at the beginning of a log set the start in its place,
        where they are known (`evaluate.estimated_start`); 0 for none.
    standard_errors : of the coefficients, in their units, as far as they are known.

    Raises
    ------
    ArtifactError
        If the values are not those that the form needs, or not finite.
    """

    name: str
    structure: Mapping[str, Any] = field(default_factory=dict)
    form: LawForm
    values: Mapping[str, float]
    discretisation: Discretisation = "exact"
    start: tuple[float, ...] = ()
    start_samples: int = 0
    standard_errors: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        needed = [c.name for c in self.form.coefficients]
        if sorted(needed) != sorted(self.values):
            odd = sorted(set(needed) ^ set(self.values))[0]
            raise ArtifactError(
                f"law '{self.name}': coefficient '{odd}' is "
                f"{'missing' if odd in needed else 'unknown'}; needed are {', '.join(needed)}."
            )
        object.__setattr__(self, "values", {name: float(self.values[name]) for name in needed})
        for name, value in self.values.items():
            if not isfinite(value):
                raise ArtifactError(f"law '{self.name}': coefficient '{name}' is {value}.")
        if not self.start:
            object.__setattr__(self, "start", (0.0,) * len(self.form.relaxations))
        if len(self.start) != len(self.form.relaxations):
            raise ArtifactError(
                f"law '{self.name}': {len(self.start)} start values for "
                f"{len(self.form.relaxations)} states."
            )
        for relaxation, value in zip(self.form.relaxations, self.start, strict=True):
            if not isfinite(value):
                raise ArtifactError(
                    f"law '{self.name}': start value of '{relaxation.name}' is {value}."
                )
