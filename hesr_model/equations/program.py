"""A component as straight-line programs: what a step does, what is read, and how both change.

A program is a list of assignments in the order in which they are made. Everything that runs a
component prints one of these; derivatives are those of the same assignments, one after the other.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import sympy

from hesr_model.equations.component import Component, in_order
from hesr_model.equations.functions import absolute, positive, sgn
from hesr_model.equations.memory import Element

Assignments = Mapping[sympy.Symbol, sympy.Expr]


def moved(element: Element) -> sympy.Symbol:
    """Return the symbol of a state at the end of a step, where it also stands at its beginning."""
    return sympy.Symbol(f"{element.name}_moved", real=True)


def step(memory: Iterable[Element]) -> dict[sympy.Symbol, sympy.Expr]:
    """Return the states after a step by their `moved` symbols; a later one sees those before it."""
    after: dict[sympy.Symbol, sympy.Expr] = {}
    seen: dict[sympy.Symbol, sympy.Expr] = {}
    for element in memory:
        first, second = (part.xreplace(seen) for part in element.parts)
        after[moved(element)] = element.sampled(first, positive(second))
        seen[element.state] = moved(element)
    return after


_SEARCH = 60
"""Steps by which a state whose own rate sees it is settled: some thirty for a factor of 1e9."""


def initial_symbol(element: Element) -> sympy.Symbol:
    """Return the symbol of a state where it begins; its own symbol is its start value there."""
    return sympy.Symbol(f"{element.name}_begun", real=True)


def initial_state(
    memory: Iterable[Element], settling: sympy.Expr
) -> dict[sympy.Symbol, sympy.Expr]:
    """Return where the states begin for the first inputs, by their `initial_symbol`s, and the way.

    A share (`Component.settling`) of the way from the start value to the steady state, each with
    those before it where they begin.
    """
    found: dict[sympy.Symbol, sympy.Expr] = {}
    seen: dict[sympy.Symbol, sympy.Expr] = {}
    for element in memory:
        first, second = (part.xreplace(seen) for part in element.parts)
        settled = element.settled(first, positive(second))
        x = element.state
        for n in range(_SEARCH if element.seeks else 0):
            nearer = sympy.Symbol(f"{element.name}_nearer_{n}", real=True)
            found[nearer] = settled.xreplace({element.state: x})
            x = nearer
        end = x if element.seeks else settled
        found[initial_symbol(element)] = element.state + settling * (end - element.state)
        seen[element.state] = initial_symbol(element)
    return found


def derivatives(memory: Iterable[Element]) -> dict[sympy.Symbol, sympy.Expr]:
    """Return the continuous derivative of each state by its symbol."""
    return {m.derivative: m.continuous() for m in memory}


def readings(component: Component, *, starting: bool = False) -> dict[sympy.Symbol, sympy.Expr]:
    """Return derivatives of the states and all equations, in order, by their symbols."""
    equations = (
        component.starting if starting else {e.symbol: e.expression for e in component.ordered}
    )
    return {**derivatives(component.memory), **equations}


@dataclass(frozen=True)
class Tangent:
    """Derivatives along a direction: for each symbol the symbol of its own change, the seed."""

    seeds: Mapping[sympy.Symbol, sympy.Expr] = field(default_factory=dict)

    def of(self, assignments: Assignments) -> dict[sympy.Symbol, sympy.Expr]:
        """Return the change of each assigned symbol, by a symbol `d_...` for it."""
        known = dict(self.seeds)
        changes: dict[sympy.Symbol, sympy.Expr] = {}
        for symbol, expression in assignments.items():
            used = sorted(expression.free_symbols & known.keys(), key=sympy.default_sort_key)
            change = sympy.Add(*(expression.diff(s) * known[s] for s in used))
            # What does not change needs no name, and nothing that follows has to ask.
            if change == 0:
                continue
            name = change_of(symbol)
            changes[name] = change
            known[symbol] = name
        return changes


def change_of(symbol: sympy.Symbol) -> sympy.Symbol:
    """Return the symbol of a symbol's change along a direction."""
    return sympy.Symbol(f"d_{symbol.name}", real=True)


