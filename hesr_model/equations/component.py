"""Components: named equations of one joint, lowered to every target.

name = expression            function of inputs, parameters, states, names and `dt`
previous(name)               value at the last sample, with its own start expression
Relaxation, Stop             memory with a sampled and a continuous form
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass
from functools import cached_property

import sympy

from hesr_model.equations.memory import DT, Element, Relaxation, find_read_symbols
from hesr_model.errors import ArtifactError


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Named number with its SI unit in FMI's spelling.

    `values` are the numbers of an integer with their meanings; a `logical`
    quantity is 0 or 1. Both have the unit 1.
    """

    name: str
    unit: str
    description: str
    values: tuple[tuple[int, str], ...] = ()
    logical: bool = False

    @property
    def symbol(self) -> sympy.Symbol:
        """Symbol for expressions."""
        return sympy.Symbol(self.name, real=True)


@dataclass(frozen=True, kw_only=True)
class Parameter(Quantity):
    """Number set by the user, changeable during a run if `tunable`."""

    start: float = 0.0
    tunable: bool = True


@dataclass(frozen=True, kw_only=True)
class Choice(Parameter):
    """Parameter with named values, numbered from 1."""

    unit: str = "1"
    tunable: bool = False
    items: tuple[tuple[str, str], ...]  # name and description of each value

    def case(self, cases: Mapping[str, sympy.Expr]) -> sympy.Expr:
        """Return the expression of the current value; 0 for values without a case."""
        numbers = {name: k for k, (name, _) in enumerate(self.items, start=1)}
        return sympy.Piecewise(
            *(
                (expression, sympy.Eq(self.symbol, numbers[name]))
                for name, expression in cases.items()
            ),
            (0, True),
        )


@dataclass(frozen=True, kw_only=True)
class Equation(Quantity):
    """name = expression; `start` is previous(name) at the first sample, None if unused."""

    unit: str = "1"
    description: str = ""
    expression: sympy.Expr
    output: bool = False
    start: sympy.Expr | None = None


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """Condition on a parameter at the start of a run; `text` continues "it must"."""

    name: str
    condition: sympy.Basic
    text: str


def previous(name: str) -> sympy.Symbol:
    """Return the symbol of the last sample's value."""
    return sympy.Symbol(f"previous({name})", real=True)


