"""Friction laws with the interface of scikit-learn, fitted to tables and logs."""

import pickle
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

import hesr
from hesr_model.errors import FitError, HesrError, TableError
from hesr_model.friction.table import MotionTable, read_motion, read_numbers, read_torques
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import RobotDescription

T = 0.005 * np.arange(1500)
DQ = np.cos(T) + 0.5 * np.cos(3.1 * T)
# Multiples of powers of two: sums and residuals are free of round-off.
LOAD = np.round(5.0 * np.sin(T) * 8.0) / 8.0
FRICTION = np.round((4.0 * np.tanh(80.0 * DQ) + 2.0 * DQ) * 2.0**20) / 2.0**20
TABLE = {"t": T, "q": np.sin(T), "dq": DQ, "load": LOAD}

_NO_MEMORY = "the torque of a row depends on the rows before it, as friction does"
EXPECTED = {
    "check_methods_sample_order_invariance": _NO_MEMORY,
    "check_methods_subset_invariance": _NO_MEMORY,
    "check_regressor_multioutput": "y has a column for each joint in X, not any number of them",
}
"""Expected failures of scikit-learn's checks, with the reason."""


class OfAnyTable(hesr.FrictionRegressor):
    """Turn the random numbers of scikit-learn's checks into a reciprocating motion at 100 Hz.

    It begins slowly: Stribeck friction of fast motion alone is not determined, and refused.
    """

    def _motion(self, values: Any, names: Any) -> MotionTable:
        t = 0.01 * np.arange(len(values))
        if len(values) < 2:
            return read_motion(np.column_stack([t, t, t, t]))  # which refuses it
        speeds = values[:, 0] * np.linspace(0.02, 1.0, len(values))
        dq = (speeds * (-1.0) ** np.arange(len(values)))[:, None]
        return MotionTable(t=t, q=np.zeros_like(dq), dq=dq, load=np.zeros_like(dq))


@pytest.mark.parametrize("law", ["stribeck", pytest.param("lugre", marks=pytest.mark.soak)])
@pytest.mark.filterwarnings("ignore")
def test_scikit_learn_checks_pass(law: str) -> None:
    checks = pytest.importorskip("sklearn.utils.estimator_checks", reason="needs hesr[sklearn]")
    found = checks.check_estimator(OfAnyTable(law), on_skip=None, on_fail=None)
    failed = {c["check_name"]: str(c["exception"]) for c in found if c["status"] == "failed"}
    assert len(found) > 45
    assert set(failed) <= set(EXPECTED), failed


@pytest.fixture(scope="module")
def fitted() -> hesr.FrictionRegressor:
    return hesr.FrictionRegressor("stribeck").fit(TABLE, FRICTION)


def test_a_table_is_fitted_and_predicted(fitted: hesr.FrictionRegressor) -> None:
    found = fitted.predict(TABLE)
    assert found.shape == (1500,)
    assert np.sqrt(np.mean((found - FRICTION) ** 2)) < 0.05 * np.std(FRICTION)
    assert fitted.score(TABLE, FRICTION) == pytest.approx(
        1.0 - np.mean((found - FRICTION) ** 2) / np.var(FRICTION)
    )
    assert fitted.equation().startswith("joint1:\n  tau = ")
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(fitted)).predict(TABLE), found)


def test_an_array_and_a_data_frame_are_equivalent(fitted: hesr.FrictionRegressor) -> None:
    array = np.column_stack(list(TABLE.values()))
    np.testing.assert_array_equal(fitted.predict(array), fitted.predict(TABLE))
    pandas = pytest.importorskip("pandas", reason="needs hesr[tables]")
    frame = pandas.DataFrame(TABLE)[["dq", "t", "load", "q"]]
    np.testing.assert_array_equal(fitted.predict(frame), fitted.predict(TABLE))


def test_joint_torque_is_friction_and_load(fitted: hesr.FrictionRegressor) -> None:
    whole = hesr.FrictionRegressor("stribeck", target="torque").fit(TABLE, FRICTION + LOAD)
    np.testing.assert_array_equal(whole.predict(TABLE), fitted.predict(TABLE) + LOAD)


def test_each_joint_has_a_column() -> None:
    table = {"t": T, "dq1": DQ, "dq2": 0.5 * DQ}
    both = hesr.FrictionRegressor("stribeck").fit(table, np.column_stack([FRICTION, 2 * FRICTION]))
    assert both.predict(table).shape == (1500, 2)
    assert both.model_.joints == ("joint1", "joint2")
    assert both.score(table, np.column_stack([FRICTION, 2 * FRICTION])) > 0.95


def test_parameters_are_set_by_name() -> None:
    regressor = hesr.FrictionRegressor()
    assert regressor.set_params(law="dahl", seed=3).get_params()["seed"] == 3
    assert repr(regressor) == "FrictionRegressor(law='dahl', seed=3)"
    with pytest.raises(TableError, match=r"has no parameter 'speed'; it has law, robot"):
        regressor.set_params(speed=1)


