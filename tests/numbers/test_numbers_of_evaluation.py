"""Laws over logs, from rest and from starts estimated from the first torques."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.optimize
from joint_data import along, law, path
from unchanged import Unchanged

from hesr_model.fitting import separable
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction import predict as evaluate
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import compute_states, predict, predict_joints, record_start
from hesr_model.laws.parfam import trial
from hesr_model.laws.stops import estimator
from hesr_model.rigid_body.friction_record import FrictionRecord

LUGRE = {"sigma_0": 500.0, "sigma_1": 0.5, "sigma_2": 4.5, "F_c": 7.5, "F_s": 10.0, "v_s": 0.12,
         "tau_0": 0.4}  # fmt: skip
STOPS = {"stops": [["1", 0], ["p", 2], ["load", 4]], "viscous": ["1", "a"], "ripple": [200],
         "window": 0.005}  # fmt: skip
STOP_VALUES = {"F_1": 2.0, "F_p_3": 1.0, "F_load_5": 3.0, "sigma_2": 1.0, "sigma_a": 20.0,
               "tau_0": 0.3, "v_a": 0.1, "v_s": 0.1, "T": 0.05, "load_scale": 20.0, "lag": 0.004,
               "ripple200_cos": 0.3, "ripple200_sin": -0.4}  # fmt: skip
HX = {"linear": ["1", "dq", "h", "dh", "h_load", "h_bump"], "state": "generalised",
      "units": [{"g": "tanh", "arguments": ["1", "dq", "h"]}], "denominator": ["dq"]}  # fmt: skip
HX_VALUES = {"c_0": 0.3, "c_dq": 2.0, "c_h": 5.0, "c_dh": 0.05, "c_h_load": 0.1, "c_h_bump": 2.0,
             "c_g1": 2.0, "theta1_0": 0.1, "theta1_dq": 1.0, "theta1_h": -0.7, "v_s": 0.1,
             "d_dq": 0.05, "alpha": 20.0, "beta": 40.0, "kappa": 60.0, "v_0": 1e-3}  # fmt: skip


def sampled(of: FrictionLaw, samples: int) -> FrictionLaw:
    return FrictionLaw(
        name=of.name, structure=of.structure, form=of.form, values=of.values, start_samples=samples
    )


LAWS: dict[str, Callable[[], FrictionLaw]] = {
    "lugre": lambda: law("lugre", {}, **LUGRE),
    "with load": lambda: law("lugre_load", {}, **LUGRE, mu=0.04),
    "stops": lambda: law("parfam_s", STOPS, **STOP_VALUES),
    "extended": lambda: law("parfam_hx", HX, **HX_VALUES),
}


@pytest.mark.parametrize("name", LAWS)
def test_a_law_over_a_log(name: str, unchanged: Unchanged) -> None:
    of, found = LAWS[name](), {}
    for rest in (False, True):
        way = path(3, seconds=4.0, from_rest=rest)
        given = {"t": way.t, "dq": way.dq, "q": way.q, "tau_load": way.load}
        start = tuple(0.01 * (k + 1) for k in range(len(of.form.memory)))
        joints = predict_joints(
            [of, of],
            t=way.t,
            **{n: np.stack([v, 0.5 * v], 1) for n, v in given.items() if n != "t"},
        )
        found[str(rest)] = {
            "torque": predict(of, **given), "from": predict(of, **given, start=start),
            "joints": joints, "states": compute_states(of, **given),
            "shown": predict(of, **given, shown=[0.5 * way.dq, way.q + 0.1, 2.0 * way.load]),
            "bare": predict(of, t=way.t, dq=way.dq),
            "first": evaluate.first_states(of, 0.007, 0.2, 5.0),
        }  # fmt: skip
    unchanged(found, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", ["lugre", "stops"])
def test_an_estimated_start(name: str, unchanged: Unchanged) -> None:
    of = LAWS[name]()
    found = {}
    for share in (-0.8, 0.3):
        start = tuple(share * x for x in ((0.02,) if name == "lugre" else (1.0, 0.0, 0.5, 1.0)))
        record = along(of, path(4, seconds=3.0), start=start[: len(of.form.memory)])
        for samples in (0, 1, 5):
            found[f"{share} {samples}"] = record_start(sampled(of, samples), record)
    unchanged(found, rtol=1e-3, atol=1e-5)


# --- problems over logs -----------------------------------------------------------------------


@pytest.mark.parametrize("state", ["paper", "generalised", "bristle"])
@pytest.mark.parametrize("how", ["exact", "euler"])
def test_columns_of_logs_from_rest(state: str, how: str, unchanged: Unchanged) -> None:
    of = LAWS["with load"]()
    records = [along(of, path(k, seconds=3.0, from_rest=k > 0), log=str(k)) for k in range(2)]
    samples = JointRows.from_records(records, coefficients=6)
    structure = {"linear": ["1", "dq", "h", "dh"], "units": [], "state": state}
    problem = trial.pose(structure, samples, how)
    low, high = problem.bounds.T
    point = low + (0.2 if how == "euler" else 0.4) * (high - low)
    weights = (samples.log_index == 0).astype(float)
    started = separable.Separable(
        problem.form, problem.space, samples, problem.discretisation, (0.5,)
    )
    unchanged({
        "columns": problem.columns(point)[::37].tolist(), "solved": problem.solve(point),
        "residual": problem._residual(point, weights), "of all": problem._residual(point, None),
        "polished": problem.solve(problem.polish(point, evaluations=2))[1],
        "started": started.columns(point)[::37].tolist(),
        "inside": problem.numbers(problem.point(dict.fromkeys(problem.space.names, 1e9))),
    }, rtol=1e-5, atol=1e-7)  # fmt: skip


def test_a_search_draws_the_given_points(
    records: list[FrictionRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = trial.pose(
        {"linear": ["1", "dq", "h"], "units": []}, JointRows.from_records(records, coefficients=5)
    )
    told: list[tuple[int, int]] = []
    monkeypatch.setattr(separable, "step", lambda done, of: told.append((done, of)))
    calls = []
    search = scipy.optimize.differential_evolution

    def seen(function: object, bounds: object, **options: object) -> object:
        calls.append({k: options[k] for k in ("popsize", "maxiter", "tol")})
        return search(function, bounds, **options)

    monkeypatch.setattr(scipy.optimize, "differential_evolution", seen)
    problem.search(np.random.default_rng(0), effort=3)
    assert calls == [{"popsize": 10, "maxiter": 3, "tol": 1e-4}]
    assert told[0] == (1, 4)
    assert told == [(k, 4) for k in range(1, len(told) + 1)]


def test_ripple_must_gain_and_pay(
    records: list[FrictionRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    samples = JointRows.from_records(records, coefficients=5)
    tau = np.sign(samples.dq) + samples.dq + 3.0 * np.cos(101.0 * samples.q)
    tau += 0.5 * np.random.default_rng(0).normal(size=len(tau))
    samples = JointRows(**(vars(samples) | {"tau": tau}))
    base = np.stack([np.sign(samples.dq), samples.dq, np.ones_like(tau)], axis=1)
    ones = np.ones_like(tau)
    assert estimator.select_waves(base, samples, ones, 101.0).frequencies[:1] == (101,)
    with monkeypatch.context() as changed:
        changed.setattr(estimator, "has_significant_gain", lambda *_: False)
        assert estimator.select_waves(base, samples, ones, 101.0).frequencies == ()
    monkeypatch.setattr(estimator, "MIN_GAIN", 0.99)
    monkeypatch.setattr(estimator, "has_significant_gain", lambda *_: True)
    assert estimator.select_waves(base, samples, ones, 101.0).frequencies == ()
    monkeypatch.setattr(estimator, "MIN_GAIN", -1.0)
    assert (
        len(estimator.select_waves(base, samples, ones, 101.0).frequencies)
        == estimator.MAX_FREQUENCIES
    )
