"""Straight-line programs of a component: ordered assignments."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import sympy

from hesr_model.equations.component import Component, in_order
from hesr_model.equations.functions import absolute, clip, positive, sgn
from hesr_model.equations.memory import Element, Prompt

Assignments = Mapping[sympy.Symbol, sympy.Expr]
Definitions = dict[sympy.Symbol, sympy.Expr]
STEEP = 1e-3  # half width of a jump without event [rad/s]


def moved(element: Element) -> sympy.Symbol:
    """Return the symbol of a moved state."""
    return sympy.Symbol(f"{element.name}_moved", real=True)


def step(memory: Iterable[Element]) -> Definitions:
    """Return the moved states; each uses the moved earlier ones."""
    after: Definitions = {}
    seen: Definitions = {}
    for element in memory:
        first, second = (part.xreplace(seen) for part in element.parts)
        after[moved(element)] = element.sampled(first, positive(second))
        seen[element.state] = moved(element)
    return after


_SEARCH = 60  # steps of the search for the settled state; about thirty bridge a factor of 1e9


def initial_symbol(element: Element) -> sympy.Symbol:
    """Return the symbol of an initial state; the state's own symbol is its start."""
    return sympy.Symbol(f"{element.name}_begun", real=True)


def initial_state(memory: Iterable[Element], settling: sympy.Expr) -> Definitions:
    """Return initial states, moved by `settling` towards steady ones, and intermediate values."""
    found: Definitions = {}
    seen: Definitions = {}
    for element in memory:
        first, second = (part.xreplace(seen) for part in element.parts)
        settled = element.settled(first, positive(second))
        x = element.state
        for n in range(_SEARCH if element.seeks else 0):
            nearer = sympy.Symbol(f"{element.name}_nearer_{n}", real=True)
            found[nearer] = settled.xreplace({element.state: x})
            x = nearer
        end = x if element.seeks else settled
        share = sympy.S.One if isinstance(element, Prompt) else settling
        found[initial_symbol(element)] = element.state + share * (end - element.state)
        seen[element.state] = initial_symbol(element)
    return found


def beginning(component: Component) -> Definitions:
    """Return a component's initial states, and intermediate values."""
    own = initial_state(component.memory, component.settling)
    return {symbol: e.xreplace(component.starts) for symbol, e in own.items()}


def derivatives(memory: Iterable[Element]) -> Definitions:
    """Return each state's continuous derivative."""
    return {element.derivative: element.continuous() for element in memory}


def readings(component: Component) -> Definitions:
    """Return derivatives of the states and all ordered equations."""
    return derivatives(component.memory) | {
        equation.symbol: equation.expression for equation in component.ordered
    }


def first_readings(component: Component) -> Definitions:
    """Return the readings before the first step, and the previous values there."""
    starts = component.starts
    own = {symbol: e.xreplace(starts) for symbol, e in starts.items()}
    return {**derivatives(component.memory), **component.starting, **own}


def changes_along(seeds: Assignments, assignments: Assignments) -> Definitions:
    """Return the change `d_...` of each assigned symbol along a direction of seeds."""
    known = dict(seeds)
    changes: Definitions = {}
    for symbol, expression in assignments.items():
        used = sorted(expression.free_symbols & known.keys(), key=sympy.default_sort_key)
        change = sympy.Add(*(expression.diff(s) * known[s] for s in used))
        if change != 0:  # later derivatives skip constant symbols
            known[symbol] = change_of(symbol)
            changes[known[symbol]] = change
    return changes


def change_of(symbol: sympy.Symbol) -> sympy.Symbol:
    """Return the symbol of a directional change."""
    return sympy.Symbol(f"d_{symbol.name}", real=True)


@dataclass(frozen=True)
class Jumps:
    """Solver events: sign changes that make a component jump; signs are held in between.

    Bends, for example of |v| or |v| sgn(v), are events for reversing inputs only. Signs of states
    alone are not held, since only outputs depend on them.
    """

    component: Component
    every: bool = False  # True if all magnitudes are events, for tools that also hold their signs

    @cached_property
    def expressions(self) -> tuple[sympy.Expr, ...]:
        """Arguments of signs and magnitudes, functions of inputs and parameters alone."""
        component = self.component
        given = {quantity.symbol for quantity in component.given}
        inputs = {quantity.symbol for quantity in component.inputs}
        parts = [e.expression for e in component.equations]
        parts += [
            part for element in component.memory for part in (*element.parts, element.continuous())
        ]
        signs = {(e, node.args[0]) for e in parts for node in e.atoms(sgn)}
        jumps = {z for e, z in signs if _jumps(e, z)}
        bends = {z for _, z in signs} | {n.args[0] for e in parts for n in e.atoms(absolute)}
        if not self.every:
            bends = {e for e in bends if e.free_symbols & inputs <= {*component.reversing}}
        found = [e for e in jumps | bends if e.free_symbols <= given and e.free_symbols & inputs]
        return tuple(sorted(found, key=sympy.default_sort_key))

    @cached_property
    def signs(self) -> tuple[sympy.Symbol, ...]:
        """Symbol of each sign."""
        return tuple(sympy.Symbol(f"s_{i}", real=True) for i in range(1, len(self.expressions) + 1))

    def held(self, assignments: Assignments) -> Definitions:
        """Replace signs in assignments by held ones, if the component has events."""
        if not self.component.events:
            return dict(assignments)
        swap = {sgn(e): s for e, s in zip(self.expressions, self.signs, strict=True)}
        return {symbol: e.xreplace(swap) for symbol, e in assignments.items()}


