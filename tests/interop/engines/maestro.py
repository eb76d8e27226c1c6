"""Maestro, the co-simulation engine of INTO-CPS, for the JVM."""

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from interop.case import Run, Together
from interop.engine import Engine, Tools, read_signals, require_success

from fmu_src.run.master import Element

_NANOSECONDS = re.compile(r"Interpretation time: (\d+)")


def _together(tools: Tools, case: Together, folder: Path) -> Run:
    java, jars = tools.java("maestro")
    (folder / "system.json").write_text(json.dumps(_multi_model(case)), encoding="utf-8")
    command = ("import", "-output=out", "-i", "sg1", "system.json")
    said = require_success((java, "-cp", f"{jars}/*", "org.intocps.maestro.Main", *command), folder)
    found = read_signals(folder / "out/outputs.csv")
    time = _NANOSECONDS.search(said)
    return Run(
        signals={name.partition("}.")[2]: values for name, values in found.items()},
        seconds=1e-9 * float(time[1]) if time else None,  # includes loading the FMUs
    )


def _multi_model(case: Together) -> dict[str, Any]:
    """Return a system in Maestro's format."""
    spec, wiring = case.spec, case.wiring()
    connections: dict[str, list[str]] = {}
    for into, out in wiring.sources.items():
        connections.setdefault(_name(out), []).append(_name(into))
    return {
        "fmus": {f"{{{c.name}}}": c.fmu.resolve().as_uri() for c in spec.components},
        "connections": connections,
        "parameters": {
            _name((component, variable)): value
            for component, values in wiring.start.items()
            for variable, value in values.items()
        },
        "logVariables": _logged(signal.partition(".") for signal in case.signals),
        "algorithm": {"type": "fixed-step", "size": spec.step},
        "startTime": 0.0,
        "endTime": spec.stop,
    }


def _name(element: Element) -> str:
    component, variable = element
    return f"{{{component}}}.{component}.{variable}"


def _logged(signals: Iterable[tuple[str, str, str]]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for component, _, variable in signals:
        found.setdefault(f"{{{component}}}.{component}", []).append(variable)
    return found


MAESTRO = Engine(
    name="Maestro",
    install="make interop, with Maven and Java",
    find=lambda tools: tools.java_version("maestro"),
    together=_together,
)
