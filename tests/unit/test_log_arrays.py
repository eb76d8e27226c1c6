"""A log from arrays fulfils the rules of readers; each mistake is a sentence with its parameter."""

import pickle
from typing import Any

import numpy as np
import pytest

import hesr
from hesr_model.errors import ConfigError, LogError, RobotError

T = 0.01 * np.arange(300)
Q = np.sin(np.outer(T, [1.0, 2.0, 3.0]))
DQ = np.cos(np.outer(T, [1.0, 2.0, 3.0])) * [1.0, 2.0, 3.0]
ARRAYS = {"t": T, "q": Q, "dq": DQ, "tau": 2.0 * np.tanh(DQ)}


def spoil(values: np.ndarray[Any, Any], place: Any, value: float) -> np.ndarray[Any, Any]:
    """Return a copy with another value at a place."""
    copy = values.copy()
    copy[place] = value
    return copy


MISTAKES: list[tuple[dict[str, Any], str, str]] = [
    ({"q": Q.T}, "shape", "q"),
    ({"tau": ARRAYS["tau"].T}, "shape", "tau"),
    ({"dq": DQ[:-1]}, "shape", "dq"),
    ({"q": Q[:, 0, None, None]}, "shape", "q"),
    ({"q": Q[:299, 0]}, "shape", "q"),
    ({"q": 0.5}, "shape", "q"),
    ({"tau": ARRAYS["tau"][:, :2]}, "joints", "tau"),
    ({"tau": ARRAYS["tau"][:, 0]}, "joints", "tau"),
    ({"t": T[:, None]}, "shape", "t"),
    ({"t": T[:1], "q": Q[:1], "dq": None, "tau": Q[:1]}, "rows", "t"),
    ({"t": [], "q": [], "dq": None, "tau": []}, "rows", "t"),
    ({"tau": spoil(Q, (7, 1), np.nan)}, "finite", "tau"),
    ({"q": spoil(Q, (0, 0), np.inf)}, "finite", "q"),
    ({"t": spoil(T, 3, np.nan)}, "finite", "t"),
    ({"q": [[1.0, 2.0], [3.0]]}, "numbers", "q"),
    ({"q": [["a", "b"]] * 300}, "numbers", "q"),
    ({"q": 1j * Q}, "numbers", "q"),
    ({"t": spoil(T, 100, 0.0)}, "increase", "t"),
    ({"t": T[::-1]}, "increase", "t"),
    ({"t": 1e3 * T}, "unit", "t"),
    ({"t": 1e9 * T}, "unit", "t"),
    ({"q": np.rad2deg(Q)}, "unit", "q"),
    ({"dq": np.rad2deg(DQ)}, "unit", "dq"),
    ({"dq": DQ * 30.0 / np.pi}, "unit", "dq"),
]


@pytest.mark.parametrize(("change", "rule", "parameter"), MISTAKES)
def test_a_mistake_is_one_sentence_with_its_parameter(
    change: dict[str, Any], rule: str, parameter: str
) -> None:
    with pytest.raises(LogError, match=rf"^log 'log': '{parameter}' ") as refused:
        hesr.Log(**(ARRAYS | change))
    assert (refused.value.code, refused.value.key) == (f"log.array.{rule}", parameter)
    assert str(refused.value).count(". ") == 0


def test_lists_integers_and_one_joint_are_numbers() -> None:
    whole = hesr.Log(**ARRAYS)
    lists = hesr.Log(**{name: values.tolist() for name, values in ARRAYS.items()})
    np.testing.assert_array_equal(lists.q, whole.q)
    counts = np.arange(300)
    one = hesr.Log(t=counts / 100.0, q=counts, tau=counts, name="counts")
    assert one.q.shape == one.tau.shape == (300, 1)
    assert one.q.dtype == one.tau.dtype == float
    assert (whole.name, one.name, one.dq) == ("log", "counts", None)


def test_arrays_of_the_caller_are_copied() -> None:
    q = Q.copy()
    log = hesr.Log(t=T, q=q, tau=Q)
    q[:] = 0.0
    np.testing.assert_array_equal(log.q, Q)


def test_parts_of_a_checked_log_may_be_short() -> None:
    log = hesr.Log(**ARRAYS)
    assert len(log.rows(slice(0, 1)).t) == 1


UF850 = hesr.Robot("uf850")


@pytest.mark.parametrize(
    "robot",
    ["uf850", UF850, UF850.description, UF850.description.model, str(UF850.description.model)],
    ids=["name", "Robot", "description", "path", "text"],
)
def test_the_robot_of_arrays_is_named_in_any_form(robot: Any) -> None:
    log = hesr.Log(**ARRAYS, robot=robot)
    assert isinstance(log.robot, hesr.RobotDescription)
    assert log.joints == UF850.joints
    for copied in (log.rows(slice(100)), pickle.loads(pickle.dumps(log))):
        assert copied.robot == log.robot


def test_a_robot_that_cannot_be_used_is_refused() -> None:
    with pytest.raises(RobotError, match="no such model file"):
        hesr.Log(**ARRAYS, robot="uf85")
    with pytest.raises(ConfigError, match="is given as int; expected a path"):
        hesr.Log(**ARRAYS, robot=850)  # type: ignore[arg-type]  # the mistake
    with pytest.raises(LogError, match="'q' has 3 joints") as refused:
        hesr.Log(**ARRAYS, robot="ur10")
    assert refused.value.code == "log.array.joints"


def test_a_body_separates_friction_from_a_log_of_arrays() -> None:
    """The friction in the torque comes back, beside the load of the bodies."""
    load = UF850.torque(UF850.nominal_parameters, Q, DQ, -Q * [1.0, 4.0, 9.0])
    log = hesr.Log(**ARRAYS | {"tau": load + ARRAYS["tau"]}, robot=UF850)
    body = hesr.RigidBody(
        robot=UF850.name,
        joints=UF850.joints,
        names=UF850.parameter_names,
        parameters=UF850.nominal_parameters,
        base=(),
        standard_errors=np.zeros(0),
        condition=1.0,
        ridge=0.0,
        friction=np.zeros((3, 3)),
        rmse=np.zeros(3),
        rows=0,
        logs=(),
        method="stacked",
        weighting="wls",
    )
    known = slice(30, -30)  # rows of which smoothing knows both sides
    for j, record in enumerate(body.separate_friction(log)):
        assert record.joint == UF850.joints[j]
        np.testing.assert_allclose(record.tau_load[known], load[known, j], atol=0.2)
        np.testing.assert_allclose(record.tau[known], ARRAYS["tau"][known, j], atol=0.2)
    with pytest.raises(LogError, match="does not name its robot"):
        body.separate_friction(hesr.Log(**ARRAYS))


def test_a_shipped_robot_is_named_by_the_interface() -> None:
    """Its robot file is used, with all that a model file alone does not say."""
    inspected = hesr.inspect(robot="uf850").proposal.description
    assert inspected.gear_ratio == UF850.description.gear_ratio == (101.0,) * 3
