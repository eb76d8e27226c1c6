"""Equations to C99.

Each distinct component becomes functions of one name, over its parameters k, the inputs u (shared
parameters behind them), the held signs s, the states x, previous values p, the step dt and whether
relaxations move by Euler's step. See `Functions` for what they write.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import sympy
from sympy.printing.c import C99CodePrinter

from fmu_src.interface import literal
from hesr_model.equations.component import Component, Quantity, previous
from hesr_model.equations.functions import cardinal_sine, positive, sgn
from hesr_model.equations.memory import DT, EULER, Relaxation
from hesr_model.equations.program import (
    Assignments,
    Invariants,
    Jumps,
    Tangent,
    beginning,
    begun,
    change_of,
    derivatives,
    moved,
    readings,
    sampled,
    step,
    straight_line,
)
from hesr_model.errors import ExportError

_POWERS = {2: "square", 3: "cube"}
_OF_ANGLES = {"sin": sympy.sin, "cos": sympy.cos, "cardinal_sine": cardinal_sine}
_SELDOM = ("start", "rates", "invariants", "begin", "begin_tangent", "tangent", "follow")
"""Functions that are to be small rather than quick."""


class _Printer(C99CodePrinter):  # type: ignore[misc] # SymPy is not typed
    """C99 with our functions, literals that read back, and small powers without pow().

    Loops of lanes have no branches, of which compilers would make no vectors.
    """

    def __init__(self, names: Mapping[sympy.Symbol, str], *, lanes: bool = False) -> None:
        super().__init__({"strict": False})
        self._names = names
        own = ("sgn", "positive", "larger", "clip", "exceeds", "over", "decay", "share",
               "share_slope", "cardinal_sine", "cardinal_slope")  # fmt: skip
        self.known_functions |= {name: name for name in own}
        self.known_functions |= {"absolute": "fabs", "exp": "even_exp"}
        if lanes:
            self.known_functions |= {name: f"even_{name}" for name in ("tanh", *_OF_ANGLES)}
        else:
            self.known_functions |= {name: f"quick_{name}" for name in ("tanh", "decay")}
            self.known_functions |= {"sin": "sine", "cos": "cosine"}

    def _print_Symbol(self, expr: sympy.Symbol) -> str:
        return self._names.get(expr, expr.name)

    _print_Dummy = _print_Symbol

    def _print_Float(self, expr: sympy.Float) -> str:
        return literal(float(expr))

    def _print_NumberSymbol(self, expr: sympy.NumberSymbol) -> str:
        return literal(float(expr))

    _print_Pi = _print_NumberSymbol
    _print_Exp1 = _print_NumberSymbol

    def _print_Pow(self, expr: sympy.Pow) -> str:
        if expr.exp in _POWERS:
            return f"{_POWERS[int(expr.exp)]}({self._print(expr.base)})"
        if -expr.exp in _POWERS:
            return f"(1.0/{_POWERS[int(-expr.exp)]}({self._print(expr.base)}))"
        return str(super()._print_Pow(expr))


@dataclass(frozen=True)
class _Arguments:
    """The symbols that a function reads, each with its name and its place in C."""

    places: Mapping[sympy.Symbol, tuple[str, str]] = field(default_factory=dict)

    def plus(self, symbols: Iterable[sympy.Symbol], array: str, lane: str = "") -> "_Arguments":
        """Add the elements of an array, which may be arrays themselves."""
        more = {s: (f"{array}_{i}", f"{array}[{i}]{lane}") for i, s in enumerate(symbols)}
        return _Arguments({**self.places, **more})

    def single(self, symbol: sympy.Symbol, name: str) -> "_Arguments":
        """Add an argument that is no array."""
        return _Arguments({**self.places, symbol: (name, name)})


@dataclass(frozen=True)
class Functions:
    """The C functions of a component.

    Attributes
    ----------
    component : the equations.
    name : prefix of the functions.
    tunable : whether the parameters k can change, so that tangents follow them.
    gathered : whether the parameters stand among the inputs u, rather than one after the other.
    """

    component: Component
    name: str
    tunable: bool = True
    gathered: bool = False

    @cached_property
    def jumps(self) -> Jumps:
        """The signs that are held between events."""
        return Jumps(self.component)

    @property
    def _outputs(self) -> tuple[sympy.Symbol, ...]:
        return tuple(e.symbol for e in self.component.outputs)

    @property
    def _states(self) -> tuple[sympy.Symbol, ...]:
        return tuple(m.state for m in self.component.memory)

    @property
    def gathers(self) -> tuple[Quantity, ...]:
        """What stands in u."""
        own = self.component
        return (*own.inputs, *(own.parameters if self.gathered else ()), *own.shared)

    @property
    def _inputs(self) -> tuple[sympy.Symbol, ...]:
        return tuple(q.symbol for q in self.gathers)

    @property
    def _parameters(self) -> tuple[sympy.Symbol, ...]:
        return () if self.gathered else tuple(q.symbol for q in self.component.parameters)

    @cached_property
    def _arguments(self) -> _Arguments:
        own = self.component
        found = _Arguments().plus(self._parameters, "k").plus(self._inputs, "u")
        found = found.plus(self.jumps.signs, "s").plus(self._states, "x")
        found = found.plus((previous(e.name) for e in own.remembered), "p")
        return found.single(DT, "dt").single(EULER, "euler")

    @cached_property
    def _seeds(self) -> dict[sympy.Symbol, sympy.Symbol]:
        moving = (*self._inputs, *self._states)
        if self.tunable:
            moving = (*self._parameters, *moving)
        return {symbol: change_of(symbol) for symbol in moving}

    @cached_property
    def _with_seeds(self) -> _Arguments:
        found = self._arguments
        places = ((self._parameters, "dk"), (self._inputs, "du"), (self._states, "tx"))
        for symbols, array in places:
            found = found.plus(
                (self._seeds[s] if s in self._seeds else sympy.Dummy() for s in symbols), array
            )
        return found

    def _written(self, held: bool, extra: Assignments, targets: Mapping[str, sympy.Symbol],
                 signature: str, *, seeds: bool = False) -> str:  # fmt: skip
        program = self.jumps.held(extra) if held else dict(extra)
        arguments = self._with_seeds if seeds else self._arguments
        return _function(f"{self.name}_{signature}", program, targets, arguments.places)

    @property
    def _reading_targets(self) -> dict[str, sympy.Symbol]:
        component = self.component
        targets = {f"y[{i}]": s for i, s in enumerate(self._outputs)}
        return targets | {f"r[{i}]": e.symbol for i, e in enumerate(component.remembered)}

    @property
    def _derivative_targets(self) -> dict[str, sympy.Symbol]:
        return {f"dx[{i}]": m.derivative for i, m in enumerate(self.component.memory)}

    def switches(self) -> str:
        """Write into z the arguments of the held signs."""
        symbols = [sympy.Dummy() for _ in self.jumps.expressions]
        own = dict(zip(symbols, self.jumps.expressions, strict=True))
        targets = {f"z[{i}]": s for i, s in enumerate(symbols)}
        return self._written(False, own, targets, "switches(IN(k), IN(u), OUT(z))")

    def read(self) -> str:
        """Write derivatives of the states dx, outputs y and what will be remembered r."""
        own = readings(self.component)
        return self._written(
            True, own, {**self._derivative_targets, **self._reading_targets},
            "read(IN(k), IN(u), IN(s), IN(x), IN(p), double dt, OUT(dx), OUT(y), OUT(r))",
        )  # fmt: skip

    def solved_derivatives(self) -> str:
        """Write derivatives of the states dx where nothing is held, as in `attempt`."""
        own = derivatives(self.component.memory)
        signature = "solved_derivatives(IN(k), IN(u), IN(x), OUT(dx))"
        return self._written(False, own, self._derivative_targets, signature)

    def start(self) -> str:
        """Write y and r as they are before the first step, and previous values p for it."""
        component = self.component
        own = readings(component, starting=True)
        starts = component.starts
        own |= {symbol: e.xreplace(starts) for symbol, e in starts.items()}
        targets = self._reading_targets
        targets |= {f"p[{i}]": s for i, s in enumerate(starts)}
        places = {s: place for s, place in self._arguments.places.items() if s not in starts}
        return _function(
            f"{self.name}_start(IN(k), IN(u), IN(s), IN(x), OUT(p), OUT(y), OUT(r))",
            self.jumps.held(own), targets, places,
        )  # fmt: skip

    def refused(self) -> str:
        """Return the place in u of a parameter that is not what it must be, or -1."""
        places = {symbol: f"u[{i}]" for i, symbol in enumerate(self._inputs)}
        printer = _Printer(places)
        names = [q.name for q in self.gathers]
        lines = []
        for requirement in self.component.requirements:
            unit = next(q.unit for q in self.gathers if q.name == requirement.name)
            shown = "" if unit == "1" else f" {unit}"
            lines += [
                f"if (!({_c(printer, requirement.condition)})) {{",
                f'    *needed = "{shown}; it must {requirement.text}.";',
                f"    return {names.index(requirement.name)};",
                "}",
            ]
        head = f"static int {self.name}_refused(const double *u, const char **needed)"
        return "\n".join([head, "{", *(f"    {line}" for line in (*lines, "return -1;")), "}", ""])

    @property
    def _moved_targets(self) -> dict[str, sympy.Symbol]:
        return {f"x[{i}]": moved(m) for i, m in enumerate(self.component.memory)}

    @property
    def _step_targets(self) -> dict[str, sympy.Symbol]:
        return {**self._moved_targets, **self._reading_targets}

    @cached_property
    def _invariants(self) -> Invariants:
        """The step, apart from what parameters and its length make of each other in it."""
        program = self.jumps.held(sampled(self.component))
        return Invariants.of(program, self._step_targets.values(), {*self._parameters, DT, EULER})

    @property
    def invariant_count(self) -> int:
        """How many numbers `invariants` writes."""
        return len(self._invariants.kept)

    def invariants(self) -> str:
        """Write into c what a step needs of parameters and its length alone."""
        targets = {f"c[{i}]": s for i, s in enumerate(self._invariants.kept)}
        signature = f"{self.name}_invariants(IN(k), double dt, double euler, OUT(c))"
        return _printed(signature, self._invariants.once, {}, targets, self._arguments.places)

    def step(self) -> str:
        """Move the states x by dt, and write the readings of the end of the step.

        What `invariants` has written is c.
        """
        places = self._arguments.plus(self._invariants.kept, "c").places
        signature = (
            f"{self.name}_step(IN(k), IN(u), IN(s), IN(p), IN(c), double dt, double euler, "
            "double *x, OUT(y), OUT(r))"
        )
        own = self._invariants
        return _printed(signature, own.moving, own.names, self._step_targets, places)

    def lanes(self) -> str:
        """Do as `step` for LANES instances side by side, whose parameters are the same.

        Signs are not given but found, as there is no event between two steps. Returns whether all
        angles of which there is a sine are small enough for one without a branch; else what was
        written is of no use.
        """
        own = self._invariants
        places = _Arguments().plus(self._parameters, "k").plus(own.kept, "c").single(DT, "dt")
        places = places.single(EULER, "euler").plus(self._inputs, "u", "[l]")
        places = places.plus(self._states, "x", "[l]")
        used = set().union(*(e.free_symbols for e in own.moving.values()))
        pairs = zip(self.jumps.signs, self.jumps.expressions, strict=True)
        signs = {s: sgn(e) for s, e in pairs if s in used}
        targets = {f"{place}[l]": s for place, s in self._moved_targets.items()}
        targets |= {f"y[{i}][l]": s for i, s in enumerate(self._outputs)}
        signature = (
            f"{self.name}_lanes(IN(k), IN(c), LANES(const, u), double dt, double euler, "
            "LANES(, x), LANES(, y))"
        )
        return _printed(signature, {**signs, **own.moving}, own.names, targets, places.places)

    def rates(self) -> str:
        """Write the rate of each relaxation, 0 for other states."""
        memory = self.component.memory
        symbols = [sympy.Dummy() for _ in memory]
        own = {
            symbol: positive(m.rate) if isinstance(m, Relaxation) else sympy.Integer(0)
            for symbol, m in zip(symbols, memory, strict=True)
        }
        targets = {f"rate[{i}]": s for i, s in enumerate(symbols)}
        signature = "rates(IN(k), IN(u), IN(x), OUT(rate))"
        return self._written(False, own, targets, signature)

    @property
    def _beginning(self) -> dict[sympy.Symbol, sympy.Expr]:
        component = self.component
        own = beginning(component.memory, component.settling)
        return {symbol: e.xreplace(component.starts) for symbol, e in own.items()}

    def begin(self) -> str:
        """Put the states x, which are at their start values, where they begin."""
        targets = {f"x[{i}]": begun(m) for i, m in enumerate(self.component.memory)}
        own = self._beginning
        return self._written(False, own, targets, "begin(IN(k), IN(u), double *x)")

    def begin_tangent(self) -> str:
        """Put the change tx of the start values x where it begins, along dk and du."""
        own = self._beginning
        changes = Tangent(self._seeds).of(own)
        targets = {f"tx[{i}]": change_of(begun(m)) for i, m in enumerate(self.component.memory)}
        signature = "begin_tangent(IN(k), IN(u), IN(x), IN(dk), IN(du), double *tx)"
        return self._written(False, own | changes, targets, signature, seeds=True)

    def tangent(self) -> str:
        """Write the change of dx and y along dk, du and tx."""
        own = self.jumps.held(readings(self.component))
        changes = Tangent(self._seeds).of(own)
        targets = {f"t{to}": change_of(s) for to, s in self._derivative_targets.items()}
        targets |= {f"ty[{i}]": change_of(s) for i, s in enumerate(self._outputs)}
        return self._written(
            True, own | changes, targets,
            "tangent(IN(k), IN(u), IN(s), IN(x), IN(p), double dt, IN(dk), IN(du), IN(tx), "
            "OUT(tdx), OUT(ty))",
            seeds=True,
        )  # fmt: skip

    def follow(self) -> str:
        """Write the change tx of the states over a step along du, from states x that stay."""
        own = self.jumps.held(step(self.component.memory))
        seeds = {s: self._seeds[s] for s in self._inputs}
        changes = Tangent(seeds).of(own)
        targets = {f"moved[{i}]": change_of(moved(m)) for i, m in enumerate(self.component.memory)}
        signature = (
            "follow(IN(k), IN(u), IN(s), IN(x), double dt, double euler, IN(du), OUT(moved))"
        )
        return self._written(True, own | changes, targets, signature, seeds=True)

    def attempt(self) -> str:
        """Write the states after a step from x, y there, and the change of y along du.

        Nothing is held: a solver inside an FMU tries inputs of its own.
        """
        own = sampled(self.component)
        changes = Tangent({s: self._seeds[s] for s in self._inputs}).of(own)
        targets = {f"moved[{i}]": moved(m) for i, m in enumerate(self.component.memory)}
        targets |= {f"y[{i}]": s for i, s in enumerate(self._outputs)}
        targets |= {f"slope[{i}]": change_of(s) for i, s in enumerate(self._outputs)}
        signature = (
            "attempt(IN(k), IN(u), IN(x), double dt, double euler, IN(du), OUT(moved), "
            "OUT(y), OUT(slope))"
        )
        return self._written(False, own | changes, targets, signature, seeds=True)


def _function(
    signature: str,
    program: Assignments,
    targets: Mapping[str, sympy.Symbol],
    places: Mapping[sympy.Symbol, tuple[str, str]],
) -> str:
    """Return a C function that computes targets by a program, common subexpressions shared."""
    return _printed(signature, *straight_line(program, targets.values()), targets, places)


def _printed(
    signature: str,
    lines: Assignments,
    names: Mapping[sympy.Symbol, str],
    targets: Mapping[str, sympy.Symbol],
    places: Mapping[sympy.Symbol, tuple[str, str]],
) -> str:
    """Return a C function of these lines, of which some have other names there."""
    known = {s: name for s, (name, _) in places.items() if s not in names}
    lanes = "LANES(" in signature
    printer = _Printer({**known, **names}, lanes=lanes)
    used = set().union(*(e.free_symbols for e in lines.values()), targets.values()) - set(lines)
    reads = [
        f"const double {name} = {place};"
        for symbol, (name, place) in places.items()
        if symbol in used and name != place
    ]
    body = [
        f"const double {names.get(symbol, str(symbol))} = {_c(printer, e)};"
        for symbol, e in lines.items()
    ]
    # What nothing moves has no name: its change is none.
    writes = [f"{place} = {_c(printer, s) if s in lines or s in known else '0.0'};"
              for place, s in targets.items()]  # fmt: skip
    signature = re.sub(r"IN\((\w+)\)", r"const double *\1", signature)
    signature = re.sub(r"OUT\((\w+)\)", r"double *\1", signature)
    signature = re.sub(r"LANES\((\w*), (\w+)\)", r"\1 double (*restrict \2)[LANES]", signature)
    arguments = re.findall(r"(\w+)(?:\)\[LANES\])?[,)]", signature)
    text = " ".join([*reads, *body, *writes])
    unused = [a for a in arguments if not re.search(rf"\b{a}\b", text)]
    silence = [f"{', '.join(f'(void){a}' for a in unused)};"] if unused else []
    seldom = any(f"_{name}(" in signature for name in _SELDOM)
    kind = "SELDOM static" if seldom else "static"
    content: Iterable[str] = (*reads, *body, *writes)
    if lanes:
        kinds = tuple(_OF_ANGLES.values())
        angles = dict.fromkeys(f.args[0] for e in lines.values() for f in e.atoms(*kinds))
        far = [f"far |= !(fabs({_c(printer, angle)}) <= LARGEST_ANGLE);" for angle in angles]
        content = (
            "int far = 0;",
            "for (int l = 0; l < LANES; l++) {",
            *(f"    {line}" for line in (*content, *far)),
            "}",
            "return !far;",
        )
    content = (*silence, *content)
    result = "bool" if lanes else "void"
    return "\n".join(
        [f"{kind} {result} {signature}", "{", *(f"    {line}" for line in content), "}", ""]
    )


def _c(printer: _Printer, expression: sympy.Expr) -> str:
    text = str(printer.doprint(expression))
    if "Not supported" in text:
        raise ExportError(f"equations: '{expression}' has no counterpart in C.")
    return text
