"""A study: robot, laws, and the logs for identification, training and test."""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from cosim.loop.closed_loop import Tracking
from hesr_model.errors import RuleError
from hesr_model.fitting.days import Nuisance
from hesr_model.inference.folds import FOLD_COUNT, MIN_FOLDS
from hesr_model.rigid_body.choice import BodyOption
from hesr_model.support.owner import Owner
from hesr_model.support.typed_files import Config, RelativePath

LEFT_OUT = "left-out rows"
"""Name of the rows of the training logs, each predicted by laws fitted without it."""

_NAME = r"^[A-Za-z0-9][A-Za-z0-9_-]*$"  # names that become file names


class Twin(Config):
    """Digital twin that makes the logs of a study."""

    plant: RelativePath
    signals: RelativePath | None = None  # arm FMU
    motions: RelativePath  # file of motions, one log each
    truth: str | None = None  # alternative plant instead of the MJCF
    truths: tuple[str, ...] = ()  # alternative plants to compare laws on

    @model_validator(mode="after")
    def _a_truth_is_run_as_an_fmu(self) -> Self:
        if (self.truth is not None or self.truths) and self.signals is None:
            raise RuleError(
                "alternative plants need the key 'signals'",
                code="study.truth_signals",
                key="signals",
            )
        return self


class Part(Config):
    """Part of a log in time."""

    log: str  # relative to the study
    start: float = Field(default=0.0, ge=0.0)  # [s] from the beginning of the log
    stop: float = Field(default=1e9, gt=0.0)  # [s]


class StudyLogs(Config):
    """Uses of the logs: files in the study's folder, or motions of the twin."""

    identification: tuple[str, ...] = Field(min_length=1)
    reversed: tuple[str, ...] = ()  # time-reversed counterparts, same order
    friction: tuple[str, ...] = ()  # training logs; `identification` by default
    test: Mapping[str, tuple[str, ...]] = {}  # without, laws are judged on left-out rows only
    parts: Mapping[Annotated[str, Field(pattern=_NAME)], Part] = {}

    @property
    def training(self) -> tuple[str, ...]:
        """Logs that train the laws."""
        return self.friction or self.identification

    @property
    def judged(self) -> Mapping[str, tuple[str, ...]]:
        """Test sets, or else the left-out rows of the training logs."""
        return self.test or {LEFT_OUT: self.training}

    @model_validator(mode="after")
    def _tests_are_unseen(self) -> Self:
        trained_logs = {*self.identification, *self.reversed, *self.training}
        for name, logs in self.test.items():
            if not logs:
                raise RuleError(
                    f"test set '{name}' has no log", code="study.test_empty", key=f"test.{name}"
                )
            for log in logs:
                if log in trained_logs:
                    raise RuleError(
                        f"log '{log}' of test set '{name}' is also trained on",
                        code="study.test_trained",
                        key=f"test.{name}",
                    )
        return self


class Variant(Config):
    """Law with other options, as a further row of the tables."""

    law: str
    options: Mapping[str, Any] = {}


class TimeBand(Config):
    """Part of a test set in time, scored separately."""

    test: str
    name: str
    start: float = Field(default=0.0, ge=0.0)  # [s] from the beginning of each log
    stop: float = Field(default=1e9, gt=0.0)  # [s]


class RefinementStudy(Config):
    """Refinement of the body: again with fitted friction, or both to the simulated position."""

    kind: Literal["in_turn", "output_error"] = "in_turn"
    law: str = ""  # by default output error refines all laws, and the body of a single joint
    rounds: int = Field(default=1, ge=1)

    @model_validator(mode="before")
    @classmethod
    def _a_name_is_a_kind(cls, data: Any) -> Any:
        return {"kind": data, "rounds": 3} if isinstance(data, str) else data

    @model_validator(mode="after")
    def _a_law_refines_in_turn(self) -> Self:
        if self.kind == "in_turn" and not self.law:
            raise RuleError(
                "'law' is missing; only \"output_error\" refines every law",
                code="study.refinement_law",
                key="law",
            )
        return self


class Study(Config):
    """Input file of `hesr run`."""

    name: str = Field(pattern=_NAME)  # also of its folder of results
    robot: RelativePath
    seed: int = Field(default=0, ge=0)
    laws: tuple[str, ...] = ()  # all everyday laws by default
    options: Mapping[str, Mapping[str, Any]] = {}  # estimator options by law
    variants: Mapping[Annotated[str, Field(pattern=_NAME)], Variant] = {}  # further rows by name
    per_log: tuple[Nuisance, ...] = ()  # quantities that differ by training log
    body: BodyOption = "choose"  # kind of the rigid body
    physical: bool = False  # the same as `body` "physical"
    refinement: RefinementStudy | None = None
    bands: tuple[TimeBand, ...] = ()
    folds: int = Field(default=FOLD_COUNT, ge=MIN_FOLDS, le=20)  # by which laws are chosen
    twin: Twin | None = None
    tracking: Tracking | None = None
    logs: StudyLogs
    owner: Owner = Owner()  # robot file by default

    @property
    def body_option(self) -> BodyOption:
        """The kind of the rigid body, or "choose"."""
        return "physical" if self.physical else self.body

    @property
    def truth(self) -> str:
        """Alternative plant of the twin that makes the logs; empty for its MJCF."""
        if self.twin is None or self.twin.truth is None:
            return ""
        return self.twin.truth

    @model_validator(mode="after")
    def _keys_fit(self) -> Self:
        for band in self.bands:
            if band.test not in self.logs.judged:
                raise RuleError(
                    f"band '{band.name}': test set '{band.test}' is unknown",
                    code="study.band_test",
                    key="bands",
                )
        if self.physical and self.body in ("nominal", "free"):
            raise RuleError(
                f"'physical' and 'body' \"{self.body}\" exclude each other; remove one",
                code="study.body",
                key="body",
            )
        _require_unique([*self.laws, *self.variants], "law", "laws")
        bands = [band.name for band in self.bands]
        _require_unique([*self.logs.judged, *bands], "test set or band", "logs.test")
        if self.tracking and not (self.twin and self.twin.signals):
            raise RuleError(
                "'tracking' needs the keys 'twin' and 'twin.signals'",
                code="study.tracking_twin",
                key="tracking",
            )
        return self


def _require_unique(names: Iterable[str], kind: str, key: str) -> None:
    """Require that no two rows of a table have one name."""
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise RuleError(
            f"more than one {kind} is named '{repeated[0]}'", code="study.names", key=key
        )
