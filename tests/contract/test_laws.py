"""The contract of every law.

Tests are parametrised over the registry, so a newly registered law is tested without a change here.
"""

import inspect
import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from oracles import over_log
from oracles.stepper import Stepper
from registry_models import everyday
from threadpoolctl import threadpool_limits

from hesr_model.errors import ArtifactError, HesrError
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.inputs import INPUTS, MOVING
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import LawStepper, coefficient_array, predict
from hesr_model.friction.records import rmse
from hesr_model.rigid_body.friction_record import FrictionRecord

EXACT_ENOUGH = 1e-12
"""Tolerance relative to the largest torque, for two lowerings of the same expressions."""
GEAR_RATIO = 101.0


def measured(log: str, seed: int, *, seconds: float = 15.0, peak: float = 1.0) -> FrictionRecord:
    """A log of a joint whose friction follows no law exactly, with all optional signals.

    Parallel stick-slip elements, a level that falls with speed and rises with the load, viscous
    friction that bends with speed, ripple, an offset and noise; uneven time stamps and a rest.
    """
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.006, 0.016, round(seconds / 0.011)))
    rates = 2.0 * np.pi * np.array([0.1, 0.17, 0.29, 0.41])
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    dq = peak * np.sin(np.outer(t, rates) + phases) @ [0.35, 0.3, 0.2, 0.15]
    dq[len(t) // 2 : len(t) // 2 + 60] = 0.0
    q = np.concatenate([[0.0], np.cumsum(0.5 * (dq[1:] + dq[:-1]) * np.diff(t))])
    load = 20.0 * np.sin(q) + 4.0 * np.cos(2.0 * t)
    weights, deflections = np.array([4.0, 3.0, 2.0]), np.array([1e-3, 4e-3, 1.5e-2])
    elements, stuck = np.zeros(3), []
    for step in np.diff(q, prepend=q[0]):
        elements = np.clip(elements + step / deflections, -1.0, 1.0)
        stuck.append(weights @ elements)
    level = 1.0 + 0.3 * np.exp(-((dq / 0.1) ** 2)) + 0.01 * np.abs(load)
    tau = level * np.array(stuck) + 6.0 * dq - 1.5 * dq * np.abs(dq) + 0.4
    tau += 0.3 * np.cos(2.0 * GEAR_RATIO * q) + 0.2 * rng.normal(size=len(t))
    return FrictionRecord(
        log=log, joint="j1", t=t, dq=dq, q=q, tau_load=load, tau=tau, gear_ratio=GEAR_RATIO
    )


@cache
def training() -> tuple[FrictionRecord, ...]:
    return measured("one", 0), measured("two", 1, peak=0.7)


@cache
def unseen() -> FrictionRecord:
    return measured("three", 2, peak=0.9)


@cache
def fitted(name: str) -> FrictionLaw:
    return fit_joint(name, training(), seed=0)


def torque(law: FrictionLaw, data: FrictionRecord) -> np.ndarray:
    return predict(law, t=data.t, dq=data.dq, q=data.q, tau_load=data.tau_load)


def model_of(law: FrictionLaw) -> FrictionModel:
    """Two joints with the law; the second has different coefficients."""
    other = replace(law, values={name: 0.9 * value for name, value in law.values.items()})
    return FrictionModel(
        law=law.name, robot="bench", joints=("j1", "j2"), laws=(law, other), sample_time=0.011
    )


@pytest.fixture(
    params=[pytest.param(n, marks=() if n in everyday() else pytest.mark.soak) for n in registry()]
)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def law(name: str) -> FrictionLaw:
    return fitted(name)


# --- the estimator ----------------------------------------------------------------------------


def test_the_registry_holds_the_laws_of_hesr() -> None:
    assert {"stribeck", "lugre", "parfam_h"} <= set(registry())


def test_a_law_describes_itself(name: str) -> None:
    entry = registry()[name]
    assert entry.name == name
    assert re.fullmatch(r"[a-z][a-z0-9_]*", name)
    assert entry.title.strip()
    assert entry.as_text().startswith("tau = ")
    assert entry.__doc__
    assert entry.fit.__doc__


def test_titles_and_equations_are_unique() -> None:
    assert len({entry.title for entry in registry().values()}) == len(registry())
    # Laws of one equation differ by the fit.
    fits = {(entry.as_text(), entry.fit) for entry in registry().values()}
    assert len(fits) == len(registry())


def test_hyper_parameters_are_keywords_with_defaults(name: str) -> None:
    entry = registry()[name]
    entry()
    for parameter in list(inspect.signature(entry).parameters.values()):
        assert parameter.kind in (parameter.KEYWORD_ONLY, parameter.VAR_KEYWORD)
    assert list(inspect.signature(entry.fit).parameters) == ["self", "records", "rng"]


def test_a_structure_of_another_law_is_refused(name: str) -> None:
    entry = registry()[name]
    for structure in ({"no_such_key": 1}, {"no_such_key": []}):
        with pytest.raises(ArtifactError):
            entry.form(structure)
    try:
        form = entry.form({})
    except ArtifactError:
        return  # a family: needs a structure
    assert entry.form({}) == form


# --- over whole logs --------------------------------------------------------------------------


def test_torque_over_a_log_in_c_equals_numpy(law: FrictionLaw) -> None:
    """Checked for the fitted coefficients and for others."""
    rows = {n: getattr(unseen(), n) for n in ("t", "dq", "q", "tau_load")}
    for own in (law, *model_of(law).laws):
        found, expected = predict(own, **rows), over_log.predicted(own, **rows)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_steps_of_many_motions_in_c_equal_numpy(law: FrictionLaw) -> None:
    """Checked for the law's own coefficients and for different ones in each motion."""
    rng, motions = np.random.default_rng(3), 20
    dt, *inputs = rng.uniform(1e-4, 1e-2, motions), *rng.normal(size=(3, motions))
    x = 1e-3 * rng.normal(size=(len(law.form.memory), motions))
    others = np.outer(list(law.values.values()), np.linspace(0.9, 1.1, motions))
    for values in (None, others):
        found = LawStepper(law, values)(dt, *inputs, x)
        own = coefficient_array(law) if values is None else values
        expected = over_log.stepped(law, own, dt, inputs, x)
        for own, right in zip(found, expected, strict=True):
            largest = np.abs(right).max(initial=0.0)
            np.testing.assert_allclose(own, right, rtol=0, atol=1e-13 * largest)


# --- the fit ----------------------------------------------------------------------------------


def test_a_law_fits_hysteretic_friction(name: str, law: FrictionLaw) -> None:
    if registry()[name].baseline:  # at least not worse than nothing
        errors = np.concatenate([torque(law, data) - data.tau for data in training()])
        measured_torque = np.concatenate([data.tau for data in training()])
        assert rmse(errors) <= rmse(measured_torque)
        return
    for data in (*training(), unseen()):
        error = rmse(torque(law, data) - data.tau)
        assert error < 0.5 * np.std(data.tau), data.log


def test_the_same_seed_gives_the_same_fit(name: str, law: FrictionLaw) -> None:
    assert fit_joint(name, training(), seed=0) == law


def test_an_estimator_has_no_state_after_a_fit(name: str, law: FrictionLaw) -> None:
    estimator = registry()[name]()
    before = json.dumps(vars(estimator), default=str)
    with threadpool_limits(1):
        estimator.fit(training()[1:], np.random.default_rng(1))
    assert json.dumps(vars(estimator), default=str) == before


def test_the_fit_does_not_modify_the_records(name: str, law: FrictionLaw) -> None:
    for data, untouched in zip(
        training(), (measured("one", 0), measured("two", 1, peak=0.7)), strict=True
    ):
        for column in ("t", "dq", "q", "tau_load", "tau"):
            np.testing.assert_array_equal(getattr(data, column), getattr(untouched, column))


def first_rows(data: FrictionRecord, rows: int) -> FrictionRecord:
    columns = {n: v[:rows] for n, v in vars(data).items() if isinstance(v, np.ndarray)}
    return replace(data, **columns)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda data: replace(data, dq=np.abs(data.dq) + 0.1), "never reverses"),
        (lambda data: replace(data, dq=np.zeros_like(data.dq)), "never reverses"),
        (lambda data: first_rows(data, 1), "1 rows for"),
    ],
)
def test_data_that_do_not_determine_a_law_are_refused(
    name: str, spoil: Callable[[FrictionRecord], FrictionRecord], said: str
) -> None:
    entry = registry()[name]
    if entry.baseline and (said == "never reverses" or len(entry.form({}).coefficients) < 2):
        law = fit_joint(name, [spoil(unseen())], seed=0)
        assert np.all(np.isfinite(torque(law, unseen())))
        return
    with pytest.raises(HesrError) as caught:
        fit_joint(name, [spoil(unseen())], seed=0)
    assert "'j1'" in str(caught.value)
    assert said in str(caught.value)
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)


