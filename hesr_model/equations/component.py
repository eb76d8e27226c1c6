"""A component: named equations over signals, parameters, names before them and memory.

    name = expression            output or not, of inputs, parameters, states, names and `dt`
    previous(name)               its value at the last sample, with a start expression of its own
    Relaxation, Stop             memory with a sampled and a continuous meaning

It is written once. C, NumPy over whole logs, a Python step, directional derivatives, dependencies,
Modelica, LaTeX and pages are lowered from it. A component describes one joint; an FMU has as many
of them as joints, and parameters that they share.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import sympy

from hesr_model.equations.memory import DT, Element, Relaxation, Stop
from hesr_model.errors import ArtifactError

K = TypeVar("K")


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A named number, with its SI unit in FMI's spelling ("1" if dimensionless)."""

    name: str
    unit: str
    description: str

    @property
    def symbol(self) -> sympy.Symbol:
        """SymPy symbol under which expressions use it."""
        return sympy.Symbol(self.name, real=True)


@dataclass(frozen=True, kw_only=True)
class Parameter(Quantity):
    """A number that a user sets: its start value, and whether it may change while it runs."""

    start: float = 0.0
    tunable: bool = True


@dataclass(frozen=True, kw_only=True)
class Choice(Parameter):
    """A parameter that is one of named choices, numbered from 1."""

    unit: str = "1"
    tunable: bool = False
    items: tuple[tuple[str, str], ...]
    """Name and description of each."""

    def case(self, cases: Mapping[str, sympy.Expr]) -> sympy.Expr:
        """Return the expression of the choice that is made; 0 for one that is not among `cases`."""
        numbers = {name: k for k, (name, _) in enumerate(self.items, start=1)}
        return sympy.Piecewise(
            *((e, sympy.Eq(self.symbol, numbers[name])) for name, e in cases.items()), (0, True)
        )


@dataclass(frozen=True, kw_only=True)
class Equation(Quantity):
    """name = expression.

    Attributes
    ----------
    expression : of inputs, parameters, states with their derivatives, names and previous ones.
    output : whether others see it.
    start : of previous(name) at the first sample, of the same and of names; None where nothing asks
        for the previous value.
    """

    unit: str = "1"
    description: str = ""
    expression: sympy.Expr
    output: bool = False
    start: sympy.Expr | None = None


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """What a parameter must be when a run begins: `condition` holds, or `text` says what it must.

    Attributes
    ----------
    name : of the parameter.
    condition : of parameters, true where all is well.
    text : goes on after "it must", as "be positive".
    """

    name: str
    condition: sympy.Basic
    text: str


def previous(name: str) -> sympy.Symbol:
    """Return the symbol of an equation's value at the last sample."""
    return sympy.Symbol(f"previous({name})", real=True)


