"""A study: which logs identify, train and test, on which robot, with which laws."""

from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from cosim.loop.closed_loop import Tracking
from hesr_model.fitting.day_offsets import Nuisance
from hesr_model.robots.owner import Owner
from hesr_model.support.config import Config, RelativePath

_NAME = r"^[A-Za-z0-9][A-Za-z0-9_-]*$"
"""Pattern of names that become file names."""


class Twin(Config):
    """Digital twin that makes the logs of a study.

    Attributes
    ----------
    plant : file of the arm.
    signals : file of the arm FMU's signals; without it the arm in Python makes the logs.
    motions : file of the motions; each becomes a log of its name.
    truth : friction of the plant file, instead of that of its MJCF.
    truths : further frictions on which the laws are compared.
    """

    plant: RelativePath
    signals: RelativePath | None = None
    motions: RelativePath
    truth: str | None = None
    truths: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _a_truth_is_run_as_an_fmu(self) -> Self:
        if (self.truth is not None or self.truths) and self.signals is None:
            raise ValueError("other truths need the key 'signals'")
        return self


class Part(Config):
    """Part of a log in time.

    Attributes
    ----------
    log : file, relative to the study.
    start, stop : limits of the part [s], from the beginning of the log.
    """

    log: str
    start: float = Field(default=0.0, ge=0.0)
    stop: float = Field(default=1e9, gt=0.0)


class StudyLogs(Config):
    """Uses of the logs: files relative to the study, or names of the twin's motions.

    Attributes
    ----------
    identification : logs that identify the rigid body.
    reversed : their time-reversed counterparts, in the same order.
    friction : logs that train the laws; by default those of the identification.
    test : test sets by name.
    parts : names of parts of logs, which are used like logs.
    """

    identification: tuple[str, ...] = Field(min_length=1)
    reversed: tuple[str, ...] = ()
    friction: tuple[str, ...] = ()
    test: Mapping[str, tuple[str, ...]] = Field(min_length=1)
    parts: Mapping[Annotated[str, Field(pattern=_NAME)], Part] = {}

    @property
    def training(self) -> tuple[str, ...]:
        """Logs that train the laws."""
        return self.friction or self.identification

    @model_validator(mode="after")
    def _tests_are_unseen(self) -> Self:
        seen = {*self.identification, *self.reversed, *self.training}
        for name, logs in self.test.items():
            if not logs:
                raise ValueError(f"test set '{name}' has no log")
            for log in logs:
                if log in seen:
                    raise ValueError(f"log '{log}' of test set '{name}' is also trained on")
        return self


class Variant(Config):
    """Law with other options, as a further row of the tables.

    Attributes
    ----------
    law : name in the registry.
    options : hyper-parameters of its estimator.
    """

    law: str
    options: Mapping[str, Any] = {}


class TimeBand(Config):
    """Part of a test set in time, scored separately.

    Attributes
    ----------
    test : name of the test set.
    name : name of the part.
    start, stop : limits of the part [s], from the beginning of each log.
    """

    test: str
    name: str
    start: float = Field(default=0.0, ge=0.0)
    stop: float = Field(default=1e9, gt=0.0)


class RefinementStudy(Config):
    """Refinement of the rigid body with fitted friction.

    Attributes
    ----------
    kind : "in_turn" identifies the body again without friction; "output_error" fits both to the
        simulated position.
    law : the friction law.
    rounds : number of repetitions.
    """

    kind: Literal["in_turn", "output_error"] = "in_turn"
    law: str
    rounds: int = Field(default=1, ge=1)


class Study(Config):
    """Input file of `hesr run`.

    Attributes
    ----------
    name : name of the study and of its folder of results.
    robot : robot file.
    seed : seed of every fit.
    laws : names in the registry; by default all everyday laws.
    options : hyper-parameters of estimators, by law.
    variants : further rows by name.
    per_log : quantities that may differ by training log, as the torque offset or the level of
        friction of different days.
    physical : whether the masses of the rigid body must be physically possible.
    refinement : refinement of the rigid body with fitted friction.
    bands : parts of test sets that are scored separately.
    twin : digital twin that makes the logs.
    tracking : closed loop on the twin.
    logs : uses of the logs.
    owner : owner of the models; by default that of the robot file.
    """

    name: str = Field(pattern=_NAME)
    robot: RelativePath
    seed: int = Field(default=0, ge=0)
    laws: tuple[str, ...] = ()
    options: Mapping[str, Mapping[str, Any]] = {}
    variants: Mapping[Annotated[str, Field(pattern=_NAME)], Variant] = {}
    per_log: tuple[Nuisance, ...] = ()
    physical: bool = False
    refinement: RefinementStudy | None = None
    bands: tuple[TimeBand, ...] = ()
    twin: Twin | None = None
    tracking: Tracking | None = None
    logs: StudyLogs
    owner: Owner = Owner()

    @model_validator(mode="after")
    def _keys_fit(self) -> Self:
        for band in self.bands:
            if band.test not in self.logs.test:
                raise ValueError(f"band '{band.name}': test set '{band.test}' is unknown")
        if self.physical and self.refinement:
            raise ValueError("'physical' and 'refinement' exclude each other; remove one")
        rows = {
            "law": [*self.laws, *self.variants],
            "test set or band": [*self.logs.test, *(band.name for band in self.bands)],
        }
        for what, names in rows.items():
            if twice := [name for name, count in Counter(names).items() if count > 1]:
                raise ValueError(f"more than one {what} is named '{twice[0]}'")
        if self.tracking and not (self.twin and self.twin.signals):
            raise ValueError("'tracking' needs the keys 'twin' and 'twin.signals'")
        return self
