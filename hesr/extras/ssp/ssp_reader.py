"""Systems of FMUs read from an SSP of any tool."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import ceil, isfinite
from pathlib import Path
from posixpath import normpath
from typing import Any, NamedTuple, get_args
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from cosim.systems.system import Conversion, SystemSpec
from fmu_src.run.archive import MAX_ENTRY_BYTES, MAX_TEXT_BYTES, Archive
from fmu_src.run.master import Order
from fmu_src.run.variables import Variables, model_description
from hesr.extras.ssp.contents import (
    COUPLING_ANNOTATION,
    NAMESPACES,
    SSD,
    UnitExponents,
    read_units,
)
from hesr.extras.ssp.ssp_graph import (
    ConnectorGraph,
    ConnectorName,
    ElementPath,
    Hop,
    ParameterValue,
    Transformation,
    Unit,
    convert_to_unit,
    find_conversion,
    format_connector,
    parse_float,
    parse_integer,
    read_boolean,
    read_number,
    read_transformation,
    safe_names,
    suggest,
)
from hesr.extras.ssp.ssp_times import fit_hint, fit_stop, read_step, require_times
from hesr.extras.ssp.vocabulary import IRRELEVANT, USED
from hesr_model.errors import ArgumentError, ConfigError, HesrError, SimulationError
from hesr_model.support.files import scratch_folder
from hesr_model.support.ledger import Ledger, get_local_name
from hesr_model.support.text import join_with_or
from hesr_model.support.xml_files import parse_xml

_PREFIXES = {key.removeprefix("xmlns:"): uri for key, uri in NAMESPACES.items()}
_PREFIXES["ssm"] = _PREFIXES["ssv"].replace("Values", "Mapping")
# Names of elements are local, since their prefix does not change their meaning here.
_COUPLING = f"{{*}}Annotations/{{*}}Annotation[@type='{COUPLING_ANNOTATION}']/{{*}}Coupling"
# Steps in annotations of the engines, in any namespace because tools differ.
_STEP_ANNOTATIONS = (
    (".//{*}FixedStepAlgorithm", "baseStepSize"),
    (".//{*}FixedStepMaster", "stepSize"),
)

_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+(e[+-]?\d+)?\s*", re.IGNORECASE)
_MAX_FILE_NAME = 100  # characters
_DEFAULT_ROWS = 500  # if neither the SSP nor its FMUs name a step
_CONNECTOR_KINDS = (
    *("", "input", "output", "inout", "parameter", "calculatedParameter"),
    *("structuralParameter", "constant", "local"),
)
_SOURCE_BASES = ("", "SSD", "component")
_SOURCE_KINDS = ("output", "local", "calculatedParameter", "constant")
_SYSTEM_SOURCE_KINDS = ("input", "parameter", "structuralParameter")
"""Kinds of connectors that give values: of elements, and of the enclosing system."""


class UnsupportedError(ConfigError):
    """A part of the standard is not supported."""


@contextmanager
def open_ssp(
    path: Path, times: Mapping[str, float | None], values: Mapping[str, Any]
) -> Iterator[SystemSpec]:
    """Yield the system of an SSP as one level with all outputs observed; see `open_system`."""
    with Archive(path, "SSP") as archive, scratch_folder() as folder:
        reader = _Reader(path, archive, Path(folder))
        try:
            content = reader.read_system(times, values)
        except ConfigError as error:
            if str(error).startswith(str(path)):
                raise
            raise ConfigError(f"{path}: {error}") from error
        try:
            yield SystemSpec.from_data(path, content)
        except HesrError as error:
            raise reader.name_members(error) from error


class _MappingTarget(NamedTuple):
    """A name that a parameter mapping gives, and how the value is converted."""

    name: str
    transformation: Transformation | None
    suppressed: bool


@dataclass(frozen=True)
class _Reader:
    path: Path
    archive: Archive
    folder: Path
    graph: ConnectorGraph = field(default_factory=ConnectorGraph)
    fmus: dict[ElementPath, Path] = field(default_factory=dict)
    sources: dict[ElementPath, str] = field(default_factory=dict)  # of components
    steps: dict[ElementPath, str] = field(default_factory=dict)  # [s] of components
    start_values: dict[ElementPath, dict[str, Any]] = field(default_factory=dict)
    element_paths: list[ElementPath] = field(default_factory=list)
    parameters: Ledger = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", Ledger(str(self.path), "parameter"))

    def name_members(self, error: HesrError) -> HesrError:
        """Return an error with the names of FMUs in the SSP instead of where they were unpacked."""
        sentence = str(error)
        for element_path, fmu in self.fmus.items():
            source = self.sources[element_path]
            sentence = sentence.replace(str(fmu), source)
            if sentence.startswith(f"{source}: "):
                sentence = f"{self.path}: {sentence}"
        return type(error)(sentence, code=error.code, where=error.where, key=error.key)

    def build_error(self, text: str) -> ConfigError:
        return ConfigError(f"{self.path}: {text}")

    def read_member(self, name: str, where: str = "", size_limit: int = MAX_ENTRY_BYTES) -> bytes:
        # Sources are URIs, but some tools write plain names, or backslashes.
        plain_name = name.replace("\\", "/")
        for candidate in (unquote(plain_name), plain_name):
            member = normpath(candidate)
            if member in self.archive.names:
                return self.archive.read(member, size_limit)
        raise self.build_error(f"{where}{name} is missing.")

    def parse_member(self, name: str, kind: str, where: str = "") -> ET.Element:
        """Return the root of an XML file, an element of a kind."""
        try:
            data = self.read_member(name, where, MAX_TEXT_BYTES)
            root = parse_xml(data, _PREFIXES)
        except (ET.ParseError, LookupError, ValueError) as error:  # or an unknown encoding
            raise self.build_error(f"{where}{name} is not valid XML ({error}).") from error
        root_kind = get_local_name(root)
        if root_kind != kind:
            raise self.build_error(f"{where}{name} is a {root_kind}; it must be a {kind}.")
        ledger = Ledger(f"{self.path}: {name}", "part")
        ledger.compare_elements(root, USED, IRRELEVANT)
        ledger.require_nothing_meant()
        return root

    def read_attribute(self, node: ET.Element, name: str, where: str) -> str:
        value = node.get(name)
        if value is None:
            raise self.build_error(f"{where}: attribute '{name}' is missing.")
        return value

    def read_choice(self, node: ET.Element, name: str, choices: Sequence[str], where: str) -> str:
        """Return an attribute that has one of several values, the first by default."""
        value = node.get(name, choices[0])
        if value not in choices:
            hint = suggest(value, choices, f"it must be {join_with_or(choices[1:])}")
            raise self.build_error(f"{where}: {name} is '{value}'; {hint}")
        return value

    def build_refusal(self, subject: str) -> UnsupportedError:
        return UnsupportedError(f"{self.path}: {subject} not supported.")

    def read_system(
        self, times: Mapping[str, float | None], start_values: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return the data of a `SystemSpec`: all components on one level, and their signals."""
        root = self.parse_member(SSD, "SystemStructureDescription")
        systems = root.findall("{*}System")
        if len(systems) != 1:
            raise self.build_error(f"{SSD} contains {len(systems)} systems; it must be one.")
        system = systems[0]
        units = read_units(root.findall("{*}Units/{*}Unit"), f"{self.path}: {SSD}")
        self.read_elements(system, (), units)
        self.apply_parameters(system, ())
        if not self.fmus:
            raise self.build_refusal(f"{SSD} contains no FMU; a system without any is")
        self.parameters.require_nothing_meant()
        for name, value in start_values.items():
            if not self.assign((), name, ParameterValue(value=value)):
                hint = suggest(name, self.list_parameters(()), "see its FMUs")
                raise ArgumentError(
                    f"{self.path}: 'set': '{name}' is not a variable of the system; {hint}"
                )
        # Names of elements may contain dots.
        names = safe_names("\0".join(element_path) for element_path in self.fmus)
        component_names = {
            element_path: names["\0".join(element_path)] for element_path in self.fmus
        }
        connections = {}
        conversions = {}
        for input_end, output_end, conversion_steps in sorted(
            self.find_sources(), key=lambda connection: self.graph.order[connection[0]]
        ):
            target = self.name_signal(input_end, component_names)
            connections[target] = self.name_signal(output_end, component_names)
            conversions[target] = conversion_steps
        observed = [self.name_signal(output, component_names) for output in self.list_outputs()]
        system_outputs = {}
        for output, output_source, conversion_steps in self.find_system_outputs():
            signal = self.name_signal(output_source, component_names)
            system_outputs[output] = {"signal": signal, "conversions": conversion_steps}
            observed.append(signal)
        run_times = self.choose_times(root, times)
        steps = {}
        for element_path, hint in self.steps.items():
            where = f"{self.path}: StepSizeHint of '{'.'.join(element_path)}'"
            if (step_size := fit_hint(hint, run_times["step"], where)) is not None:
                steps[element_path] = step_size
        return {
            "name": root.get("name", self.path.stem),
            **run_times,
            **self.read_order(system),
            "components": self.list_components(component_names, steps),
            "connections": connections,
            "conversions": conversions,
            "open_inputs": True,
            "observe": list(dict.fromkeys(observed)),
            "outputs": system_outputs,
        }

    def list_components(
        self, component_names: Mapping[ElementPath, str], steps: Mapping[ElementPath, float]
    ) -> list[dict[str, Any]]:
        """Return the data of the components: name, FMU, start values, and step [s] if stated."""
        components = []
        for element_path, fmu in self.fmus.items():
            component: dict[str, Any] = {"name": component_names[element_path], "fmu": fmu}
            component["start"] = self.start_values.get(element_path, {})
            if element_path in steps:
                component["step"] = steps[element_path]
            components.append(component)
        return components

    def choose_times(self, root: ET.Element, times: Mapping[str, float | None]) -> dict[str, Any]:
        """Return the times of a run [s], those of the default experiment by default."""
        experiment = root.find("{*}DefaultExperiment")
        if experiment is None:
            experiment = ET.Element("none")
        start_time = times.get("start")
        if start_time is None:
            start_time = read_number(experiment, "startTime", 0.0, SSD)
        stop_time = times.get("stop")
        if stop_time is None:
            if experiment.get("stopTime") is None:
                raise ArgumentError(
                    f"{self.path}: the default experiment has no stopTime; give 'stop'."
                )
            stop_time = read_number(experiment, "stopTime", 0.0, SSD)
        require_times(start_time, stop_time, str(self.path))
        step = times.get("step")
        if step is not None:
            read_step(f"{step:g}", f"{self.path}: 'step'")
        else:
            step = self.read_stated_step(root)
            if step is not None:
                stop_time = fit_stop(start_time, stop_time, step, str(self.path))
            else:
                step = self.choose_step(stop_time - start_time)
        return {"begin": start_time, "stop": stop_time, "step": step}

    def read_stated_step(self, root: ET.Element) -> float | None:
        """Return the step [s] of an annotation, None without any."""
        for tag, key in _STEP_ANNOTATIONS:
            node = root.find(tag)
            text = None if node is None else node.get(key)
            if text:
                return read_step(text, f"{self.path}: {SSD}: {key}")
        return None

    def choose_step(self, duration: float) -> float:
        """Return the shortest step [s] of the FMUs that fits into a duration [s]."""
        steps = []
        for fmu in self.fmus.values():
            experiment = model_description(fmu).defaultExperiment
            if experiment and experiment.stepSize:
                steps.append(float(experiment.stepSize))
        row_count = _DEFAULT_ROWS
        if steps:
            row_count = ceil(duration / min(steps) - 1e-6)  # round-off gives no further row
        return duration / max(row_count, 1)

    def read_order(self, system: ET.Element) -> dict[str, str]:
        """Return the order of the coupling in our annotation; SSPs of other tools have none."""
        coupling = system.find(_COUPLING)
        if coupling is None:
            return {}
        order = self.read_attribute(coupling, "order", SSD)
        if order not in get_args(Order):
            orders = join_with_or(get_args(Order))
            raise self.build_error(f"the order of its coupling is '{order}'; it must be {orders}.")
        return {"order": order}

    def read_elements(
        self, system: ET.Element, parent_path: ElementPath, units: Mapping[str, Any]
    ) -> None:
        """Read connectors and elements of a system, then its connections."""
        self.element_paths.append(parent_path)
        self.read_connectors(system, parent_path, units)
        for node in system.findall("{*}Elements/*"):
            name = self.read_attribute(node, "name", "an element")
            kind = node.tag.rpartition("}")[2]
            element_path = (*parent_path, name)
            if element_path in self.element_paths:
                raise self.build_error(f"two elements are named '{'.'.join(element_path)}'.")
            if kind == "System":
                self.read_elements(node, element_path, units)
                self.apply_parameters(node, element_path)
            elif kind == "Component":
                self.read_component(node, element_path)
                self.read_connectors(node, element_path, units)
                self.apply_parameters(node, element_path)
            else:
                raise self.build_refusal(f"element '{name}' is a {kind}, which is")
        for node in system.findall("{*}Connections/{*}Connection"):
            self.read_connection(node, parent_path)

    def read_component(self, node: ET.Element, element_path: ElementPath) -> None:
        where = f"component '{'.'.join(element_path)}'"
        source = self.read_attribute(node, "source", where)
        if not source.lower().endswith(".fmu"):
            raise self.build_refusal(f"{where} is {source}, no FMU, which is")
        self.element_paths.append(element_path)
        # Names may collide on other file systems.
        file = f"{re.sub(r'[^0-9A-Za-z_]', '_', element_path[-1])[:_MAX_FILE_NAME]}.fmu"
        fmu = self.folder / str(len(self.fmus)) / file
        fmu.parent.mkdir(exist_ok=True)
        fmu.write_bytes(self.read_member(source, f"{where}: "))
        try:
            description = model_description(fmu)
        except SimulationError as error:
            sentence = str(error).replace(str(fmu), source)
            raise SimulationError(f"{self.path}: {where}: {sentence}") from error
        if description.fmiVersion not in ("2.0", "3.0"):
            raise self.build_refusal(f"{where} is of FMI {description.fmiVersion}, which is")
        if description.coSimulation is None:
            raise self.build_refusal(f"{where} is for model exchange only, which is")
        self.fmus[element_path] = fmu
        self.sources[element_path] = source
        self.graph.variables[element_path] = Variables(Path(source), description)
        hint = node.find(".//{*}StepSizeHint")
        if hint is not None:
            self.steps[element_path] = hint.get("value", "")

    def read_connectors(
        self, node: ET.Element, element_path: ElementPath, units: Mapping[str, Any]
    ) -> None:
        for connector in node.findall("{*}Connectors/{*}Connector"):
            name = self.read_attribute(connector, "name", f"a connector of '{node.get('name')}'")
            where = f"connector '{format_connector((element_path, name))}'"
            if connector.find("{*}Dimension") is not None:
                raise self.build_refusal(f"{where} is an array, which is")
            kind = self.read_choice(connector, "kind", _CONNECTOR_KINDS, where)
            if not kind and element_path in self.fmus:  # SSP 2.0 leaves it to the FMU
                kind = self.graph.variables[element_path][name].causality
            unit_names = [child.get("unit") for child in connector]
            unit_name = next(filter(None, unit_names), None)
            self.graph.kinds[element_path, name] = kind
            self.graph.units[element_path, name] = _find_unit(unit_name, units)

    def read_connection(self, node: ET.Element, system_path: ElementPath) -> None:
        """Add a connection of two connectors of a system or its elements to the graph."""
        source = self.read_connection_end(node, "start", system_path)
        target = self.read_connection_end(node, "end", system_path)
        # The order of start and end does not state a direction.
        if self.is_source(target, system_path) and not self.is_source(source, system_path):
            source, target = target, source
        where = f"connection '{format_connector(target)}' = '{format_connector(source)}'"
        hop = Hop(
            target=target,
            suppressed=_is_conversion_suppressed(node, where),
            transformation=read_transformation(node, where),
        )
        self.graph.add(source, hop)

    def read_connection_end(
        self, node: ET.Element, end: str, system_path: ElementPath
    ) -> ConnectorName:
        """Return the connector at the "start" or "end" of a connection."""
        # OMSimulator writes an empty name for the system.
        element = node.get(f"{end}Element")
        element_path = (*system_path, element) if element else system_path
        name = self.read_attribute(node, f"{end}Connector", "a connection")
        where = f"connection of '{format_connector((element_path, name))}'"
        if element_path not in self.element_paths:
            names = [path[-1] for path in self.element_paths if path[:-1] == system_path != path]
            hint = suggest(element or "", names, f"its components are {', '.join(names)}")
            raise self.build_error(f"{where}: '{element}' is not a component of the system; {hint}")
        if element_path not in self.fmus and (element_path, name) not in self.graph.kinds:
            names = [connector for path, connector in self.graph.kinds if path == element_path]
            hint = suggest(name, names, "add it")
            raise self.build_error(f"{where}: the system has no such connector; {hint}")
        if node.get(f"{end}Indices"):
            raise self.build_refusal(f"{where}: an index is")
        return element_path, name

    def is_source(self, connector: ConnectorName, system_path: ElementPath) -> bool:
        """Return whether a connector gives values within a system."""
        kind = self.graph.kinds.get(connector)
        if connector[0] == system_path:
            return kind in _SYSTEM_SOURCE_KINDS
        return kind in _SOURCE_KINDS

    def find_sources(self) -> Iterator[tuple[ConnectorName, ConnectorName, tuple[Conversion, ...]]]:
        """Yield input, output and conversions of connected components."""
        for source in list(self.graph.hops):
            if source[0] not in self.fmus:
                continue
            for path in self.graph.find_paths(source):
                if self.graph.kinds.get(source) in ("calculatedParameter", "constant"):
                    raise self.build_refusal(
                        f"connection of the parameter '{format_connector(source)}' is"
                    )
                steps = self.graph.find_conversions(source, path, self.graph.find_unit(source))
                yield path[-1].target, source, steps

    def find_system_outputs(
        self,
    ) -> Iterator[tuple[str, ConnectorName, tuple[Conversion, ...]]]:
        """Yield the outputs of the whole system, their sources and conversions."""
        for source in list(self.graph.hops):
            for path in self.graph.find_paths(source, to_root=True):
                if source[0] in self.fmus:
                    steps = self.graph.find_conversions(source, path, self.graph.find_unit(source))
                    yield path[-1].target[1], source, steps

    def list_outputs(self) -> list[ConnectorName]:
        """Return all outputs with a connector, or all outputs."""
        shown_outputs = [
            node
            for node, kind in self.graph.kinds.items()
            if node[0] in self.fmus and kind in ("output", "calculatedParameter", "local")
        ]
        if shown_outputs:
            return shown_outputs
        outputs: list[ConnectorName] = []
        for element_path, variables in self.graph.variables.items():
            outputs += [(element_path, name) for name in variables.feedthrough]
        return outputs

    def apply_parameters(self, node: ET.Element, element_path: ElementPath) -> None:
        """Apply the parameter bindings of an element, which replace those of inner ones."""
        kind = "component" if element_path in self.fmus else "system"
        where = f"{kind} '{'.'.join(element_path) or node.get('name')}'"
        for binding in node.findall("{*}ParameterBindings/{*}ParameterBinding"):
            base = self.read_choice(binding, "sourceBase", _SOURCE_BASES, where)
            if base == "component":
                raise self.build_refusal(f"{where}: a parameter source inside an FMU is")
            parameter_sets = binding.findall("{*}ParameterValues/{*}ParameterSet")
            if not parameter_sets:
                source = self.read_attribute(binding, "source", f"{where}: a parameter binding")
                parameter_sets = [self.parse_member(source, "ParameterSet", f"{where}: ")]
            values = self.read_values(parameter_sets, binding.get("prefix", ""), where)
            mapping = self.read_mapping(binding, where)
            if mapping is not None:
                values = self.map_values(values, mapping, where)
            self.assign_all(element_path, values, where)

    def map_values(
        self,
        values: list[tuple[str, ParameterValue]],
        mapping: Mapping[str, list[_MappingTarget]],
        where: str,
    ) -> list[tuple[str, ParameterValue]]:
        """Return values by the names of their targets, and record what does not match."""
        names = [name for name, _ in values]
        self.parameters.compare(f"the values of {where}", mapping, names)
        self.parameters.compare(f"the mapping of {where}", names, mapping)
        mapped_values = []
        for name, value in values:
            for target in mapping.get(name, ()):
                mapped_value = replace(
                    value, transformation=target.transformation, suppressed=target.suppressed
                )
                mapped_values.append((target.name, mapped_value))
        return mapped_values

    def read_values(
        self, parameter_sets: list[ET.Element], prefix: str, where: str
    ) -> list[tuple[str, ParameterValue]]:
        """Return names with a prefix, and values, in the order of the file."""
        values = []
        for parameter_set in parameter_sets:
            units = read_units(parameter_set.findall("{*}Units/{*}Unit"), f"{self.path}: {where}")
            for parameter in parameter_set.findall("{*}Parameters/{*}Parameter"):
                name = self.read_attribute(parameter, "name", f"{where}: a parameter")
                value = self.read_value(parameter, units, f"{where}: parameter '{name}'")
                values.append((prefix + name, value))
        return values

    def assign_all(
        self, element_path: ElementPath, values: list[tuple[str, ParameterValue]], where: str
    ) -> None:
        """Set parameters below an element, and record the names that nothing has."""
        assigned = [name for name, value in values if self.assign(element_path, name, value)]
        names = [name for name, _ in values]
        if len(assigned) < len(names):
            known_names = [*assigned, *self.list_parameters(element_path)]
            homes = {
                ".".join(inner_path): variables.names
                for inner_path, variables in self.graph.variables.items()
                if inner_path != element_path
            }
            self.parameters.compare(where, names, known_names, homes)

    def list_parameters(self, outer_path: ElementPath) -> Iterator[str]:
        """Yield the hierarchical names of what can be set below an element."""
        for inner_path in self.element_paths:
            if inner_path[: len(outer_path)] != outer_path:
                continue
            prefix = _compose_prefix(inner_path, outer_path)
            if inner_path in self.graph.variables:
                names: Iterable[str] = self.graph.variables[inner_path].names
            else:
                names = [name for node, name in self.graph.kinds if node == inner_path]
            yield from (f"{prefix}{name}" for name in names)

    def read_mapping(
        self, binding: ET.Element, where: str
    ) -> dict[str, list[_MappingTarget]] | None:
        """Return the targets of each name of a parameter mapping; None without a mapping."""
        node = binding.find("{*}ParameterMapping")
        if node is None:
            return None
        if self.read_choice(node, "sourceBase", _SOURCE_BASES, where) == "component":
            raise self.build_refusal(f"{where}: a parameter mapping inside an FMU is")
        if node.find("{*}MappingEntry") is None and node.find("{*}ParameterMapping") is None:
            source = self.read_attribute(node, "source", f"{where}: a parameter mapping")
            node = self.parse_member(source, "ParameterMapping", f"{where}: ")
        targets_by_name: dict[str, list[_MappingTarget]] = {}
        for entry in node.findall(".//{*}MappingEntry"):
            name = self.read_attribute(entry, "source", f"{where}: a mapping")
            entry_place = f"{where}: mapping of '{name}'"
            target = _MappingTarget(
                name=self.read_attribute(entry, "target", f"{where}: a mapping"),
                transformation=read_transformation(entry, entry_place),
                suppressed=_is_conversion_suppressed(entry, entry_place),
            )
            targets_by_name.setdefault(name, []).append(target)
        return targets_by_name

    def read_value(
        self, parameter: ET.Element, units: Mapping[str, Any], where: str
    ) -> ParameterValue:
        """Return the value of a parameter, which its first child states, with its unit."""
        node = next(iter(parameter), None)
        if node is None:
            raise self.build_error(f"{where} has no value.")
        kind = node.tag.rpartition("}")[2]
        text = node.get("value")
        if kind in ("Dimension", "Binary") or text is None:
            raise self.build_refusal(f"{where} is an array or of type {kind}, which is")
        if kind in ("String", "Enumeration"):
            return ParameterValue(value=text)
        if kind == "Boolean":
            return ParameterValue(value=read_boolean(text, where))
        try:
            number = parse_integer(text) if "Int" in kind else parse_float(text)
        except ValueError as error:
            sentence = f"{where} is '{text}', which is not of type {kind}"
            if _DECIMAL_COMMA.fullmatch(text):
                sentence += "; write a decimal point"
            raise self.build_error(f"{sentence}.") from error
        if not isfinite(number):
            raise self.build_error(f"{where} is '{text}'; it must be a finite number.")
        return ParameterValue(value=number, unit=_find_unit(node.get("unit"), units))

    def assign(self, outer_path: ElementPath, name: str, parameter: ParameterValue) -> bool:
        """Set a parameter below an element by its hierarchical name; return whether it exists."""
        exists = False
        for inner_path in self.element_paths:
            prefix = _compose_prefix(inner_path, outer_path)
            if inner_path[: len(outer_path)] != outer_path or not name.startswith(prefix):
                continue
            inner_name = name.removeprefix(prefix)
            if inner_path in self.fmus:
                exists |= self.set_start_value(inner_path, inner_name, parameter)
            elif (inner_path, inner_name) in self.graph.kinds:
                exists = True
                for path in self.graph.find_paths((inner_path, inner_name)):
                    self.set_start_value(
                        *path[-1].target, parameter, (inner_path, inner_name), path
                    )
        return exists

    def set_start_value(
        self,
        element_path: ElementPath,
        name: str,
        parameter: ParameterValue,
        connector: ConnectorName | None = None,
        path: tuple[Hop, ...] = (),
    ) -> bool:
        """Set a variable of a component and return whether it exists.

        A value of a `connector` is converted along its `path` to the component.
        """
        variables = self.graph.variables[element_path]
        try:
            elements = variables.elements(name)
        except SimulationError:
            return False
        where = f"{self.path}: component '{'.'.join(element_path)}': parameter '{name}'"
        for element in elements:
            if connector is None:
                value = _convert_to_variable(parameter, variables, element, where)
            else:
                value = self.convert_along_path(parameter, connector, path, where)
            self.start_values.setdefault(element_path, {})[element] = value
        return True

    def convert_along_path(
        self,
        parameter: ParameterValue,
        connector: ConnectorName,
        path: tuple[Hop, ...],
        where: str,
    ) -> Any:
        """Return a value in the unit of a connector, converted along its path to a component."""
        value = parameter.value
        unit = None if parameter.suppressed else parameter.unit
        connector_unit = self.graph.find_unit(connector)
        if unit and connector_unit:
            value = find_conversion(unit, connector_unit, where)(value)
        if parameter.transformation:
            value = parameter.transformation.apply(value, where)
        if isinstance(value, str | bool):  # without unit
            for hop in path:
                if hop.transformation:
                    value = hop.transformation.apply(value, where)
            return value
        for step in self.graph.find_conversions(connector, path, connector_unit or unit):
            value = step(value)
        return value

    def name_signal(self, signal: ConnectorName, component_names: Mapping[ElementPath, str]) -> str:
        """Return the name of a component's connector in the flat system."""
        element_path, connector = signal
        component = component_names[element_path]
        if not connector:
            raise self.build_error(f"a connector of '{component}' has an empty name.")
        return f"{component}.{connector}"


def _is_conversion_suppressed(node: ET.Element, where: str) -> bool:
    """Return whether a connection or mapping converts no units."""
    name = "suppressUnitConversion"
    return read_boolean(node.get(name, "false"), f"{where}: {name}")


def _convert_to_variable(
    parameter: ParameterValue, variables: Variables, element: str, where: str
) -> Any:
    """Return a value in the unit of a variable of a component."""
    value = parameter.value
    if parameter.unit and not parameter.suppressed:
        value = convert_to_unit(variables, element, value, parameter.unit, where)
    if parameter.transformation:
        value = parameter.transformation.apply(value, where)
    return value


def _find_unit(unit_name: str | None, units: Mapping[str, UnitExponents]) -> Unit | None:
    """Return a unit with its exponents, None if those are unknown; None without a name."""
    if not unit_name:
        return None
    return unit_name, units.get(unit_name)


def _compose_prefix(inner_path: ElementPath, outer_path: ElementPath) -> str:
    """Return the names of elements between two, each with a dot, before those of variables."""
    return "".join(f"{name}." for name in inner_path[len(outer_path) :])