# --- the law ----------------------------------------------------------------------------------


def test_the_form_is_rebuilt_from_name_and_structure(name: str, law: FrictionLaw) -> None:
    assert law.name == name
    assert json.loads(json.dumps(dict(law.structure))) == dict(law.structure)
    assert registry()[name].form(law.structure) == law.form


def test_coefficients_have_names_units_and_descriptions(law: FrictionLaw) -> None:
    for coefficient in law.form.coefficients:
        assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", coefficient.name)
        assert re.fullmatch(r"1|1/\S+|[A-Za-z0-9.]+(/\S+)?", coefficient.unit)
        assert coefficient.description.strip()
    assert np.all(np.isfinite(list(law.values.values())))


def test_a_law_uses_known_inputs_only(law: FrictionLaw) -> None:
    assert set(law.form.inputs) <= set(INPUTS)
    data = first_rows(unseen(), 300)
    expected = torque(law, data)
    used = {symbol.name for symbol in law.form.inputs}
    assert "dq" in used or registry()[law.name].baseline
    for column in {"q", "tau_load"} - used:
        noise = 1e3 * np.random.default_rng(0).normal(size=300)
        np.testing.assert_array_equal(torque(law, replace(data, **{column: noise})), expected)


def test_a_whole_log_equals_the_log_step_by_step(law: FrictionLaw) -> None:
    data = first_rows(unseen(), 400)
    stepper = Stepper(law)
    rows = np.stack(
        [np.diff(data.t, prepend=data.t[0]), data.dq, data.q, data.tau_load], axis=1
    ).tolist()
    stepped = np.array([stepper.step(*row) for row in rows])
    np.testing.assert_allclose(
        torque(law, data), stepped, rtol=0, atol=EXACT_ENOUGH * np.abs(stepped).max()
    )


