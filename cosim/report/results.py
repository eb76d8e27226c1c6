"""Saved results of a run."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from cosim.loop.closed_loop import Scheme
from cosim.loop.traces import FOLLOWING, Following, LoopOutcome, Trace, read_traces
from cosim.loop.traces import TRACES as PATHS
from cosim.report.tables.table import joints
from cosim.study.position_errors import SIMULATION, PositionErrors
from cosim.study.replicates import Replicates, read_replicates
from cosim.study.results import COMMAND_RUN, RUN, TRACES, TRUTHS, SavedLog, SavedRun, read_torques
from cosim.study.scores import Comparison, Errors, is_usable
from cosim.study.study import LEFT_OUT
from cosim.study.verdict import Verdict, read_verdict
from fmu_src.pages.datasheet import ModelAudit
from hesr_model.audit.properties import Properties, read_properties
from hesr_model.errors import ArtifactError, SimulationError
from hesr_model.fitting.estimator import laws_of_paper
from hesr_model.friction.model import FrictionModel
from hesr_model.inference.choice import PLAIN
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.support.arrays import Array
from hesr_model.support.result_folder import describe_leftover
from hesr_model.support.typed_files import from_json, read_json
from hesr_model.units import unit_of_joints

AREAS = (
    "over Coulomb + viscous",
    *("prediction", "at rest", "at reversals", "simulation", "between days"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Results:
    """Saved results of a run; mappings are empty if not saved, `audited` are known audits."""

    folder: Path
    run: SavedRun
    body: RigidBody
    models: Mapping[str, FrictionModel]
    comparisons: Mapping[str, Comparison]
    properties: Mapping[str, Properties] = field(default_factory=dict)
    simulated: Mapping[str, PositionErrors] = field(default_factory=dict)
    truths: Mapping[str, Errors] = field(default_factory=dict)
    replicates: Mapping[str, Replicates | None] = field(default_factory=dict)
    loop: LoopOutcome | None = None
    following: Following | None = None
    paths: Mapping[tuple[Scheme, str], Trace] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    audited: Mapping[str, ModelAudit] | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Short names of the joints."""
        return joints(len(self.run.joints))

    @property
    def sliding(self) -> tuple[bool, ...]:
        """Whether each joint slides; empty if all turn."""
        return next((model.sliding for model in self.models.values()), ())

    @property
    def numbered(self) -> list[tuple[int, str, str]]:
        """Number, short name and name of each joint."""
        names = zip(self.joints, self.run.joints, strict=True)
        return [(k, short, name) for k, (short, name) in enumerate(names, start=1)]

    def unit(self, unit: str, j: int | None = None) -> str:
        """Return a unit for all joints, or for one by index."""
        sliding = self.sliding if j is None else self.sliding[j : j + 1]
        return unit_of_joints(unit, sliding)

    @property
    def tests(self) -> list[str]:
        """Names of test sets without bands."""
        bands = {band.name for band in self.run.bands}
        return [name for name in self.comparisons if name not in bands]

    @property
    def has_tests(self) -> bool:
        """Whether the run has test sets; without, laws are judged on left-out rows only."""
        return self.tests != [LEFT_OUT]

    @property
    def laws(self) -> list[str]:
        """Laws without variants."""
        return [law_name for law_name in self.models if law_name not in self.run.variants]

    @cached_property
    def verdict(self) -> Verdict | None:
        """Verdict; None in results of earlier versions."""
        return read_verdict(self.folder)

    @property
    def recommended(self) -> tuple[str, ...]:
        """Laws of the verdict by joint, or else the best one."""
        if self.verdict:
            return self.verdict.laws
        return (self.best,) * len(self.joints)

    def compare_to_reference(self, j: int) -> tuple[str, str, dict[str, float | None]]:
        """Return recommended law and strongest reference of a joint, and ratios of their errors.

        Ratios are those of the first test set by `AREAS`, None where the run has no such errors.
        The first one is that to Coulomb + viscous friction.
        """
        test = self.tests[0]
        comparison = self.comparisons[test]
        law_name = self.recommended[j]
        reference = comparison.ratios.find_reference(law_name, j)
        law_error = comparison.laws[law_name].rmse[j]
        plain_scores = comparison.laws.get(PLAIN)
        plain_error = plain_scores.rmse[j] if plain_scores else None
        law_errors = self._find_errors(test, law_name, j)
        reference_errors = self._find_errors(test, reference, j)
        ratios = [
            _divide_errors(law_error, plain_error),
            *map(_divide_errors, law_errors, reference_errors),
        ]
        return law_name, reference, dict(zip(AREAS, ratios, strict=True))

    def _find_errors(self, test: str, law_name: str, j: int) -> list[float | None]:
        """Return the errors of a law on a joint by `AREAS`, without the first; None if unknown."""
        scores = self.comparisons[test].laws[law_name]
        model = self.models[law_name]
        has_days = sum("training" in log.roles for log in self.run.logs) > 1
        left_out_error = None
        if has_days and not model.coupling:
            left_out_error = _get_known(model.left_out_rmse, j)
        return [
            scores.rmse[j],
            _get_known(scores.rmse_rest, j),  # empty in earlier versions
            scores.rmse_reversal[j],
            _simulated_error(self.simulated.get(test), law_name, j),
            left_out_error,
        ]

    @property
    def fmu(self) -> str:
        """Recommended FMU."""
        if self.verdict:
            return self.verdict.fmu
        return f"fmus/{self.best}.fmu"

    @cached_property
    def best(self) -> str:
        """Law with the lowest error over the size of friction, on the first test set."""
        comparison = self.comparisons[self.tests[0]]
        return min(filter(is_usable, comparison.laws), key=comparison.size)

    @cached_property
    def key_laws(self) -> list[str]:
        """Laws of figures."""
        paper, *other_laws = laws_of_paper()
        return [
            law_name
            for law_name in dict.fromkeys((paper, self.best, *other_laws))
            if law_name in self.models
        ]

    @cached_property
    def audits(self) -> Mapping[str, ModelAudit]:
        """Audits of the laws with a trained range."""
        if self.audited is not None:
            return self.audited
        audits = {}
        for law_name, model in self.models.items():
            with suppress(SimulationError):
                if model.trained:
                    audits[law_name] = ModelAudit.from_model(model, model.trained)
        return audits

    def find_fitted(self, *laws: str) -> list[str]:
        """Return the fitted ones of some laws."""
        return [law_name for law_name in dict.fromkeys(laws) if law_name in self.models]

    def find_log(self, role: str) -> SavedLog | None:
        """Return the first log of a role whose torques are saved."""
        return next((log for log in self.run.logs if role in log.roles and log.trace), None)

    def torques(self, log: SavedLog) -> dict[str, Array]:
        """Return the torques of a log over time; see `write_torques`."""
        return read_torques(self.folder / TRACES / log.trace)

    @classmethod
    def read(cls, folder: Path) -> "Results":
        """Read a folder written by `hesr run`, or raise ArtifactError or LogError."""
        if not (folder / RUN).is_file():
            raise ArtifactError(f"{folder}: no results of 'hesr run'; {_explain_missing(folder)}.")
        run = SavedRun.read(folder / RUN)
        body = RigidBody.read(folder / "rigid_body.json")
        truths_path = folder / TRUTHS
        saved_truths = _read_if_present(truths_path)
        following_path = folder / FOLLOWING
        saved_following = _read_if_present(following_path)
        scores_path = folder / "evaluation.json"
        comparisons = _read_by_test(Comparison, scores_path, "the scores of a run")
        if not comparisons:
            raise ArtifactError(f"{scores_path}: not the scores of a run (it has no test set).")
        models = {
            law_name: FrictionModel.read(folder / "laws" / f"{law_name}.json")
            for law_name in run.inputs
        }
        properties: Mapping[str, Properties] = {}
        properties_path = folder / "properties.json"
        if properties_path.is_file() and not run.quick:
            properties = read_properties(properties_path)
        simulated: Mapping[str, PositionErrors] = {}
        simulation_path = folder / SIMULATION
        if simulation_path.is_file():
            simulated = _read_by_test(PositionErrors, simulation_path, "the simulations of a run")
        truths = from_json(
            dict[str, Errors], saved_truths, truths_path, "the errors on alternative plants"
        )
        replicates = read_replicates(folder)
        following = None
        if saved_following:
            following = from_json(Following, saved_following, following_path, "following errors")
        loop = None
        paths: Mapping[tuple[Scheme, str], Trace] = {}
        if run.controller:
            loop_path = folder / "closed_loop.json"
            loop = from_json(
                LoopOutcome, read_json(loop_path), loop_path, "the closed loop of a run"
            )
            paths = read_traces(folder / PATHS)
        return cls(
            folder=folder,
            run=run,
            body=body,
            models=models,
            comparisons=comparisons,
            properties=properties,
            simulated=simulated,
            truths=truths,
            replicates=replicates,
            following=following,
            provenance=body.provenance,
            loop=loop,
            paths=paths,
        )


