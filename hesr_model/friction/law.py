"""What a friction law is: a few first-order relaxations and an output map, as SymPy expressions.

    x_i' = b_i(v, u) - r_i(v, u) x_i        drive b, rate r >= 0
    tau  = f(v, x, x', u)

v is the joint velocity, u are optional further inputs (`functions.INPUTS`). Everything that runs a
law (NumPy over a log, Python or C step by step) and everything that shows it is lowered from this
description; no law is written a second time.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf, isfinite
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
import sympy
from numpy.typing import ArrayLike, NDArray

from hesr_model.errors import ArtifactError, SimulationError
from hesr_model.friction.functions import INPUTS

if TYPE_CHECKING:
    from hesr_model.friction.trained import TrainedRange
    from hesr_model.residual import FrictionRecord

Discretisation = Literal["exact", "euler"]


@dataclass(frozen=True, kw_only=True)
class Coefficient:
    """A named constant of a law, with its SI unit in FMI's spelling ("1" if dimensionless)."""

    name: str
    unit: str
    description: str

    @property
    def symbol(self) -> sympy.Symbol:
        """SymPy symbol under which the law's expressions use it."""
        return sympy.Symbol(self.name, real=True)


@dataclass(frozen=True, kw_only=True)
class Relaxation:
    """One state x' = drive - rate x, with rate >= 0 for every input."""

    name: str
    unit: str
    drive: sympy.Expr
    rate: sympy.Expr

    @property
    def state(self) -> sympy.Symbol:
        """Symbol of the state x."""
        return sympy.Symbol(self.name, real=True)

    @property
    def derivative(self) -> sympy.Symbol:
        """Symbol of x' = drive - rate x, taken after the state was updated (as in eq. 10)."""
        return sympy.Symbol(f"d{self.name}", real=True)


@dataclass(frozen=True, kw_only=True)
class LawForm:
    """The expressions of a law, without numbers.

    Raises
    ------
    ArtifactError
        If an expression uses a symbol that is neither an input, a coefficient nor a state, or two
        of these have one name.
    """

    coefficients: tuple[Coefficient, ...]
    relaxations: tuple[Relaxation, ...] = ()
    output: sympy.Expr

    def __post_init__(self) -> None:
        known = {*INPUTS, *(c.symbol for c in self.coefficients)}
        states = [s for r in self.relaxations for s in (r.state, r.derivative)]
        own = set(states)
        names = Counter([*INPUTS, *(c.symbol for c in self.coefficients), *states])
        if twice := [symbol for symbol, count in names.items() if count > 1]:
            raise ArtifactError(
                f"friction law: '{twice[0]}' stands twice among its inputs, coefficients and "
                "states."
            )
        inner = {s for r in self.relaxations for e in (r.drive, r.rate) for s in e.free_symbols}
        unknown = (inner - known) | (self.output.free_symbols - known - own)
        if unknown:
            raise ArtifactError(
                f"friction law: symbol '{min(map(str, unknown))}' is neither an input, "
                "a coefficient nor a state of the law."
            )

    @cached_property
    def inputs(self) -> tuple[sympy.Symbol, ...]:
        """Those of `INPUTS` that the law really uses, in their order."""
        expressions = [self.output, *(e for r in self.relaxations for e in (r.drive, r.rate))]
        used = set().union(*(e.free_symbols for e in expressions))
        return tuple(symbol for symbol in INPUTS if symbol in used)


@dataclass(frozen=True, kw_only=True)
class FrictionLaw:
    """A frozen law of one joint: a form, its numbers and its discretisation.

    Attributes
    ----------
    name : name in the registry, from which `form` is rebuilt together with `structure`.
    structure : JSON data that select one form of a family (empty where there is only one).
    form : the expressions.
    values : value of every coefficient of `form`, in its order and unit.
    discretisation : "exact" integrates each relaxation exactly for inputs held over a step;
        "euler" is eq. 10 and requires 0 <= rate * dt < 1.
    start : value of each state before the first sample, zero by default.
    start_samples : how many measured torques at the beginning of a log set the start in its place,
        where they are known (`evaluate.estimated_start`); 0 for none.
    standard_errors : of the coefficients, in their units, as far as they are known.

    Raises
    ------
    ArtifactError
        If the values are not those that the form needs, or not finite.
    """

    name: str
    structure: Mapping[str, Any] = field(default_factory=dict)
    form: LawForm
    values: Mapping[str, float]
    discretisation: Discretisation = "exact"
    start: tuple[float, ...] = ()
    start_samples: int = 0
    standard_errors: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        needed = [c.name for c in self.form.coefficients]
        if sorted(needed) != sorted(self.values):
            odd = sorted(set(needed) ^ set(self.values))[0]
            raise ArtifactError(
                f"law '{self.name}': coefficient '{odd}' is "
                f"{'missing' if odd in needed else 'unknown'}; needed are {', '.join(needed)}."
            )
        object.__setattr__(self, "values", {name: float(self.values[name]) for name in needed})
        for name, value in self.values.items():
            if not isfinite(value):
                raise ArtifactError(f"law '{self.name}': coefficient '{name}' is {value}.")
        if not self.start:
            object.__setattr__(self, "start", (0.0,) * len(self.form.relaxations))
        if len(self.start) != len(self.form.relaxations):
            raise ArtifactError(
                f"law '{self.name}': {len(self.start)} start values for "
                f"{len(self.form.relaxations)} states."
            )
        for relaxation, value in zip(self.form.relaxations, self.start, strict=True):
            if not isfinite(value):
                raise ArtifactError(
                    f"law '{self.name}': start value of '{relaxation.name}' is {value}."
                )


