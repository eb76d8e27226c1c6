"""What a component remembers: relaxations and stops, each sampled, continuous and settled.

Sampled, an element moves by steps of any length over which its inputs are held; continuous, it is a
state of model exchange; settled, it is where inputs that are held for good take it. All three are
expressions, so whatever is lowered from a component (C,
NumPy, derivatives, Modelica) has them alike.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Literal, Self, TypeAlias

import sympy

from hesr_model.equations.functions import (
    absolute,
    clip,
    decay,
    larger,
    over,
    positive,
    sgn,
    share,
)

DT = sympy.Symbol("dt", real=True)
"""Length of the step that ends now [s]."""

Discretisation: TypeAlias = Literal["exact", "euler"]
"""How relaxations move over a step: exactly for held inputs, or by explicit Euler (eq. 10)."""

EULER = sympy.Symbol("euler", real=True)
"""1 where relaxations move by Euler's step (eq. 10), 0 where exactly."""

FIRST_STEP = sympy.Rational(1, 1000)
"""Step [s] by which a state leaves a place where its own rate is 0, on its way to where it settles.
"""

RELEASE = sympy.Float(0.005)
"""T of a continuous stop [s]: how fast it lets go where its bound shrinks."""


@dataclass(frozen=True, kw_only=True)
class _Element:
    name: str
    unit: str

    def __post_init__(self) -> None:
        for f in fields(self):  # numbers may be written as Python's
            if f.name not in ("name", "unit"):
                object.__setattr__(self, f.name, sympy.S.Zero + getattr(self, f.name))

    def subs(self, replaced: Mapping[sympy.Symbol, sympy.Expr]) -> Self:
        """Return the element with symbols replaced in its expressions."""
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(
            self, **{k: v.xreplace(replaced) for k, v in own.items() if isinstance(v, sympy.Basic)}
        )

    @property
    def state(self) -> sympy.Symbol:
        """Symbol of the state x."""
        return sympy.Symbol(self.name, real=True)

    @property
    def derivative(self) -> sympy.Symbol:
        """Symbol of the continuous x', taken after the state was updated (as in eq. 10)."""
        return sympy.Symbol(f"d{self.name}", real=True)


@dataclass(frozen=True, kw_only=True)
class Relaxation(_Element):
    """One state x' = drive - rate x; a negative rate counts as 0.

    Drive and rate may use states named before this one, the rate also its own, which is frozen
    over a step.
    """

    drive: sympy.Expr
    rate: sympy.Expr

    @property
    def parts(self) -> tuple[sympy.Expr, sympy.Expr]:
        """Drive and rate, of which inputs and states are read."""
        return self.drive, self.rate

    def sampled(self, first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:
        """Return x at the end of a step; exact for a drive and a rate that are held over it.

        x+ = x exp(-z) + drive dt (1 - exp(-z)) / z with z = rate dt; `first` and `second` stand
        for drive and guarded rate.
        """
        z = second * DT
        e = decay(z, EULER)
        return (1 + e) * self.state + first * DT * share(z, e, EULER)

    def continuous(self) -> sympy.Expr:
        """Return x'."""
        return self.drive - positive(self.rate) * self.state

    @property
    def seeks(self) -> bool:
        """Whether `settled` is one step of an iteration, since the rate sees the state."""
        return self.state in self.rate.free_symbols

    def settled(self, first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:
        """Return drive / rate, at which x' = 0; without a rate x itself, which settles nowhere.

        Where the rate sees x, half the way there from x: as with Heron's square root a few of such
        steps find x even where whole ones would overshoot for ever.
        """
        if not self.seeks:
            return over(first, second, self.state)
        return (self.state + over(first, second, self.state + FIRST_STEP * first)) / 2


class Slow(Relaxation):
    """A relaxation over minutes or hours: it begins at its start, not where it settles."""

    @property
    def seeks(self) -> bool:
        """Whether `settled` is one step of an iteration: never."""
        return False

    def settled(self, first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:  # noqa: ARG002 - as of every element
        """Return x itself."""
        return self.state


@dataclass(frozen=True, kw_only=True)
class Stop(_Element):
    """One state x+ = clip(x + v dt / w, -s, s), the stop operator of Prandtl and Ishlinskii.

    Attributes
    ----------
    velocity : v, what moves it.
    deflection : w > 0, the way from 0 to 1.
    bound : s; a negative one counts as 0. Any expression of inputs, parameters and states named
        before this one.
    """

    velocity: sympy.Expr
    deflection: sympy.Expr
    bound: sympy.Expr

    @property
    def parts(self) -> tuple[sympy.Expr, sympy.Expr]:
        """Rate at which it moves, and bound, of which inputs and states are read."""
        return self.velocity / self.deflection, self.bound

    def sampled(self, first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:
        """Return x at the end of a step; `first` is v / w and `second` the guarded bound."""
        return clip(self.state + first * DT, second)

    @property
    def seeks(self) -> bool:
        """Whether `settled` is one step of an iteration: never."""
        return False

    def settled(self, first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:
        """Return the bound on the side to which it moves; x itself between both where it rests."""
        return sgn(first) * second + (1 - absolute(sgn(first))) * clip(self.state, second)

    def continuous(self) -> sympy.Expr:
        """Return x' of the form without events: passive with the same storage function.

        With e = w x, d = max(.01 w s, 1e-3 w), b = max(w s - d, 0) and m = max(w s, d),
        e' = v - abs(v)/d (e - clip(e, -b, b)) - (e - clip(e, -m, m))/T: the second term bounds the
        way, the last one lets go where a bound shrinks at rest. Everything is divided by w here.
        """
        s = positive(self.bound)
        d = larger(s / 100, sympy.Rational(1, 1000))
        b, m = positive(s - d), larger(s, d)
        x, w, speed = self.state, self.deflection, absolute(self.velocity)
        return self.velocity / w - speed / (w * d) * (x - clip(x, b)) - (x - clip(x, m)) / RELEASE


Element: TypeAlias = Relaxation | Stop
"""One element of memory."""