def _explain_missing(folder: Path) -> str:
    """Return why a folder has no results."""
    leftover = describe_leftover(folder)
    if leftover:
        return leftover
    if (folder / COMMAND_RUN).is_file():
        return "its run was from commands, whose report is complete"
    if folder.is_dir():
        return f"'{RUN}' is missing in it"
    return "the folder does not exist"


def _read_if_present(path: Path) -> Any:
    """Read a JSON file; an empty object if there is none."""
    return read_json(path) if path.is_file() else {}


def _divide_errors(error: float | None, reference_error: float | None) -> float | None:
    """Return the ratio of two errors; None if one is unknown, diverged or zero."""
    if not error or not reference_error:
        return None
    return error / reference_error


def _get_known(errors: Sequence[float | None], j: int) -> float | None:
    """Return the error of a joint; None if no joint has one."""
    return errors[j] if errors else None


def _simulated_error(position_errors: PositionErrors | None, law_name: str, j: int) -> float | None:
    """Return the position error [rad; m] of whole logs, or else of the longest windows."""
    if position_errors is None or law_name not in position_errors.windows:
        return None
    log_errors = position_errors.open_loop.get(law_name)
    if log_errors:
        return log_errors[j]
    return position_errors.windows[law_name][-1][j]


def _read_by_test(kind: Any, path: Path, description: str) -> dict[str, Any]:
    saved_tests = read_json(path).items()
    return {
        name: from_json(kind, saved, path, f"{description} on {name!r}")
        for name, saved in saved_tests
    }
