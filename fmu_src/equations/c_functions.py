"""Equations in C99.

Each distinct component becomes functions with a common prefix over its parameters k, the inputs u
(followed by shared parameters), the held signs s, the states x, previous values p, the step dt and
a flag for Euler relaxations. See `Functions` for the results.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import sympy

from fmu_src.equations.c_printer import Arguments, function, in_c, printed
from hesr_model.equations.component import Component, Quantity, previous
from hesr_model.equations.functions import positive, sgn
from hesr_model.equations.memory import DT, EULER, Relaxation
from hesr_model.equations.program import (
    Assignments,
    Invariants,
    Jumps,
    beginning,
    change_of,
    changes_along,
    derivatives,
    first_readings,
    initial_symbol,
    moved,
    readings,
    sampled,
    step,
)


@dataclass(frozen=True)
class Functions:
    """The C functions of a component, with their common prefix `name`.

    If the parameters k are `tunable`, tangents follow them; `gathered` ones are among the inputs u.
    """

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
        return tuple(e.symbol for e in self.component.outputs)

    @property
    def _states(self) -> tuple[sympy.Symbol, ...]:
        return tuple(m.state for m in self.component.memory)

    @property
    def gathers(self) -> tuple[Quantity, ...]:
        """Arguments stored in u."""
        own = self.component
        return (*own.inputs, *(own.parameters if self.gathered else ()), *own.shared)

    @property
    def _inputs(self) -> tuple[sympy.Symbol, ...]:
        return tuple(q.symbol for q in self.gathers)

    @property
    def _parameters(self) -> tuple[sympy.Symbol, ...]:
        return () if self.gathered else tuple(q.symbol for q in self.component.parameters)

    @cached_property
    def _arguments(self) -> Arguments:
        own = self.component
        found = Arguments().plus(self._parameters, "k").plus(self._inputs, "u")
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
    def _with_seeds(self) -> Arguments:
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
        return function(f"{self.name}_{signature}", program, targets, arguments.places)

    @property
    def _reading_targets(self) -> dict[str, sympy.Symbol]:
        component = self.component
        targets = {f"y[{i}]": s for i, s in enumerate(self._outputs)}
        return targets | {f"r[{i}]": e.symbol for i, e in enumerate(component.remembered)}

    @property
    def _derivative_targets(self) -> dict[str, sympy.Symbol]:
        return {f"dx[{i}]": m.derivative for i, m in enumerate(self.component.memory)}

    def switches(self) -> str:
        """Write the arguments of the held signs into z."""
        symbols = [sympy.Dummy() for _ in self.jumps.expressions]
        own = dict(zip(symbols, self.jumps.expressions, strict=True))
        targets = {f"z[{i}]": s for i, s in enumerate(symbols)}
        return self._written(False, own, targets, "switches(IN(k), IN(u), OUT(z))")

    def read(self) -> str:
        """Write state derivatives dx, outputs y and remembered values r."""
        own = readings(self.component)
        return self._written(
            True, own, {**self._derivative_targets, **self._reading_targets},
            "read(IN(k), IN(u), IN(s), IN(x), IN(p), double dt, OUT(dx), OUT(y), OUT(r))",
        )  # fmt: skip

    def solved_derivatives(self) -> str:
        """Write state derivatives dx without held signs, as in `attempt`."""
        own = derivatives(self.component.memory)
        signature = "solved_derivatives(IN(k), IN(u), IN(x), OUT(dx))"
        return self._written(False, own, self._derivative_targets, signature)

    def start(self) -> str:
        """Write y and r before the first step, and the previous values p for it."""
        own, starts = first_readings(self.component), self.component.starts
        targets = self._reading_targets
        targets |= {f"p[{i}]": s for i, s in enumerate(starts)}
        places = {s: place for s, place in self._arguments.places.items() if s not in starts}
        return function(
            f"{self.name}_start(IN(k), IN(u), IN(s), IN(x), OUT(p), OUT(y), OUT(r))",
            self.jumps.held(own), targets, places,
        )  # fmt: skip

    def refused(self) -> str:
        """Return the index in u of an invalid parameter, or -1."""
        places = {symbol: f"u[{i}]" for i, symbol in enumerate(self._inputs)}
        names = [q.name for q in self.gathers]
        lines = []
        for requirement in self.component.requirements:
            unit = next(q.unit for q in self.gathers if q.name == requirement.name)
            shown = "" if unit == "1" else f" {unit}"
            lines += [
                f"if (!({in_c(requirement.condition, places)})) {{",
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
        """The step without its invariants."""
        program = self.jumps.held(sampled(self.component))
        return Invariants.of(program, self._step_targets.values(), {*self._parameters, DT, EULER})

    @property
    def invariant_count(self) -> int:
        """Number of values that `invariants` writes."""
        return len(self._invariants.kept)

    def invariants(self) -> str:
        """Write into c the terms of a step that depend only on parameters and its length."""
        targets = {f"c[{i}]": s for i, s in enumerate(self._invariants.kept)}
        signature = f"{self.name}_invariants(IN(k), double dt, double euler, OUT(c))"
        return printed(signature, self._invariants.once, {}, targets, self._arguments.places)

    def step(self) -> str:
        """Advance the states x by dt and write the readings at its end; c is from `invariants`."""
        places = self._arguments.plus(self._invariants.kept, "c").places
        signature = (
            f"{self.name}_step(IN(k), IN(u), IN(s), IN(p), IN(c), double dt, double euler, "
            "double *x, OUT(y), OUT(r))"
        )
        own = self._invariants
        return printed(signature, own.moving, own.names, self._step_targets, places)

    def lanes(self) -> str:
        """Do as `step` for LANES instances with the same parameters.

        Signs are computed, because there is no event between two steps. The C function returns
        whether all angles are small enough for the branch-free sine; otherwise its results are
        invalid.
        """
        own = self._invariants
        places = Arguments().plus(self._parameters, "k").plus(own.kept, "c").single(DT, "dt")
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
        return printed(signature, {**signs, **own.moving}, own.names, targets, places.places)

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

    def begin(self) -> str:
        """Move the states x from their start values to their initial values."""
        targets = {f"x[{i}]": initial_symbol(m) for i, m in enumerate(self.component.memory)}
        own = beginning(self.component)
        return self._written(False, own, targets, "begin(IN(k), IN(u), double *x)")

    def begin_tangent(self) -> str:
        """Propagate the change tx of the start values x to the initial values, along dk and du."""
        own = beginning(self.component)
        changes = changes_along(self._seeds, own)
        targets = {
            f"tx[{i}]": change_of(initial_symbol(m)) for i, m in enumerate(self.component.memory)
        }
        signature = "begin_tangent(IN(k), IN(u), IN(x), IN(dk), IN(du), double *tx)"
        return self._written(False, own | changes, targets, signature, seeds=True)

    def tangent(self) -> str:
        """Write the changes of dx and y along dk, du and tx."""
        own = self.jumps.held(readings(self.component))
        changes = changes_along(self._seeds, own)
        targets = {f"t{to}": change_of(s) for to, s in self._derivative_targets.items()}
        targets |= {f"ty[{i}]": change_of(s) for i, s in enumerate(self._outputs)}
        return self._written(
            True, own | changes, targets,
            "tangent(IN(k), IN(u), IN(s), IN(x), IN(p), double dt, IN(dk), IN(du), IN(tx), "
            "OUT(tdx), OUT(ty))",
            seeds=True,
        )  # fmt: skip

    def follow(self) -> str:
        """Write the change tx of the states over a step along du, from constant states x."""
        own = self.jumps.held(step(self.component.memory))
        seeds = {s: self._seeds[s] for s in self._inputs}
        changes = changes_along(seeds, own)
        targets = {f"moved[{i}]": change_of(moved(m)) for i, m in enumerate(self.component.memory)}
        signature = (
            "follow(IN(k), IN(u), IN(s), IN(x), double dt, double euler, IN(du), OUT(moved))"
        )
        return self._written(True, own | changes, targets, signature, seeds=True)

    def attempt(self) -> str:
        """Write the states after a step from x, the outputs y there, and the change of y along du.

        No sign is held, because a solver inside an FMU tries its own inputs.
        """
        own = sampled(self.component)
        changes = changes_along({s: self._seeds[s] for s in self._inputs}, own)
        targets = {f"moved[{i}]": moved(m) for i, m in enumerate(self.component.memory)}
        targets |= {f"y[{i}]": s for i, s in enumerate(self._outputs)}
        targets |= {f"slope[{i}]": change_of(s) for i, s in enumerate(self._outputs)}
        signature = (
            "attempt(IN(k), IN(u), IN(x), double dt, double euler, IN(du), OUT(moved), "
            "OUT(y), OUT(slope))"
        )
        return self._written(False, own | changes, targets, signature, seeds=True)
