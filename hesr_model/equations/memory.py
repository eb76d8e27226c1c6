"""Memory of a component: relaxations and stops, each in sampled, continuous and settled form."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Literal, Self, TypeAlias

import sympy

from hesr_model.equations.functions import absolute, clip, decay, larger, over, positive, sgn, share
from hesr_model.errors import ArtifactError

DT = sympy.Symbol("dt", real=True)  # length of the current step [s]
Discretisation: TypeAlias = Literal["exact", "euler"]  # exact for held inputs; Euler: eq. 10
EULER = sympy.Symbol("euler", real=True)  # 1 for Euler's step (eq. 10) of relaxations, 0 if exact
FIRST_STEP = sympy.Rational(1, 1000)  # step [s] of the search for the settled state
RELEASE_TIME = sympy.Float(
    0.005
)  # T [s], time constant of a continuous stop with a shrinking bound


def to_expression(owner: str, attribute: str, value: object) -> sympy.Expr:
    """Return an expression or a number as an expression; raise ArtifactError for other shapes."""
    if isinstance(value, sympy.Expr):
        return value
    if isinstance(value, Real):
        return sympy.S.Zero + value
    raise ArtifactError(
        f"{owner}: '{attribute}' is {type(value).__name__}; expected one expression, that of one "
        "joint.",
        code="law.class.shape",
        key=attribute,
    )


@dataclass(frozen=True, kw_only=True)
class MemoryElement:
    """State of one joint; a number in place of an expression is taken as one."""

    name: str
    unit: str

    def __post_init__(self) -> None:
        for f in fields(self):  # accept Python numbers
            if f.name not in ("name", "unit"):
                value = to_expression(f"memory '{self.name}'", f.name, getattr(self, f.name))
                object.__setattr__(self, f.name, value)

    def subs(self, replacements: Mapping[sympy.Symbol, sympy.Expr]) -> Self:
        """Return the element with expressions in place of symbols."""
        attributes = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(
            self,
            **{
                name: expression.xreplace(replacements)
                for name, expression in attributes.items()
                if isinstance(expression, sympy.Basic)
            },
        )

    @property
    def seeks(self) -> bool:
        """True if `steady_state` is one step of an iteration: the rate depends on x."""
        return False

    @property
    def state(self) -> sympy.Symbol:
        """Symbol of x."""
        return sympy.Symbol(self.name, real=True)

    @property
    def derivative(self) -> sympy.Symbol:
        """Symbol of the continuous x', evaluated after the state was updated (as in eq. 10)."""
        return sympy.Symbol(f"d{self.name}", real=True)


@dataclass(frozen=True, kw_only=True)
class Relaxation(MemoryElement):
    """x' = drive - rate x, where both may use earlier states.

    Attributes
    ----------
    drive : in the unit of x per second.
    rate : [1/s], may also use x, frozen over a step; a negative rate counts as 0.
    """

    drive: sympy.Expr
    rate: sympy.Expr

    @property
    def parts(self) -> tuple[sympy.Expr, sympy.Expr]:
        """Drive and rate."""
        return self.drive, self.rate

    def advance(self, first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:
        """Return x+ = x exp(-z) + drive dt (1 - exp(-z)) / z for z = rate dt, exact if held."""
        z = second * DT
        e = decay(z, EULER)
        return (1 + e) * self.state + first * DT * share(z, e, EULER)

    def express_derivative(self) -> sympy.Expr:
        """Return x'."""
        return self.drive - positive(self.rate) * self.state

    @property
    def seeks(self) -> bool:
        """See `MemoryElement.seeks`."""
        return self.state in self.rate.free_symbols

    def steady_state(self, first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:
        """Return drive / rate, the zero of x'; x itself if the rate is 0.

        If the rate depends on x, return the point halfway there, as in Heron's
        square root; whole steps could oscillate.
        """
        if not self.seeks:
            return over(first, second, self.state)
        return (self.state + over(first, second, self.state + FIRST_STEP * first)) / 2


class Prompt(Relaxation):
    """Relaxation that begins in its steady state, also at rest."""


class Slow(Relaxation):
    """Relaxation over minutes or hours, whose initial state is its start."""

    @property
    def seeks(self) -> bool:
        """False: `steady_state` is exact."""
        return False

    def steady_state(self, first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:  # noqa: ARG002 - signature of every element
        """Return x itself."""
        return self.state


@dataclass(frozen=True, kw_only=True)
class Stop(MemoryElement):
    """x+ = clip(x + v dt / w, -s, s), the stop operator of Prandtl and Ishlinskii.

    Attributes
    ----------
    velocity : v [rad/s, m/s].
    deflection : w > 0 [rad, m], at which a state of 1 is reached.
    bound : s [1]; negative values count as 0.
    """

    velocity: sympy.Expr
    deflection: sympy.Expr
    bound: sympy.Expr

    @property
    def parts(self) -> tuple[sympy.Expr, sympy.Expr]:
        """Rate v / w and bound."""
        return self.velocity / self.deflection, self.bound

    def advance(self, first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:
        """Return x at the end of a step, from v / w and the guarded bound."""
        return clip(self.state + first * DT, second)

    def steady_state(self, first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:
        """Return the bound in the direction of motion; x within the bounds at rest."""
        return sgn(first) * second + (1 - absolute(sgn(first))) * clip(self.state, second)

    def express_derivative(self) -> sympy.Expr:
        """Return x' without events, passive with the same storage function.

        With e = w x, d = max(0.01 w s, 1e-3 w), b = max(w s - d, 0) and m =
        max(w s, d), e' = v - abs(v)/d (e - clip(e, -b, b)) - (e - clip(e, -m,
        m))/T: the second term bounds the deflection, the last one follows a
        bound that shrinks at rest.
        """
        s = positive(self.bound)
        d = larger(s / 100, sympy.Rational(1, 1000))
        b = positive(s - d)
        m = larger(s, d)
        x = self.state
        w = self.deflection
        speed = absolute(self.velocity)
        return (
            self.velocity / w - speed / (w * d) * (x - clip(x, b)) - (x - clip(x, m)) / RELEASE_TIME
        )


Element: TypeAlias = Relaxation | Stop


def find_read_symbols(memory: Iterable[Element]) -> set[sympy.Symbol]:
    """Return the symbols that the parts of some elements read."""
    symbols: set[sympy.Symbol] = set()
    for element in memory:
        for part in element.parts:
            symbols |= part.free_symbols
    return symbols
