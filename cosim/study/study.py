"""A study: which logs identify, train and test, on which robot, with which laws."""

from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from cosim.loop.closed_loop import Tracking
from hesr_model.fitting.day_offsets import Nuisance
from hesr_model.robots.owner import Owner
from hesr_model.support.config import Config, RelativePath

# Names that become names of files.
_NAME = r"^[A-Za-z0-9][A-Za-z0-9_-]*$"


class Twin(Config):
    """Logs that the digital twin makes, instead of measured ones.

    Attributes
    ----------
    plant : file of the arm.
    signals : file of the signals of the arm's FMU, which then gives the logs; the arm in Python
        gives them where left out.
    motions : file of the motions; each becomes a log of its name.
    truth : one of the plant's, in place of the friction of its MJCF.
    truths : those under which the laws are compared besides.
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
    """A part of a log in time, where there is one log only to train on and to test.

    Attributes
    ----------
    log : file beside the study.
    start, stop : of the part [s], from the beginning of the log.
    """

    log: str
    start: float = Field(default=0.0, ge=0.0)
    stop: float = Field(default=1e9, gt=0.0)


class StudyLogs(Config):
    """Which logs serve for what: files beside the study, or names of the twin's motions.

    Attributes
    ----------
    identification : logs from which the rigid body is identified.
    reversed : their time-reversed counterparts, where there are any, in the same order.
    friction : logs on which the laws are trained; those of the identification if left out.
    test : sets of logs on which the laws are compared, by a name of the set.
    parts : names for parts of logs, which may stand wherever a log does.
    """

    identification: tuple[str, ...] = Field(min_length=1)
    reversed: tuple[str, ...] = ()
    friction: tuple[str, ...] = ()
    test: Mapping[str, tuple[str, ...]] = Field(min_length=1)
    parts: Mapping[Annotated[str, Field(pattern=_NAME)], Part] = {}

    @property
    def training(self) -> tuple[str, ...]:
        """Logs on which the laws are trained."""
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
    """A further row of the tables: a law with other options, for an ablation say.

    Attributes
    ----------
    law : name in the registry.
    options : hyper-parameters of its estimator.
    """

    law: str
    options: Mapping[str, Any] = {}


class Band(Config):
    """A part of a test set in time, for instance one side of a chirp's middle frequency.

    Attributes
    ----------
    test : name of the test set.
    name : of the part.
    start, stop : of the part [s], from the beginning of each log.
    """

    test: str
    name: str
    start: float = Field(default=0.0, ge=0.0)
    stop: float = Field(default=1e9, gt=0.0)


class RefinementStudy(Config):
    """Rigid body and friction in turn, or together.

    Attributes
    ----------
    kind : "in_turn", least squares of the torque; "output_error", the simulated position, too.
    law : whose torque is subtracted before the rigid body is identified again, or which is refined
        together with it.
    rounds : how often.
    """

    kind: Literal["in_turn", "output_error"] = "in_turn"
    law: str
    rounds: int = Field(default=1, ge=1)


class Study(Config):
    """What `hesr run` does.

    Attributes
    ----------
    name : of the study and of its folder of results.
    robot : robot file.
    seed : of every fit.
    laws : names in the registry; all laws if left out.
    options : hyper-parameters of estimators, by law.
    variants : further rows, by their name.
    per_log : what may differ by log where laws are trained, as on logs of several days: the offset
        of the torque, the level of friction.
    physical : whether the rigid body must be one that can exist.
    refinement : whether the rigid body is identified again once friction is known.
    bands : parts of test sets that are scored by themselves.
    twin : where the logs come from the digital twin.
    tracking : closed loop on the twin.
    logs : which logs serve for what.
    owner : whose the models are; that of the robot file where not given.
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
    bands: tuple[Band, ...] = ()
    twin: Twin | None = None
    tracking: Tracking | None = None
    logs: StudyLogs
    owner: Owner = Owner()

    @model_validator(mode="after")
    def _bands_are_of_tests(self) -> Self:
        for band in self.bands:
            if band.test not in self.logs.test:
                raise ValueError(f"band '{band.name}' is of the unknown test set '{band.test}'")
        return self

    @model_validator(mode="after")
    def _one_way_to_a_body(self) -> Self:
        if self.physical and self.refinement:
            raise ValueError("'physical' does not go with 'refinement'; give one of them")
        return self

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        rows = {
            "law": [*self.laws, *self.variants],
            "test set or band": [*self.logs.test, *(band.name for band in self.bands)],
        }
        for what, names in rows.items():
            if twice := [name for name, count in Counter(names).items() if count > 1]:
                raise ValueError(f"the name '{twice[0]}' stands for more than one {what}")
        return self

    @model_validator(mode="after")
    def _a_loop_needs_an_arm(self) -> Self:
        if self.tracking and not (self.twin and self.twin.signals):
            raise ValueError("'tracking' needs the keys 'twin' and 'twin.signals'")
        return self
