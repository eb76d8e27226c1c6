"""Whole studies: from logs to scored FMUs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from cosim.workflow.answer import Answer, Written, find_job, finding_lines, shorten_lines
from cosim.workflow.arguments import list_names
from hesr_model.support import plugins
from hesr_model.support.files import PathArg, models_folder, path_of
from hesr_model.support.progress import Interrupted, Stages, silent
from hesr_model.support.text import few

if TYPE_CHECKING:
    from cosim.report.tables.table import ResultTable
    from cosim.study.results import Seeds
    from cosim.study.run import Outcome
    from cosim.workflow.arguments import Names
    from hesr_model.findings import Finding

_REUSED = {
    "laws of joints": "laws/*.json",
    "finished rows of the closed loop": "*.json",
    "tested laws": "properties/*.json",
}
"""Files of an interrupted run that the next one reuses."""
_CACHED = {"binaries": "compiled libraries", "functions": "C functions", "valid": "checks of FMUs"}


@dataclass(frozen=True, kw_only=True, repr=False)
class RunResult(Answer):
    """Result of `hesr.run`: body, laws, FMUs, scores and verdict in `outcome`."""

    format = "hesr-run-1"
    folder: Path
    outcome: Outcome
    findings: Sequence[Finding] = ()

    def summary(self) -> str:
        """Return the verdict, the number of warnings and the report."""
        from cosim.report.tables import loop

        verdict = self.outcome.verdict
        located = replace(verdict, fmu=str(self.outcome.fmus[verdict.law]))  # can be copied
        if verdict.simulation:
            fmu = str(self.outcome.fmus[verdict.simulation.law])
            located = replace(located, simulation=replace(verdict.simulation, fmu=fmu))
        lines = list(located.sentences)
        if self.outcome.following.rows:
            lines.append(loop.benefit(self.outcome.following, self._sliding))
        count = len(self.findings)
        if count:
            lines.append(f"{count} finding{'s' * (count > 1)} of the checks: --verbose lists them.")
        lines.append(f"FMUs: {self.folder / 'fmus'}, {self._platforms}")
        lines.append(f"Report: {self.folder / 'report.html'}")
        return shorten_lines(lines)

    @property
    def _platforms(self) -> str:
        """Platforms of the FMUs, in words."""
        from fmu_src.export.toolchain import HOST

        built_for = few(self.outcome.platforms)
        if self.outcome.study.twin is None:
            return f"for {built_for}"
        return f"for {built_for} (Arm.fmu with MuJoCo: {HOST[0]} only)"

    @property
    def _sliding(self) -> Sequence[bool]:
        return next(iter(self.outcome.models.values())).sliding

    def tables(self) -> Sequence[ResultTable | str]:
        """Return body, scores, closed loop, physics checks, findings and cache use."""
        from cosim.report.tables import loop
        from cosim.report.tables.laws import legend, properties, rigid_body
        from cosim.report.tables.scores import MEASURES, errors, left_out, other_truths, separations
        from cosim.study.scores import input_classes

        outcome = self.outcome
        sliding = self._sliding
        inputs = input_classes(outcome.models)
        shown: list[ResultTable | str] = [rigid_body(outcome.rigid_body, sliding)]
        for name, comparison in outcome.comparisons.items():
            shown += [errors(name, comparison, measure, inputs, sliding) for measure in MEASURES]
            laws = outcome.verdict.laws if name == outcome.verdict.test else ()
            shown += filter(None, [separations(name, comparison, laws)])
        shown += filter(None, [left_out(outcome.models, sliding)])
        if outcome.truths:
            shown.append(other_truths(outcome.comparisons, outcome.truths, outcome.truth))
        if outcome.loop:
            shown += loop.outcome(outcome.loop)
        follow = outcome.following
        shown += filter(None, [loop.following(follow, sliding) or loop.benefit(follow, sliding)])
        if outcome.properties:
            shown += [properties(outcome.properties), legend(sliding)]
        shown.append("Scores come from running these FMUs in FMPy:")
        shown += [f"  {fmu}" for fmu in outcome.fmus.values()]
        shown += finding_lines(self.findings)
        reused = [
            f"{found} of {asked} {_CACHED[kind]}"
            for kind, (found, asked) in outcome.cached.items()
            if found and kind in _CACHED
        ]
        return [*shown, *([f"Reused from cache: {', '.join(reused)}."] if reused else [])]

    def result(self) -> Any:
        """Return FMUs, verdict and scores as JSON data."""
        from hesr_model.support.typed_files import to_json

        outcome = self.outcome
        return {
            "folder": str(self.folder),
            "fmus": {law: str(path) for law, path in outcome.fmus.items()},
            "left_out": dict(outcome.left_out),
            "verdict": to_json(outcome.verdict),
            "evaluation": {
                name: to_json(comparison) for name, comparison in outcome.comparisons.items()
            },
            "closed_loop": to_json(outcome.loop) if outcome.loop else None,
            "following": to_json(outcome.following),
            "cache": {
                kind: {"reused": reused, "of": asked}
                for kind, (reused, asked) in outcome.cached.items()
            },
        }


@overload
def run(  # type: ignore[overload-overlap]  # a name of the shipped study, not any text
    study: Literal["paper"], *, output: PathArg | None = None, progress: Stages = silent
) -> Answer: ...


@overload
def run(
    study: PathArg | None = None,
    *,
    output: PathArg | None = None,
    platform: Names | None = None,
    quick: bool = False,
    seeds: None = None,
    accept: Names = (),
    progress: Stages = silent,
) -> RunResult: ...


@overload
def run(
    study: PathArg | None = None,
    *,
    output: PathArg | None = None,
    platform: Names | None = None,
    quick: bool = False,
    seeds: int,
    accept: Names = (),
    progress: Stages = silent,
) -> Seeds: ...


def run(
    study: PathArg | None = None,
    *,
    output: PathArg | None = None,
    platform: Names | None = None,
    quick: bool = False,
    seeds: int | None = None,
    accept: Names = (),
    progress: Stages = silent,
) -> RunResult | Seeds | Answer:
    """Run a whole study: identify, fit, build FMUs and score them.

    Scores are those of the FMUs on motions that were not used for fitting. An interrupted run
    continues where it stopped.

    Parameters
    ----------
    study : path, optional
        Study (.toml), or paper, the shipped study of the paper's claims; by default the digital
        twin.
    output : path, optional
        Folder of the results; by default results/NAME.
    platform : str or sequence of str, optional
        Platforms of the FMUs: linux64, win64, darwin64, aarch64-linux or all; repeatable; by
        default linux64, win64 and that of this machine, which is always included. The arm of a
        digital twin, with MuJoCo inside, has that of this machine only.
    quick : bool
        Stribeck, LuGre and ParFam-H only, in closed loop on one motion, without physics checks;
        figures of the report neither zoom nor are files until 'hesr report' is run.
    seeds : int, optional
        Twin only: score the laws over N draws of noise, motions and true friction instead, without
        FMUs; writes seeds.json.
    accept : str or sequence of str, optional
        Names of checks whose errors only warn; repeatable.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    RunResult
        Verdict, scores [N.m], FMUs and findings; with `seeds` the spread over the draws; for a
        study of claims, an answer with their table.

    Raises
    ------
    HesrError
        If the study, a log or the data in it do not allow the run.

    Examples
    --------
    On the command line::

        $ hesr run tests/real/ur10e_study.toml -o results/ur10e
        $ hesr run --quick --seeds 20
        $ hesr run paper

    >>> import hesr
    >>> hesr.run("study.toml", quick=True).outcome.fmus["lugre"].name
    'lugre.fmu'
    """
    from cosim.study.results import read_findings
    from cosim.study.run import run_study, unfinished
    from cosim.study.study import Study
    from fmu_src.export.toolchain import DEFAULT_PLATFORMS
    from hesr_model.fitting.estimator import select_laws
    from hesr_model.support.typed_files import to_json, write_json

    platforms = None if platform is None else list_names("platform", platform)
    accepted = list_names("accept", accept)
    path = path_of(study or models_folder() / "studies" / "default.toml", "'study'")
    shipped = models_folder() / "studies" / f"{path.name}.toml"
    if path == Path(path.name) and not path.is_file() and shipped.is_file():
        path = shipped
    job = find_job(path, "run")
    if job:
        given = {"quick": quick, "seeds": seeds, "accept": accepted}
        given["platform"] = platforms is not None
        return job.run(path, output=output and Path(output), progress=progress, **given)
    folder = path_of(output or Path("results") / Study.read(path).name, "a folder")
    if seeds is not None:
        laws = select_laws("quick") if quick else ()
        run_seeds = plugins.find("hesr.studies", "seeds")
        progress = partial(progress, "running draws")
        spread: Seeds = run_seeds(path, seeds, laws=laws, progress=progress)
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "seeds.json", to_json(spread))
        return spread
    try:
        outcome = run_study(
            path,
            folder,
            platforms=DEFAULT_PLATFORMS if platforms is None else platforms,
            quick=quick,
            accepted=accepted,
            progress=progress,
        )
    except KeyboardInterrupt as interrupt:
        kept = unfinished(folder)
        counts = {what: len(list(kept.glob(pattern))) for what, pattern in _REUSED.items()}
        finished = [f"{count} {what}" for what, count in counts.items() if count]
        if not finished:
            raise
        raise Interrupted(
            f"{', '.join(finished)} are kept in {kept}: repeat the command to continue", interrupt
        ) from interrupt
    return RunResult(folder=folder, outcome=outcome, findings=read_findings(folder))


def answer(spread: Seeds, _: PathArg | None) -> Answer:
    """Return the answer of a run over draws: its tables."""
    from hesr_model.support.typed_files import to_json

    return Written(
        format="hesr-seeds-1",
        lines=[],
        shown=list(over_draws(spread)),
        shows_tables=True,
        data=to_json(spread),
    )


def over_draws(found: Seeds) -> Iterator[ResultTable]:
    """Yield errors and ratios of each test set over draws of noise, motions and friction."""
    from cosim.report.tables.table import ResultTable, TableCell, joints, row_of, title

    draws = f"mean of {found.seeds} draws of noise, motions and true friction [95 % interval]"
    for test, scores in found.tests.items():
        for what, laws in (
            (f"RMSE of the predicted torque [N.m] on '{test}'", scores.rmse),
            (f"RMSE over that of {title(found.reference)} on '{test}'", scores.ratios),
        ):
            rows = []
            for law, spreads in laws.items():
                texts = [f"{s.mean:.3f} [{s.low:.3f}, {s.high:.3f}]" for s in spreads]
                pairs = zip(texts, spreads, strict=True)
                cells = [TableCell(text=text, value=s.mean) for text, s in pairs]
                rows.append(row_of(title(law), *cells))
            yield ResultTable(
                caption=f"{what}, {draws}", head=("law", *joints(len(found.joints))), rows=rows
            )
