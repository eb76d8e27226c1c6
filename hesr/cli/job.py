"""Commands of the whole job: run, laws."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import Interrupted, answer_file, shown_progress
from hesr.cli.old_app import Accept, Folder, Json, Platforms, app

_CACHED = {
    "binaries": "compiled libraries",
    "functions": "functions in C",
    "valid": "checks of FMUs",
}


@app.command()
def run(
    study: Annotated[
        Path | None, typer.Argument(metavar="STUDY.toml", help="Default: the digital twin.")
    ] = None,
    output: Folder = None,
    platform: Platforms = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Stribeck, LuGre and ParFam-H only.")
    ] = False,
    seeds: Annotated[
        int | None,
        typer.Option(
            "--seeds",
            metavar="N",
            help="Of a twin: score the laws over N draws of noise, motions and true friction "
            "instead, in Python, and write FOLDER/seeds.json.",
        ),
    ] = None,
    accept: Accept = None,
    json_file: Json = None,
) -> None:
    """Do the whole job: identify, fit, build FMUs and score them.

    The scores are those of the FMUs on motions that the laws have not seen. A run that was
    interrupted or killed goes on from what it had finished when it is started again.

    Examples: hesr run tests/real/ur10e_study.toml -o results/ur10e; hesr run --quick --seeds 20
    """
    from rich.console import Console

    from cosim.report.tables import loop, properties
    from cosim.report.tables.laws import rigid_body
    from cosim.report.tables.scores import MEASURES, errors, other_truths
    from cosim.report.tables.terminal import show
    from cosim.study.run import run_study, unfinished
    from cosim.study.scores import input_classes
    from cosim.study.study import Study
    from hesr_model.support.files import models_folder
    from hesr_model.support.typed_json import to_json, write_json

    path = study or models_folder() / "studies" / "default.toml"
    folder = output or Path("results") / Study.read(path).name
    if seeds is not None:
        _seeds(path, folder, seeds, quick=quick, json_file=json_file)
        return
    with answer_file(json_file) as wanted:
        with shown_progress() as progress, _going_on(unfinished(folder)):
            outcome = run_study(
                path,
                folder,
                platforms=platform or ["linux64"],
                quick=quick,
                accepted=accept or (),
                progress=progress,
            )
        if wanted:
            write_json(
                wanted,
                {
                    "folder": str(folder),
                    "fmus": {law: str(path) for law, path in outcome.fmus.items()},
                    "left_out": outcome.left_out,
                    "verdict": to_json(outcome.verdict),
                    "evaluation": {name: to_json(c) for name, c in outcome.comparisons.items()},
                    "closed_loop": to_json(outcome.loop) if outcome.loop else None,
                    "cache": {
                        kind: {"reused": reused, "of": asked}
                        for kind, (reused, asked) in outcome.cached.items()
                    },
                },
            )
    sliding = next(iter(outcome.models.values())).sliding
    show(rigid_body(outcome.rigid_body, sliding))
    inputs = input_classes(outcome.models)
    for name, comparison in outcome.comparisons.items():
        show(*(errors(name, comparison, measure, inputs, sliding) for measure in MEASURES))
    if outcome.truths:
        show(other_truths(outcome.comparisons, outcome.truths, outcome.truth))
    if outcome.loop:
        show(*loop.outcome(outcome.loop))
    if outcome.properties:
        show(properties.properties(outcome.properties), properties.legend(sliding))
    show("The figures are those of the FMUs, run through FMPy over the test logs:")
    for fmu in outcome.fmus.values():
        typer.echo(f"  {fmu}")
    for sentence in outcome.verdict.sentences:
        Console().print(sentence, highlight=False, markup=False)
    if reused := [
        f"{found} of {asked} {_CACHED[kind]}"
        for kind, (found, asked) in outcome.cached.items()
        if found and kind in _CACHED
    ]:
        show(f"Made before and taken from the cache: {', '.join(reused)}.")
    typer.echo(f"Everything is in {folder}; look at {folder / 'report.html'}.")


def _seeds(path: Path, folder: Path, seeds: int, *, quick: bool, json_file: Path | None) -> None:
    """Score laws over draws, write what comes out and print its tables."""
    from cosim.report.tables.seeds import over_draws
    from cosim.report.tables.terminal import show
    from cosim.study.seeds import run_seeds
    from hesr_model.friction.registry import laws_with
    from hesr_model.support.typed_json import to_json, write_json

    with answer_file(json_file) as wanted:
        with shown_progress() as progress:
            found = run_seeds(
                path,
                seeds,
                laws=laws_with("quick") if quick else (),
                progress=partial(progress, "running draws"),
            )
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "seeds.json", to_json(found))
        if wanted:
            write_json(wanted, to_json(found))
    show(*over_draws(found))


@contextmanager
def _going_on(kept: Path) -> Iterator[None]:
    """Say on an interrupt what the next run goes on from."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        found = {
            "laws of joints": "laws/*.json",
            "finished rows of the closed loop": "*.json",
            "tested laws": "properties/*.json",
        }
        counts = {what: len(list(kept.glob(pattern))) for what, pattern in found.items()}
        finished = [f"{count} {what}" for what, count in counts.items() if count]
        if not finished:
            raise
        raise Interrupted(
            f"{', '.join(finished)} are kept in {kept}: the same command goes on from there",
            interrupt,
        ) from interrupt
