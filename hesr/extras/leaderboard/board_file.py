"""Leaderboard file, and scores: a bootstrap draws all joints together, as errors correlate."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from cosim.workflow.arguments import require_healthy
from hesr_model.errors import ConfigError
from hesr_model.friction.records import rmse
from hesr_model.logs.robot_log import Log, parts_of
from hesr_model.logs.signals import moving, near_reversals
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import FrictionRecord, friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array, Mask
from hesr_model.support.files import sha256
from hesr_model.support.typed_files import Config, PrintableName, RelativePath

Kind = Literal["all", "moving", "reversals", "rests"]
ScoreName = Literal["all", "moving", "reversals", "rests", "properties", "time"]
Connector = Literal["dq", "q", "tau_load"]
Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]

KINDS: tuple[Kind, ...] = ("all", "moving", "reversals", "rests")
"""Kinds of rows with a separate score."""

CLASSES: Mapping[str, tuple[Connector, ...]] = {
    "v": ("dq",),
    "v, q": ("dq", "q"),
    "v, load": ("dq", "tau_load"),
    "v, q, load": ("dq", "q", "tau_load"),
}
"""Default classes of inputs."""


class BoardRobot(Config):
    """A robot with its rigid body."""

    name: PrintableName = Field(min_length=1)
    file: RelativePath
    rigid_body: RelativePath
    rigid_body_sha256: Hash


class BoardLog(Config):
    """A log; `robot` is optional with a single robot."""

    file: RelativePath
    sha256: Hash
    robot: str = ""
    source: PrintableName = Field(min_length=1)
    licence: PrintableName = Field(min_length=1)


class BoardFile(Config):
    """Content of a leaderboard file."""

    name: PrintableName = Field(min_length=1)
    robots: tuple[BoardRobot, ...] = Field(min_length=1)
    logs: tuple[BoardLog, ...] = Field(min_length=1)
    warm_up: float = Field(default=2.0, ge=0.0)  # [s] not scored: the initial state is unknown
    block: float = Field(default=8.0, gt=0.0)  # [s] of the bootstrap
    classes: Mapping[PrintableName, tuple[Connector, ...]] = Field(default=CLASSES, min_length=1)
    scores: tuple[ScoreName, ...] = (*KINDS, "properties", "time")
    accept: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        names = [robot.name for robot in self.robots]
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise ValueError(f"two robots have the name '{twice[0]}'")
        of_robots = {log.robot or (names[0] if len(names) == 1 else "") for log in self.logs}
        unknown = sorted(of_robots - set(names))
        if unknown:
            raise ValueError(f"a log is of the robot '{unknown[0]}'; known are {', '.join(names)}")
        idle = [name for name in names if name not in of_robots]
        if idle:
            raise ValueError(f"robot '{idle[0]}' has no log")
        if "all" not in self.scores:
            raise ValueError("'scores' must contain 'all', which ranks the entries")
        return self


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Data of one robot; records are [part][joint]."""

    model: Robot
    body: RigidBody
    records: Sequence[Sequence[FrictionRecord]] = field(repr=False)


def read_grounds(rules: BoardFile) -> dict[str, Ground]:
    """Read robots, bodies and logs; raises ConfigError for a missing or changed file."""
    grounds = {}
    for robot in rules.robots:
        _require_same(robot.rigid_body, robot.rigid_body_sha256, "")
        model = Robot(RobotDescription.read(robot.file))
        body = RigidBody.read(robot.rigid_body)
        logs = []
        for log in rules.logs:
            if log.robot in ("", robot.name):
                _require_same(log.file, log.sha256, f" Its source is {log.source} ({log.licence}).")
                logs.append(Log.read(log.file, model.description))
        require_healthy(logs, model, rules.accept)
        records = [friction_records(joint_records, model, body) for joint_records in parts_of(logs)]
        for joint_records in records:
            seconds = joint_records[0].t[-1] - joint_records[0].t[0]
            if seconds <= rules.warm_up:
                raise ConfigError(
                    f"log '{joint_records[0].log}' lasts {seconds:.3g} s, not longer than the "
                    "warm-up of "
                    f"{rules.warm_up:g} s."
                )
        grounds[robot.name] = Ground(model=model, body=body, records=records)
    return grounds


def _require_same(file: Path, expected: str, whence: str) -> None:
    try:
        found = sha256(file)
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read ({error.strerror}).{whence}") from error
    if found != expected:
        raise ConfigError(f"{file}: its SHA-256 is {found}, not {expected}.{whence}")