def event_free(component: Component) -> Component:
    """Return a component without events, whose jumps are steep lines."""
    jumps = Jumps(replace(component, reversing=())).expressions
    steep = {sgn(equation): clip(equation / STEEP, 1) for equation in jumps}
    equations = []
    for equation in component.equations:
        start = None if equation.start is None else equation.start.xreplace(steep)
        equations.append(
            replace(equation, expression=equation.expression.xreplace(steep), start=start)
        )
    memory = tuple(element.subs(steep) for element in component.memory)
    return replace(component, events=False, memory=memory, equations=tuple(equations))


def _jumps(expression: sympy.Expr, z: sympy.Expr) -> bool:
    """Return whether an expression differs on the two sides of z = 0, or z is not a symbol."""
    ahead, back = (
        expression.xreplace({sgn(z): sympy.Integer(way)}).xreplace({z: sympy.S.Zero})
        for way in (1, -1)
    )
    return not (z.is_Symbol and sympy.expand(ahead - back) == 0)


def sources(assignments: Assignments, wanted: sympy.Symbol) -> frozenset[sympy.Symbol]:
    """Return the unassigned symbols that a symbol depends on."""
    own = needed(assignments, [wanted])
    used = set[sympy.Symbol]().union(*(e.free_symbols for e in own.values()))
    return frozenset(used - assignments.keys())


def needed(assignments: Assignments, wanted: Iterable[sympy.Symbol]) -> Definitions:
    """Return the ordered assignments for the wanted symbols."""
    keep: set[sympy.Symbol] = set()
    waiting = set(wanted) & assignments.keys()
    while waiting:
        symbol = waiting.pop()
        keep.add(symbol)
        waiting |= (assignments[symbol].free_symbols & assignments.keys()) - keep
    kept = {s: e for s, e in assignments.items() if s in keep}
    return {s: kept[s] for s in in_order(kept)}


def straight_line(
    assignments: Assignments, wanted: Iterable[sympy.Symbol]
) -> tuple[Definitions, dict[sympy.Symbol, str]]:
    """Return ordered assignments with shared subexpressions, and their short names `a_0`, .."""
    own = needed(assignments, wanted)
    shared, found = sympy.cse(list(own.values()), symbols=sympy.numbered_symbols("t"), order="none")
    lines = dict(zip(own, found, strict=True)) | dict(shared)
    names = {symbol: f"a_{i}" for i, symbol in enumerate(own)}
    return {symbol: lines[symbol] for symbol in in_order(lines)}, names


def sampled(component: Component) -> Definitions:
    """Return the assignments of a step: `moved` states, then readings."""
    after = {element.state: moved(element) for element in component.memory}
    return step(component.memory) | {s: e.xreplace(after) for s, e in readings(component).items()}


@dataclass(frozen=True, kw_only=True)
class Invariants:
    """Program split into `once`, of fixed symbols alone, and `moving`, which uses those `kept`."""

    once: Assignments
    kept: tuple[sympy.Symbol, ...]
    moving: Assignments
    names: Mapping[sympy.Symbol, str]

    @classmethod
    def of(
        cls, program: Assignments, wanted: Iterable[sympy.Symbol], fixed: Iterable[sympy.Symbol]
    ) -> "Invariants":
        """Split a program; fixed factors and terms are combined, and rounded as such."""
        wanted = tuple(wanted)
        lines, names = straight_line(program, wanted)
        once: Definitions = {}
        moving: Definitions = {}
        known = set(fixed)
        parts = dict[sympy.Expr, sympy.Symbol]()

        def symbol_of(part: sympy.Expr) -> sympy.Symbol:
            if part not in parts:
                parts[part] = symbol = sympy.Symbol(f"fixed_{len(parts)}", real=True)
                once[symbol] = part
                known.add(symbol)
            return parts[part]

        def separated(expression: sympy.Expr) -> sympy.Expr:
            if expression.is_Atom:
                return expression
            if expression.free_symbols and expression.free_symbols <= known:
                return symbol_of(expression)
            rest = list(expression.args)
            if expression.is_Add or expression.is_Mul:
                part = expression.func(*(a for a in rest if a.free_symbols <= known))
                if part.free_symbols and not part.is_Atom:
                    rest = [symbol_of(part), *(a for a in rest if not a.free_symbols <= known)]
            return expression.func(*map(separated, rest))

        for symbol, expression in lines.items():
            if not expression.is_Atom and expression.free_symbols <= known:
                once[symbol] = expression
                parts.setdefault(expression, symbol)
                known.add(symbol)
            else:
                moving[symbol] = separated(expression)
        used = set[sympy.Symbol](wanted).union(*(e.free_symbols for e in moving.values()))
        return cls(once=once, kept=tuple(s for s in once if s in used), moving=moving, names=names)
