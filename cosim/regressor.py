"""Friction laws as estimators by scikit-learn's rules; scikit-learn is optional."""

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np

from cosim.workflow.arguments import (
    Names,
    find_body,
    find_robot,
    list_names,
    logs_unless_table,
    read_logs,
)
from hesr_model.errors import FitError, TableError
from hesr_model.fitting.estimator import Estimator, estimator, to_law_name
from hesr_model.fitting.fit import fit
from hesr_model.friction.log_friction import mean_determination
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.table import MotionTable, read_motion, read_numbers, read_torques
from hesr_model.inference.choice import CHOOSE
from hesr_model.logs.robot_log import Log, collect_parts
from hesr_model.logs.signals import smooth_logs
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import FrictionRecord, friction_records
from hesr_model.robots.robot import Robot, RobotLike, to_robot
from hesr_model.support import plugins
from hesr_model.support.arrays import Array
from hesr_model.support.files import to_path

Record = Sequence[FrictionRecord]  # friction of all joints in one log
_TARGETS = ("friction", "torque")


class FrictionRegressor:
    """Friction law as an estimator, fitted to logs or to tables in memory.

    Rows of a table are samples of one motion in order of time: laws have
    memory, so a prediction depends on the rows before it.

    Parameters
    ----------
    law : name of a law, see `hesr.laws`, or its class; or "choose", the
        proposed law of each joint that predicts left-out rows of logs best.
    robot : robot of the logs; by default that of the log.
    rigid_body : rigid body of the robot, or its file; by default identified
        from the logs of `fit`.
    target : predicted quantity and meaning of y: "friction", or "torque"
        including load torque.
    seed : seed of the fit.
    options : options of the law's estimator.

    Attributes
    ----------
    model_ : fitted `FrictionModel`.
    n_features_in_ : number of columns of the fitted table; absent after logs.
    robot_, rigid_body_ : robot and body of the fitted logs; absent after a
        table.
    """

    def __init__(
        self,
        law: str | type[Estimator] = "lugre",
        *,
        robot: RobotLike | None = None,
        rigid_body: RigidBody | str | PathLike[str] | None = None,
        target: str = "friction",
        seed: int = 0,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self.law = law
        self.robot = robot
        self.rigid_body = rigid_body
        self.target = target
        self.seed = seed
        self.options = options

    def __repr__(self) -> str:
        parameters = inspect.signature(type(self)).parameters
        arguments = [
            f"{name}={value!r}"
            for name, value in self.get_params().items()
            if not (value is parameters[name].default or value == parameters[name].default)
        ]
        return f"{type(self).__name__}({', '.join(arguments)})"

    def _repr_html_(self) -> str:
        return self._require_fitted()._repr_html_() if hasattr(self, "model_") else repr(self)

    def get_params(self, deep: bool = True) -> dict[str, Any]:  # noqa: ARG002  # scikit-learn's signature
        """Return the parameters of the constructor by name."""
        return {name: getattr(self, name) for name in inspect.signature(type(self)).parameters}

    def set_params(self, **params: Any) -> Self:
        """Set parameters of the constructor; raise TableError for an unknown one."""
        allowed = self.get_params()
        for name, value in params.items():
            if name not in allowed:
                raise TableError(
                    f"a friction regressor has no parameter '{name}'; it has {', '.join(allowed)}."
                )
            setattr(self, name, value)
        return self

    def fit(self, X: Any, y: Any = None) -> Self:
        """Fit the law.

        Parameters
        ----------
        X : one or several logs (`Log` or path), or a table with columns t, q,
            dq, load [s, rad, rad/s, N.m], numbered from 1 for several joints.
        y : (N,) or (N, n) measured torque of the rows of a table [N.m]; None
            for logs.

        Raises
        ------
        TableError, LogError
            If the table, y or a log cannot be used.
        FitError
            If the data do not determine the law.
        """
        if self.law != CHOOSE:
            estimator(to_law_name(self.law))
        if self.target not in _TARGETS:
            raise TableError(
                f"the target of a friction regressor is '{self.target}'; allowed are "
                f"{' and '.join(_TARGETS)}."
            )
        logs = self._logs(X)
        if logs is not None:
            if y is not None:
                raise TableError("y was given with logs, which contain the measured torque.")
            robot = find_robot(self.robot, logs)
            self.robot_ = robot.description
            self.rigid_body_ = find_body(self.rigid_body, logs, robot)
            robot_name = robot.description.name
            self.__dict__.pop("n_features_in_", None)
            if self.law == CHOOSE:
                self.model_ = replace(self._choose(logs, robot), rigid_body=self.rigid_body_)
                return self
            records = self._records(collect_parts(logs))
        else:
            if self.law == CHOOSE:
                raise TableError(f"the law '{CHOOSE}' needs logs; name a law to fit a table.")
            values, names = read_numbers(X)
            measured = read_torques(y, len(values))
            table = self._motion(values, names)
            load = table.load if self.target == "torque" else 0.0
            robot_name = "table"
            records = [table.to_records(measured - load)]
            for attribute in ("robot_", "rigid_body_"):
                self.__dict__.pop(attribute, None)
            self.n_features_in_ = values.shape[1]
            self._flat = np.asarray(y).ndim == 1
        self.model_ = fit(
            self.law, *records, seed=self.seed, options=self.options, robot=robot_name
        )
        self.model_ = replace(self.model_, rigid_body=getattr(self, "rigid_body_", None))
        return self

    def _choose(self, logs: Sequence[Log], robot: Robot) -> FrictionModel:
        """Return the chosen law of each joint."""
        from cosim.study.law_choice import fit_chosen_laws

        if self.options:
            raise TableError(f"the law '{CHOOSE}' has no options.")
        model, _ = fit_chosen_laws(
            smooth_logs(logs, robot),
            robot,
            self.rigid_body_,
            identifies_body=self.rigid_body is None,
            seed=self.seed,
        )
        return model

    def predict(self, X: Any) -> Array:
        """Return the friction torque, or the joint torque if that is the target.

        Parameters
        ----------
        X : a log, or a table like that of `fit`.

        Returns
        -------
        ndarray
            (N, n) [N.m]; (N,) if the y of `fit` was.

        Raises
        ------
        TableError
            If the table cannot be used, or several logs are given.
        SimulationError
            If the log has other joints.
        """
        model = self._require_fitted()
        logs = self._logs(X)
        if logs is not None:
            if len(logs) != 1:
                raise TableError(f"predict() was given {len(logs)} logs; expected one.")
            (log_records,) = self._records(logs)
            return self._convert_to_target(model.predict(log_records), log_records)
        table = self._table(X)
        torque = model.predict(t=table.t, dq=table.dq, q=table.q, tau_load=table.load)
        torque += table.load if self.target == "torque" else 0.0
        return torque[:, 0] if self._flat else torque

    def score(self, X: Any, y: Any = None) -> float:
        """Return the coefficient of determination R2, averaged over joints; X and y as in `fit`.

        Logs are predicted separately; rows in their gaps do not count.
        """
        model = self._require_fitted()
        logs = self._logs(X)
        if logs is not None:
            records = self._records(collect_parts(logs))
            tau_predicted = np.vstack(
                [
                    self._convert_to_target(model.predict(log_records), log_records)
                    for log_records in records
                ]
            )
            tau = np.vstack(
                [
                    self._convert_to_target(
                        np.column_stack([record.tau for record in log_records]), log_records
                    )
                    for log_records in records
                ]
            )
        else:
            tau_predicted = self.predict(X)
            tau_predicted = tau_predicted.reshape(len(tau_predicted), -1)
            tau = read_torques(y, len(tau_predicted))
        return mean_determination(tau, tau_predicted)

    def equation(self) -> str:
        """Return the fitted law as text, joint by joint."""
        return self._require_fitted().equation()

    def plot(self, X: Any, y: Any = None) -> Any:
        """Draw measured and predicted torque of one log or table over time.

        Returns
        -------
        ndarray of matplotlib axes
            One for each joint.
        """
        from cosim.report.tables.table import title
        from cosim.workflow.objects import plot_torques

        model = self._require_fitted()
        tau_predicted = self.predict(X)
        tau_predicted = tau_predicted.reshape(len(tau_predicted), -1)
        logs = self._logs(X)
        if logs is not None:
            (log_records,) = self._records(logs)
            t = log_records[0].t
            tau = np.column_stack([record.tau for record in log_records])
            tau_measured = self._convert_to_target(tau, log_records)
        else:
            t = self._table(X).t
            tau_measured = read_torques(y, len(tau_predicted))
        signals = {"measured": tau_measured, title(model.law): tau_predicted}
        return plot_torques(model.joints, model.slides, t, signals, self.target)

    def to_fmu(self, path: str | PathLike[str], *, platforms: Names | None = None) -> Path:
        """Write the fitted law as an FMU.

        The default platforms are linux64, win64 and that of this machine.
        """
        from fmu_src import export_fmu
        from fmu_src.export.toolchain import DEFAULT_PLATFORMS

        platform_names: Sequence[str] = DEFAULT_PLATFORMS
        if platforms is not None:
            platform_names = list_names("platforms", platforms)
        model = self._require_fitted()
        fmu = to_path(path, "'path'")
        return export_fmu(model, fmu, platforms=platform_names)

    def to_torch(self, path: str | PathLike[str]) -> Path:
        """Write the fitted law as a module of PyTorch, in the export format `torch`."""
        file = to_path(path, "'path'")
        plugins.find("hesr.exports", "torch").write(self._require_fitted(), file)
        return file

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "model_")

    def __sklearn_tags__(self) -> Any:
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor",
            target_tags=TargetTags(required=True, multi_output=True),
            regressor_tags=RegressorTags(poor_score=True),  # scores of shuffled rows mean nothing
            input_tags=InputTags(),
        )

    def _motion(self, values: Array, names: Sequence[str]) -> MotionTable:
        return read_motion(values, names)

    def _table(self, X: Any) -> MotionTable:
        values, names = read_numbers(X)
        expected = getattr(self, "n_features_in_", values.shape[1])
        if values.shape[1] != expected:
            raise TableError(
                f"X has {values.shape[1]} features, but {type(self).__name__} is expecting "
                f"{expected} features as input."
            )
        table = self._motion(values, names)
        joint_count = len(self._require_fitted().joints)
        if table.dq.shape[1] != joint_count:
            raise TableError(
                f"X is the motion of {table.dq.shape[1]} joints; the law was fitted to "
                f"{joint_count}."
            )
        return table

    def _logs(self, X: Any) -> list[Log] | None:
        sources = logs_unless_table(X)
        if sources is None:
            return None
        robot = getattr(self, "robot_", None) if self.robot is None else self.robot
        return read_logs(sources, robot)

    def _records(self, logs: Sequence[Log]) -> list[Record]:
        if not hasattr(self, "robot_"):
            raise TableError("a law fitted to a table needs a table.")
        robot = to_robot(self.robot_)
        return [friction_records(log, robot, self.rigid_body_) for log in logs]

    def _convert_to_target(self, friction: Array, log_records: Record) -> Array:
        if self.target == "friction":
            return friction
        return friction + np.column_stack([record.of_bodies for record in log_records])

    def _require_fitted(self) -> FrictionModel:
        if hasattr(self, "model_"):
            return self.model_
        raise _unfitted_error()("this friction regressor is not fitted yet; call fit() first.")


def _unfitted_error() -> type[FitError]:
    """Return the error of an unfitted estimator, scikit-learn's own class if it is installed."""
    try:
        from sklearn.exceptions import NotFittedError
    except ImportError:
        return FitError
    return type("NotFittedError", (FitError, NotFittedError), {})
