"""Straight-line programs of a component: ordered assignments."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import sympy

from hesr_model.equations.component import Component, order_symbols
from hesr_model.equations.functions import absolute, clip, positive, sgn
from hesr_model.equations.memory import Element, Prompt

Assignments = Mapping[sympy.Symbol, sympy.Expr]
Definitions = dict[sympy.Symbol, sympy.Expr]
STEEP = 1e-3  # half width of a jump without event [rad/s]


def moved_symbol(element: Element) -> sympy.Symbol:
    """Return the symbol of a moved state."""
    return sympy.Symbol(f"{element.name}_moved", real=True)


def step(memory: Iterable[Element]) -> Definitions:
    """Return the moved states; each uses the moved earlier ones."""
    moved_states: Definitions = {}
    replacements: Definitions = {}
    for element in memory:
        first, second = (part.xreplace(replacements) for part in element.parts)
        moved_states[moved_symbol(element)] = element.advance(first, positive(second))
        replacements[element.state] = moved_symbol(element)
    return moved_states


_SEARCH_STEPS = 60  # steps of the search for the settled state; about thirty bridge a factor of 1e9


def initial_symbol(element: Element) -> sympy.Symbol:
    """Return the symbol of an initial state; the state's own symbol is its start."""
    return sympy.Symbol(f"{element.name}_begun", real=True)


def initial_state(memory: Iterable[Element], settling: sympy.Expr) -> Definitions:
    """Return initial states, moved by `settling` towards steady ones, and intermediate values."""
    definitions: Definitions = {}
    replacements: Definitions = {}
    for element in memory:
        first, second = (part.xreplace(replacements) for part in element.parts)
        steady_value = element.steady_state(first, positive(second))
        if element.seeks:
            search_steps = _search_steady_state(element, steady_value)
            definitions |= search_steps
            steady_value = list(search_steps)[-1]
        share = sympy.S.One if isinstance(element, Prompt) else settling
        displacement = share * (steady_value - element.state)
        definitions[initial_symbol(element)] = element.state + displacement
        replacements[element.state] = initial_symbol(element)
    return definitions


def _search_steady_state(element: Element, iteration: sympy.Expr) -> Definitions:
    """Return estimates of a steady state, each one step of an iteration from the state before."""
    definitions: Definitions = {}
    estimate = element.state
    for n in range(_SEARCH_STEPS):
        next_estimate = sympy.Symbol(f"{element.name}_nearer_{n}", real=True)
        definitions[next_estimate] = iteration.xreplace({element.state: estimate})
        estimate = next_estimate
    return definitions


def build_initial_states(component: Component) -> Definitions:
    """Return a component's initial states, and intermediate values."""
    definitions = initial_state(component.memory, component.settling)
    return {
        symbol: expression.xreplace(component.starts) for symbol, expression in definitions.items()
    }


def derivatives(memory: Iterable[Element]) -> Definitions:
    """Return each state's continuous derivative."""
    return {element.derivative: element.express_derivative() for element in memory}


def readings(component: Component) -> Definitions:
    """Return derivatives of the states and all ordered equations."""
    return derivatives(component.memory) | {
        equation.symbol: equation.expression for equation in component.ordered
    }


def first_readings(component: Component) -> Definitions:
    """Return the readings before the first step, and the previous values there."""
    starts = component.starts
    previous_values = {symbol: expression.xreplace(starts) for symbol, expression in starts.items()}
    return {**derivatives(component.memory), **component.starting, **previous_values}


def derive_changes(seeds: Assignments, assignments: Assignments) -> Definitions:
    """Return the change `d_...` of each assigned symbol along a direction of seeds."""
    known_changes = dict(seeds)
    changes: Definitions = {}
    for symbol, expression in assignments.items():
        changed_symbols = sorted(
            expression.free_symbols & known_changes.keys(), key=sympy.default_sort_key
        )
        terms = [
            expression.diff(changed_symbol) * known_changes[changed_symbol]
            for changed_symbol in changed_symbols
        ]
        change = sympy.Add(*terms)
        if change != 0:  # later derivatives skip constant symbols
            known_changes[symbol] = change_symbol(symbol)
            changes[known_changes[symbol]] = change
    return changes


def change_symbol(symbol: sympy.Symbol) -> sympy.Symbol:
    """Return the symbol of a directional change."""
    return sympy.Symbol(f"d_{symbol.name}", real=True)


