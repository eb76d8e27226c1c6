"""Equations in C99.

Arguments are the parameters `k`, the inputs `u` followed by shared parameters, the held signs `s`,
the states `x`, previous values `p`, the step `dt` and a flag for Euler relaxations. See `Functions`
for the results.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import sympy

from fmu_src.equations.c_printer import Arguments, expression_to_c, function, print_function
from hesr_model.equations.component import Component, Quantity, previous
from hesr_model.equations.functions import positive, sgn
from hesr_model.equations.memory import DT, EULER, Relaxation
from hesr_model.equations.program import (
    Assignments,
    Invariants,
    Jumps,
    build_initial_states,
    build_step,
    change_symbol,
    derivatives,
    derive_changes,
    first_readings,
    initial_symbol,
    moved_symbol,
    readings,
    remove_events,
    step,
)

_ZERO = sympy.Integer(0)

SIGNATURES: Mapping[str, str] = {
    "switches": "IN(k), IN(u), OUT(z)",
    "read": "IN(k), IN(u), IN(s), IN(x), IN(p), double dt, OUT(dx), OUT(y), OUT(r)",
    "solved_derivatives": "IN(k), IN(u), IN(x), OUT(dx)",
    "flow": "IN(k), IN(u), IN(x), OUT(dx), OUT(y)",
    "flow_tangent": "IN(k), IN(u), IN(x), IN(dk), IN(du), IN(tx), OUT(tdx), OUT(ty)",
    "start": "IN(k), IN(u), IN(s), IN(x), OUT(p), OUT(y), OUT(r)",
    "invariants": "IN(k), double dt, double euler, OUT(c)",
    "step": "IN(k), IN(u), IN(s), IN(p), IN(c), double dt, double euler, double *x, OUT(y), OUT(r)",
    "together": "IN(v), IN(c), double dt, double euler, LANES(, x), LANES(, y)",
    "lanes": "IN(k), IN(c), LANES(const, u), double dt, double euler, LANES(, x), LANES(, y)",
    "rates": "IN(k), IN(u), IN(x), OUT(rate)",
    "begin": "IN(k), IN(u), double *x",
    "begin_tangent": "IN(k), IN(u), IN(x), IN(dk), IN(du), double *tx",
    "tangent": "IN(k), IN(u), IN(s), IN(x), IN(p), double dt, IN(dk), IN(du), IN(tx), OUT(tdx), "
    "OUT(ty)",
    "follow": "IN(k), IN(u), IN(s), IN(x), double dt, double euler, IN(du), OUT(moved)",
    "attempt": "IN(k), IN(u), IN(x), double dt, double euler, IN(du), OUT(moved), OUT(y), "
    "OUT(slope)",
    "prepare": "IN(k), IN(u), OUT(c)",
    "attempts": "LANES(const, c), LANES(const, u), LANES(const, x), double dt, double euler, "
    "LANES(, moved), LANES(, rise), LANES(, y), LANES(, slope)",
}
"""Arguments of the functions, with arrays that are read or written."""


def _array(name: str, symbols: Iterable[sympy.Symbol]) -> dict[str, sympy.Symbol]:
    return {f"{name}[{i}]": symbol for i, symbol in enumerate(symbols)}


@dataclass(frozen=True)
class Functions:
    """The C functions of a component, with a prefix; `gathered` parameters are inputs in u."""

    component: Component
    name: str
    tunable: bool = True
    gathered: bool = False

    @cached_property
    def jumps(self) -> Jumps:
        """Signs that are held between events."""
        return Jumps(self.component)

    @property
    def _outputs(self) -> tuple[sympy.Symbol, ...]:
        return tuple(equation.symbol for equation in self.component.outputs)

    @property
    def _states(self) -> tuple[sympy.Symbol, ...]:
        return tuple(element.state for element in self.component.memory)

    @property
    def gathers(self) -> tuple[Quantity, ...]:
        """Arguments stored in u."""
        component = self.component
        if self.gathered:
            return (*component.inputs, *component.parameters, *component.shared)
        return (*component.inputs, *component.shared)

    @property
    def _inputs(self) -> tuple[sympy.Symbol, ...]:
        return tuple(quantity.symbol for quantity in self.gathers)

    @property
    def _parameters(self) -> tuple[sympy.Symbol, ...]:
        if self.gathered:
            return ()
        return tuple(quantity.symbol for quantity in self.component.parameters)

    @cached_property
    def _arguments(self) -> Arguments:
        component = self.component
        arguments = Arguments().add_array(self._parameters, "k").add_array(self._inputs, "u")
        arguments = arguments.add_array(self.jumps.signs, "s").add_array(self._states, "x")
        arguments = arguments.add_array(
            (previous(equation.name) for equation in component.remembered), "p"
        )
        return arguments.add_scalar(DT, "dt").add_scalar(EULER, "euler")

    @cached_property
    def _seeds(self) -> dict[sympy.Symbol, sympy.Symbol]:
        moving = [*self._inputs, *self._states]
        if self.tunable:
            moving = [*self._parameters, *moving]
        return {symbol: change_symbol(symbol) for symbol in moving}

    @cached_property
    def _seeded_arguments(self) -> Arguments:
        arguments = self._arguments
        places = ((self._parameters, "dk"), (self._inputs, "du"), (self._states, "tx"))
        for symbols, array in places:
            # Elements that do not change keep their place, under a symbol that is never read.
            seeds = (self._seeds.get(symbol, sympy.Dummy()) for symbol in symbols)
            arguments = arguments.add_array(seeds, array)
        return arguments

    def _head(self, function: str) -> str:
        return f"{self.name}_{function}({SIGNATURES[function]})"

    def _print_program(
        self, name: str, program: Assignments, targets: Mapping[str, sympy.Symbol]
    ) -> str:
        return function(self._head(name), program, targets, self._arguments.places)

    def _print_changes(
        self,
        name: str,
        program: Assignments,
        targets: Mapping[str, sympy.Symbol],
        seeds: Mapping[sympy.Symbol, sympy.Symbol],
        *,
        held: bool = False,
    ) -> str:
        extended_program: Assignments = {**program, **derive_changes(seeds, program)}
        if held:
            extended_program = self.jumps.hold_signs(extended_program)
        return function(self._head(name), extended_program, targets, self._seeded_arguments.places)

    def _print_evaluation(self, name: str, array: str, expressions: Iterable[sympy.Expr]) -> str:
        program = {sympy.Dummy(): expression for expression in expressions}
        return self._print_program(name, program, _array(array, program))

    @property
    def _reading_targets(self) -> dict[str, sympy.Symbol]:
        remembered = (equation.symbol for equation in self.component.remembered)
        return _array("y", self._outputs) | _array("r", remembered)

    @property
    def _derivative_targets(self) -> dict[str, sympy.Symbol]:
        return _array("dx", (element.derivative for element in self.component.memory))

    def switches(self) -> str:
        """Write the arguments of the held signs into z."""
        return self._print_evaluation("switches", "z", self.jumps.expressions)

    def read(self) -> str:
        """Write state derivatives dx, outputs y and remembered values r."""
        program = self.jumps.hold_signs(readings(self.component))
        return self._print_program(
            "read", program, self._derivative_targets | self._reading_targets
        )

    def solved_derivatives(self) -> str:
        """Write state derivatives dx without held signs, as in `attempt`."""
        program = derivatives(self.component.memory)
        return self._print_program("solved_derivatives", program, self._derivative_targets)

    @cached_property
    def _flow(self) -> Assignments:
        # Terms of the step's length, such as means over a step, take their limit without steps.
        program = readings(remove_events(self.component))
        return {symbol: expression.xreplace({DT: _ZERO}) for symbol, expression in program.items()}

    def flow(self) -> str:
        """Write state derivatives dx and outputs y of the event-free form."""
        return self._print_program(
            "flow", self._flow, self._derivative_targets | _array("y", self._outputs)
        )

    def flow_tangent(self) -> str:
        """Write their changes along dk, du and tx."""
        return self._print_changes("flow_tangent", self._flow, self._tangent_targets, self._seeds)

    def start(self) -> str:
        """Write y and r before the first step, and the previous values p for it."""
        program = first_readings(self.component)
        starts = self.component.starts
        targets = self._reading_targets | _array("p", starts)
        places = {s: place for s, place in self._arguments.places.items() if s not in starts}
        return function(self._head("start"), self.jumps.hold_signs(program), targets, places)

    def print_refusal(self) -> str:
        """Return the index in u of an invalid parameter, or -1."""
        places = {symbol: f"u[{i}]" for i, symbol in enumerate(self._inputs)}
        names = [quantity.name for quantity in self.gathers]
        lines = []
        for requirement in self.component.requirements:
            place = names.index(requirement.name)
            unit = self.gathers[place].unit
            unit_text = ""
            if unit != "1":
                unit_text = f" {unit}"
            lines += [
                f"if (!({expression_to_c(requirement.condition, places)})) {{",
                f'    *needed = "{unit_text}; it must {requirement.text}.";',
                f"    return {place};",
                "}",
            ]
        head = f"static int {self.name}_refused(const double *u, const char **needed)"
        return "\n".join([head, "{", *(f"    {line}" for line in (*lines, "return -1;")), "}", ""])

    @property
    def _moved(self) -> tuple[sympy.Symbol, ...]:
        return tuple(map(moved_symbol, self.component.memory))

    @property
    def _step_targets(self) -> dict[str, sympy.Symbol]:
        return _array("x", self._moved) | self._reading_targets

    @cached_property
    def _invariants(self) -> Invariants:
        program = self.jumps.hold_signs(build_step(self.component))
        return Invariants.from_program(
            program, self._step_targets.values(), {*self._parameters, DT, EULER}
        )

    @property
    def invariant(self) -> tuple[sympy.Symbol, ...]:
        """Terms that `invariants` writes."""
        return self._invariants.reused

    def invariants(self) -> str:
        """Write into c the terms of a step that depend only on parameters and its length."""
        invariants = self._invariants
        targets = _array("c", invariants.reused)
        return print_function(
            self._head("invariants"), invariants.once, {}, targets, self._arguments.places
        )

    def step(self) -> str:
        """Advance the states x by dt and write the readings at its end; c is from `invariants`."""
        invariants = self._invariants
        places = self._arguments.add_array(invariants.reused, "c").places
        return print_function(
            self._head("step"), invariants.moving, invariants.names, self._step_targets, places
        )

    def lanes(self) -> str:
        """Do as `step` for LANES instances with the same parameters, computing signs.

        The C function returns whether all angles are small enough for the branch-free sine.
        """
        places = Arguments().add_array(self._parameters, "k").add_array(self.invariant, "c")
        places = places.add_array(self._inputs, "u", "[l]").add_array(self._states, "x", "[l]")
        return self._print_lanes("lanes", places)

    def together(self) -> str:
        """Do as `lanes` for the joints of an FMU with variables v, by the indices of `header`."""
        argument_arrays = (
            ("k", "v", self._parameters),
            ("c", "c", self.invariant),
            ("x", "v", self._states),
        )
        places: dict[sympy.Symbol, tuple[str, str]] = {}
        for name, array, symbols in argument_arrays:
            for i, symbol in enumerate(symbols):
                places[symbol] = (f"{name}_{i}", f"{array}[{name}_at[l] + {i}]")
        for i, symbol in enumerate(self._inputs):
            places[symbol] = (f"u_{i}", f"v[u_at[{i}][l]]")
        return self._print_lanes("together", Arguments(places))

    def _print_lanes(self, name: str, places: Arguments) -> str:
        invariants = self._invariants
        places = places.add_scalar(DT, "dt").add_scalar(EULER, "euler")
        used_symbols = set()
        for expression in invariants.moving.values():
            used_symbols |= expression.free_symbols
        # Lanes have no events: they compute the signs that others hold.
        lines = {}
        for sign, expression in zip(self.jumps.signs, self.jumps.expressions, strict=True):
            if sign in used_symbols:
                lines[sign] = sgn(expression)
        lines |= invariants.moving
        targets = _array("x", self._moved) | _array("y", self._outputs)
        targets = {f"{place}[l]": symbol for place, symbol in targets.items()}
        return print_function(self._head(name), lines, invariants.names, targets, places.places)

    def rates(self) -> str:
        """Write the rate of each relaxation, 0 for other states."""
        memory = self.component.memory
        rates = (
            positive(element.rate) if isinstance(element, Relaxation) else _ZERO
            for element in memory
        )
        return self._print_evaluation("rates", "rate", rates)

    def begin(self) -> str:
        """Move the states x from their start values to their initial values."""
        targets = _array("x", map(initial_symbol, self.component.memory))
        return self._print_program("begin", build_initial_states(self.component), targets)

    def begin_tangent(self) -> str:
        """Propagate the change tx of the start values x to the initial values, along dk and du."""
        targets = _array(
            "tx", (change_symbol(initial_symbol(element)) for element in self.component.memory)
        )
        return self._print_changes(
            "begin_tangent", build_initial_states(self.component), targets, self._seeds
        )

    def tangent(self) -> str:
        """Write the changes of dx and y along dk, du and tx."""
        program = self.jumps.hold_signs(readings(self.component))
        return self._print_changes(
            "tangent", program, self._tangent_targets, self._seeds, held=True
        )

    @property
    def _tangent_targets(self) -> dict[str, sympy.Symbol]:
        targets = {f"t{to}": change_symbol(s) for to, s in self._derivative_targets.items()}
        return targets | _array("ty", map(change_symbol, self._outputs))

    @property
    def _input_seeds(self) -> dict[sympy.Symbol, sympy.Symbol]:
        return {s: self._seeds[s] for s in self._inputs}

    def follow(self) -> str:
        """Write the change tx of the states over a step along du, from constant states x."""
        program = self.jumps.hold_signs(step(self.component.memory))
        targets = _array("moved", map(change_symbol, self._moved))
        return self._print_changes("follow", program, targets, self._input_seeds, held=True)

    def attempt(self) -> str:
        """Write states and outputs after a step from x, and the change of y; no sign is held."""
        targets = _array("moved", self._moved) | _array("y", self._outputs)
        targets |= _array("slope", map(change_symbol, self._outputs))
        return self._print_changes(
            "attempt", build_step(self.component), targets, self._input_seeds
        )

    @cached_property
    def _attempt_invariants(self) -> Invariants:
        program = build_step(self.component)
        seeds = dict(zip(self._inputs[:2], (sympy.Integer(1), DT), strict=True))
        extended_program = {**program, **derive_changes(seeds, program)}
        targets = (*self._moved, *self._outputs)
        fixed = {*self._parameters, *self._inputs[len(self.component.inputs) :]}
        return Invariants.from_program(
            extended_program, (*targets, *map(change_symbol, targets)), fixed
        )

    @property
    def prepared(self) -> tuple[sympy.Symbol, ...]:
        """Terms of `attempts` that depend only on parameters."""
        return (*self._attempt_invariants.reused, *self._parameters)

    def prepare(self) -> str:
        """Write the prepared terms into c."""
        once = self._attempt_invariants.once
        targets = _array("c", self.prepared)
        return print_function(self._head("prepare"), once, {}, targets, self._arguments.places)

    def attempts(self) -> str:
        """Do as `attempt` for LANES instances, along their velocity, which moves their position.

        The values c are from `prepare`; `rise` is the change of `moved`.
        """
        invariants = self._attempt_invariants
        places = (
            Arguments().add_array(self.prepared, "c", "[l]").add_array(self._inputs, "u", "[l]")
        )
        places = (
            places.add_array(self._states, "x", "[l]")
            .add_scalar(DT, "dt")
            .add_scalar(EULER, "euler")
        )
        targets = _array("moved", self._moved) | _array("y", self._outputs)
        targets |= _array("rise", map(change_symbol, self._moved))
        targets |= _array("slope", map(change_symbol, self._outputs))
        targets = {f"{place}[l]": symbol for place, symbol in targets.items()}
        return print_function(
            self._head("attempts"), invariants.moving, invariants.names, targets, places.places
        )