def test_unfitted_estimators_raise() -> None:
    with pytest.raises(FitError, match="friction regressor is not fitted yet"):
        hesr.FrictionRegressor().predict(TABLE)


def test_logs_are_fitted_predicted_drawn_and_exported(
    arm: RobotDescription, arm_log: Log, tmp_path: Path
) -> None:
    file = tmp_path / "run.csv"
    arm_log.write(file)
    log = hesr.Log.read(file, arm)
    regressor = hesr.FrictionRegressor("stribeck").fit(log)
    assert regressor.robot_ is arm
    assert regressor.predict(log).shape == (2000, 3)
    assert regressor.score(log) > 0.9
    assert "tau = " in regressor._repr_html_()
    model = regressor.model_
    np.testing.assert_array_equal(model.predict(log), regressor.predict(log))
    assert model.predict(str(file), robot=arm, rigid_body=regressor.rigid_body_).shape == (2000, 3)
    assert model.score([log]) == regressor.score(log)
    assert model.select(arm.joints[1]).predict(log).shape == (2000, 1)
    for axes in (regressor.plot(log), model.plot(log), regressor.rigid_body_.plot(log)):
        assert [axis.get_title(loc="left") for axis in axes] == list(arm.joints)
        assert len(axes[0].lines) == 2
    with ZipFile(regressor.to_fmu(str(tmp_path / "Friction.fmu"))) as archive:
        assert "resources/friction_model.json" in archive.namelist()
    assert "import torch" in regressor.to_torch(tmp_path / "friction.py").read_text("utf-8")
    whole = hesr.FrictionRegressor("stribeck", target="torque", robot=arm).fit([str(file)])
    assert whole.score(str(file)) > regressor.score(log)
    for call, sentence in [
        (lambda: regressor.predict([log, log]), r"'X' contains 2 logs; expected one"),
        (lambda: regressor.fit(log, log.tau), "y was given with logs"),
    ]:
        with pytest.raises(TableError, match=sentence):
            call()
    assert not hasattr(regressor.fit(TABLE, FRICTION), "robot_")


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: read_motion(np.zeros((9, 3))), "X has 3 columns without names"),
        (lambda: read_motion(np.ones((9, 4))), "1 s in row 2, after"),
        (lambda: read_motion(np.ones((1, 4))), "motion needs at least 2"),
        (
            lambda: read_motion(np.ones((9, 2)), ("t", "q")),
            "X has no column 'dq', only t, q; expect",
        ),
        (
            lambda: read_motion(np.ones((9, 3)), ("t", "dq", "x")),
            "X has the unknown column 'x'; expect",
        ),
        (
            lambda: read_motion(TALL, ("t", "dq1", "dq2", "q")),
            "1 columns of q, but 2",
        ),
        (lambda: read_numbers(1.0), "X has 0 dimensions"),
        (lambda: read_numbers([["a"]]), "X must hold numbers "),
        (lambda: read_numbers([[1j]]), "supported: X must hold real numbers"),
        (lambda: read_numbers([[np.nan]]), "X contains NaN or infinity"),
        (
            lambda: read_numbers(np.zeros((0, 4))),
            r"X has 0 sample\(s\) \(shape=\(0, 4\)\); rows are",
        ),
        (
            lambda: read_numbers(np.zeros((4, 0))),
            r"X has 0 feature\(s\) \(shape=\(4, 0\)\) while a",
        ),
        (
            lambda: read_numbers({"t": [1], "dq": [1, 2]}),
            "X has columns of unequal lengths; expected",
        ),
        (lambda: read_torques(None, 3), "table of motion requires y"),
        (lambda: read_torques([1.0], 3), "3 rows and y 1"),
        (lambda: REGRESSOR.fit(TABLE, np.ones((1500, 2))), "y has 2 columns, but X"),
        (lambda: REGRESSOR.set_params(target="x").fit(TABLE, T), "target of a friction regressor"),
    ],
)
def test_unusable_tables_are_refused(call: Any, sentence: str) -> None:
    with pytest.raises(HesrError, match=sentence) as caught:
        call()
    assert isinstance(caught.value, ValueError)


TALL = np.column_stack([T[:9], T[:9], T[:9], T[:9]])
REGRESSOR = hesr.FrictionRegressor("stribeck")


def test_tables_other_than_the_fitted_one_are_refused(fitted: hesr.FrictionRegressor) -> None:
    sparse = pytest.importorskip("scipy.sparse")
    for table, sentence in [
        ({"t": T, "dq": DQ}, "FrictionRegressor is expecting 4 features as input"),
        ({"t": T, "dq1": DQ, "dq2": DQ, "dq3": DQ}, "motion of 3 joints; the law"),
        (sparse.csr_matrix(np.eye(4)), "X is a sparse matrix"),
    ]:
        with pytest.raises(TableError, match=sentence):
            fitted.predict(table)
    log = Log(name="a", t=T, q=T[:, None], dq=None, tau=T[:, None])
    with pytest.raises(TableError, match="law fitted to a table needs"):
        fitted.predict(log)
