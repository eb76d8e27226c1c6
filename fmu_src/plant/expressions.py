"""Hash-consed arithmetic expressions, and the straight-line C of them."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from fmu_src.export.interface import literal


class Operation(NamedTuple):
    """One operation: const, name, add or mul; operands are indices of nodes."""

    kind: str
    left: int = 0
    right: int = 0
    value: float = 0.0
    name: str = ""


class Expressions:
    """Expressions that share equal parts; constants are folded, zeros and ones vanish."""

    def __init__(self) -> None:
        self.nodes: list[Operation] = []
        self._known: dict[Operation, int] = {}

    def _node(self, node: Operation) -> "Expression":
        index = self._known.setdefault(node, len(self.nodes))
        if index == len(self.nodes):
            self.nodes.append(node)
        return Expression(self, index)

    def constant(self, value: float) -> "Expression":
        """Return a constant."""
        return self._node(Operation("const", value=float(value) + 0.0))

    def name(self, text: str) -> "Expression":
        """Return a C expression without side effects, such as a variable."""
        return self._node(Operation("name", name=text))

    def add(self, a: int, b: int) -> "Expression":
        """Return the sum of two nodes."""
        first = self.nodes[a]
        second = self.nodes[b]
        if first.kind == "const" and second.kind == "const":
            return self.constant(first.value + second.value)
        if first.kind == "const" and first.value == 0.0:
            return Expression(self, b)
        if second.kind == "const" and second.value == 0.0:
            return Expression(self, a)
        if self._factor(a)[1] == self._factor(b)[1]:
            factor_sum = self._factor(a)[0] + self._factor(b)[0]
            return self.multiply(self.constant(factor_sum).index, self._factor(a)[1])
        return self._node(Operation("add", min(a, b), max(a, b)))

    def multiply(self, a: int, b: int) -> "Expression":
        """Return the product of two nodes; a constant factor comes first."""
        first_factor, first = self._factor(a)
        second_factor, second = self._factor(b)
        factor = first_factor * second_factor
        first_is_constant = self.nodes[first].kind == "const"
        second_is_constant = self.nodes[second].kind == "const"
        if factor == 0.0 or (first_is_constant and second_is_constant):
            return self.constant(factor)
        if first_is_constant:
            product = second
        elif second_is_constant:
            product = first
        else:
            product = self._node(Operation("mul", min(first, second), max(first, second))).index
        if factor == 1.0:
            return Expression(self, product)
        return self._node(Operation("mul", self.constant(factor).index, product))

    def _factor(self, index: int) -> tuple[float, int]:
        """Return the constant factor of a node and the node without it."""
        node = self.nodes[index]
        if node.kind == "const":
            return node.value, self.constant(1.0).index
        if node.kind == "mul" and self.nodes[node.left].kind == "const":
            return self.nodes[node.left].value, node.right
        return 1.0, index

    def changes(self, seeds: Mapping[str, "Expression"]) -> list["Expression"]:
        """Return the change of every node along changes of names, by the rule of products."""
        changes: list[Expression] = []
        for node in tuple(self.nodes):
            left_operand = Expression(self, node.left)
            right_operand = Expression(self, node.right)
            if node.kind == "add":
                changes.append(changes[node.left] + changes[node.right])
            elif node.kind == "mul":
                changes.append(
                    changes[node.left] * right_operand + left_operand * changes[node.right]
                )
            else:
                changes.append(seeds.get(node.name, self.constant(0.0)))
        return changes

    def to_c(self, stores: Mapping[str, "Expression"]) -> str:
        """Return the C statements of a function that store expressions."""
        needed = sorted(self._find_dependencies(e.index for e in stores.values()))
        moving = [i for i in needed if self.nodes[i].kind != "const"]
        lines = [f"    const double t{i} = {self._text(i)};" for i in moving]
        lines += [f"    {place} = {self._operand(e.index)};" for place, e in stores.items()]
        return "\n".join(lines)

    def _find_dependencies(self, roots: Iterable[int]) -> set[int]:
        indices = set(roots)
        for index in reversed(range(len(self.nodes))):  # operands come first
            node = self.nodes[index]
            if index in indices and node.kind in ("add", "mul"):
                indices |= {node.left, node.right}
        return indices

    def _operand(self, index: int) -> str:
        node = self.nodes[index]
        if node.kind == "const":
            return literal(node.value)
        return f"t{index}"

    def _text(self, index: int) -> str:
        node = self.nodes[index]
        if node.kind == "name":
            return node.name
        if node.kind == "mul":
            if self.nodes[node.left] == Operation("const", value=-1.0):
                return f"-{self._operand(node.right)}"
            return f"{self._operand(node.left)} * {self._operand(node.right)}"
        return f"{self._operand(node.left)} + {self._operand(node.right)}"


class Expression:
    """A node of a graph with arithmetic operators."""

    def __init__(self, graph: Expressions, index: int) -> None:
        self.graph = graph
        self.index = index

    def _index(self, other: "Expression | float") -> int:
        expression = other if isinstance(other, Expression) else self.graph.constant(float(other))
        return expression.index

    def __add__(self, other: "Expression | float") -> "Expression":
        return self.graph.add(self.index, self._index(other))

    def __mul__(self, other: "Expression | float") -> "Expression":
        return self.graph.multiply(self.index, self._index(other))

    def __neg__(self) -> "Expression":
        return self * -1.0

    def __sub__(self, other: "Expression | float") -> "Expression":
        return self + self.graph.multiply(self._index(other), self.graph.constant(-1.0).index)

    def __rsub__(self, other: float) -> "Expression":
        return -self + other

    __radd__ = __add__
    __rmul__ = __mul__
