"""Equations as operations on registers, run by `rows.c`; uniform values are computed once."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from hesr_model.equations.memory import DT, Element, Relaxation, Stop
from hesr_model.errors import ArtifactError

NAMES = (
    *("ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "NEGATE", "ROOT", "POWER", "EXP"),
    *("LOG", "SINH", "COSH", "ATAN", "ATAN2", "TANH", "TAN", "SIN", "COS", "CARDINAL_SINE"),
    *("SGN", "ABSOLUTE", "POSITIVE", "LARGER"),
    *("CLIP", "EXCEEDS", "OVER", "CARRIED", "RELAX", "STOP", "STOP_BESIDE", "ADD_SAME"),
    "MULTIPLY_SAME",
)  # Operations of `rows.c` by number
STOPS = 4  # stops moved together, as in `rows.c`

_FUNCTIONS: Mapping[Any, str] = {sympy.exp: "EXP"} | {
    name.lower(): name for name in NAMES[NAMES.index("LOG") : NAMES.index("CARRIED")]
}
_MOVES = ("CARRIED", "RELAX", "STOP", "STOP_BESIDE")
_MOST_FACTORS = 8  # largest integer power written as a product


class Dependence(IntEnum):
    """Values that a node depends on."""

    LITERAL, NUMBERS, INPUTS, ROWS = range(4)


@dataclass(frozen=True)
class Node:
    """Value of every row; `detail` is a literal, or the index of a number, input or state."""

    operation: str  # empty for literals, numbers and inputs
    operands: "tuple[int, ...]"
    detail: Any
    dependence: Dependence


class Graph:
    """Nodes of expressions, each after its operands; `inputs` differ between rows."""

    def __init__(self, numbers: Sequence[sympy.Symbol], inputs: Sequence[sympy.Symbol]) -> None:
        self.inputs = (DT, *inputs)
        self.nodes: list[Node] = []
        self._places: dict[tuple[Any, ...], int] = {}
        self._of: dict[sympy.Basic, int] = {}
        for kind, symbols in ((Dependence.NUMBERS, numbers), (Dependence.INPUTS, self.inputs)):
            for i, symbol in enumerate(symbols):
                self._of[symbol] = self._node("", (), i, kind)

    def assign(self, assignments: Mapping[sympy.Symbol, sympy.Expr]) -> None:
        """Define symbols by expressions of earlier ones."""
        for symbol, expression in assignments.items():
            self._of[symbol] = self.of(expression)

    def move(self, memory: Sequence[Element]) -> None:
        """Define states and derivatives by their values after a step."""
        for first, end in _groups(memory):
            self._move_together(memory[first:end], first)

    def _move_together(self, group: Sequence[Element], first: int) -> None:
        (element, *_), states = group, [m.state for m in group]
        sees_itself = element.state in sympy.Tuple(*element.parts).free_symbols
        if sees_itself:
            self._of[element.state] = self._node("CARRIED", (), first, Dependence.ROWS)
        parts = [tuple(map(self.of, m.parts)) for m in group]
        if sees_itself:
            self._of = {e: k for e, k in self._of.items() if element.state not in e.free_symbols}
        kind = "RELAX" if isinstance(element, Relaxation) else "STOP"
        leader = self._of[states[0]] = self._node(kind, parts[0], first, Dependence.ROWS)
        for i in range(1, len(group)):
            own = (*parts[i], leader)
            self._of[states[i]] = self._node("STOP_BESIDE", own, first + i, Dependence.ROWS)
        for m in group:
            self._of[m.derivative] = self.of(m.continuous())

    def of(self, expression: sympy.Expr) -> int:
        """Return an expression's node; raise ArtifactError for a function without operation."""
        if expression not in self._of:
            self._of[expression] = self._made(expression)
        return self._of[expression]

    def _made(self, e: sympy.Expr) -> int:
        if e.is_Number or isinstance(e, sympy.NumberSymbol):
            return self._literal(float(e))
        if e.is_Add:
            return self._sum(e)
        if e.is_Mul:
            return self._product(e)
        if e.is_Pow:
            return self._power(e)
        name = _FUNCTIONS.get(e.func, _FUNCTIONS.get(e.func.__name__))
        if name is None and e.is_number:
            return self._literal(float(e))
        if name is None:
            raise ArtifactError(
                f"equations: '{e}' uses the function '{e.func.__name__}', which cannot be run over "
                f"logs; use {', '.join(sorted(map(str, _FUNCTIONS)))} and powers."
            )
        return self._operation(name, *map(self.of, e.args))

    def _sum(self, e: sympy.Add) -> int:
        negative = [t.could_extract_minus_sign() for t in e.args]
        plus = [self.of(t) for t, n in zip(e.args, negative, strict=True) if not n]
        minus = [self.of(-t) for t, n in zip(e.args, negative, strict=True) if n]
        if not plus:
            return self._operation("NEGATE", self._chain_operation("ADD", minus))
        found = self._chain_operation("ADD", plus)
        for node in self._by_dependence(minus):
            found = self._operation("SUBTRACT", found, node)
        return found

    def _product(self, e: sympy.Mul) -> int:
        above = []
        below = []
        sign = False
        for factor in e.args:
            if factor.is_Rational and factor < 0:
                sign, factor = not sign, -factor
            if factor.is_Rational:
                above += [] if factor.p == 1 else [self._literal(float(factor.p))]
                below += [] if factor.q == 1 else [self._literal(float(factor.q))]
            elif factor.is_Pow and factor.exp.is_number and factor.exp < 0:
                below.append(self.of(1 / factor))
            else:
                above.append(self.of(factor))
        one = self._literal(1.0)
        # Divide once by uniform values: products are five times as fast.
        same = [node for node in below if self.nodes[node].dependence <= Dependence.NUMBERS]
        differs = [node for node in below if node not in same]
        if same:
            above.append(self._operation("DIVIDE", one, self._chain_operation("MULTIPLY", same)))
        found = self._chain_operation("MULTIPLY", above) if above else one
        if differs:
            found = self._operation("DIVIDE", found, self._chain_operation("MULTIPLY", differs))
        return self._operation("NEGATE", found) if sign else found

    def _power(self, e: sympy.Pow) -> int:
        if e.base is sympy.E:
            return self._operation("EXP", self.of(e.exp))
        if e.exp.is_Rational and e.exp < 0:
            return self._operation("DIVIDE", self._literal(1.0), self.of(e.base**-e.exp))
        base = self.of(e.base)
        if e.exp == sympy.Rational(1, 2):
            return self._operation("ROOT", base)
        if not e.exp.is_Integer or e.exp > _MOST_FACTORS:
            return self._operation("POWER", base, self.of(e.exp))
        found = base
        for _ in range(int(e.exp) - 1):
            found = self._operation("MULTIPLY", found, base)
        return found

    def _by_dependence(self, nodes: Iterable[int]) -> list[int]:
        return sorted(nodes, key=lambda node: self.nodes[node].dependence)

    def _chain_operation(self, name: str, nodes: Iterable[int]) -> int:
        first, *others = self._by_dependence(nodes)
        for node in others:
            first = self._operation(name, first, node)
        return first

    def _literal(self, value: float) -> int:
        return self._node("", (), value, Dependence.LITERAL)

    def _operation(self, name: str, *operands: int) -> int:
        of = {self.nodes[node].dependence for node in operands}
        mixed = {Dependence.NUMBERS, Dependence.INPUTS} <= of
        kind = Dependence.ROWS if mixed else max(*of, Dependence.NUMBERS)
        return self._node(name, operands, None, kind)

    def _node(self, name: str, operands: tuple[int, ...], detail: Any, kind: Dependence) -> int:
        # Literals are compared as text because 0.0 == -0.0.
        key = (name, operands, repr(detail) if kind is Dependence.LITERAL else detail, kind)
        if key not in self._places:
            self._places[key] = len(self.nodes)
            self.nodes.append(Node(name, operands, detail, kind))
        return self._places[key]


