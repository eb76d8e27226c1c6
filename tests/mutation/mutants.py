"""Small faults inserted into sources to see whether tests detect them.

Python faults come from the operators of Cosmic Ray and those below. It changes numbers only by one,
while typical faults in science are factors, and has none for arguments, slices and statements.
Its own runs support neither random samples nor tests per module, so `run.py` performs them. C is
formatted by clang-format, which puts spaces around binary operators only, so tokens suffice to
distinguish them.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import cosmic_ray.plugins
from cosmic_ray.ast import ast_nodes, get_ast, is_number
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from parso.python.tree import Keyword, Name, Number
from parso.tree import NodeOrLeaf


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """A source with one fault.

    Attributes
    ----------
    place : line and column of the fault, from 1 and 0.
    before, after : the changed lines, stripped.
    text : the whole source.
    """

    place: tuple[int, int]
    before: str
    after: str
    text: str


Variant = tuple[str, int]
"""Name of a fault and the index of its occurrence in the source."""


def variants(path: Path) -> dict[tuple[int, int], list[Variant]]:
    """Possible faults in a source, by place."""
    text = path.read_text(encoding="utf-8")
    found: dict[tuple[int, int], list[Variant]] = {}
    if path.suffix == ".py":
        nodes, lines = list(ast_nodes(get_ast(text))), text.split("\n")
        for name, operator in _operators().items():
            places = (at for node in nodes for at, _ in operator.mutation_positions(node))
            for occurrence, place in enumerate(places):
                line = lines[place[0] - 1]
                if not _NO_FAULT.search(f"{name}: {line[: place[1]]}") and line != _FOR_CHECKERS:
                    found.setdefault(place, []).append((name, occurrence))
    else:
        for start, _, others in _c_faults(text):
            line = text.count("\n", 0, start) + 1
            place = (line, start - text.rfind("\n", 0, start) - 1)
            found[place] = [(other, start) for other in others]
    return found


def mutant(path: Path, place: tuple[int, int], variant: Variant) -> Mutant:
    """Make one of the faults listed by `variants`."""
    text = path.read_text(encoding="utf-8")
    name, occurrence = variant
    if path.suffix == ".py":
        changed = mutate_code(text, _operators()[name], occurrence)
    else:
        end = next(end for start, end, _ in _c_faults(text) if start == occurrence)
        changed = text[:occurrence] + name + text[end:]
    old, new = text.split("\n"), changed.split("\n")
    while old[0] == new[0]:
        del old[0], new[0]
    while old[-1] == new[-1]:  # a loop over several lines becomes one line
        del old[-1], new[-1]
    before, after = (" ".join(map(str.strip, lines)) for lines in (old, new))
    return Mutant(place=place, before=before, after=after, text=changed)


# --- Python -----------------------------------------------------------------------------------

# Others are detected by any test that runs the line, or do not concern numbers.
_CHOSEN = re.compile(
    r"core/(ReplaceBinaryOperator_(Add|Sub|Mul|Div|FloorDiv|Mod|Pow)_(Add|Sub|Mul|Div)|"
    r"ReplaceBinaryOperator_BitAnd_BitOr|"
    r"ReplaceComparisonOperator_(Eq|NotEq|Lt|LtE|Gt|GtE)_(Eq|NotEq|Lt|LtE|Gt|GtE)|"
    r"ReplaceComparisonOperator_(Is_IsNot|IsNot_Is)|ReplaceUnaryOperator_(USub_UAdd|Delete_\w+)|"
    r"AddNot|ReplaceAndWithOr|ReplaceOrWithAnd|ReplaceTrueWithFalse|ReplaceFalseWithTrue|"
    r"ReplaceBreakWithContinue|ReplaceContinueWithBreak|ZeroIterationForLoop)"
)


# Decorators against programming errors, and sizes of caches, do not change results; the star of a
# signature is not a product.
_NO_FAULT = re.compile(r"\b(frozen|kw_only|eq|strict|maxsize)=$|_Mul_\w+: (.*[\[({,])? *$")


_FOR_CHECKERS = "if TYPE_CHECKING:"  # imports that never run, above code that runs without them


class _OtherNumber(Operator):  # type: ignore[misc]  # untyped
    """Replacements of a number: twice, half, ten times, one more, one less."""

    def mutation_positions(self, node):
        if is_number(node):
            for _ in _other_numbers(node.value):
                yield node.start_pos, node.end_pos

    def mutate(self, node, index):
        return Number(_other_numbers(node.value)[index], node.start_pos, node.prefix)

    @classmethod
    def examples(cls) -> tuple[()]:
        return ()


class _RemovedStatement(Operator):  # type: ignore[misc]  # untyped
    """Removal of a call, an augmented assignment or a `raise`."""

    def mutation_positions(self, node):
        if node.type != "simple_stmt":
            return
        statement = node.children[0]
        is_call = statement.type == "atom_expr" and statement.children[-1].type == "trailer"
        is_augmented = False
        if statement.type == "expr_stmt":
            operator = statement.children[1]
            is_augmented = operator.type == "operator" and operator.value != "="
        if is_call or is_augmented or statement.type == "raise_stmt":
            yield statement.start_pos, statement.end_pos

    def mutate(self, node, index):
        first = node.children[0].get_first_leaf()
        node.children[0] = Keyword("pass", first.start_pos, first.prefix)
        return node

    @classmethod
    def examples(cls) -> tuple[()]:
        return ()


class _SwappedArguments(Operator):  # type: ignore[misc]  # untyped
    """Exchange of neighbouring positional arguments."""

    def mutation_positions(self, node):
        for first, _ in _neighbours(node):
            yield first.start_pos, first.end_pos

    def mutate(self, node, index):
        first, second = _neighbours(node)[index]
        a, b = node.children.index(first), node.children.index(second)
        leaves = first.get_first_leaf(), second.get_first_leaf()
        leaves[0].prefix, leaves[1].prefix = leaves[1].prefix, leaves[0].prefix
        node.children[a], node.children[b] = second, first
        return node

    @classmethod
    def examples(cls) -> tuple[()]:
        return ()


_COMMUTATIVE = ("max", "min", "maximum", "minimum", "hypot")  # which any order of arguments suits


def _neighbours(node: NodeOrLeaf) -> list[tuple[NodeOrLeaf, NodeOrLeaf]]:
    """Return pairs of positional arguments of a call that differ."""
    if node.type != "arglist":
        return []
    function = node.get_first_leaf().get_previous_leaf().get_previous_leaf()  # before "("
    if function is not None and function.value in _COMMUTATIVE:
        return []
    arguments = [child for child in node.children if child.type != "operator"]
    return [
        (first, second)
        for first, second in pairwise(arguments)
        if "argument" not in (first.type, second.type)
        and first.get_code(include_prefix=False) != second.get_code(include_prefix=False)
    ]


class _OtherSlice(Operator):  # type: ignore[misc]  # untyped
    """Bounds of slices one more; those that are numbers are in `_OtherNumber`."""

    def mutation_positions(self, node):
        for bound in _bounds(node):
            yield bound.start_pos, bound.end_pos

    def mutate(self, node, index):
        bound = _bounds(node)[index]
        more = Name(f"{bound.get_code()} + 1", bound.start_pos, "")
        node.children[node.children.index(bound)] = more
        return node

    @classmethod
    def examples(cls) -> tuple[()]:
        return ()


def _bounds(node: NodeOrLeaf) -> list[NodeOrLeaf]:
    if node.type != "subscript":
        return []
    return [c for c in node.children if c.type not in ("operator", "number", "sliceop")]


_OPERATORS = {
    "number": _OtherNumber, "statement": _RemovedStatement,
    "arguments": _SwappedArguments, "slice": _OtherSlice,
}  # fmt: skip


@cache
def _operators() -> dict[str, Operator]:
    known = [name for name in cosmic_ray.plugins.operator_names() if _CHOSEN.fullmatch(name)]
    ours = {name: operator() for name, operator in _OPERATORS.items()}
    return {n: cosmic_ray.plugins.get_operator(n)() for n in known} | ours


def _other_numbers(text: str) -> list[str]:
    """Return replacements of a number in the notation of Python and C."""
    if re.fullmatch(r"\d+", text):
        whole = int(text)
        return [str(whole + 1), *([str(whole - 1)] if whole else [])]
    try:
        value = float(text)
    except ValueError:  # hexadecimal, or with a suffix
        return []
    # Tiny numbers represent round-off, where doubling is not a fault; still smaller ones keep
    # divisors from being zero, where no other such number is one.
    factors = (2.0, 0.5, 10.0) if value >= 1e-8 else (1e6,) if value > 1e-200 else ()
    return [repr(value * k) for k in factors] if value else ["1.0"]


# --- C ----------------------------------------------------------------------------------------

_BINARY = {
    "<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<"),
    "==": ("!=",), "!=": ("==",), "&&": ("||",), "||": ("&&",),
    "+": ("-",), "-": ("+",), "*": ("/",), "/": ("*",),
    "+=": ("-=", "="), "-=": ("+=", "="), "*=": ("/=", "="), "/=": ("*=", "="),
}  # fmt: skip
_WORDS = {
    "true": "false", "false": "true", "fmin": "fmax", "fmax": "fmin", "sin": "cos", "cos": "sin",
    "fabs": "", "ceil": "floor", "floor": "ceil", "continue": "break", "break": "continue",
}  # fmt: skip
# Blocks for Windows are not compiled here.
_C_TOKEN = re.compile(
    r"^#ifdef _WIN32\n.*?^#(?:else|endif)[^\n]*|"
    r"//[^\n]*|/\*.*?\*/|\"(?:\\.|[^\"\\])*\"|'[^']*'|^[ ]*#(?!define)[^\n]*|"
    r"(?P<statement>(?<=[;{}/]\n) +(?!return\b|\w+ [*\w]|\(void\))[\w*(][^\n;{}]*;$)|"
    r"(?P<number>(?<![\w.])\d+(?:\.\d*)?(?:[eE][+-]?\d+)?(?![\w.]))|(?P<word>\b[A-Za-z_]\w*)|"
    r"(?P<not>!(?=[\w(]))|(?P<minus>(?:(?<=[(=,?:] )|(?<=\()|(?<=return ))-(?=[\w(]))|"
    r"(?<= )(?P<binary>[<>=!]=|&&|\|\||[-+*/]=?|[<>])(?=\s)",
    re.MULTILINE | re.DOTALL,
)


def _c_faults(text: str) -> Iterator[tuple[int, int, list[str]]]:
    """Start and end of replaceable text in C source, and its replacements."""
    place = 0
    while found := _C_TOKEN.search(text, place):
        kind, token, place = found.lastgroup, found.group(), found.end()
        others: list[str] = []
        if kind == "statement":
            place = found.start() + len(token) - len(token.lstrip())  # and what is in it
            yield place, found.end(), [";"]
            continue
        if kind == "number":
            others = _other_numbers(token)
        elif kind == "word" and token in _WORDS:
            others = [_WORDS[token]]
        elif kind in ("not", "minus"):
            others = [""]
        elif kind == "binary":
            others = list(_BINARY.get(token, ()))
        if others:
            yield found.start(), found.end(), others
