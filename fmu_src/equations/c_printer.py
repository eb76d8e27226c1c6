"""One function in C99: arguments, inputs read, statements and results."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import sympy
from sympy.printing.c import C99CodePrinter

from fmu_src.export.interface import literal
from hesr_model.equations.functions import cardinal_sine
from hesr_model.equations.program import Assignments, build_straight_line
from hesr_model.errors import ExportError

_SAME_NAMES = (
    *("sgn", "positive", "larger", "clip", "exceeds", "over", "decay"),
    *("share", "share_slope", "cardinal_sine", "cardinal_slope"),
)
_POWERS = {2: "square", 3: "cube"}
_ANGLE_FUNCTIONS = {"sin": sympy.sin, "cos": sympy.cos, "cardinal_sine": cardinal_sine}
_RARE_FUNCTIONS = (
    "start",
    "rates",
    "prepare",
    "invariants",
    "begin",
    "begin_tangent",
    "tangent",
    "follow",
)
"""Attribute of functions optimised for size."""
_INLINED_FUNCTIONS = ("step", "switches")
_MAX_INLINED_STATEMENTS = 60  # statements of a function that is worth inlining for each joint


class _Printer(C99CodePrinter):  # type: ignore[misc] # SymPy is not typed
    """C99 printer with exact literals, powers without pow(), and loops without branches.

    `library` prints elementary functions as those of the C library, not of law_math.h.
    """

    def __init__(
        self, names: Mapping[sympy.Symbol, str], *, lanes: bool = False, library: bool = False
    ) -> None:
        super().__init__({"strict": False})
        self._names = names
        self.known_functions |= {name: name for name in _SAME_NAMES}
        self.known_functions |= {"absolute": "fabs"}
        if library:
            return
        self.known_functions |= {"exp": "even_exp"}
        if lanes:
            self.known_functions |= {name: f"even_{name}" for name in ("tanh", *_ANGLE_FUNCTIONS)}
        else:
            self.known_functions |= {name: f"quick_{name}" for name in ("tanh", "decay", "exp")}
            self.known_functions |= {"sin": "sine", "cos": "cosine"}

    def _print_Symbol(self, expr: sympy.Symbol) -> str:
        return self._names.get(expr, expr.name)

    _print_Dummy = _print_Symbol

    def _print_Float(self, expr: sympy.Expr) -> str:
        return literal(float(expr))

    _print_NumberSymbol = _print_Pi = _print_Exp1 = _print_Float

    def _print_Pow(self, expr: sympy.Pow) -> str:
        if expr.exp in _POWERS:
            return f"{_POWERS[int(expr.exp)]}({self._print(expr.base)})"
        if -expr.exp in _POWERS:
            return f"(1.0/{_POWERS[int(-expr.exp)]}({self._print(expr.base)}))"
        return str(super()._print_Pow(expr))


@dataclass(frozen=True)
class Arguments:
    """Symbols that a function reads, with their names and C expressions."""

    places: Mapping[sympy.Symbol, tuple[str, str]] = field(default_factory=dict)

    def add_array(self, symbols: Iterable[sympy.Symbol], array: str, lane: str = "") -> "Arguments":
        """Add the elements of an array, which may itself contain arrays."""
        elements = {s: (f"{array}_{i}", f"{array}[{i}]{lane}") for i, s in enumerate(symbols)}
        return Arguments({**self.places, **elements})

    def add_scalar(self, symbol: sympy.Symbol, name: str) -> "Arguments":
        """Add a scalar argument."""
        return Arguments({**self.places, symbol: (name, name)})


def function(
    signature: str,
    program: Assignments,
    targets: Mapping[str, sympy.Symbol],
    places: Mapping[sympy.Symbol, tuple[str, str]],
    *,
    library: bool = False,
) -> str:
    """Return a C function that computes targets by a program with shared subexpressions.

    `library` calls elementary functions of the C library instead of those of law_math.h.
    """
    lines, names = build_straight_line(program, targets.values())
    return print_function(signature, lines, names, targets, places, library=library)


def print_function(
    signature: str,
    lines: Assignments,
    names: Mapping[sympy.Symbol, str],
    targets: Mapping[str, sympy.Symbol],
    places: Mapping[sympy.Symbol, tuple[str, str]],
    *,
    library: bool = False,
) -> str:
    """Return a C function of these assignments, with some symbols renamed; see `function`.

    `targets` maps C expressions that are written to symbols, `places` symbols that are read to a
    local name and a C expression.
    """
    symbol_names = {s: name for s, (name, _) in places.items() if s not in names}
    has_lanes = "LANES(" in signature
    printer = _Printer({**symbol_names, **names}, lanes=has_lanes, library=library)
    reads = _print_reads(lines, targets, places)
    computations = [
        f"const double {names.get(symbol, str(symbol))} = {_c(printer, expression)};"
        for symbol, expression in lines.items()
    ]
    writes = []
    for place, symbol in targets.items():
        value = "0.0"  # the change of what does not change has no assignment
        if symbol in lines or symbol in symbol_names:
            value = _c(printer, symbol)
        writes.append(f"{place} = {value};")
    statements = [*reads, *computations, *writes]
    signature = declare_arguments(signature)
    arguments = re.findall(r"(\w+)(?:\)\[LANES\])?[,)]", signature)
    content = _silence_unused(arguments, statements)
    variants = _find_width_variants(signature)
    if has_lanes:
        checks = _check_angles(lines, printer)
        content += _loop_over_lanes([*statements, *checks], variants)
        result = "bool"
    else:
        content += statements
        result = "void"
    expansion = ""
    if variants is None:
        head = f"{_storage(signature, len(computations))} {result} {signature}"
    else:
        head = f"INLINED {result} {variants.name}_inlined{variants.parameters}"
        expansion = (
            f"{variants.macro}({variants.name}, {variants.parameters}, ({', '.join(arguments)}))\n"
        )
    return "\n".join([head, "{", *(f"    {line}" for line in content), "}", expansion])


def _print_reads(
    lines: Assignments,
    targets: Mapping[str, sympy.Symbol],
    places: Mapping[sympy.Symbol, tuple[str, str]],
) -> list[str]:
    """Return statements that copy the places that are used to their local names."""
    used_symbols = set(targets.values())
    for expression in lines.values():
        used_symbols |= expression.free_symbols
    used_symbols -= set(lines)
    return [
        f"const double {name} = {place};"
        for symbol, (name, place) in places.items()
        if symbol in used_symbols and name != place
    ]


def _silence_unused(arguments: Iterable[str], statements: Iterable[str]) -> list[str]:
    """Return a statement against warnings of unused arguments, if there are any."""
    text = " ".join(statements)
    unused = [name for name in arguments if not re.search(rf"\b{name}\b", text)]
    if not unused:
        return []
    return [", ".join(f"(void){name}" for name in unused) + ";"]


class _WidthVariants(NamedTuple):
    """A function that wide.h compiles for several widths of vectors, by a macro."""

    name: str
    parameters: str
    macro: str
    loop: str  # macro in front of the loop over lanes


def _find_width_variants(signature: str) -> _WidthVariants | None:
    """Return what wide.h needs for a function over lanes, None for one without variants."""
    parts = re.fullmatch(r"(\w+_(?:attempts|together))(\(.*\))", signature)
    if parts is None:
        return None
    if parts[1].endswith("together"):
        return _WidthVariants(parts[1], parts[2], "IN_PAIRS", "PAIRED")
    return _WidthVariants(parts[1], parts[2], "IN_WIDTHS", "INTERLEAVED")


def _check_angles(lines: Assignments, printer: _Printer) -> list[str]:
    """Return statements that find angles too large for the branch-free sine and cosine."""
    functions = tuple(_ANGLE_FUNCTIONS.values())
    angles: dict[sympy.Expr, None] = {}
    for expression in lines.values():
        calls = sorted(expression.atoms(*functions), key=sympy.default_sort_key)
        angles |= dict.fromkeys(call.args[0] for call in calls)
    return [f"far |= !(fabs({_c(printer, angle)}) <= LARGEST_ANGLE);" for angle in angles]


def _loop_over_lanes(statements: Iterable[str], variants: _WidthVariants | None) -> list[str]:
    """Return a loop over the lanes of vectors, and whether all angles were small."""
    loop_macros = []
    if variants is not None:
        loop_macros = [variants.loop]
    return [
        "int far = 0;",
        *loop_macros,
        "for (int l = 0; l < LANES; l++) {",
        *(f"    {statement}" for statement in statements),
        "}",
        "return !far;",
    ]


def _storage(signature: str, length: int) -> str:
    """Return the storage class and attributes of a function with `length` computations."""
    if any(f"_{name}(" in signature for name in _RARE_FUNCTIONS):
        return "SELDOM static"
    is_called_often = any(f"_{name}(" in signature for name in _INLINED_FUNCTIONS)
    if is_called_often and length <= _MAX_INLINED_STATEMENTS:
        return "QUICK"
    return "static"


def declare_arguments(arguments: str) -> str:
    """Return arguments in C: IN and OUT are arrays, LANES arrays of lanes."""
    arguments = re.sub(r"IN\((\w+)\)", r"const double *\1", arguments)
    arguments = re.sub(r"OUT\((\w+)\)", r"double *\1", arguments)
    return re.sub(r"LANES\((\w*), (\w+)\)", r"\1 double (*__restrict \2)[LANES]", arguments)


def expression_to_c(expression: sympy.Expr, names: Mapping[sympy.Symbol, str]) -> str:
    """Return an expression in C with the given symbol names."""
    return _c(_Printer(names), expression)


def _c(printer: _Printer, expression: sympy.Expr) -> str:
    text = str(printer.doprint(expression))
    if "Not supported" in text:
        raise ExportError(f"equations: '{expression}' has no counterpart in C.")
    return text
