"""Elements and attributes of SSP that are read, and those that cannot change a result.

Names are local, since the prefix of an element does not change its meaning here.
"""

from collections.abc import Mapping

from fmu_src.run.variables import SI

_TRANSFORMATIONS = (
    "LinearTransformation",
    "BooleanMappingTransformation",
    "IntegerMappingTransformation",
    "EnumerationMappingTransformation",
)
_INTEGERS = tuple(f"{kind}{bits}" for kind in ("Int", "UInt") for bits in (8, 16, 32, 64))
_REALS = ("Real", "Float64", "Float32")
_TEXTS = ("Integer", *_INTEGERS, "Boolean", "String", "Enumeration")
_TYPES = (*_REALS, *_TEXTS, "Binary")

USED: Mapping[str, tuple[str, ...]] = {
    "SystemStructureDescription": ("name", "System", "Units", "DefaultExperiment", "Annotations"),
    "System": (
        "name",
        "Connectors",
        "Elements",
        "Connections",
        "ParameterBindings",
        "Annotations",
    ),
    "Elements": ("System", "Component", "SignalDictionaryReference"),
    "Component": ("name", "source", "Connectors", "ParameterBindings", "Annotations"),
    "Connectors": ("Connector",),
    "Connector": ("name", "kind", *_TYPES, "Dimension"),
    **dict.fromkeys(_REALS, ("unit", "value")),
    **dict.fromkeys(_TEXTS, ("value",)),
    "Units": ("Unit",),
    "Unit": ("name", "BaseUnit"),
    "BaseUnit": SI,
    "Connections": ("Connection",),
    "Connection": (
        "startElement",
        "startConnector",
        "startIndices",
        "endElement",
        "endConnector",
        "endIndices",
        "suppressUnitConversion",
        *_TRANSFORMATIONS,
    ),
    "LinearTransformation": ("factor", "offset"),
    **dict.fromkeys(_TRANSFORMATIONS[1:], ("MapEntry",)),
    "MapEntry": ("source", "target"),
    "ParameterBindings": ("ParameterBinding",),
    "ParameterBinding": ("source", "sourceBase", "prefix", "ParameterValues", "ParameterMapping"),
    "ParameterValues": ("ParameterSet",),
    "ParameterSet": ("Parameters", "Units"),
    "Parameters": ("Parameter",),
    "Parameter": ("name", *_TYPES, "Dimension"),
    "ParameterMapping": ("source", "sourceBase", "MappingEntry", "ParameterMapping"),
    "MappingEntry": ("source", "target", "suppressUnitConversion", *_TRANSFORMATIONS),
    "DefaultExperiment": ("startTime", "stopTime"),
}
"""Attributes and child elements by element; what is listed and not supported is refused."""

_TEXT = "a text for readers"
_DRAWING = "where an editor draws it"
_OTHER_TOOLS = "data of other tools"
_COMMON = {"id": _TEXT, "description": _TEXT, "Annotations": _OTHER_TOOLS}
_FILE = {
    "version": "the parts used here are equal in all versions",
    "name": _TEXT,
    "author": _TEXT,
    "fileversion": _TEXT,
    "copyright": _TEXT,
    "license": _TEXT,
    "generationTool": _TEXT,
    "generationDateAndTime": _TEXT,
    "schemaLocation": "the schemas are known",
    "noNamespaceSchemaLocation": "the schemas are known",
    "Enumerations": "the items are those of the FMUs",
    "MetaData": _OTHER_TOOLS,
    "Signature": _OTHER_TOOLS,
}
# They have no attributes.
_LISTS = (
    "Connectors",
    "Elements",
    "Connections",
    "ParameterBindings",
    "ParameterValues",
    "Units",
    "Parameters",
)
_OWN: Mapping[str, Mapping[str, str]] = {
    "SystemStructureDescription": _FILE,
    "ParameterSet": _FILE,
    "ParameterMapping": {**_FILE, "type": "the content tells it"},
    "System": {
        "ElementGeometry": _DRAWING,
        "SystemGeometry": _DRAWING,
        "GraphicalElements": _DRAWING,
        "SignalDictionaries": "references to them are refused",
    },
    "Component": {
        "type": "the file tells it",
        "implementation": "FMUs are run as co-simulation",
        "ElementGeometry": _DRAWING,
    },
    "Connector": {"ConnectorGeometry": _DRAWING},
    "Connection": {"ConnectionGeometry": _DRAWING},
    "ParameterBinding": {"type": "the content tells it"},
    "Enumeration": {"name": "the items are those of the FMU"},
}
IRRELEVANT: Mapping[str, Mapping[str, str]] = {
    kind: {**_COMMON, **_OWN.get(kind, {})} for kind in USED if kind not in _LISTS
}
"""Reasons by name, by element."""
