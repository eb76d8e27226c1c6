"""Functions of FMI 2.0 and 3.0, and those required by capability flags of FMI 2.0."""

import re
from itertools import chain
from pathlib import Path

import fmpy


def _declared(version: int) -> list[list[str]]:
    header = Path(fmpy.__file__).parent / "c-code" / f"fmi{version}Functions.h"
    sections = re.split(r"^(?:Common )?Functions", header.read_text("utf-8"), flags=re.MULTILINE)
    found = [re.findall(rf"FMI{version}_Export\s+\w+\s+(\w+);", section) for section in sections]
    return [names for names in found if names]


_COMMON, _EXCHANGE, _SIMULATION = _declared(2)

REQUIRED = {"ModelExchange": _COMMON + _EXCHANGE, "CoSimulation": _COMMON + _SIMULATION}
REQUIRED_3 = list(chain(*_declared(3)))
"""The standard requires all of them, even for unsupported features."""

KNOWN = frozenset((*_COMMON, *_EXCHANGE, *_SIMULATION, *REQUIRED_3))

PROMISED = {
    "canGetAndSetFMUstate": ("fmi2GetFMUstate", "fmi2SetFMUstate", "fmi2FreeFMUstate"),
    "canSerializeFMUstate": (
        "fmi2SerializedFMUstateSize",
        "fmi2SerializeFMUstate",
        "fmi2DeSerializeFMUstate",
    ),
    "providesDirectionalDerivative": ("fmi2GetDirectionalDerivative",),
    "canInterpolateInputs": ("fmi2SetRealInputDerivatives",),
    "canRunAsynchronuously": ("fmi2CancelStep", "fmi2GetStatus"),
}
"""Functions that hosts call because of a flag."""
