"""Friction laws as estimators by scikit-learn's rules; scikit-learn is optional."""

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from cosim.workflow.arguments import (
    Names,
    find_body,
    find_robot,
    list_names,
    logs_unless_table,
    read_logs,
    require_one_way,
)
from hesr_model.errors import FitError, TableError
from hesr_model.fitting.estimator import Estimator, estimator, to_law_name
from hesr_model.fitting.fit import fit
from hesr_model.friction.expressions import CoefficientTable, LawExpressions
from hesr_model.friction.log_friction import mean_determination
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.table import MotionTable, read_motion, read_numbers, read_torques
from hesr_model.inference.choice import CHOOSE
from hesr_model.logs.robot_log import Log, collect_parts
from hesr_model.logs.signals import smooth_logs
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotLike
from hesr_model.support.arrays import Array
from hesr_model.support.files import PathArg

if TYPE_CHECKING:
    from hesr_model.audit.certificate import Certificate

_TARGETS = ("friction", "torque")


@dataclass(frozen=True, kw_only=True)
class _Prediction:
    """Measured and predicted torque (N, n) [N.m] over t (N,) [s] of a log or table."""

    t: Array
    tau: Array  # that predicted if the measured one is unknown
    tau_predicted: Array
    is_table: bool = False


class FrictionRegressor:
    """Friction law as an estimator, fitted to logs or to tables in memory.

    Rows of a table are samples of one motion in order of time: laws have
    memory, so a prediction depends on the rows before it. `equation`, `sympy`,
    `latex`, `coefficients`, `passivity` and `to_fmu` are those of `model_`.

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
        rigid_body: RigidBody | PathArg | None = None,
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
        if hasattr(self, "model_"):
            return self.model_._repr_html_()
        return repr(self)

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
            self._flat = False
            if self.law == CHOOSE:
                self.model_ = replace(self._choose(logs, robot), rigid_body=self.rigid_body_)
                return self
            parts = collect_parts(logs)
            records = [friction_records(part, robot, self.rigid_body_) for part in parts]
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
        prediction = self._predict_one(X)
        torque = prediction.tau_predicted
        # The shape of the y of `fit`, as scikit-learn expects.
        if prediction.is_table and self._flat:
            return torque[:, 0]
        return torque

    def score(self, X: Any, y: Any = None) -> float:
        """Return the coefficient of determination R2, averaged over joints.

        X and y are as in `fit`. Logs are predicted separately; rows in their
        gaps do not count.
        """
        logs = self._logs(X)
        if logs is None:
            predictions = [self._predict_table(X, y)]
        else:
            predictions = [self._predict_log(part) for part in collect_parts(logs)]
        tau = np.vstack([prediction.tau for prediction in predictions])
        tau_predicted = np.vstack([prediction.tau_predicted for prediction in predictions])
        return mean_determination(tau, tau_predicted)

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
        prediction = self._predict_one(X, y)
        signals = {"measured": prediction.tau, title(model.law): prediction.tau_predicted}
        return plot_torques(model.joints, model.slides, prediction.t, signals, self.target)

    def equation(self) -> str:
        """Return the fitted law as text, joint by joint."""
        return self._require_fitted().equation()

    def sympy(self) -> dict[str, LawExpressions]:
        """Return the SymPy expressions of each joint; see `FrictionModel`."""
        return self._require_fitted().sympy()

    def latex(self) -> dict[str, str]:
        """Return the equations of each joint in LaTeX."""
        return self._require_fitted().latex()

    def coefficients(self) -> CoefficientTable:
        """Return the coefficients with units, errors and bounds that were hit."""
        return self._require_fitted().coefficients()

    def passivity(self) -> "dict[str, Certificate]":
        """Return for each joint whether its law is passive."""
        return self._require_fitted().passivity()

    def to_fmu(self, path: PathArg, *, platforms: Names | None = None) -> Path:
        """Write the fitted law as an FMU.

        The default platforms are linux64, win64 and that of this machine.
        """
        names = None
        if platforms is not None:
            names = list_names("platforms", platforms)
        return self._require_fitted().to_fmu(path, platform=names)

    def to_torch(self, path: PathArg) -> Path:
        """Write the fitted law as a module of PyTorch, see `hesr.export`."""
        from cosim.workflow.export import export

        return export(self._require_fitted(), path, format="torch")

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

    def _predict_one(self, X: Any, y: Any = None) -> _Prediction:
        """Return the prediction of one log or of a table; y may be unknown."""
        logs = self._logs(X)
        if logs is None:
            return self._predict_table(X, y)
        if len(logs) != 1:
            raise TableError(f"'X' contains {len(logs)} logs; expected one.")
        return self._predict_log(logs[0])

    def _predict_log(self, log: Log) -> _Prediction:
        model = self._require_fitted()
        if not hasattr(self, "robot_"):
            raise TableError("a law fitted to a table needs a table.")
        records = model.records(log, robot=self.robot_)
        tau = np.column_stack([record.tau for record in records])
        tau_predicted = model.predict(records)
        if self.target == "torque":
            load = np.column_stack([record.of_bodies for record in records])
            tau, tau_predicted = tau + load, tau_predicted + load
        return _Prediction(t=records[0].t, tau=tau, tau_predicted=tau_predicted)

    def _predict_table(self, X: Any, y: Any) -> _Prediction:
        model = self._require_fitted()
        table = self._table(X)
        tau_predicted = model.predict(t=table.t, dq=table.dq, q=table.q, tau_load=table.load)
        if self.target == "torque":
            tau_predicted = tau_predicted + table.load
        tau = tau_predicted
        if y is not None:
            tau = read_torques(y, len(tau_predicted))
        return _Prediction(t=table.t, tau=tau, tau_predicted=tau_predicted, is_table=True)

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
        robot = self.robot
        if robot is None:
            robot = getattr(self, "robot_", None)
        logs = read_logs(sources, robot)
        require_one_way(logs, from_commands=False)
        return logs

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