@dataclass(frozen=True, kw_only=True)
class Component:
    """Equations of one joint; ArtifactError for unknown or repeated symbols, or a circle.

    Attributes
    ----------
    shared : parameters of all joints.
    memory : states, in the order of their moves; they may also read previous
        values.
    sample_time : name of the parameter with the sample period [s]; empty if
        every step is a sample.
    reversing : inputs whose sign changes are solver events because a magnitude
        bends there.
    settling : share of the steady state in the initial state, 0 to 1; the rest
        is `start`.
    events : whether signs are held between events; else a sign change only ends
        a solver's step.
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
    events: bool = True

    def __post_init__(self) -> None:
        given_symbols = [quantity.symbol for quantity in self.given]
        state_symbols = []
        for element in self.memory:
            state_symbols += [element.state, element.derivative]
        equation_symbols = [equation.symbol for equation in self.equations]
        _require_unique([*given_symbols, *state_symbols, *equation_symbols])
        previous_symbols = [previous(equation.name) for equation in self.remembered]
        known_symbols = {*given_symbols, DT, *previous_symbols}
        self._require_known_memory(known_symbols)
        self._require_known_equations({*known_symbols, *state_symbols, *equation_symbols})
        _require_known(self.settling.free_symbols - set(given_symbols), "settling")
        _require_acyclic({equation.symbol: equation.expression for equation in self.equations})

    def _require_known_memory(self, known_symbols: Set[sympy.Symbol]) -> None:
        """Raise ArtifactError if memory reads unknown symbols or states that move later."""
        readable_symbols = set(known_symbols)
        for element in self.memory:
            first, second = element.parts
            unknown_of_second = second.free_symbols - readable_symbols
            if isinstance(element, Relaxation):
                # A rate may depend on the state itself, which is frozen over a step.
                unknown_of_second.discard(element.state)
            unknown_of_first = first.free_symbols - readable_symbols
            _require_known(unknown_of_first | unknown_of_second, element.name)
            readable_symbols.add(element.state)

    def _require_known_equations(self, known_symbols: Set[sympy.Symbol]) -> None:
        """Raise ArtifactError if equations or their starts read unknown symbols."""
        for equation in self.equations:
            read_symbols = set(equation.expression.free_symbols)
            if equation.start is not None:
                read_symbols |= equation.start.free_symbols
            _require_known(read_symbols - known_symbols, equation.name)

    @property
    def given(self) -> tuple[Quantity, ...]:
        """Inputs and all parameters."""
        return (*self.inputs, *self.parameters, *self.shared)

    @cached_property
    def ordered(self) -> tuple[Equation, ...]:
        """Equations, each after those it uses."""
        equations_by_symbol = {equation.symbol: equation for equation in self.equations}
        expressions = {equation.symbol: equation.expression for equation in self.equations}
        return tuple(equations_by_symbol[symbol] for symbol in order_symbols(expressions))

    @property
    def outputs(self) -> tuple[Equation, ...]:
        """Visible equations."""
        return tuple(equation for equation in self.equations if equation.output)

    @property
    def remembered(self) -> tuple[Equation, ...]:
        """Equations with a previous value."""
        return tuple(equation for equation in self.equations if equation.start is not None)

    @property
    def starts(self) -> Mapping[sympy.Symbol, sympy.Expr]:
        """Previous values before the first step."""
        return {
            previous(equation.name): equation.start
            for equation in self.equations
            if equation.start is not None
        }

    @cached_property
    def starting(self) -> Mapping[sympy.Symbol, sympy.Expr]:
        """Ordered equations before the first step: previous values are starts, dt is 0."""
        start_expressions = {
            equation.symbol: equation.expression.xreplace(self.starts).xreplace(
                {DT: sympy.Integer(0)}
            )
            for equation in self.equations
        }
        return {symbol: start_expressions[symbol] for symbol in order_symbols(start_expressions)}

    @cached_property
    def sampled_memory(self) -> bool:
        """True if memory reads previous values; it then moves by whole steps only."""
        read_symbols = find_read_symbols(self.memory)
        return any(previous(equation.name) in read_symbols for equation in self.remembered)

    @cached_property
    def holds(self) -> bool:
        """True if outputs depend on `dt` and previous values and so change by steps only."""
        timed = any(DT in equation.expression.free_symbols for equation in self.equations)
        return timed and bool(self.remembered)

    def find_sources(
        self, expression: sympy.Expr, *, starting: bool = False
    ) -> frozenset[sympy.Symbol]:
        """Return the given symbols and states behind an expression, at the start if `starting`."""
        definitions = {equation.symbol: equation.expression for equation in self.equations}
        if starting:
            definitions |= self.starts
        for element in self.memory:
            definitions[element.derivative] = sympy.Tuple(element.state, *element.parts)
        visited: set[sympy.Symbol] = set()
        waiting = set(expression.free_symbols)
        while waiting:
            symbol = waiting.pop()
            visited.add(symbol)
            waiting |= definitions.get(symbol, sympy.Integer(0)).free_symbols - visited
        return frozenset(visited - definitions.keys())


def order_symbols(expressions: Mapping[sympy.Symbol, sympy.Expr]) -> Iterator[sympy.Symbol]:
    """Yield symbols, each after those it uses; raise ArtifactError for a circle."""
    visited: set[sympy.Symbol] = set()

    def visit(symbol: sympy.Symbol, path: tuple[sympy.Symbol, ...]) -> Iterator[sympy.Symbol]:
        if symbol in path:
            raise ArtifactError(
                f"equations: '{symbol}' depends on itself through "
                f"{', '.join(map(str, path[path.index(symbol) :]))}; use previous()."
            )
        if symbol in visited:
            return
        for other in sorted(expressions[symbol].free_symbols & expressions.keys(), key=str):
            yield from visit(other, (*path, symbol))
        visited.add(symbol)
        yield symbol

    for symbol in expressions:
        yield from visit(symbol, ())


def _require_unique(symbols: Iterable[sympy.Symbol]) -> None:
    for symbol, count in Counter(symbols).items():
        if count > 1:
            raise ArtifactError(
                f"equations: '{symbol}' is used twice among inputs, coefficients, states and names."
            )


def _require_acyclic(expressions: Mapping[sympy.Symbol, sympy.Expr]) -> None:
    """Raise ArtifactError if expressions form a circle."""
    for _ in order_symbols(expressions):
        pass


def _require_known(unknown: set[sympy.Symbol], where: str) -> None:
    if unknown:
        raise ArtifactError(
            f"equations: symbol '{min(map(str, unknown))}' of '{where}' is neither an input, "
            "a coefficient nor a state."
        )