@dataclass(frozen=True, kw_only=True)
class FrictionModel:
    """One law for each joint of a robot.

    Attributes
    ----------
    law : name of the law, as in the registry or of a published model.
    robot : name of the robot.
    joints : names of the joints.
    laws : the law of each joint.
    sample_time : sample period at which the laws were made [s].
    trained : ranges of the records that each law was fitted to; empty where they are not known.
    training_rmse : error of each law on those records [N.m]; empty where it is not known.
    provenance : JSON data on where the model comes from (files with hashes, seed, versions).
    """

    law: str
    robot: str
    joints: tuple[str, ...]
    laws: tuple[FrictionLaw, ...]
    sample_time: float
    trained: "tuple[TrainedRange, ...]" = ()
    training_rmse: tuple[float, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.joints or len(self.joints) != len(self.laws):
            raise ArtifactError(
                f"friction model '{self.law}': {len(self.laws)} laws for {len(self.joints)} joints."
            )
        if self.trained and len(self.trained) != len(self.joints):
            raise ArtifactError(
                f"friction model '{self.law}': {len(self.trained)} trained ranges for "
                f"{len(self.joints)} joints."
            )
        if self.training_rmse and len(self.training_rmse) != len(self.joints):
            raise ArtifactError(
                f"friction model '{self.law}': {len(self.training_rmse)} training errors for "
                f"{len(self.joints)} joints."
            )
        if not 0.0 < self.sample_time < inf:
            raise ArtifactError(
                f"friction model '{self.law}': sample time is {self.sample_time} s; needed is a "
                "positive number."
            )

    @overload
    def predict(self, records: "Sequence[FrictionRecord]") -> NDArray[np.float64]: ...

    @overload
    def predict(
        self,
        *,
        t: ArrayLike,
        dq: ArrayLike,
        q: ArrayLike | None = None,
        tau_load: ArrayLike | None = None,
    ) -> NDArray[np.float64]: ...

    def predict(
        self,
        records: "Sequence[FrictionRecord] | None" = None,
        *,
        t: ArrayLike | None = None,
        dq: ArrayLike | None = None,
        q: ArrayLike | None = None,
        tau_load: ArrayLike | None = None,
    ) -> NDArray[np.float64]:
        """Return the friction torque of all joints, (N, n) [N.m].

        Of a log, or of a motion given by its arrays. With the log, a law whose state is not known
        at the start takes it from the first measured torques.

        Parameters
        ----------
        records : of one log, as `residual.friction_records` returns them.
        t : (N,) time [s], increasing.
        dq : (N, n) joint velocity [rad/s].
        q : (N, n) joint position [rad]; zero where not given.
        tau_load : (N, n) rigid-body torque of the motion [N.m]; zero where not given.

        Raises
        ------
        SimulationError
            If the records or arrays are not those of the model's joints, time does not increase, or
            the discretisation of a law is not stable at these steps.
        """
        # Here, because these modules run and fit what this one defines.
        from hesr_model.friction.evaluate import predict
        from hesr_model.friction.records import predict_record

        if records is not None:
            self._require_joints(records)
            columns = [predict_record(law, r) for law, r in zip(self.laws, records, strict=True)]
            return np.column_stack(columns)
        if t is None or dq is None:
            raise TypeError("predict() takes the records of a log, or the arrays 't' and 'dq'")
        time = np.asarray(t, dtype=float)
        speed, position, load = (
            self._rows(name, values, len(time))
            for name, values in (("dq", dq), ("q", q), ("tau_load", tau_load))
        )
        if np.any(np.diff(time) <= 0.0):
            row = int(np.argmax(np.diff(time) <= 0.0)) + 1
            raise SimulationError(
                f"friction model '{self.law}': time must increase, but t[{row}] is {time[row]:g} s "
                f"after {time[row - 1]:g} s."
            )
        columns = [
            predict(law, t=time, dq=speed[:, k], q=position[:, k], tau_load=load[:, k])
            for k, law in enumerate(self.laws)
        ]
        return np.column_stack(columns)

    def _rows(self, name: str, values: ArrayLike | None, count: int) -> NDArray[np.float64]:
        shape = (count, len(self.joints))
        rows = np.zeros(shape) if values is None else np.asarray(values, dtype=float)
        if rows.shape != shape:
            raise SimulationError(
                f"friction model '{self.law}': '{name}' has the shape {rows.shape}; needed is "
                f"{shape}, {count} samples of {len(self.joints)} joints."
            )
        return rows

    def _require_joints(self, records: "Sequence[FrictionRecord]") -> None:
        found = tuple(record.joint for record in records)
        if found != self.joints:
            raise SimulationError(
                f"friction model '{self.law}': the records are of the joints "
                f"{', '.join(found) or 'none'}; needed is one of each of "
                f"{', '.join(self.joints)}, in this order."
            )
