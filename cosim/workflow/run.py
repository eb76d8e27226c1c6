"""Whole studies: from logs to scored FMUs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from cosim.workflow.answer import Answer, Written, find_job, finding_lines, shorten_lines
from cosim.workflow.arguments import list_names, list_paths, require_number
from hesr_model.errors import ArgumentError
from hesr_model.support import plugins
from hesr_model.support.files import PathArg, to_path
from hesr_model.support.progress import Interrupted, Stages, silent
from hesr_model.support.text import join_few

if TYPE_CHECKING:
    from cosim.report.tables.table import ResultTable
    from cosim.study.results import Seeds
    from cosim.study.run import Outcome
    from cosim.workflow.arguments import Names, Paths
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
    """Result of `hesr.run`.

    Attributes
    ----------
    folder : folder of the results.
    outcome : body, laws, FMUs, scores and verdict.
    findings : warnings of the checks, and accepted errors.
    """

    format = "hesr-run-1"
    folder: Path
    outcome: Outcome
    findings: Sequence[Finding] = ()

    def summary(self) -> str:
        """Return the verdict, the number of warnings and the report."""
        from cosim.report.tables import loop

        verdict = self.outcome.verdict
        located_verdict = replace(verdict, fmu=str(self.outcome.fmus[verdict.law]))  # can be copied
        if verdict.simulation:
            fmu = str(self.outcome.fmus[verdict.simulation.law])
            located_verdict = replace(
                located_verdict, simulation=replace(verdict.simulation, fmu=fmu)
            )
        lines = [*located_verdict.sentences, *self._joint_lines()]
        if self.outcome.rigid_body.sentence:
            lines.append(self.outcome.rigid_body.sentence)
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

        built_for = join_few(self.outcome.platforms)
        if self.outcome.study.twin is None:
            return f"for {built_for}"
        return f"for {built_for} (Arm.fmu with MuJoCo: {HOST[0]} only)"

    @property
    def _sliding(self) -> Sequence[bool]:
        return next(iter(self.outcome.models.values())).sliding

    def _recommendation(self) -> Iterator[ResultTable]:
        """Yield the table of the recommended laws."""
        from cosim.report.tables.scores import recommendation
        from hesr_model.audit.properties import combine_results

        outcome = self.outcome
        verdict = outcome.verdict
        if verdict.choice:
            properties = combine_results(verdict.law, outcome.properties, verdict.laws)
            yield recommendation(verdict.choice, properties)

    def _joint_lines(self) -> Iterator[str]:
        """Yield the table of the recommended laws as lines of the terminal."""
        from cosim.report.tables.scores import NOT_JUDGED

        for table in self._recommendation():
            for row in table.rows:
                law, ratio, unexplained, passivity, feed_forward = (cell.text for cell in row.cells)
                judged = "not judged"
                if ratio != NOT_JUDGED:
                    judged = f"{ratio} of Coulomb + viscous, {unexplained} unexplained"
                yield f"  {row.head}: {law}, {judged}, {passivity}; feed-forward: {feed_forward}."

    def tables(self) -> Sequence[ResultTable | str]:
        """Return laws, body, scores, closed loop, physics checks, findings and cache use."""
        from cosim.report.tables.laws import legend, properties, rigid_body

        outcome = self.outcome
        tables: list[ResultTable | str] = [
            *self._recommendation(),
            rigid_body(outcome.rigid_body, self._sliding),
            *self._score_tables(),
            *self._loop_tables(),
        ]
        if outcome.properties:
            tables += [properties(outcome.properties), legend(self._sliding)]
        tables.append("Scores come from running these FMUs in FMPy:")
        tables += [f"  {fmu}" for fmu in outcome.fmus.values()]
        tables += finding_lines(self.findings)
        reused_texts = [
            f"{reused} of {requested} {_CACHED[kind]}"
            for kind, (reused, requested) in outcome.cached.items()
            if reused and kind in _CACHED
        ]
        if reused_texts:
            tables.append(f"Reused from cache: {', '.join(reused_texts)}.")
        return tables

    def _score_tables(self) -> list[ResultTable | str]:
        from cosim.report.tables.replicates import build_tables
        from cosim.report.tables.scores import (
            MEASURES,
            compare_truths,
            cross_validation,
            errors,
            separations,
        )
        from cosim.study.replicates import TRAINING
        from cosim.study.scores import input_classes

        outcome = self.outcome
        inputs = input_classes(outcome.models)
        tables: list[ResultTable | str | None] = []
        for name, comparison in outcome.comparisons.items():
            tables += [
                errors(name, comparison, measure, inputs, self._sliding, outcome.left_out)
                for measure in MEASURES
            ]
            tables += build_tables(outcome.replicates, name, outcome.verdict.laws, self._sliding)
            recommended_laws: Sequence[str] = ()
            if name == outcome.verdict.test:
                recommended_laws = outcome.verdict.laws
            tables.append(separations(name, comparison, recommended_laws))
        tables.append(cross_validation(outcome.models, self._sliding))
        tables += build_tables(outcome.replicates, TRAINING, outcome.verdict.laws, self._sliding)
        if outcome.truths:
            tables.append(compare_truths(outcome.comparisons, outcome.truths, outcome.truth))
        return [table for table in tables if table]

    def _loop_tables(self) -> list[ResultTable | str]:
        from cosim.report.tables import loop

        outcome = self.outcome
        tables: list[ResultTable | str] = []
        if outcome.loop:
            tables += loop.outcome(outcome.loop)
        table = loop.following(outcome.following, self._sliding)
        text = loop.benefit(outcome.following, self._sliding)
        if table or text:
            tables.append(table or text)
        return tables

    def result(self) -> Any:
        """Return FMUs, verdict and scores as JSON data."""
        from hesr_model.support.typed_files import to_json

        outcome = self.outcome
        evaluation = {name: to_json(scores) for name, scores in outcome.comparisons.items()}
        replicates = {name: saved and to_json(saved) for name, saved in outcome.replicates.items()}
        cache = {}
        for kind, (reused, requested) in outcome.cached.items():
            cache[kind] = {"reused": reused, "of": requested}
        return {
            "folder": str(self.folder),
            "fmus": {law_name: str(path) for law_name, path in outcome.fmus.items()},
            "left_out": dict(outcome.left_out),
            "verdict": to_json(outcome.verdict),
            "evaluation": evaluation,
            "replicates": replicates,
            "closed_loop": outcome.loop and to_json(outcome.loop),
            "following": to_json(outcome.following),
            "cache": cache,
        }


@overload
def run(  # type: ignore[overload-overlap]  # a name of the shipped study, not any text
    study: Literal["paper"],
    *,
    output: PathArg | None = None,
    measured: Paths = (),
    progress: Stages = silent,
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
    measured: Paths = (),
    progress: Stages = silent,
) -> RunResult | Seeds | Answer:
    """Run a whole study: identify, fit, build FMUs and score them.

    Scores are those of the FMUs on motions that were not used for fitting. An
    interrupted run continues where it stopped.

    Parameters
    ----------
    study : path, optional
        Study (.toml), or the name of a shipped one: ur10, fretting and cylinder
        are measured, paper has the claims of the paper; by default the digital
        twin.
    output : path, optional
        Folder of the results; by default results/NAME.
    platform : str or sequence of str, optional
        Platforms of the FMUs: linux64, win64, darwin64, aarch64-linux or all;
        by default linux64, win64 and that of this machine, which is
        always included. The arm of a digital twin, with MuJoCo inside, has that
        of this machine only.
    quick : bool
        Stribeck, LuGre and ParFam-H only, in closed loop on one motion, without
        physics checks; figures of the report neither zoom nor are files until
        `report` is run.
    seeds : int, optional
        Twin only: score the laws over N draws of noise, motions and true
        friction instead, without FMUs; writes seeds.json.
    accept : str or sequence of str, optional
        Names of checks whose errors only warn.
    measured : path or sequence of path, optional
        Study of claims only: studies of measured robots (.toml) that judge the
        claims as well.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    RunResult
        Verdict, scores [N.m], FMUs and findings; with `seeds` the spread over
        the draws; for a study of claims, an answer with their table.

    Raises
    ------
    HesrError
        If the study, a log or the data in it do not allow the run.

    Examples
    --------
    On the command line::

        $ hesr run tests/real/ur10e_study.toml -o results/ur10e
        $ hesr run --quick --seeds 20
        $ hesr run ur10
        $ hesr run paper
        $ hesr run paper --measured ur10e/sines.toml

    >>> import hesr
    >>> result = hesr.run("my_arm/study.toml", quick=True)
    >>> result.outcome.fmus["lugre"].name
    'lugre.fmu'
    """
    from cosim.servo.study import lacks_torque
    from cosim.study.results import read_findings
    from cosim.study.run import run_study
    from cosim.study.study import Study
    from fmu_src.export.toolchain import DEFAULT_PLATFORMS

    platforms: Sequence[str] = DEFAULT_PLATFORMS
    if platform is not None:
        platforms = list_names("platform", platform)
    accepted = list_names("accept", accept)
    measured_studies = list_paths("measured", measured)
    require_number("seeds", seeds)
    study_path = _find_study(study)
    job = find_job(study_path, "run")
    if job:
        return job.run(
            study_path,
            output=output and Path(output),
            progress=progress,
            quick=quick,
            seeds=seeds,
            accept=accepted,
            platform=platform is not None,
            measured=measured_studies,
        )
    if measured_studies:
        raise ArgumentError("'measured' is for a study of claims; run each study by itself.")
    results_folder = to_path(output or Path("results") / Study.read(study_path).name, "'output'")
    if lacks_torque(study_path):
        return _run_from_commands(
            study_path,
            results_folder,
            platforms=platforms,
            quick=quick,
            seeds=seeds,
            accepted=accepted,
            progress=progress,
        )
    if seeds is not None:
        return _run_draws(study_path, seeds, results_folder, quick=quick, progress=progress)
    try:
        outcome = run_study(
            study_path,
            results_folder,
            platforms=platforms,
            quick=quick,
            accepted=accepted,
            progress=progress,
        )
    except KeyboardInterrupt as interrupt:
        reusable = _describe_checkpoints(results_folder)
        if not reusable:
            raise
        raise Interrupted(f"{reusable}: repeat the command to continue", interrupt) from interrupt
    return RunResult(folder=results_folder, outcome=outcome, findings=read_findings(results_folder))


def _run_from_commands(
    study: Path,
    folder: Path,
    *,
    platforms: Sequence[str],
    quick: bool,
    seeds: int | None,
    accepted: Sequence[str],
    progress: Stages,
) -> Answer:
    """Run a study whose logs have no torque."""
    from cosim.servo.study import run_from_commands
    from cosim.workflow.command_run import CommandRun, write_command_report

    if seeds is not None:
        raise ArgumentError(
            "'seeds' draws the noise of a digital twin; measured logs have their own."
        )
    outcome = run_from_commands(
        study,
        folder,
        platforms=platforms,
        quick=quick,
        accepted=accepted,
        write_report=partial(write_command_report, shown_folder=folder),
        progress=progress,
    )
    return CommandRun(folder=folder, outcome=outcome)


def _find_study(study: PathArg | None) -> Path:
    """Return the file of a study: a path, the name of a shipped study, or the digital twin."""
    from cosim.study.shipped_studies import DEFAULT, find_shipped_studies

    shipped_studies = find_shipped_studies()
    path = to_path(study or shipped_studies[DEFAULT], "'study'")
    is_name = path == Path(path.name) and not path.is_file()
    if is_name:
        return shipped_studies.get(path.name, path)
    return path


def _run_draws(
    study_path: Path, seeds: int, results_folder: Path, *, quick: bool, progress: Stages
) -> Seeds:
    """Score the laws over draws and write `seeds.json`."""
    from hesr_model.fitting.estimator import select_laws
    from hesr_model.support.typed_files import to_json, write_json

    laws = select_laws("quick") if quick else ()
    run_seeds = plugins.find("hesr.studies", "seeds")
    draws: Seeds = run_seeds(
        study_path, seeds, laws=laws, progress=partial(progress, "running draws")
    )
    results_folder.mkdir(parents=True, exist_ok=True)
    write_json(results_folder / "seeds.json", to_json(draws))
    return draws


def _describe_checkpoints(results_folder: Path) -> str:
    """Return what an interrupted run leaves for the next one; empty if nothing."""
    from cosim.study.steps import checkpoint_folder

    checkpoints = checkpoint_folder(results_folder)
    finished = []
    for kind, pattern in _REUSED.items():
        count = len(list(checkpoints.glob(pattern)))
        if count:
            finished.append(f"{count} {kind}")
    if not finished:
        return ""
    return f"{', '.join(finished)} are kept in {checkpoints}"


def answer(draws: Seeds, _: PathArg | None) -> Answer:
    """Return the answer of a run over draws: its tables."""
    from hesr_model.support.typed_files import to_json

    return Written(
        format="hesr-seeds-1",
        lines=[],
        shown=list(build_draw_tables(draws)),
        shows_tables=True,
        data=to_json(draws),
    )


def build_draw_tables(draws: Seeds) -> Iterator[ResultTable]:
    """Yield errors and ratios of each test set over draws of noise, motions and friction."""
    from cosim.report.tables.table import ResultTable, TableCell, joints, make_row, title

    sample = f"mean of {draws.seeds} draws of noise, motions and true friction [95 % interval]"
    reference = title(draws.reference)
    for test, scores in draws.tests.items():
        for caption, laws in (
            (f"RMSE of the predicted torque [N.m] on '{test}'", scores.rmse),
            (f"RMSE over that of {reference} on '{test}'", scores.ratios),
        ):
            rows = []
            for law_name, spreads in laws.items():
                cells = []
                for spread in spreads:
                    text = f"{spread.mean:.3f} [{spread.low:.3f}, {spread.high:.3f}]"
                    cells.append(TableCell(text=text, value=spread.mean))
                rows.append(make_row(title(law_name), *cells))
            yield ResultTable(
                caption=f"{caption}, {sample}",
                head=("law", *joints(len(draws.joints))),
                rows=rows,
            )