@dataclass(frozen=True, eq=False)
class Program:
    """Program for `rows.c`; registers hold inputs, then uniform values, then the others.

    `inputs` are the inputs of the first registers, `dt` first, then known nodes; `given` (G,)
    literals, 0 in place of numbers; `numbers` (2, M) positions there and numbers; `operations`
    (K, 5) operation, result and three operands, uniform ones first; `results` (R,) registers.
    """

    inputs: tuple[int, ...]
    given: NDArray[np.float64]
    numbers: NDArray[np.int64]
    operations: NDArray[np.int32]
    uniform: int
    uniform_count: int
    registers: int
    results: NDArray[np.int32]

    @cached_property
    def addresses(self) -> tuple[int, int]:
        """Addresses of operations and results."""
        return int(self.operations.ctypes.data), int(self.results.ctypes.data)


def _groups(memory: Sequence[Element]) -> Iterator[tuple[int, int]]:
    """Yield first place and end of a relaxation, or of at most `STOPS` independent stops."""
    i = 0
    while i < len(memory):
        end = i + 1
        states = {memory[i].state}
        most = min(i + STOPS, len(memory))
        while end < most and all(isinstance(memory[k], Stop) for k in (i, end)):
            states.add(memory[end].state)
            read = sympy.Tuple(*(part for element in memory[i : end + 1] for part in element.parts))
            if states & read.free_symbols:
                break
            end += 1
        yield i, end
        i = end