@dataclass(frozen=True)
class Jumps:
    """Solver events: sign changes that make a component jump; signs are held in between.

    Bends, for example of |v| or |v| sgn(v), are events for reversing inputs only. Signs of states
    alone are not held, since only outputs depend on them.
    """

    component: Component
    all_magnitudes: bool = (
        False  # True if all magnitudes are events, for tools that also hold their signs
    )

    @cached_property
    def expressions(self) -> tuple[sympy.Expr, ...]:
        """Arguments of signs and magnitudes, functions of inputs and parameters alone."""
        component = self.component
        given_symbols = {quantity.symbol for quantity in component.given}
        inputs = {quantity.symbol for quantity in component.inputs}
        jumps, bends = _find_jumps_and_bends(_list_expressions(component))
        if not self.all_magnitudes:
            reversing = set(component.reversing)
            bends = {bend for bend in bends if bend.free_symbols & inputs <= reversing}
        events = [
            expression
            for expression in jumps | bends
            if expression.free_symbols <= given_symbols and expression.free_symbols & inputs
        ]
        return tuple(sorted(events, key=sympy.default_sort_key))

    @cached_property
    def signs(self) -> tuple[sympy.Symbol, ...]:
        """Symbol of each sign."""
        return tuple(sympy.Symbol(f"s_{i}", real=True) for i in range(1, len(self.expressions) + 1))

    def hold_signs(self, assignments: Assignments) -> Definitions:
        """Replace signs in assignments by held ones, if the component has events."""
        if not self.component.events:
            return dict(assignments)
        held_signs = {}
        for expression, sign in zip(self.expressions, self.signs, strict=True):
            held_signs[sgn(expression)] = sign
        return {
            symbol: expression.xreplace(held_signs) for symbol, expression in assignments.items()
        }


def _find_jumps_and_bends(
    expressions: Iterable[sympy.Expr],
) -> tuple[set[sympy.Expr], set[sympy.Expr]]:
    """Return arguments whose sign makes expressions jump, and all of signs and magnitudes."""
    jumps: set[sympy.Expr] = set()
    bends: set[sympy.Expr] = set()
    for expression in expressions:
        for sign in expression.atoms(sgn):
            z = sign.args[0]
            bends.add(z)
            if z not in jumps and _has_jump(expression, z):
                jumps.add(z)
        for magnitude in expression.atoms(absolute):
            bends.add(magnitude.args[0])
    return jumps, bends


def _list_expressions(component: Component) -> list[sympy.Expr]:
    """Return the expressions of equations, then those of memory."""
    expressions = [equation.expression for equation in component.equations]
    for element in component.memory:
        expressions += [*element.parts, element.express_derivative()]
    return expressions


def remove_events(component: Component) -> Component:
    """Return a component without events, whose jumps are steep lines."""
    jumps = Jumps(replace(component, reversing=())).expressions
    steep_lines = {sgn(jump): clip(jump / STEEP, 1) for jump in jumps}
    equations = []
    for equation in component.equations:
        expression = equation.expression.xreplace(steep_lines)
        start = equation.start
        if start is not None:
            start = start.xreplace(steep_lines)
        equations.append(replace(equation, expression=expression, start=start))
    memory = tuple(element.subs(steep_lines) for element in component.memory)
    return replace(component, events=False, memory=memory, equations=tuple(equations))


def _has_jump(expression: sympy.Expr, z: sympy.Expr) -> bool:
    """Return whether an expression differs on the two sides of z = 0, or z is not a symbol."""
    if not z.is_Symbol:
        return True
    ahead = expression.xreplace({sgn(z): sympy.Integer(1)}).xreplace({z: sympy.S.Zero})
    behind = expression.xreplace({sgn(z): sympy.Integer(-1)}).xreplace({z: sympy.S.Zero})
    return bool(sympy.expand(ahead - behind) != 0)


def find_sources(assignments: Assignments, target: sympy.Symbol) -> frozenset[sympy.Symbol]:
    """Return the unassigned symbols that a symbol depends on."""
    required = order_definitions(assignments, [target])
    read_symbols = set[sympy.Symbol]().union(
        *(expression.free_symbols for expression in required.values())
    )
    return frozenset(read_symbols - assignments.keys())