def test_the_past_does_not_depend_on_the_future(law: FrictionLaw) -> None:
    data = unseen()
    whole = torque(law, data)
    np.testing.assert_allclose(
        torque(law, first_rows(data, 500)),
        whole[:500],
        rtol=0,
        atol=EXACT_ENOUGH * np.abs(whole).max(),
    )


def test_a_law_is_finite_at_rest_and_beyond_the_trained_speeds(law: FrictionLaw) -> None:
    t = 0.01 * np.arange(500)
    still = np.zeros(500)
    assert np.all(np.isfinite(predict(law, t=t, dq=still)))
    largest = max(float(np.abs(data.tau).max()) for data in training())
    fast = predict(law, t=t, dq=1.5 * np.sin(2.0 * t), q=-0.75 * np.cos(2.0 * t), tau_load=still)
    assert np.abs(fast).max() < 4.0 * largest


def test_a_law_survives_its_file(law: FrictionLaw, tmp_path: Path) -> None:
    model = model_of(law)
    model.write(tmp_path / "law.json")
    found = FrictionModel.read(tmp_path / "law.json")
    assert found == model
    np.testing.assert_array_equal(torque(found.laws[0], unseen()), torque(law, unseen()))


@pytest.mark.parametrize(
    ("law", "need"), [(name, need) for name, law in registry().items() for need in law.needs]
)
def test_a_missing_input_of_the_records_is_named(law: str, need: str) -> None:
    lacking = replace(measured("log", 0), **{need: None})
    with pytest.raises(HesrError) as caught:
        fit_joint(law, [lacking], seed=0)
    assert f"law '{law}' needs the key '{need}'" in str(caught.value)


def test_a_start_in_motion_gives_no_kick(law: FrictionLaw) -> None:
    """The first torque is the steady one of the first inputs, for all trained speeds."""
    exact = replace(law, discretisation="exact")
    fastest = max(float(np.abs(data.dq).max()) for data in training())
    for speed in np.geomspace(MOVING, fastest, 12):
        for dq in (speed, -speed):
            tau = predict(
                exact,
                t=1e4 * np.arange(3),
                dq=np.full(3, dq),
                q=0.3 * np.ones(3),
                tau_load=4.0 * np.ones(3),
            )
            assert abs(tau[0] - tau[-1]) <= 0.05 * abs(tau[-1]), dq