@dataclass(frozen=True)
class Jumps:
    """Where a solver has to stop: signs at whose changes a component jumps, held between events.

    A magnitude bends and does not jump, so it follows its argument and no sign is held for it; a
    solver is still asked to stop where one of a reversing input bends. Signs of states alone stay
    as they are, since a solver does not integrate what only the output depends on.
    """

    component: Component
    every: bool = False
    """Whether all magnitudes count, for tools that hold their signs as well."""

    @cached_property
    def expressions(self) -> tuple[sympy.Expr, ...]:
        """Arguments of the signs and magnitudes, of inputs and parameters alone."""
        own = self.component
        given, inputs = {q.symbol for q in own.given}, {q.symbol for q in own.inputs}
        parts = [e.expression for e in own.equations]
        parts += [part for m in own.memory for part in (*m.parts, m.continuous())]
        jumps = {node.args[0] for e in parts for node in e.atoms(sgn)}
        bends = {node.args[0] for e in parts for node in e.atoms(absolute)}
        if not self.every:
            bends = {e for e in bends if e.free_symbols & inputs <= {*own.reversing}}
        found = [e for e in jumps | bends if e.free_symbols <= given and e.free_symbols & inputs]
        return tuple(sorted(found, key=sympy.default_sort_key))

    @cached_property
    def signs(self) -> tuple[sympy.Symbol, ...]:
        """A symbol for each sign."""
        return tuple(
            sympy.Symbol(f"s_{i}", real=True) for i, _ in enumerate(self.expressions, start=1)
        )

    def held(self, assignments: Assignments) -> dict[sympy.Symbol, sympy.Expr]:
        """Return assignments with the held signs in place of the expressions'."""
        swap = {sgn(e): s for e, s in zip(self.expressions, self.signs, strict=True)}
        return {symbol: e.xreplace(swap) for symbol, e in assignments.items()}


def sources(assignments: Assignments, wanted: sympy.Symbol) -> frozenset[sympy.Symbol]:
    """Return of which symbols that are not assigned themselves a wanted one is made."""
    own = needed(assignments, [wanted])
    used = set[sympy.Symbol]().union(*(e.free_symbols for e in own.values()))
    return frozenset(used - assignments.keys())


def needed(
    assignments: Assignments, wanted: Iterable[sympy.Symbol]
) -> dict[sympy.Symbol, sympy.Expr]:
    """Return the assignments on which the wanted ones rest, in order."""
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
) -> tuple[dict[sympy.Symbol, sympy.Expr], dict[sympy.Symbol, str]]:
    """Return what the wanted symbols rest on, common subexpressions shared, ready to be printed.

    Returns
    -------
    The assignments in order, and short names `a_0`, `a_1`, .. for those that were given; shared
    subexpressions are called `t0`, `t1`, ..
    """
    own = needed(assignments, wanted)
    shared, results = sympy.cse(
        list(own.values()), symbols=sympy.numbered_symbols("t"), order="none"
    )
    lines = dict(zip(own, results, strict=True)) | dict(shared)
    names = {symbol: f"a_{i}" for i, symbol in enumerate(own)}
    return {symbol: lines[symbol] for symbol in in_order(lines)}, names


def sampled(component: Component) -> dict[sympy.Symbol, sympy.Expr]:
    """Return what a step assigns: states by their `moved` symbols, then readings of these."""
    after = {m.state: moved(m) for m in component.memory}
    own = step(component.memory)
    return own | {s: e.xreplace(after) for s, e in readings(component).items()}


@dataclass(frozen=True, kw_only=True)
class Invariants:
    """A straight line, apart from what of it need not be computed at every step.

    Attributes
    ----------
    once : what is made of fixed symbols alone, in order.
    kept : symbols of these that the rest needs.
    moving : the rest.
    names : short names of symbols that a program assigns.
    """

    once: Assignments
    kept: tuple[sympy.Symbol, ...]
    moving: Assignments
    names: Mapping[sympy.Symbol, str]

    @classmethod
    def of(
        cls, program: Assignments, wanted: Iterable[sympy.Symbol], fixed: Iterable[sympy.Symbol]
    ) -> "Invariants":
        """Separate a program; fixed factors and terms are gathered, and rounded as such."""
        wanted = tuple(wanted)
        lines, names = straight_line(program, wanted)
        once: dict[sympy.Symbol, sympy.Expr] = {}
        moving: dict[sympy.Symbol, sympy.Expr] = {}
        known, parts = set(fixed), dict[sympy.Expr, sympy.Symbol]()

        def symbol_of(part: sympy.Expr) -> sympy.Symbol:
            if part not in parts:
                parts[part] = symbol = sympy.Symbol(f"fixed_{len(parts)}", real=True)
                once[symbol] = part
                known.add(symbol)
            return parts[part]

        def separated(expression: sympy.Expr) -> sympy.Expr:
            """Return an expression with symbols for its parts that are fixed."""
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
