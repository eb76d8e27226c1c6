"""FMI4j, a library for the JVM, in our own host."""

from pathlib import Path

from interop.case import Alone, Run
from interop.engine import (
    Engine,
    Tools,
    arguments,
    read_signals,
    require_fmi_2,
    require_success,
    write_inputs,
)


def _alone(tools: Tools, case: Alone, folder: Path) -> Run:
    require_fmi_2(case)
    java, jars = tools.java("fmi4j")
    write_inputs(case, folder / "inputs.tsv", "\t")
    files: tuple[str | Path, ...] = (case.fmu.resolve(), "inputs.tsv", "result.tsv")
    command = (java, "-cp", f"{jars}/classes:{jars}/*", "Host", *files, *arguments(case))
    require_success(command, folder)
    return Run(signals=read_signals(folder / "result.tsv", "\t"))


FMI4J = Engine(
    name="FMI4j",
    install="make interop, with Maven and a JDK",
    find=lambda tools: tools.java_version("fmi4j"),
    alone=_alone,
)
