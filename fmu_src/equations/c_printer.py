"""One function in C99: arguments, inputs read, statements and results."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

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
    """Return a C function of these statements, with some symbols renamed; see `function`."""
    symbol_names = {s: name for s, (name, _) in places.items() if s not in names}
    lanes = "LANES(" in signature
    printer = _Printer({**symbol_names, **names}, lanes=lanes, library=library)
    used_symbols = set().union(
        *(expression.free_symbols for expression in lines.values()), targets.values()
    ) - set(lines)
    reads = [
        f"const double {name} = {place};"
        for symbol, (name, place) in places.items()
        if symbol in used_symbols and name != place
    ]
    body = [
        f"const double {names.get(symbol, str(symbol))} = {_c(printer, expression)};"
        for symbol, expression in lines.items()
    ]
    writes = [
        f"{place} = {_c(printer, s) if s in lines or s in symbol_names else '0.0'};"
        for place, s in targets.items()
    ]
    signature = declare_arguments(signature)
    arguments = re.findall(r"(\w+)(?:\)\[LANES\])?[,)]", signature)
    text = " ".join([*reads, *body, *writes])
    unused = [a for a in arguments if not re.search(rf"\b{a}\b", text)]
    silence = [f"{', '.join(f'(void){a}' for a in unused)};"] if unused else []
    seldom = any(f"_{name}(" in signature for name in _RARE_FUNCTIONS)
    always = len(body) <= _MAX_INLINED_STATEMENTS and any(
        f"_{name}(" in signature for name in _INLINED_FUNCTIONS
    )
    kind = "SELDOM static" if seldom else "QUICK" if always else "static"
    wide = re.fullmatch(r"(\w+_(?:attempts|together))(\(.*\))", signature)
    paired = wide is not None and wide[1].endswith("together")
    widths = "IN_PAIRS" if paired else "IN_WIDTHS"
    width_variants = f"{widths}({wide[1]}, {wide[2]}, ({', '.join(arguments)}))\n" if wide else ""
    if wide:
        kind = "INLINED"
        signature = f"{wide[1]}_inlined{wide[2]}"
    content: Iterable[str] = (*reads, *body, *writes)
    if lanes:
        kinds = tuple(_ANGLE_FUNCTIONS.values())
        angles = dict.fromkeys(
            f.args[0] for expression in lines.values() for f in expression.atoms(*kinds)
        )
        range_checks = [
            f"far |= !(fabs({_c(printer, angle)}) <= LARGEST_ANGLE);" for angle in angles
        ]
        content = (
            "int far = 0;",
            *(("PAIRED",) if paired else ("INTERLEAVED",) if wide else ()),
            "for (int l = 0; l < LANES; l++) {",
            *(f"    {line}" for line in (*content, *range_checks)),
            "}",
            "return !far;",
        )
    content = (*silence, *content)
    result = "bool" if lanes else "void"
    head = f"{kind} {result} {signature}"
    return "\n".join([head, "{", *(f"    {line}" for line in content), "}", width_variants])


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