def fixed_nodes(graph: Graph, results: Sequence[int]) -> list[int]:
    """Return nodes that depend on inputs alone and are results or operands of others."""
    fixed = {
        k
        for k, node in enumerate(graph.nodes)
        if node.dependence is Dependence.INPUTS and node.operation
    }
    return sorted(fixed & _reached(graph.nodes, results, fixed))


def _reached(nodes: Sequence[Node], results: Sequence[int], ends: set[int]) -> set[int]:
    found = set[int]()
    waiting = list(results)
    while waiting:
        k = waiting.pop()
        if k not in found:
            found.add(k)
            waiting += () if k in ends else nodes[k].operands
    return found


def program_of(graph: Graph, results: Sequence[int], known: Sequence[int] = ()) -> Program:
    """Return the program of results; `known` nodes are inputs."""
    nodes = graph.nodes
    order = _in_order(nodes, results, set(known))
    numbered = {k: len(graph.inputs) + i for i, k in enumerate(known)}
    numbered |= {
        k: nodes[k].detail
        for k in order
        if nodes[k].dependence is Dependence.INPUTS and not nodes[k].operation
    }
    inputs = [k for k in order if k in numbered]
    given = [k for k in order if not nodes[k].operation and k not in numbered]
    uniform = [k for k in order if nodes[k].operation and nodes[k].dependence <= Dependence.NUMBERS]
    # `dt` always comes first: states move by it.
    places = {k: 1 + i for i, k in enumerate((*inputs, *given, *uniform))}
    rest = [k for k in order if k not in places]
    registers = _allocate(nodes, rest, set(results), places, 1 + len(places))
    values = [nodes[k].detail if nodes[k].dependence is Dependence.LITERAL else 0.0 for k in given]
    numbers = [
        (i, nodes[k].detail)
        for i, k in enumerate(given)
        if nodes[k].dependence is Dependence.NUMBERS
    ]
    operations = [_encoded(nodes, k, places) for k in (*uniform, *rest)]
    return Program(
        inputs=(0, *(numbered[k] for k in inputs)),
        given=np.array(values, dtype=np.float64),
        numbers=np.array(numbers, dtype=np.int64).reshape(-1, 2).T,
        operations=np.array(operations, dtype=np.int32).reshape(-1, 5),
        uniform=len(uniform),
        uniform_count=len(given) + len(uniform),
        registers=registers,
        results=np.array([places[k] for k in results], dtype=np.int32),
    )


def _in_order(nodes: Sequence[Node], results: Sequence[int], known: set[int]) -> list[int]:
    done: dict[int, None] = {}

    def visit(k: int) -> None:
        if k not in done:
            for operand in () if k in known else nodes[k].operands:
                visit(operand)
            done[k] = None

    needed = _reached(nodes, results, known)
    moves = sorted(k for k in needed if nodes[k].operation in _MOVES)
    for k in moves:
        # Stops of one group move together, after all operands.
        for other in moves:
            if nodes[other].operation == "STOP_BESIDE" and nodes[other].operands[2] == k:
                for operand in nodes[other].operands[:2]:
                    visit(operand)
        visit(k)
    for k in results:
        visit(k)
    return list(done)


def _allocate(
    nodes: Sequence[Node], rest: Sequence[int], kept: set[int], places: dict[int, int], first: int
) -> int:
    last = {operand: i for i, k in enumerate(rest) for operand in nodes[k].operands}
    own = set(rest)
    free = list[int]()
    count = first
    for i, k in enumerate(rest):
        # A result must not overwrite operands.
        if free:
            places[k] = free.pop()
        else:
            places[k], count = count, count + 1
        ended = {o for o in nodes[k].operands if o in own and last[o] == i and o not in kept}
        ended |= {k} if k not in last and k not in kept else set()
        free += sorted(places[o] for o in ended)
    return count


def _encoded(
    nodes: Sequence[Node], k: int, places: Mapping[int, int]
) -> tuple[int, int, int, int, int]:
    name = nodes[k].operation
    operands = list(nodes[k].operands)
    if name in ("ADD", "MULTIPLY") and nodes[k].dependence is Dependence.ROWS:
        # The uniform operand comes second; it is read once.
        operands.sort(key=lambda o: -nodes[o].dependence)
        name += "_SAME" if nodes[operands[1]].dependence <= Dependence.NUMBERS else ""
    registers = [places[o] for o in operands] + [0, 0, 0]
    if name in _MOVES:
        registers[2] = nodes[k].detail
    return (NAMES.index(name), places[k], registers[0], registers[1], registers[2])
