"""Connections of a system, checked against its FMUs."""

from collections.abc import Iterator, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from pathlib import Path
from typing import Any

from cosim.systems.system import Bounds, SystemSpec, Value
from fmu_src.run.master import Element
from fmu_src.run.variables import Variables
from hesr_model.errors import ArgumentError, ConfigError, SimulationError
from hesr_model.support.ledger import find_close_names, format_suggestion

_ACCEPTED_TYPES: Mapping[str, tuple[str, ...]] = {
    "Real": ("Real", "Float32", "Integer", "Boolean"),
    "Float32": ("Float32",),
    "Integer": ("Integer", "Enumeration", "Boolean"),
    "Enumeration": ("Integer", "Enumeration"),
    "Boolean": ("Boolean",),
    "String": ("String",),
}
"""Types of outputs that an input of a type takes without loss."""


class Wiring:
    """Signals of a system; `slaves` holds the variables of its components.

    Raises ConfigError if signals do not fit, an input has no value, or there is an algebraic loop.
    """

    def __init__(self, system: SystemSpec, slaves: Mapping[str, Variables], path: Path) -> None:
        self._slaves = slaves
        self._path = path
        self._converted = frozenset(system.conversions)
        self.sources: dict[Element, Element] = {}
        for target, source in system.connections.items():
            self._connect(target, source, f"connection '{target}' = '{source}'")
        starts = {component.name: component.start for component in system.components}
        self.start = {name: self._start(name, starts.get(name, {})) for name in slaves}
        observed = (self.elements(s, f"observed '{s}'") for s in system.observe)
        self.observed = list(dict.fromkeys(chain.from_iterable(observed)))
        self.limited: list[tuple[Element, Bounds]] = []
        for signal, bounds in system.limits.items():
            self.limited += self._bounds(signal, bounds, f"limits of '{signal}'")
        if not system.open_inputs:
            for name, slave in self._slaves.items():
                for variable in slave.needed:
                    if (name, variable) not in self.sources and variable not in self.start[name]:
                        raise self._error(
                            f"input '{name}.{variable}' is not connected and has no start value.",
                            code="system.open_input",
                            key=f"components.{name}.start.{variable}",
                        )
        self.order = self._sort_components(system.delay_undeclared)

    def merge_start_values(
        self, extra_start: Mapping[str, Mapping[str, Value]]
    ) -> dict[str, dict[str, float | str]]:
        """Return the start values of each component, replaced by the given ones."""
        for name in extra_start:
            self._require_component(name, "start values")
        return {
            n: component_start | self._start(n, extra_start.get(n, {}))
            for n, component_start in self.start.items()
        }

    def _error(self, text: str, *, code: str, key: str) -> ConfigError:
        return ConfigError(f"{self._path}: {text}", code=code, where=self._path, key=key)

    def _require_component(self, name: str, where: str) -> None:
        if name not in self._slaves:
            hint = format_suggestion(find_close_names(name, self._slaves, 1))
            hint = hint or f"there are {', '.join(self._slaves)}."
            raise self._error(
                f"{where}: there is no component '{name}'; {hint}",
                code="system.component",
                key=_find_key(where),
            )

    def elements(self, signal: str, where: str = "", kind: str | None = None) -> list[Element]:
        """Return the elements of a signal, and check their type if one is given."""
        name, _, variable = signal.partition(".")
        where = where or f"'{signal}'"
        self._require_component(name, where)
        try:
            element_names = self._slaves[name].elements(variable)
            if kind:
                self._slaves[name].references(element_names, kind)
        except SimulationError as error:
            raise self._error(
                f"{where}: {error}", code="system.variable", key=_find_key(where)
            ) from error
        return [(name, element) for element in element_names]

    def _start(self, name: str, values: Mapping[str, Value]) -> dict[str, float | str]:
        try:
            return self._slaves[name].expand_values(values)
        except SimulationError as error:
            raise self._error(
                f"start values of '{name}': {error}",
                code="system.start",
                key=f"components.{name}.start",
            ) from error

    def _bounds(self, signal: str, bounds: Any, where: str) -> Iterator[tuple[Element, Bounds]]:
        elements = self.elements(signal, where, "Real")
        pairs = bounds
        if not isinstance(bounds[0], tuple):
            pairs = (bounds,) * len(elements)
        if len(pairs) != len(elements):
            raise self._error(
                f"{where}: {len(pairs)} pairs for {len(elements)} elements.",
                code="system.limit_pairs",
                key=_find_key(where),
            )
        yield from zip(elements, pairs, strict=True)

    def _connect(self, target: str, source: str, where: str) -> None:
        inputs = self.elements(target, where)
        outputs = self.elements(source, where)
        if len(inputs) != len(outputs):
            raise self._error(
                f"{where}: '{target}' has {len(inputs)} element{'s'[: len(inputs) > 1]}, "
                f"'{source}' has {len(outputs)}.",
                code="system.sizes",
                key=_find_key(where),
            )
        for input_element, output_element in zip(inputs, outputs, strict=True):
            self._require_fit(input_element, output_element, where)
            if input_element in self.sources:
                raise self._error(
                    f"{where}: '{'.'.join(input_element)}' is connected already, to "
                    f"'{'.'.join(self.sources[input_element])}'.",
                    code="system.connected",
                    key=_find_key(where),
                )
            self.sources[input_element] = output_element

    def _require_fit(self, target: Element, source: Element, where: str) -> None:
        """Raise ConfigError unless an input takes an output: causality, type and unit."""
        self._require_causality(target, source, where)
        input_name, input_variable = target
        output_name, output_variable = source
        input_type = self._slaves[input_name][input_variable].type
        output_type = self._slaves[output_name][output_variable].type
        if output_type not in _ACCEPTED_TYPES.get(input_type, ()):
            raise self._error(
                f"{where}: the input is of type {input_type}, the output of type {output_type}, "
                "which does not fit.",
                code="system.types",
                key=_find_key(where),
            )
        is_converted = ".".join(target) in self._converted
        if not is_converted and "Real" in (input_type, output_type):
            self._require_unit(target, source, where)

    def _require_causality(self, target: Element, source: Element, where: str) -> None:
        for (name, variable), expected in ((target, "input"), (source, "output")):
            causality = self._slaves[name][variable].causality
            if causality != expected:
                raise self._error(
                    f"{where}: the causality of '{name}.{variable}' is {causality}; it must be "
                    f"{expected}.",
                    code="system.causality",
                    key=_find_key(where),
                )

    def _require_unit(self, target: Element, source: Element, where: str) -> None:
        target_unit, source_unit = (
            self._slaves[name].unit(variable) for name, variable in (target, source)
        )
        # Tools spell units differently: compare SI base units.
        same_base = target_unit[0] == source_unit[0] or (
            target_unit[1] is not None and target_unit[1] == source_unit[1]
        )
        if target_unit[0] and source_unit[0] and not same_base:
            raise self._error(
                f"{where}: the input is in {target_unit[0]}, the output in {source_unit[0]}.",
                code="system.units",
                key=_find_key(where),
            )

    def _sort_components(self, delay_undeclared: bool) -> tuple[Element, ...]:
        # Lists, not sets, for a reproducible order.
        graph: dict[Element, list[Element]] = {
            target: [source] for target, source in self.sources.items()
        }
        for name, slave in self._slaves.items():
            if delay_undeclared and not slave.declares_feedthrough:
                continue
            for output, needed_inputs in slave.feedthrough.items():
                graph[name, output] = [(name, element) for element in needed_inputs]
        try:
            return tuple(TopologicalSorter(graph).static_order())
        except CycleError as error:
            loop = error.args[1]
            raise ArgumentError(
                f"{self._path}: algebraic loop through direct feedthrough: "
                f"{' -> '.join(map('.'.join, loop))}{self._explain_loop(loop)}.",
                code="system.loop",
                where=self._path,
                key="connections",
            ) from error

    def _explain_loop(self, loop: Sequence[Element]) -> str:
        """Return which components of a loop state no dependencies, and the remedy, or ""."""
        hint = ""
        for name in dict.fromkeys(name for name, _ in loop):
            if not self._slaves[name].declares_feedthrough:
                hint += f" ('{name}' does not say what its outputs depend on: every input counts)"
        if hint:
            hint += "; 'order' \"jacobi\" exchanges values of the step before"
        return hint


_TABLES = {"connection": "connections", "limits": "limits", "observed": "observe"}


def _find_key(where: str) -> str:
    """Return the key of a system file for a place such as ``limits of 'arm.q'``."""
    kind, _, remainder = where.partition("'")
    table = _TABLES.get(kind.partition(" ")[0])
    signal = remainder.partition("'")[0]
    if table:
        return f"{table}.{signal}"
    return signal or where
