"""The command that runs a system of FMUs: simulate."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from hesr.cli.console import shown_progress
from hesr.cli.old_app import System, Table, Trust, app, require_table, trusted

if TYPE_CHECKING:
    from cosim.systems.system import SystemSpec


@app.command()
def simulate(
    system: System,
    output: Table,
    trust: Trust = False,
) -> None:
    """Run a system of FMUs and write the signals that it observes.

    Example: hesr simulate loop.toml -o result.csv
    """
    from cosim.systems.ssp_reader import opened_system

    require_table(output)
    with opened_system(system) as spec:
        trusted((component.fmu for component in spec.components), trust=trust)
        _simulate(spec, system, output)


def _simulate(spec: "SystemSpec", system: Path, output: Path) -> None:
    from cosim.systems.simulation import Master
    from hesr_model.errors import ConfigError, SimulationError
    from hesr_model.support.files import written_whole

    if not spec.observe:
        raise ConfigError(f"{system}: key 'observe' names no signals, so nothing would be written.")
    # Whether the file can be written is found out before the run, not after it.
    with written_whole(output) as temporary:
        with Master(spec, system) as master, shown_progress() as progress:
            result = master.run(partial(progress, spec.name))
        if not len(result.t):
            result.require_success()
        result.write(temporary)
    if result.failure:
        raise SimulationError(
            f"{str(result.failure).rstrip('.')}; the results so far, {len(result.t)} samples to "
            f"t = {result.t[-1]:.9g} s, are kept in {output}."
        )
    typer.echo(f"{len(result.t)} samples of {len(result.signals)} signals, written to {output}.")