@dataclass(frozen=True, kw_only=True)
class Component:
    """The equations of one joint.

    Attributes
    ----------
    inputs : signals.
    parameters : of the joint.
    shared : parameters of all joints together.
    memory : states, in the order in which they move; what they read may be previous values, too.
    equations : in any order that has no circle.
    sample_time : name of the parameter at whose multiples it ticks [s], between which all holds;
        empty where every step is a sample.
    requirements : on parameters.
    reversing : inputs at whose change of sign a solver does well to stop where a magnitude bends.
    settling : share, from 0 to 1, of the way from the states' own start to the steady state of the
        first inputs at which they begin; of inputs and parameters.

    Raises
    ------
    ArtifactError
        If an expression uses a symbol that is nothing of the component's, two things have one name,
        or equations go in a circle.
    """

    inputs: tuple[Quantity, ...] = ()
    parameters: tuple[Quantity, ...] = ()
    shared: tuple[Quantity, ...] = ()
    memory: tuple[Element, ...] = ()
    equations: tuple[Equation, ...]
    sample_time: str = ""
    requirements: tuple[Requirement, ...] = ()
    reversing: tuple[sympy.Symbol, ...] = ()
    settling: sympy.Expr = sympy.S.Zero

    def __post_init__(self) -> None:
        given = [q.symbol for q in self.given]
        states = [s for m in self.memory for s in (m.state, m.derivative)]
        named = [e.symbol for e in self.equations]
        names = Counter([*given, *states, *named])
        if twice := [symbol for symbol, count in names.items() if count > 1]:
            raise ArtifactError(
                f"equations: '{twice[0]}' stands twice among its inputs, coefficients, states and "
                "names."
            )
        before = {previous(e.name) for e in self.equations if e.start is not None}
        known = {*given, DT, *before}
        for element in self.memory:
            own = {element.state} if isinstance(element, Relaxation) else set()
            rate = element.parts[1].free_symbols - known - own
            _require_known((element.parts[0].free_symbols - known) | rate, element.name)
            known.add(element.state)
        known |= {*states, *named}
        for equation in self.equations:
            parts = (equation.expression, *(() if equation.start is None else (equation.start,)))
            _require_known(set().union(*(e.free_symbols for e in parts)) - known, equation.name)
        _require_known(self.settling.free_symbols - set(given), "settling")
        self.ordered  # noqa: B018 - raises where equations go in a circle

    @property
    def given(self) -> tuple[Quantity, ...]:
        """Inputs and all parameters."""
        return (*self.inputs, *self.parameters, *self.shared)

    @cached_property
    def ordered(self) -> tuple[Equation, ...]:
        """The equations, each after those that it uses."""
        by_symbol = {e.symbol: e for e in self.equations}
        return tuple(
            by_symbol[s] for s in in_order({s: e.expression for s, e in by_symbol.items()})
        )

    @property
    def outputs(self) -> tuple[Equation, ...]:
        """The equations that others see, in the order in which they were given."""
        return tuple(e for e in self.equations if e.output)

    @property
    def remembered(self) -> tuple[Equation, ...]:
        """The equations whose previous value counts."""
        return tuple(e for e in self.equations if e.start is not None)

    @property
    def starts(self) -> Mapping[sympy.Symbol, sympy.Expr]:
        """What each previous value is before the first step."""
        return {previous(e.name): e.start for e in self.equations if e.start is not None}

    @cached_property
    def starting(self) -> Mapping[sympy.Symbol, sympy.Expr]:
        """Each equation, in order, as before the first step: previous values are starts, dt 0."""
        found = {
            e.symbol: e.expression.xreplace(self.starts).xreplace({DT: sympy.Integer(0)})
            for e in self.equations
        }
        return {symbol: found[symbol] for symbol in in_order(found)}

    @cached_property
    def sampled_memory(self) -> bool:
        """Whether memory reads previous values: it moves exactly, and by whole steps only."""
        read = sympy.Tuple(*(part for m in self.memory for part in m.parts)).free_symbols
        return any(previous(e.name) in read for e in self.remembered)

    @cached_property
    def holds(self) -> bool:
        """Whether outputs move by steps only, as what is made of a step's length and the past."""
        timed = any(DT in e.expression.free_symbols for e in self.equations)
        return timed and bool(self.remembered)

    def sources(self, expression: sympy.Expr, *, starting: bool = False) -> frozenset[sympy.Symbol]:
        """Return the inputs, parameters and states of which an expression is made, via names.

        A state's derivative stands for what its element reads, and before the first step
        (`starting`) a previous value for its start.
        """
        into = {e.symbol: e.expression for e in self.equations}
        into |= self.starts if starting else {}
        into |= {m.derivative: sympy.Tuple(m.state, *m.parts) for m in self.memory}
        seen: set[sympy.Symbol] = set()
        waiting = set(expression.free_symbols)
        while waiting:
            symbol = waiting.pop()
            seen.add(symbol)
            waiting |= into.get(symbol, sympy.Integer(0)).free_symbols - seen
        return frozenset(seen - into.keys())


def in_order(expressions: Mapping[sympy.Symbol, sympy.Expr]) -> Iterator[sympy.Symbol]:
    """Yield the symbols of named expressions, each after those that its own expression uses.

    Raises
    ------
    ArtifactError
        If they go in a circle.
    """
    done: set[sympy.Symbol] = set()

    def visit(symbol: sympy.Symbol, path: tuple[sympy.Symbol, ...]) -> Iterator[sympy.Symbol]:
        if symbol in path:
            raise ArtifactError(
                f"equations: '{symbol}' depends on itself, by way of "
                f"{', '.join(map(str, path[path.index(symbol) :]))}; use previous()."
            )
        if symbol in done:
            return
        used = sorted(expressions[symbol].free_symbols & expressions.keys(), key=str)
        for other in used:
            yield from visit(other, (*path, symbol))
        done.add(symbol)
        yield symbol

    for symbol in expressions:
        yield from visit(symbol, ())


def elements_of(memory: Iterable[Element], kind: type[K]) -> tuple[K, ...]:
    """Return the elements of one kind, in their order."""
    return tuple(m for m in memory if isinstance(m, kind))


def _require_known(unknown: set[sympy.Symbol], where: str) -> None:
    if unknown:
        raise ArtifactError(
            f"equations: symbol '{min(map(str, unknown))}' of '{where}' is neither an input, "
            "a coefficient nor a state."
        )


__all__ = [
    "Choice", "Component", "Equation", "Parameter", "Quantity", "Relaxation", "Requirement", "Stop",
    "elements_of", "in_order", "previous",
]  # fmt: skip
