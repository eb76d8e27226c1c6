"""The command that runs a system of FMUs: simulate."""

from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.app import app, shown_progress


@app.command()
def simulate(
    system: Annotated[
        Path, typer.Argument(metavar="SYSTEM.toml", help="FMUs, connections, steps.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="CSV or Parquet file to write.")],
) -> None:
    """Run a system of FMUs and write the signals that it observes.

    Example: hesr simulate loop.toml -o result.csv
    """
    from cosim.master import Master
    from cosim.system import SystemSpec
    from hesr_model.errors import ConfigError, SimulationError
    from hesr_model.files import written_whole

    if output.suffix.lower() not in (".csv", ".parquet", ".pq"):
        raise ConfigError(f"{output}: results are written as .csv or .parquet.")
    spec = SystemSpec.read(system)
    if not spec.observe:
        raise ConfigError(f"{system}: key 'observe' names no signals, so nothing would be written.")
    # Whether the file can be written is found out before the run, not after it.
    with written_whole(output) as temporary:
        with Master(spec, system) as master, shown_progress() as progress:
            result = master.run(lambda done, steps: progress(spec.name, done, steps))
        if not len(result.t):
            result.require_success()
        result.write(temporary)
    if result.failure:
        raise SimulationError(
            f"{str(result.failure).rstrip('.')}; the results so far, {len(result.t)} samples to "
            f"t = {result.t[-1]:.9g} s, are kept in {output}."
        )
    typer.echo(f"{len(result.t)} samples of {len(result.signals)} signals, written to {output}.")
