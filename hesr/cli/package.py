"""The command that makes one file of a system of FMUs: package."""

from typing import Annotated

import typer

from hesr.cli.console import working
from hesr.cli.old_app import Output, System, app


@app.command()
def package(
    system: System,
    output: Output,
    ssp: Annotated[
        str | None, typer.Option("--ssp", metavar="VERSION", help="1.0 (default) or 2.0.")
    ] = None,
    container: Annotated[
        bool, typer.Option("--container", help="Write one FMU that holds the whole system.")
    ] = False,
) -> None:
    """Write a system of FMUs as one file: an SSP, or one FMU. No foreign code is run.

    Examples: hesr package loop.toml -o loop.ssp; hesr package loop.toml --container -o Loop.fmu
    """
    from cosim.systems.contents import read_contents
    from cosim.systems.ssp_reader import opened_system
    from hesr_model.errors import ConfigError

    if container and ssp is not None:
        raise ConfigError("--ssp is the version of a file in .ssp; --container makes an FMU.")
    if ssp not in (None, "1.0", "2.0"):
        raise ConfigError(f"--ssp is '{ssp}'; needed is 1.0 or 2.0.")
    with working(f"packing {system.name}"), opened_system(system) as spec:
        contents = read_contents(spec, system)
        note = None
        if container:
            from cosim.systems.container import write_container

            write_container(contents, output)
        else:
            from cosim.systems.ssp import left_out, write_ssp

            note = left_out(contents)
            write_ssp(contents, output, version="2.0" if ssp == "2.0" else "1.0")
    typer.echo(f"{len(spec.components)} FMUs, written to {output}.")
    if note:
        typer.echo(note)