_DRAWS = 20_000
_LEVEL = 0.95


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A dimensionless value with a bootstrap interval."""

    value: float
    low: float
    high: float


class Judge:
    """Scores torques on the logs of a robot; `tau_std` (n,) is that of measured friction [N.m]."""

    def __init__(self, ground: Ground, *, warm_up: float, block: float) -> None:
        parts = ground.records
        self._rows = [
            joint_records[0].t - joint_records[0].t[0] >= warm_up for joint_records in parts
        ]
        self._tau = [
            np.column_stack([record.tau for record in joint_records])[rows]
            for joint_records, rows in zip(parts, self._rows, strict=True)
        ]
        self.tau_std: Array = np.vstack(self._tau).std(axis=0)
        self._block = max(1, round(block / float(np.median(np.diff(parts[0][0].t)))))
        kinds = [
            _kinds(joint_records, rows)
            for joint_records, rows in zip(parts, self._rows, strict=True)
        ]
        self._masks: Mapping[Kind, list[Mask]] = {
            kind: [of_part[kind] for of_part in kinds] for kind in kinds[0]
        }

    def errors(self, torques: Sequence[Array]) -> list[Array]:
        """Return torque errors (N, n) [N.m] per part, on scored rows."""
        pairs = zip(torques, self._rows, self._tau, strict=True)
        return [torque[rows] - tau for torque, rows, tau in pairs]

    def by_joint(self, errors: Sequence[Array], kind: Kind) -> tuple[float | None, ...]:
        """Return the RMSE by joint [N.m] on rows of a kind; None without rows."""
        error = np.vstack(errors)
        mask = np.vstack(self._masks[kind])
        return tuple(
            rmse(error[rows, j]) if np.any(rows) else None for j, rows in enumerate(mask.T)
        )

    def relative(self, errors: Sequence[Array], kind: Kind) -> Interval | None:
        """Return the error over the size of friction; None without scored rows."""
        counts = [np.sqrt(mask.sum(axis=1)) for mask in self._masks[kind]]
        if not any(map(np.any, counts)):
            return None
        return self._interval(self._sizes(errors, kind), counts, _LEVEL)

    def ratio(self, errors: Sequence[Array], below: Sequence[Array], compared: int) -> Interval:
        """Return the ratio of two errors, simultaneous for `compared` ones (Bonferroni)."""
        level = 1.0 - (1.0 - _LEVEL) / max(1, compared)
        return self._interval(self._sizes(errors, "all"), self._sizes(below, "all"), level)

    def _sizes(self, errors: Sequence[Array], kind: Kind) -> list[Array]:
        return [
            np.sqrt(np.sum(mask * np.square(error / self.tau_std), axis=1))
            for error, mask in zip(errors, self._masks[kind], strict=True)
        ]

    def _interval(self, above: list[Array], below: list[Array], level: float) -> Interval:
        low, high = rmse_ratio_interval(
            above,
            below,
            block=self._block,
            rng=np.random.default_rng(0),
            resamples=_DRAWS,
            level=level,
        )
        value = rmse(np.concatenate(above)) / rmse(np.concatenate(below))
        return Interval(value=value, low=low, high=high)


def _kinds(joint_records: Sequence[FrictionRecord], rows: Mask) -> dict[Kind, Mask]:
    fast = np.column_stack([moving(record.dq) for record in joint_records])[rows]
    near = np.column_stack([near_reversals(record.t, record.dq) for record in joint_records])[rows]
    return {"all": np.ones_like(fast), "moving": fast, "reversals": near, "rests": ~fast}


def rmse_ratio_interval(
    errors: Sequence[Array],
    reference: Sequence[Array],
    *,
    block: int,
    rng: np.random.Generator,
    resamples: int = 2000,
    level: float = 0.95,
) -> tuple[float, float]:
    """Return the interval, of probability `level`, of the ratio of two RMSEs over the same rows.

    Circular block bootstrap: the same blocks of rows are drawn with replacement from each log's
    errors (N,) [N.m]. A `block` has a few correlation lengths [rows]; with less the interval is too
    narrow.
    """
    above = np.zeros(resamples)
    below = np.zeros(resamples)
    for error, other in zip(errors, reference, strict=True):
        rows = len(error)
        length = min(block, len(error))
        draws = rng.integers(rows, size=(resamples, -(-rows // length)))
        share = rows / (draws.shape[1] * length)
        above += share * _block_sums(error, length)[draws].sum(axis=1)
        below += share * _block_sums(other, length)[draws].sum(axis=1)
    low, high = np.quantile(np.sqrt(above / below), [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def _block_sums(error: Array, length: int) -> Array:
    around = np.concatenate([error, error[: length - 1]]) ** 2
    total = np.concatenate([[0.0], np.cumsum(around)])
    return np.asarray(total[length:] - total[:-length])
