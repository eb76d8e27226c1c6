"""A small FMU for building systems."""

from pathlib import Path

from fmu_src.export.description import Description
from fmu_src.export.interface import Interface, Variable
from fmu_src.export.package import Content, Version, write_fmu

LAGS = """
name = "lags"
step = 0.1
stop = 1.0
observe = ["a.y", "b.y"]

[[components]]
name = "a"
fmu = "FMU"
start = { u = 2.0, T = 0.5, x_start = 0.25 }

[[components]]
name = "b"
fmu = "FMU"
step = 0.2

[connections]
"b.u" = "a.y"
"""
"""A system of two instances; FMU is a placeholder for the file."""

SOURCE = Path(__file__).with_name("fmu") / "lag.c"


def lag(folder: Path, fmi: Version = 2) -> Path:
    """Write the FMU of T x' = u - x, y = x; a step past the time `refused` fails."""
    table = Interface(
        variables=(
            Variable(name="u", role="input", description="input", unit="1"),
            Variable(name="y", role="output", description="output", unit="1", dependencies=("x",)),
            Variable(
                name="x",
                role="state",
                description="state",
                unit="1",
                initial_dependencies=("x_start",),
            ),
            Variable(
                name="der(x)",
                role="local",
                description="its derivative",
                unit="1/s",
                derivative_of="x",
                dependencies=("u", "x", "T"),
            ),
            Variable(name="T", role="fixed", description="time constant", unit="s", start=0.5),
            Variable(name="refused", role="fixed", description="time", unit="s", start=1e9),
            Variable(
                name="x_start", role="fixed", description="x at the start", unit="1", start=0.25
            ),
        ),
        own=1,  # STARTED in lag.c
        directional_derivatives=False,
    )
    about = Description(
        name="Lag",
        identifier="lag",
        text="A first-order lag.",
        version="1",
        step=0.01,
        created="2000-01-01T00:00:00Z",
        sources=("all.c",),
    )
    sources = {"lag.c": SOURCE.read_text(encoding="utf-8")}
    whole = Content(table=table, about=about, members={}, sources=sources)
    return write_fmu(whole, folder / "Lag.fmu", fmi=fmi)