def order_definitions(assignments: Assignments, targets: Iterable[sympy.Symbol]) -> Definitions:
    """Return the ordered assignments that the targets depend on."""
    required_symbols: set[sympy.Symbol] = set()
    waiting = set(targets) & assignments.keys()
    while waiting:
        symbol = waiting.pop()
        required_symbols.add(symbol)
        waiting |= (assignments[symbol].free_symbols & assignments.keys()) - required_symbols
    required = {
        symbol: expression
        for symbol, expression in assignments.items()
        if symbol in required_symbols
    }
    return {symbol: required[symbol] for symbol in order_symbols(required)}


def build_straight_line(
    assignments: Assignments, targets: Iterable[sympy.Symbol]
) -> tuple[Definitions, dict[sympy.Symbol, str]]:
    """Return ordered assignments with shared subexpressions, and their short names `a_0`, .."""
    required = order_definitions(assignments, targets)
    shared, reduced = sympy.cse(
        list(required.values()), symbols=sympy.numbered_symbols("t"), order="none"
    )
    lines = dict(zip(required, reduced, strict=True)) | dict(shared)
    names = {symbol: f"a_{i}" for i, symbol in enumerate(required)}
    return {symbol: lines[symbol] for symbol in order_symbols(lines)}, names


def build_step(component: Component) -> Definitions:
    """Return the assignments of a step: `moved` states, then readings."""
    moved_symbols = {element.state: moved_symbol(element) for element in component.memory}
    return step(component.memory) | {
        symbol: expression.xreplace(moved_symbols)
        for symbol, expression in readings(component).items()
    }


@dataclass(frozen=True, kw_only=True)
class Invariants:
    """Program split into `once`, of fixed symbols alone, and `moving`, which reads `reused`."""

    once: Assignments
    reused: tuple[sympy.Symbol, ...]
    moving: Assignments
    names: Mapping[sympy.Symbol, str]

    @classmethod
    def from_program(
        cls, program: Assignments, targets: Iterable[sympy.Symbol], fixed: Iterable[sympy.Symbol]
    ) -> "Invariants":
        """Split a program; fixed factors and terms are combined, and rounded as such."""
        targets = tuple(targets)
        lines, names = build_straight_line(program, targets)
        fixed_parts = _FixedParts(fixed)
        moving: Definitions = {}
        for symbol, expression in lines.items():
            if not expression.is_Atom and fixed_parts.is_fixed(expression):
                fixed_parts.define(symbol, expression)
            else:
                moving[symbol] = fixed_parts.separate_terms(expression)
        read_symbols = set[sympy.Symbol](targets).union(
            *(expression.free_symbols for expression in moving.values())
        )
        once = fixed_parts.definitions
        return cls(
            once=once,
            reused=tuple(symbol for symbol in once if symbol in read_symbols),
            moving=moving,
            names=names,
        )


class _FixedParts:
    """Parts of expressions that depend on fixed symbols alone, each defined once."""

    def __init__(self, fixed: Iterable[sympy.Symbol]) -> None:
        self.definitions: Definitions = {}
        self._fixed_symbols = set(fixed)
        self._symbol_by_part: dict[sympy.Expr, sympy.Symbol] = {}

    def is_fixed(self, expression: sympy.Expr) -> bool:
        """Return whether an expression reads fixed symbols only, or none."""
        return bool(expression.free_symbols <= self._fixed_symbols)

    def define(self, symbol: sympy.Symbol, part: sympy.Expr) -> None:
        """Define a symbol by a fixed part; later equal parts are replaced by the first symbol."""
        self.definitions[symbol] = part
        self._symbol_by_part.setdefault(part, symbol)
        self._fixed_symbols.add(symbol)

    def separate_terms(self, expression: sympy.Expr) -> sympy.Expr:
        """Return an expression with symbols in place of its fixed parts, which are defined."""
        if expression.is_Atom:
            return expression
        if expression.free_symbols and self.is_fixed(expression):
            return self._name_part(expression)
        arguments = list(expression.args)
        if expression.is_Add or expression.is_Mul:
            # Fixed terms or factors become one part, although others may be between them.
            part = expression.func(*filter(self.is_fixed, arguments))
            if part.free_symbols and not part.is_Atom:
                changing = [argument for argument in arguments if not self.is_fixed(argument)]
                arguments = [self._name_part(part), *changing]
        return expression.func(*map(self.separate_terms, arguments))

    def _name_part(self, part: sympy.Expr) -> sympy.Symbol:
        if part not in self._symbol_by_part:
            symbol = sympy.Symbol(f"fixed_{len(self._symbol_by_part)}", real=True)
            self.define(symbol, part)
        return self._symbol_by_part[part]
