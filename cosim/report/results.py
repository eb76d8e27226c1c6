"""The saved results of a run, read back."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.saved import RUN, TRACES, SavedLog, SavedRun, read_columns
from cosim.scoring import ORACLE, Comparison
from hesr_model.artifacts import read_model, read_rigid_body
from hesr_model.errors import ArtifactError
from hesr_model.friction.evaluate import Array
from hesr_model.friction.laws import registry
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.properties import Properties, read_properties
from hesr_model.rigid_body import RigidBody
from hesr_model.units import unit_of_joints

if TYPE_CHECKING:
    from cosim.studies.traces import Trace
    from cosim.studies.whole_loop import LoopOutcome

PAPERS = "parfam_h"
"""The law of the paper."""
_PAPERS_LAWS = (PAPERS, "lugre", "rbfnn_h", "stribeck", "parfam_v")


@dataclass(frozen=True, kw_only=True, eq=False)
class Results:
    """What a run has saved.

    Attributes
    ----------
    folder : of the results.
    run : what was run.
    body : rigid body.
    models : the laws, by name.
    comparisons : scores on every test set and band, by name.
    properties : findings of the property battery, by law; empty where it was not run.
    loop : closed loop; None where there was none.
    paths : of the closed loop, by (scheme, law); empty where they were not saved.
    provenance : of the rigid body and the laws.
    """

    folder: Path
    run: SavedRun
    body: RigidBody
    models: Mapping[str, FrictionModel]
    comparisons: Mapping[str, Comparison]
    properties: Mapping[str, Properties] = field(default_factory=dict)
    loop: "LoopOutcome | None" = None
    paths: "Mapping[tuple[str, str], Trace]" = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def joints(self) -> tuple[str, ...]:
        """Short names of the joints, as in tables."""
        return tuple(f"J{k}" for k in range(1, len(self.run.joints) + 1))

    @property
    def sliding(self) -> tuple[bool, ...]:
        """Whether each joint slides; empty if all turn."""
        return next((model.sliding for model in self.models.values()), ())

    def unit(self, unit: str, joint: int | None = None) -> str:
        """Return a unit as it is for all joints, or for the one of an index."""
        sliding = self.sliding if joint is None else self.sliding[joint : joint + 1]
        return unit_of_joints(unit, sliding)

    @property
    def tests(self) -> list[str]:
        """Names of the test sets that are whole, not bands."""
        bands = {band.name for band in self.run.bands}
        return [name for name in self.comparisons if name not in bands]

    @property
    def laws(self) -> list[str]:
        """The laws without their variants."""
        return [law for law in self.models if law not in self.run.variants]

    @cached_property
    def best(self) -> str:
        """The law with the least error on the first test set, relative to the reference's."""
        scores = self.comparisons[self.tests[0]].laws
        relative = {
            law: sum(s.rmse / r.rmse for s, r in zip(row, next(iter(scores.values())), strict=True))
            for law, row in scores.items()
            if law != ORACLE
        }
        return min(relative, key=lambda law: relative[law])

    @cached_property
    def key_laws(self) -> list[str]:
        """The laws that pictures show: those of the paper, and the best one."""
        named = dict.fromkeys((PAPERS, self.best, *_PAPERS_LAWS))
        return [law for law in named if law in self.models]

    def log_of(self, role: str) -> SavedLog | None:
        """Return the first log of a role whose torques are saved."""
        logs = (log for log in self.run.logs if role in log.roles and log.trace)
        return next(logs, None)

    def torques(self, log: SavedLog) -> dict[str, Array]:
        """Return the torques of a log over time; see `saved.write_torques`."""
        return read_columns(self.folder / TRACES / log.trace)

    def title(self, law: str) -> str:
        """Return what people call a law or variant."""
        known = registry()
        if law in known:
            return known[law].title
        return law[1:-1] if law.startswith("(") else law

    @classmethod
    def read(cls, folder: Path) -> "Results":
        """Read a folder that `hesr run` has written.

        Raises
        ------
        ArtifactError, LogError
            If it is none, or naming the file that is missing or damaged.
        """
        if not (folder / RUN).is_file():
            what = f"'{RUN}' is missing in it" if folder.is_dir() else "there is no such folder"
            raise ArtifactError(f"{folder}: no results of 'hesr run'; {what}.")
        run = SavedRun.read(folder / RUN)
        body_file, battery = folder / "rigid_body.json", folder / "properties.json"
        return cls(
            folder=folder,
            run=run,
            body=read_rigid_body(body_file),
            models={law: read_model(folder / "laws" / f"{law}.json") for law in run.inputs},
            comparisons=_comparisons(folder / "evaluation.json"),
            properties=read_properties(battery) if battery.is_file() and not run.quick else {},
            provenance=json.loads(body_file.read_text("utf-8")).get("provenance", {}),
            **(_loop(folder) if run.controller else {}),
        )


def _comparisons(path: Path) -> dict[str, Comparison]:
    data = _json(path)
    try:
        found = {name: Comparison.from_json(scores) for name, scores in data.items()}
        if not found:
            raise KeyError("test")
        return found
    except KeyError as error:
        raise ArtifactError(f"{path}: key {error} is missing.") from error
    except (TypeError, AttributeError, ValueError) as error:
        raise ArtifactError(f"{path}: not the scores of a run ({error}).") from error


def _loop(folder: Path) -> dict[str, Any]:
    from cosim.studies.traces import TRACES as PATHS
    from cosim.studies.traces import read_traces
    from cosim.studies.whole_loop import LoopOutcome

    path = folder / "closed_loop.json"
    data = _json(path)
    try:
        loop = LoopOutcome.from_json(data)
    except KeyError as error:
        raise ArtifactError(f"{path}: key {error} is missing.") from error
    except (TypeError, AttributeError, ValueError) as error:
        raise ArtifactError(f"{path}: not the closed loop of a run ({error}).") from error
    return {"loop": loop, "paths": read_traces(folder / PATHS)}


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: no such file.") from error
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ArtifactError(f"{path}: not a readable JSON file ({error}).") from error
