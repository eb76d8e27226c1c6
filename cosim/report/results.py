"""Saved results of a run."""

from collections.abc import Mapping
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
from cosim.study.scores import MEASURED_START, ORACLE, Comparison, Errors
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
        return self.verdict.laws if self.verdict else (self.best,) * len(self.joints)

    def compare_to_reference(self, j: int) -> tuple[str, str, dict[str, float | None]]:
        """Return recommended law and strongest reference of a joint, and ratios of their errors.

        Ratios are those of the first test set by `AREAS`, None where the run has no such errors.
        The first one is that to Coulomb + viscous friction.
        """
        test = self.tests[0]
        comparison = self.comparisons[test]
        recommended = self.recommended[j]
        law_names = recommended, comparison.ratios.find_reference(recommended, j)
        law_scores = [comparison.laws[law_name] for law_name in law_names]
        models = [self.models[law_name] for law_name in law_names]
        has_days = sum("training" in log.roles for log in self.run.logs) > 1
        simulated = self.simulated.get(test)
        plain = comparison.laws.get(PLAIN)
        errors = (
            [law_scores[0].rmse[j : j + 1], plain.rmse[j : j + 1] if plain else ()],
            [scores.rmse[j : j + 1] for scores in law_scores],
            [scores.rmse_rest[j : j + 1] for scores in law_scores],
            [scores.rmse_reversal[j : j + 1] for scores in law_scores],
            [_simulated_errors(simulated, law_name, j) for law_name in law_names],
            [
                model.left_out_rmse[j : j + 1] if has_days and not model.coupling else ()
                for model in models
            ],
        )
        ratios = (o[0] / r[0] if o and r and o[0] and r[0] else None for o, r in errors)
        return *law_names, dict(zip(AREAS, ratios, strict=True))

    @property
    def fmu(self) -> str:
        """Recommended FMU."""
        return self.verdict.fmu if self.verdict else f"fmus/{self.best}.fmu"

    @cached_property
    def best(self) -> str:
        """Law with the lowest error over the size of friction, on the first test set."""
        comparison = self.comparisons[self.tests[0]]
        laws = (
            law_name
            for law_name in comparison.laws
            if law_name != ORACLE and not law_name.endswith(MEASURED_START)
        )
        return min(laws, key=comparison.size)

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
            reason = f"'{RUN}' is missing in it" if folder.is_dir() else "the folder does not exist"
            if (folder / COMMAND_RUN).is_file():
                reason = "its run was from commands, whose report is complete"
            reason = describe_leftover(folder) or reason
            raise ArtifactError(f"{folder}: no results of 'hesr run'; {reason}.")
        run = SavedRun.read(folder / RUN)
        body = RigidBody.read(folder / "rigid_body.json")
        properties_path = folder / "properties.json"
        simulation_path = folder / SIMULATION
        truths_path = folder / TRUTHS
        truths = read_json(truths_path) if truths_path.is_file() else {}
        following_path = folder / FOLLOWING
        following = read_json(following_path) if following_path.is_file() else {}
        scores_path = folder / "evaluation.json"
        loop_path = folder / "closed_loop.json"
        comparisons = _read_by_test(Comparison, scores_path, "the scores of a run")
        if not comparisons:
            raise ArtifactError(f"{scores_path}: not the scores of a run (it has no test set).")
        return cls(
            folder=folder,
            run=run,
            body=body,
            models={
                law_name: FrictionModel.read(folder / "laws" / f"{law_name}.json")
                for law_name in run.inputs
            },
            comparisons=comparisons,
            properties=read_properties(properties_path)
            if properties_path.is_file() and not run.quick
            else {},
            simulated=_read_by_test(PositionErrors, simulation_path, "the simulations of a run")
            if simulation_path.is_file()
            else {},
            truths=from_json(
                dict[str, Errors], truths, truths_path, "the errors on alternative plants"
            ),
            replicates=read_replicates(folder),
            following=from_json(Following, following, following_path, "following errors")
            if following
            else None,
            provenance=body.provenance,
            loop=from_json(LoopOutcome, read_json(loop_path), loop_path, "the closed loop of a run")
            if run.controller
            else None,
            paths=read_traces(folder / PATHS) if run.controller else {},
        )


def _simulated_errors(
    position_errors: PositionErrors | None, law_name: str, j: int
) -> tuple[float | None, ...]:
    """Return the position error [rad; m] of whole logs, or else of the longest windows."""
    if position_errors is None or law_name not in position_errors.windows:
        return ()
    return (position_errors.open_loop.get(law_name) or position_errors.windows[law_name][-1])[
        j : j + 1
    ]


def _read_by_test(kind: Any, path: Path, description: str) -> dict[str, Any]:
    saved_tests = read_json(path).items()
    return {
        name: from_json(kind, saved, path, f"{description} on {name!r}")
        for name, saved in saved_tests
    }
