"""Systems of FMUs read from an SSP of any tool."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import ceil, isfinite
from pathlib import Path
from posixpath import normpath
from typing import Any, get_args
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from cosim.systems.system import Conversion, SystemSpec
from fmu_src.run.archive import MAX_ENTRY_BYTES, MAX_TEXT_BYTES, Archive
from fmu_src.run.master import Order
from fmu_src.run.variables import Variables, model_description
from hesr.extras.ssp.contents import (
    COUPLING,
    COUPLING_ANNOTATION,
    NAMESPACES,
    SSD,
    read_units,
)
from hesr.extras.ssp.ssp_graph import (
    FALSE,
    TRUE,
    ConnectorGraph,
    ConnectorName,
    ElementPath,
    Hop,
    ParameterValue,
    convert_to_unit,
    find_conversion,
    format_connector,
    read_number,
    read_transformation,
    safe_names,
)
from hesr.extras.ssp.ssp_times import fit_hint, fit_stop, read_step, require_times
from hesr.extras.ssp.vocabulary import IRRELEVANT, USED
from hesr_model.errors import ArgumentError, ConfigError, HesrError, SimulationError
from hesr_model.support.files import scratch_folder
from hesr_model.support.ledger import Ledger
from hesr_model.support.text import join_with_or
from hesr_model.support.xml_files import parse_xml

_PREFIXES = {key.removeprefix("xmlns:"): uri for key, uri in NAMESPACES.items()}
_PREFIXES["ssm"] = _PREFIXES["ssv"].replace("Values", "Mapping")
_COUPLING = f"ssd:Annotations/ssc:Annotation[@type='{COUPLING_ANNOTATION}']/{{{COUPLING}}}Coupling"
# Steps in annotations of the engines, in any namespace because tools differ.
_STEP_ANNOTATIONS = (
    (".//{*}FixedStepAlgorithm", "baseStepSize"),
    (".//{*}FixedStepMaster", "stepSize"),
)

_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+(e[+-]?\d+)?\s*", re.IGNORECASE)
_MAX_FILE_NAME = 100  # characters
_DEFAULT_ROWS = 500  # if neither the SSP nor its FMUs name a step
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
        names = self.archive.names
        plain_name = name.replace("\\", "/")
        candidates = (normpath(candidate) for candidate in (unquote(plain_name), plain_name))
        member = next((candidate for candidate in candidates if candidate in names), None)
        if member is None:
            raise self.build_error(f"{where}{name} is missing.")
        return self.archive.read(member, size_limit)

    def parse_member(self, name: str, where: str = "") -> ET.Element:
        try:
            data = self.read_member(name, where, MAX_TEXT_BYTES)
            root = parse_xml(data, _PREFIXES)
        except (ET.ParseError, LookupError, ValueError) as error:  # or an unknown encoding
            raise self.build_error(f"{where}{name} is not valid XML ({error}).") from error
        ledger = Ledger(f"{self.path}: {name}", "part")
        ledger.compare_elements(root, USED, IRRELEVANT)
        ledger.require_nothing_meant()
        return root

    def read_attribute(self, node: ET.Element, name: str, where: str) -> str:
        value = node.get(name)
        if value is None:
            raise self.build_error(f"{where}: attribute '{name}' is missing.")
        return value

    def build_refusal(self, subject: str) -> UnsupportedError:
        return UnsupportedError(f"{self.path}: {subject} not supported.")

    def read_system(
        self, times: Mapping[str, float | None], start_values: Mapping[str, Any]
    ) -> dict[str, Any]:
        root = self.parse_member(SSD)
        system = _find_element(root, "ssd:System")
        if system is None:
            raise self.build_error(f"{SSD} contains no system.")
        where = f"{self.path}: {SSD}"
        self.read_elements(
            system, (), read_units(_find_elements(root, "ssd:Units/ssc:Unit"), where)
        )
        self.apply_parameters(system, ())
        if not self.fmus:
            raise self.build_refusal(f"{SSD} contains no FMU; a system without any is")
        self.parameters.require_nothing_meant()
        for name, value in start_values.items():
            if not self.assign((), name, ParameterValue(value=value)):
                raise ArgumentError(
                    f"{self.path}: 'set': '{name}' is not a variable of the system."
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
            target, source = (
                self.name_signal(component_names[element_path], connector)
                for element_path, connector in (input_end, output_end)
            )
            connections[target] = source
            conversions[target] = conversion_steps
        observed = [
            self.name_signal(component_names[element_path], connector)
            for element_path, connector in self.list_outputs()
        ]
        system_outputs = {}
        for output, output_source, conversion_steps in self.find_system_outputs():
            element_path, connector = output_source
            signal = self.name_signal(component_names[element_path], connector)
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
            "components": [
                {
                    "name": component_names[element_path],
                    "fmu": fmu,
                    "start": self.start_values.get(element_path, {}),
                }
                | ({"step": steps[element_path]} if element_path in steps else {})
                for element_path, fmu in self.fmus.items()
            ],
            "connections": connections,
            "conversions": conversions,
            "open_inputs": True,
            "observe": list(dict.fromkeys(observed)),
            "outputs": system_outputs,
        }

    def choose_times(self, root: ET.Element, times: Mapping[str, float | None]) -> dict[str, Any]:
        experiment = _find_element(root, "ssd:DefaultExperiment")
        experiment_node = ET.Element("none") if experiment is None else experiment
        start_time = times.get("start")
        stop_time = times.get("stop")
        start_time = (
            read_number(experiment_node, "startTime", 0.0, SSD)
            if start_time is None
            else start_time
        )
        if stop_time is None and experiment_node.get("stopTime") is None:
            raise ArgumentError(
                f"{self.path}: the default experiment has no stopTime; give 'stop'."
            )
        stop_time = (
            read_number(experiment_node, "stopTime", 0.0, SSD) if stop_time is None else stop_time
        )
        require_times(start_time, stop_time, str(self.path))
        step_size = times.get("step")
        if step_size is not None:
            read_step(f"{step_size:g}", f"{self.path}: 'step'")
            return {"begin": start_time, "stop": stop_time, "step": step_size}
        for tag, key in _STEP_ANNOTATIONS:
            node = root.find(tag)
            if node is not None and (text := node.get(key)):
                step_size = read_step(text, f"{self.path}: {SSD}: {key}")
                stop_time = fit_stop(start_time, stop_time, step_size, str(self.path))
                return {"begin": start_time, "stop": stop_time, "step": step_size}
        steps = [
            float(model_description_.defaultExperiment.stepSize)
            for fmu in self.fmus.values()
            if (model_description_ := model_description(fmu)).defaultExperiment
            and model_description_.defaultExperiment.stepSize
        ]
        row_count = ceil((stop_time - start_time) / min(steps) - 1e-6) if steps else _DEFAULT_ROWS
        return {
            "begin": start_time,
            "stop": stop_time,
            "step": (stop_time - start_time) / max(row_count, 1),
        }

    def read_order(self, system: ET.Element) -> dict[str, str]:
        """Return the order of the coupling in our annotation; SSPs of other tools have none."""
        coupling = _find_element(system, _COUPLING)
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
        for node in _find_elements(system, "ssd:Elements/*"):
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
        for node in _find_elements(system, "ssd:Connections/ssd:Connection"):
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
        for connector in _find_elements(node, "ssd:Connectors/ssd:Connector"):
            name = self.read_attribute(connector, "name", f"a connector of '{node.get('name')}'")
            kind = next(
                (child for child in connector if child.tag.startswith(f"{{{_PREFIXES['ssc']}}}")),
                None,
            )
            if any(
                connector.find(f"{prefix}:Dimension", _PREFIXES) is not None
                for prefix in ("ssc", "ssd")
            ):
                raise self.build_refusal(
                    f"connector '{format_connector((element_path, name))}' is an array, which is"
                )
            unit = None if kind is None else kind.get("unit")
            self.graph.kinds[element_path, name] = connector.get("kind", "")
            self.graph.units[element_path, name] = (unit, units.get(unit)) if unit else None

    def read_connection(self, node: ET.Element, system_path: ElementPath) -> None:
        ends: list[ConnectorName] = []
        for end in ("start", "end"):
            # OMSimulator writes an empty name for the system.
            element = node.get(f"{end}Element") or None
            element_path = system_path if element is None else (*system_path, element)
            name = self.read_attribute(node, f"{end}Connector", "a connection")
            if element_path not in self.element_paths:
                raise self.build_error(
                    f"connection of '{format_connector((element_path, name))}': '{element}' is "
                    "not a component of the system."
                )
            if element_path not in self.fmus and (element_path, name) not in self.graph.kinds:
                raise self.build_error(
                    f"connection of '{format_connector((element_path, name))}': the system has "
                    "no such connector."
                )
            if node.get(f"{end}Indices"):
                raise self.build_refusal(
                    f"connection of '{format_connector((element_path, name))}': an index is"
                )
            ends.append((element_path, name))
        is_source = [
            self.graph.kinds.get(end)
            in (_SYSTEM_SOURCE_KINDS if end[0] == system_path else _SOURCE_KINDS)
            for end in ends
        ]
        # The order of start and end does not state a direction.
        source, target = ends[::-1] if is_source[1] and not is_source[0] else ends
        where = f"connection '{format_connector(target)}' = '{format_connector(source)}'"
        hop = Hop(
            target=target,
            suppressed=node.get("suppressUnitConversion") in TRUE,
            transformation=read_transformation(node, where),
        )
        self.graph.add(source, hop)

    def find_sources(self) -> Iterator[tuple[ConnectorName, ConnectorName, tuple[Conversion, ...]]]:
        """Yield input, output and conversions of connected components."""
        for source in list(self.graph.hops):
            for path in self.graph.find_paths(source) if source[0] in self.fmus else ():
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
        return shown_outputs or [
            (element_path, name)
            for element_path, variables in self.graph.variables.items()
            for name in variables.feedthrough
        ]

    def apply_parameters(self, node: ET.Element, element_path: ElementPath) -> None:
        """Apply the parameter bindings of an element, which replace those of inner ones."""
        kind = "component" if element_path in self.fmus else "system"
        where = f"{kind} '{'.'.join(element_path) or node.get('name')}'"
        for binding in _find_elements(node, "ssd:ParameterBindings/ssd:ParameterBinding"):
            if binding.get("sourceBase") == "component":
                raise self.build_refusal(f"{where}: a parameter source inside an FMU is")
            source = binding.get("source")
            parameter_sets = (
                _find_elements(binding, "ssd:ParameterValues/ssv:ParameterSet")
                if source is None
                else [self.parse_member(source, f"{where}: ")]
            )
            values = self.read_values(parameter_sets, binding.get("prefix", ""), where)
            mapping = self.read_mapping(binding, where)
            if mapping is not None:
                names = [name for name, _ in values]
                self.parameters.compare(f"the values of {where}", mapping, names)
                self.parameters.compare(f"the mapping of {where}", names, mapping)
                values = [
                    (target, replace(value, **conversion_options))
                    for name, value in values
                    for target, conversion_options in mapping.get(name, ())
                ]
            self.assign_all(element_path, values, where)

    def read_values(
        self, parameter_sets: list[ET.Element], prefix: str, where: str
    ) -> list[tuple[str, ParameterValue]]:
        """Return names with a prefix, and values, in the order of the file."""
        values = []
        for parameter_set in parameter_sets:
            units = read_units(
                _find_elements(parameter_set, "ssv:Units/ssc:Unit"), f"{self.path}: {where}"
            )
            for parameter in _find_elements(parameter_set, "ssv:Parameters/ssv:Parameter"):
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
            known = [*assigned, *self.list_parameters(element_path)]
            homes = {
                ".".join(inner_path): variables.names
                for inner_path, variables in self.graph.variables.items()
                if inner_path != element_path
            }
            self.parameters.compare(where, names, known, homes)

    def list_parameters(self, outer_path: ElementPath) -> Iterator[str]:
        """Yield the hierarchical names of what can be set below an element."""
        for inner_path in self.element_paths:
            if inner_path[: len(outer_path)] != outer_path:
                continue
            prefix = "".join(f"{name}." for name in inner_path[len(outer_path) :])
            variables = self.graph.variables.get(inner_path)
            names = (
                [name for node, name in self.graph.kinds if node == inner_path]
                if variables is None
                else variables.names
            )
            yield from (f"{prefix}{name}" for name in names)

    def read_mapping(
        self, binding: ET.Element, where: str
    ) -> dict[str, list[tuple[str, dict[str, Any]]]] | None:
        node = _find_element(binding, "ssd:ParameterMapping")
        if node is None:
            return None
        if node.get("sourceBase") == "component":
            raise self.build_refusal(f"{where}: a parameter mapping inside an FMU is")
        source = node.get("source")
        targets_by_name: dict[str, list[tuple[str, dict[str, Any]]]] = {}
        root = node if source is None else self.parse_member(source, f"{where}: ")
        for entry in root.iter(f"{{{_PREFIXES['ssm']}}}MappingEntry"):
            name, target = (
                self.read_attribute(entry, key, f"{where}: a mapping")
                for key in ("source", "target")
            )
            conversion_options = {
                "transformation": read_transformation(entry, f"{where}: mapping of '{name}'"),
                "suppressed": entry.get("suppressUnitConversion") in TRUE,
            }
            targets_by_name.setdefault(name, []).append((target, conversion_options))
        return targets_by_name

    def read_value(
        self, parameter: ET.Element, units: Mapping[str, Any], where: str
    ) -> ParameterValue:
        for node in parameter:
            kind = node.tag.rpartition("}")[2]
            if kind in ("Dimension", "Binary") or (text := node.get("value")) is None:
                raise self.build_refusal(f"{where} is an array or of type {kind}, which is")
            if kind in ("String", "Enumeration"):
                return ParameterValue(value=text)
            if kind == "Boolean":
                if text.lower() not in (*TRUE, *FALSE):
                    raise self.build_error(f"{where} is '{text}'; write true or false.")
                return ParameterValue(value=text.lower() in TRUE)
            try:
                number = int(text) if "Int" in kind else float(text)
            except ValueError as error:
                hint = "; write a decimal point" if _DECIMAL_COMMA.fullmatch(text) else ""
                raise self.build_error(
                    f"{where} is '{text}', which is not of type {kind}{hint}."
                ) from error
            if not isfinite(number):
                raise self.build_error(f"{where} is '{text}'; it must be a finite number.")
            unit_name = node.get("unit")
            return ParameterValue(
                value=number, unit=(unit_name, units.get(unit_name)) if unit_name else None
            )
        raise self.build_error(f"{where} has no value.")

    def assign(self, outer_path: ElementPath, name: str, parameter: ParameterValue) -> bool:
        """Set a parameter below an element by its hierarchical name; return whether it exists."""
        exists = False
        for inner_path in self.element_paths:
            prefix = "".join(f"{name_part}." for name_part in inner_path[len(outer_path) :])
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
        variables = self.graph.variables[element_path]
        try:
            elements = variables.elements(name)
        except SimulationError:
            return False
        where = f"{self.path}: component '{'.'.join(element_path)}': parameter '{name}'"
        for element in elements:
            value = parameter.value
            unit = None if parameter.suppressed else parameter.unit
            target_unit = connector and self.graph.find_unit(connector)
            if unit and not connector:
                value = convert_to_unit(variables, element, value, unit, where)
            elif unit and target_unit:
                value = find_conversion(unit, target_unit, where)(value)
            if parameter.transformation:
                value = parameter.transformation.apply(value, where)
            if isinstance(value, str | bool):
                for transformation in (hop.transformation for hop in path if hop.transformation):
                    value = transformation.apply(value, where)
            elif connector:
                for step in self.graph.find_conversions(connector, path, target_unit or unit):
                    value = step(value)
            self.start_values.setdefault(element_path, {})[element] = value
        return True

    def name_signal(self, component: str, connector: str) -> str:
        if not connector or re.search(r"\s", connector):
            raise self.build_refusal(
                f"connector '{connector}' of '{component}': names with spaces are"
            )
        return f"{component}.{connector}"


def _find_element(node: ET.Element, path: str) -> ET.Element | None:
    return node.find(path, _PREFIXES)


def _find_elements(node: ET.Element, path: str) -> list[ET.Element]:
    return node.findall(path, _PREFIXES)
