"""Equations as operations on registers, run by `rows.c`; uniform values are computed once."""

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import sympy
from numpy.typing import NDArray

from hesr_model.equations.memory import DT, Element, Relaxation, Stop, find_read_symbols
from hesr_model.errors import ArtifactError

NAMES = (
    *("ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "NEGATE", "ROOT", "POWER", "EXP"),
    *("LOG", "SINH", "COSH", "ATAN", "ATAN2", "TANH", "TAN", "SIN", "COS", "CARDINAL_SINE"),
    *("SGN", "ABSOLUTE", "POSITIVE", "LARGER"),
    *("CLIP", "EXCEEDS", "OVER", "CARRIED", "RELAX", "STOP", "STOP_BESIDE", "ADD_SAME"),
    "MULTIPLY_SAME",
)  # operations of `rows.c` by number
STOPS = 4  # stops moved together, as in `rows.c`

_FUNCTIONS: Mapping[Any, str] = {sympy.exp: "EXP"} | {
    name.lower(): name for name in NAMES[NAMES.index("LOG") : NAMES.index("CARRIED")]
}
_MOVES = ("CARRIED", "RELAX", "STOP", "STOP_BESIDE")
_MAX_FACTORS = 8  # largest integer power written as a product


class Dependence(IntEnum):
    """Values that a node depends on."""

    LITERAL, NUMBERS, INPUTS, ROWS = range(4)


@dataclass(frozen=True)
class Node:
    """Value of every row.

    Attributes
    ----------
    operation : name in `NAMES`; empty for literals, numbers and inputs.
    operands : nodes.
    detail : literal, or the index of a number, input or state.
    """

    operation: str
    operands: "tuple[int, ...]"
    detail: Any
    dependence: Dependence


class _Fraction(NamedTuple):
    """Product as a quotient of products of nodes."""

    numerator: list[int]
    denominator: list[int]
    is_negative: bool


class Graph:
    """Nodes of expressions, each after its operands; `inputs` differ between rows."""

    def __init__(self, numbers: Sequence[sympy.Symbol], inputs: Sequence[sympy.Symbol]) -> None:
        self.inputs = (DT, *inputs)
        self.nodes: list[Node] = []
        self._index_by_key: dict[tuple[Any, ...], int] = {}
        self._index_by_expression: dict[sympy.Basic, int] = {}
        for dependence, symbols in (
            (Dependence.NUMBERS, numbers),
            (Dependence.INPUTS, self.inputs),
        ):
            for i, symbol in enumerate(symbols):
                self._index_by_expression[symbol] = self._intern_node("", (), i, dependence)

    def assign(self, assignments: Mapping[sympy.Symbol, sympy.Expr]) -> None:
        """Define symbols by expressions of earlier ones."""
        for symbol, expression in assignments.items():
            self._index_by_expression[symbol] = self.find_node(expression)

    def move(self, memory: Sequence[Element]) -> None:
        """Define states and derivatives by their values after a step."""
        for first, end in _group_moves(memory):
            self._move_group(memory[first:end], first)

    def _move_group(self, group: Sequence[Element], first: int) -> None:
        leader = group[0]
        states = [element.state for element in group]
        reads_itself = leader.state in find_read_symbols([leader])
        if reads_itself:
            self._index_by_expression[leader.state] = self._intern_node(
                "CARRIED", (), first, Dependence.ROWS
            )
        parts = [tuple(map(self.find_node, element.parts)) for element in group]
        if reads_itself:
            self._index_by_expression = {
                expression: k
                for expression, k in self._index_by_expression.items()
                if leader.state not in expression.free_symbols
            }
        operation = "RELAX" if isinstance(leader, Relaxation) else "STOP"
        leader_node = self._intern_node(operation, parts[0], first, Dependence.ROWS)
        self._index_by_expression[leader.state] = leader_node
        for i in range(1, len(group)):
            operands = (*parts[i], leader_node)
            self._index_by_expression[states[i]] = self._intern_node(
                "STOP_BESIDE", operands, first + i, Dependence.ROWS
            )
        for element in group:
            derivative = self.find_node(element.express_derivative())
            self._index_by_expression[element.derivative] = derivative

    def find_node(self, expression: sympy.Expr) -> int:
        """Return an expression's node; raise ArtifactError for a function without operation."""
        if expression not in self._index_by_expression:
            self._index_by_expression[expression] = self._build_node(expression)
        return self._index_by_expression[expression]

    def _build_node(self, expression: sympy.Expr) -> int:
        if expression.is_Number or isinstance(expression, sympy.NumberSymbol):
            return self._add_literal(float(expression))
        if expression.is_Add:
            return self._add_sum(expression)
        if expression.is_Mul:
            return self._add_product(expression)
        if expression.is_Pow:
            return self._add_power(expression)
        operation = _FUNCTIONS.get(expression.func, _FUNCTIONS.get(expression.func.__name__))
        if operation is None and expression.is_number:
            return self._add_literal(float(expression))
        if operation is None:
            raise ArtifactError(
                f"equations: '{expression}' uses the function '{expression.func.__name__}', "
                "which cannot be run over logs; use "
                f" {', '.join(sorted(map(str, _FUNCTIONS)))} and powers."
            )
        return self._add_operation(operation, *map(self.find_node, expression.args))

    def _add_sum(self, expression: sympy.Add) -> int:
        added_nodes = [
            self.find_node(term) for term in expression.args if not term.could_extract_minus_sign()
        ]
        subtracted_nodes = [
            self.find_node(-term) for term in expression.args if term.could_extract_minus_sign()
        ]
        if not added_nodes:
            return self._add_operation("NEGATE", self._chain_operation("ADD", subtracted_nodes))
        total = self._chain_operation("ADD", added_nodes)
        for node in self._sort_by_dependence(subtracted_nodes):
            total = self._add_operation("SUBTRACT", total, node)
        return total

    def _add_product(self, expression: sympy.Mul) -> int:
        fraction = self._split_product(expression)
        numerator = list(fraction.numerator)
        unit_node = self._add_literal(1.0)
        # Divide once by uniform values: products are five times as fast.
        uniform_nodes = [
            node
            for node in fraction.denominator
            if self.nodes[node].dependence <= Dependence.NUMBERS
        ]
        varying_nodes = [node for node in fraction.denominator if node not in uniform_nodes]
        if uniform_nodes:
            divisor = self._chain_operation("MULTIPLY", uniform_nodes)
            numerator.append(self._add_operation("DIVIDE", unit_node, divisor))
        product = unit_node
        if numerator:
            product = self._chain_operation("MULTIPLY", numerator)
        if varying_nodes:
            divisor = self._chain_operation("MULTIPLY", varying_nodes)
            product = self._add_operation("DIVIDE", product, divisor)
        if fraction.is_negative:
            return self._add_operation("NEGATE", product)
        return product

    def _split_product(self, expression: sympy.Mul) -> "_Fraction":
        """Return the factors of a product as nodes, those with negative powers inverted."""
        numerator = []
        denominator = []
        is_negative = False
        for signed_factor in expression.args:
            factor = signed_factor
            if factor.is_Rational and factor < 0:
                is_negative = not is_negative
                factor = -factor
            if factor.is_Rational:
                if factor.p != 1:
                    numerator.append(self._add_literal(float(factor.p)))
                if factor.q != 1:
                    denominator.append(self._add_literal(float(factor.q)))
            elif factor.is_Pow and factor.exp.is_number and factor.exp < 0:
                denominator.append(self.find_node(1 / factor))
            else:
                numerator.append(self.find_node(factor))
        return _Fraction(numerator, denominator, is_negative)

    def _add_power(self, expression: sympy.Pow) -> int:
        if expression.base is sympy.E:
            return self._add_operation("EXP", self.find_node(expression.exp))
        if expression.exp.is_Rational and expression.exp < 0:
            unit_node = self._add_literal(1.0)
            divisor = self.find_node(expression.base**-expression.exp)
            return self._add_operation("DIVIDE", unit_node, divisor)
        base = self.find_node(expression.base)
        if expression.exp == sympy.Rational(1, 2):
            return self._add_operation("ROOT", base)
        if not expression.exp.is_Integer or expression.exp > _MAX_FACTORS:
            return self._add_operation("POWER", base, self.find_node(expression.exp))
        power = base
        for _ in range(int(expression.exp) - 1):
            power = self._add_operation("MULTIPLY", power, base)
        return power

    def _sort_by_dependence(self, nodes: Iterable[int]) -> list[int]:
        return sorted(nodes, key=lambda node: self.nodes[node].dependence)

    def _chain_operation(self, name: str, nodes: Iterable[int]) -> int:
        result, *other_nodes = self._sort_by_dependence(nodes)
        for node in other_nodes:
            result = self._add_operation(name, result, node)
        return result

    def _add_literal(self, value: float) -> int:
        return self._intern_node("", (), value, Dependence.LITERAL)

    def _add_operation(self, name: str, *operands: int) -> int:
        dependences = {self.nodes[node].dependence for node in operands}
        dependence = max(*dependences, Dependence.NUMBERS)
        if {Dependence.NUMBERS, Dependence.INPUTS} <= dependences:
            dependence = Dependence.ROWS
        return self._intern_node(name, operands, None, dependence)

    def _intern_node(
        self, name: str, operands: tuple[int, ...], detail: Any, dependence: Dependence
    ) -> int:
        compared_detail = detail
        if dependence is Dependence.LITERAL:
            # Literals are compared as text because 0.0 == -0.0.
            compared_detail = repr(detail)
        key = (name, operands, compared_detail, dependence)
        if key not in self._index_by_key:
            self._index_by_key[key] = len(self.nodes)
            self.nodes.append(Node(name, operands, detail, dependence))
        return self._index_by_key[key]


@dataclass(frozen=True, eq=False)
class Program:
    """Program for `rows.c`; registers hold inputs, then uniform values, then the others.

    Attributes
    ----------
    inputs : those of the first registers, `dt` first, then known nodes.
    constants : (G,) literals, 0 in place of numbers.
    numbers : (2, M) positions among the constants, and numbers.
    operations : (K, 5) operation, result and three operands, uniform ones first.
    uniform : number of uniform operations.
    uniform_count : number of constants and uniform values.
    registers : number of registers.
    results : (R,) registers.
    """

    inputs: tuple[int, ...]
    constants: NDArray[np.float64]
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


def _group_moves(memory: Sequence[Element]) -> Iterator[tuple[int, int]]:
    """Yield first place and end of a relaxation, or of at most `STOPS` independent stops."""
    first = 0
    while first < len(memory):
        end = first + 1
        max_end = min(first + STOPS, len(memory))
        while end < max_end and _can_move_together(memory[first : end + 1]):
            end += 1
        yield first, end
        first = end


def _can_move_together(group: Sequence[Element]) -> bool:
    """Return whether all elements are stops, and none reads the state of another."""
    if not all(isinstance(element, Stop) for element in group):
        return False
    states = {element.state for element in group}
    return not states & find_read_symbols(group)


def find_fixed_nodes(graph: Graph, results: Sequence[int]) -> list[int]:
    """Return nodes that depend on inputs alone and are results or operands of others."""
    fixed = {
        k
        for k, node in enumerate(graph.nodes)
        if node.dependence is Dependence.INPUTS and node.operation
    }
    return sorted(fixed & _collect_reachable_nodes(graph.nodes, results, fixed))


def _collect_reachable_nodes(
    nodes: Sequence[Node], results: Sequence[int], ends: set[int]
) -> set[int]:
    reachable = set[int]()
    waiting = list(results)
    while waiting:
        k = waiting.pop()
        if k in reachable:
            continue
        reachable.add(k)
        if k not in ends:
            waiting += nodes[k].operands
    return reachable


def build_program(graph: Graph, results: Sequence[int], known_nodes: Sequence[int] = ()) -> Program:
    """Return the program of results; `known_nodes` are inputs."""
    nodes = graph.nodes
    order = _order_nodes(nodes, results, set(known_nodes))
    input_numbers = {k: len(graph.inputs) + i for i, k in enumerate(known_nodes)}
    for k in order:
        if nodes[k].dependence is Dependence.INPUTS and not nodes[k].operation:
            input_numbers[k] = nodes[k].detail
    groups = _group_nodes(nodes, order, input_numbers)
    # `dt` always comes first: states move by it.
    fixed_nodes = (*groups.inputs, *groups.constants, *groups.uniform)
    places = {k: 1 + i for i, k in enumerate(fixed_nodes)}
    registers = _allocate(nodes, groups.rows, set(results), places, 1 + len(places))
    constants = np.zeros(len(groups.constants))
    numbers = []
    for i, k in enumerate(groups.constants):
        if nodes[k].dependence is Dependence.LITERAL:
            constants[i] = nodes[k].detail
        else:
            numbers.append((i, nodes[k].detail))
    operations = [_encode_operation(nodes, k, places) for k in (*groups.uniform, *groups.rows)]
    return Program(
        inputs=(0, *(input_numbers[k] for k in groups.inputs)),
        constants=constants,
        numbers=np.array(numbers, dtype=np.int64).reshape(-1, 2).T,
        operations=np.array(operations, dtype=np.int32).reshape(-1, 5),
        uniform=len(groups.uniform),
        uniform_count=len(groups.constants) + len(groups.uniform),
        registers=registers,
        results=np.array([places[k] for k in results], dtype=np.int32),
    )


class _NodeGroups(NamedTuple):
    """Nodes in the order of evaluation, by the place of their values."""

    inputs: list[int]
    constants: list[int]  # literals and numbers
    uniform: list[int]  # operations on constants, run once
    rows: list[int]  # operations that are run for each row


def _group_nodes(
    nodes: Sequence[Node], order: Sequence[int], inputs: Container[int]
) -> _NodeGroups:
    groups = _NodeGroups([], [], [], [])
    for k in order:
        if k in inputs:
            groups.inputs.append(k)
        elif not nodes[k].operation:
            groups.constants.append(k)
        elif nodes[k].dependence <= Dependence.NUMBERS:
            groups.uniform.append(k)
        else:
            groups.rows.append(k)
    return groups


def _order_nodes(nodes: Sequence[Node], results: Sequence[int], known_nodes: set[int]) -> list[int]:
    ordered: dict[int, None] = {}

    def visit(k: int) -> None:
        if k in ordered:
            return
        if k not in known_nodes:
            for operand in nodes[k].operands:
                visit(operand)
        ordered[k] = None

    reachable = _collect_reachable_nodes(nodes, results, known_nodes)
    moves = sorted(k for k in reachable if nodes[k].operation in _MOVES)
    for k in moves:
        # Stops of one group move together, after all operands.
        for other in moves:
            if nodes[other].operation == "STOP_BESIDE" and nodes[other].operands[2] == k:
                for operand in nodes[other].operands[:2]:
                    visit(operand)
        visit(k)
    for k in results:
        visit(k)
    return list(ordered)


def _allocate(
    nodes: Sequence[Node],
    row_nodes: Sequence[int],
    result_nodes: set[int],
    places: dict[int, int],
    first_register: int,
) -> int:
    """Add places of registers of rows, reused after their last use; return their count."""
    last_use: dict[int, int] = {}
    for i, k in enumerate(row_nodes):
        last_use.update(dict.fromkeys(nodes[k].operands, i))
    # Registers of results and of other nodes than rows stay occupied.
    allocatable = set(row_nodes) - result_nodes
    free_registers = list[int]()
    register_count = first_register
    for i, k in enumerate(row_nodes):
        # A result must not overwrite operands.
        if free_registers:
            places[k] = free_registers.pop()
        else:
            places[k] = register_count
            register_count += 1
        ended_nodes = {
            operand
            for operand in nodes[k].operands
            if operand in allocatable and last_use[operand] == i
        }
        if k in allocatable and k not in last_use:
            ended_nodes.add(k)
        free_registers += sorted(places[node] for node in ended_nodes)
    return register_count


def _encode_operation(
    nodes: Sequence[Node], k: int, places: Mapping[int, int]
) -> tuple[int, int, int, int, int]:
    name = nodes[k].operation
    operands = list(nodes[k].operands)
    if name in ("ADD", "MULTIPLY") and nodes[k].dependence is Dependence.ROWS:
        # The uniform operand comes second; it is read once.
        operands.sort(key=lambda operand: -nodes[operand].dependence)
        if nodes[operands[1]].dependence <= Dependence.NUMBERS:
            name += "_SAME"
    registers = [places[operand] for operand in operands] + [0, 0, 0]
    if name in _MOVES:
        registers[2] = nodes[k].detail
    return (NAMES.index(name), places[k], registers[0], registers[1], registers[2])
