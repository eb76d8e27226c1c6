"""RBFNN-H and MLP-H: expressions, training and selection."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from hesr.extras.laws import mlp
from hesr.extras.laws.mlp import MlpH, Network, train_path
from hesr_model.errors import ArtifactError, FitError
from hesr_model.fitting.fit import fit_joint
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.laws import rbfnn
from hesr_model.laws.parfam import family
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.rbfnn import (
    MAX_TRIED_LAWS,
    NetworkInputs,
    RbfnnH,
    find_bounded_law,
    find_candidates,
)
from hesr_model.rigid_body.friction_record import FrictionRecord

ALPHA, BETA = 9.0, 30.0


def record(rows: int = 1500, seed: int = 0, *, noise: float = 0.05) -> FrictionRecord:
    """Friction that lags behind reversals and bends with speed; outside both networks' forms."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.006, 0.014, rows))
    dq = np.sin(1.3 * t + seed) * (0.6 + 0.4 * np.sin(0.31 * t))
    dq *= np.minimum((t - t[0]) / 0.2, 1.0)  # from rest, as laws begin
    dq[rows // 2 : rows // 2 + 40] = 0.0
    h, states = 0.0, []
    for step, target in zip(np.diff(t, prepend=t[0]), np.tanh(BETA * dq), strict=True):
        h = target + (h - target) * np.exp(-ALPHA * step)
        states.append(h)
    tau = 8.0 * np.array(states) / (1.0 + 0.2 * np.abs(dq)) + 3.0 * dq - 0.4
    tau += noise * rng.normal(size=rows)
    zero = np.zeros(rows)
    return FrictionRecord(log=f"run{seed}", joint="j1", t=t, dq=dq, q=zero, tau_load=zero, tau=tau)


@pytest.fixture(scope="module")
def records() -> list[FrictionRecord]:
    return [record(seed=0), record(seed=1)]


@pytest.fixture(scope="module")
def features(records: list[FrictionRecord]) -> HysteresisFeatures:
    samples = JointRows.from_records(records, coefficients=3)
    return HysteresisFeatures(rows=samples, discretisation="exact")


def cloud(rows: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(rows, 3))


def law_with(form_of: type[RbfnnH] | type[MlpH], structure: dict[str, int]) -> FrictionLaw:
    """Return a network with coefficients that make every term matter."""
    form = form_of.form(structure)
    numbers = np.random.default_rng(3).uniform(0.3, 1.5, len(form.coefficients))
    values = dict(zip((c.name for c in form.coefficients), numbers, strict=True))
    return FrictionLaw(name=form_of.name, structure=structure, form=form, values=values)


def columns_of(law: FrictionLaw, data: FrictionRecord) -> np.ndarray:
    features = HysteresisFeatures(
        rows=JointRows.from_records([data], coefficients=3), discretisation=law.discretisation
    )
    return features.columns(law.values["alpha"], law.values["beta"])


# --- expressions ------------------------------------------------------------------------------


def test_rbfnn_is_a_sum_of_gaussians() -> None:
    data = record(300)
    law = law_with(RbfnnH, {"centres": 3})
    x, v = columns_of(law, data)[:, 1:], law.values
    widths = np.array([v["s_dq"], v["s_h"], v["s_dh"]])
    expected = np.full(len(x), v["w_0"])
    for k in (1, 2, 3):
        centre = np.array([v[f"m{k}_dq"], v[f"m{k}_h"], v[f"m{k}_dh"]])
        expected += v[f"w_{k}"] * np.exp(-0.5 * np.sum(((x - centre) / widths) ** 2, axis=1))
    np.testing.assert_allclose(predict(law, t=data.t, dq=data.dq), expected, rtol=1e-12)


def test_mlp_is_a_sum_of_tanh() -> None:
    data = record(300)
    law = law_with(MlpH, {"hidden": 3})
    x, v = columns_of(law, data), law.values
    expected = np.full(len(x), v["c_0"])
    for k in (1, 2, 3):
        theta = [v[family.argument_name(k, feature)] for feature in family.FEATURES]
        expected += v[f"c_g{k}"] * np.tanh(x @ theta)
    np.testing.assert_allclose(predict(law, t=data.t, dq=data.dq), expected, rtol=1e-12)


def test_units_follow_from_the_inputs() -> None:
    units = {c.name: c.unit for c in RbfnnH.form({"centres": 2}).coefficients}
    assert (units["w_1"], units["m2_dq"], units["m2_h"], units["m2_dh"]) == (
        "N.m",
        "rad/s",
        "1",
        "1/s",
    )
    assert (units["s_dq"], units["s_h"], units["s_dh"]) == ("rad/s", "1", "1/s")


@pytest.mark.parametrize(
    ("estimator", "key", "largest"), [(RbfnnH, "centres", 40), (MlpH, "hidden", 16)]
)
def test_structures_of_other_laws_are_refused(
    estimator: type[RbfnnH] | type[MlpH], key: str, largest: int
) -> None:
    estimator.form({key: largest})
    for found in (0, -1, largest + 1, 2.0, "2", True, None):
        with pytest.raises(ArtifactError, match=f"'{key}', a whole number from 1 to {largest}"):
            estimator.form({key: found})
    with pytest.raises(ArtifactError, match="expected only"):
        estimator.form({key: 2, "width": 1.0})


def test_invalid_network_sizes_are_refused() -> None:
    for sizes in ((), (1,), (10, 41), (2.5,)):
        with pytest.raises(
            FitError, match=r"'centres' is .*; expected whole numbers from 2 to 40\."
        ):
            fit_joint("rbfnn_h", [record(300)], seed=0, options={"centres": sizes})
    for sizes in ((), (0,), (4, 17)):
        with pytest.raises(
            FitError, match=r"'hidden' is .*; expected whole numbers from 1 to 16\."
        ):
            fit_joint("mlp_h", [record(300)], seed=0, options={"hidden": sizes})


# --- inputs -----------------------------------------------------------------------------------


def test_standardised_inputs_convert_back_to_units(features: HysteresisFeatures) -> None:
    found = find_candidates(features, 2)
    assert len({(inputs.cell.alpha, inputs.cell.beta) for inputs in found}) == 2
    for inputs in found:
        np.testing.assert_allclose(inputs.z.mean(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(inputs.z.std(axis=0), 1.0)
        expected = features.columns(inputs.cell.alpha, inputs.cell.beta)[:, 1:]
        np.testing.assert_allclose(inputs.mean + inputs.spread * inputs.z, expected, atol=1e-12)


def test_networks_that_explode_are_skipped(records: list[FrictionRecord]) -> None:
    good = fit_joint("mlp_h", records, seed=0, options={"hidden": (2,), "cells": 1, "starts": 1})
    wild = replace(good, values={**good.values, "c_0": 1e3})
    assert find_bounded_law([wild, wild, good], records) is good

    made = []

    def endless() -> Iterator[FrictionLaw]:
        while True:
            made.append(wild)
            yield wild

    said = "joint 'j1': the torque"
    with pytest.raises(FitError, match=said):
        find_bounded_law(endless(), records)
    assert len(made) == MAX_TRIED_LAWS


# --- RBF: centres and weights -----------------------------------------------------------------


def test_centres_lie_among_the_rows_and_depend_on_the_seed() -> None:
    z = cloud(800)
    centres, spacing = rbfnn.cluster_centres(z, 12, np.random.default_rng(1))
    again, _ = rbfnn.cluster_centres(z, 12, np.random.default_rng(1))
    np.testing.assert_array_equal(centres, again)
    assert centres.shape == (12, 3)
    assert np.all((centres >= z.min(axis=0)) & (centres <= z.max(axis=0)))
    distance = np.linalg.norm(centres[:, None] - centres, axis=2) + np.diag(np.full(12, np.inf))
    assert spacing == pytest.approx(distance.min(axis=1).mean())


def test_repeated_rows_give_fewer_centres() -> None:
    z = np.repeat(cloud(5), 100, axis=0)
    centres, spacing = rbfnn.cluster_centres(z, 12, np.random.default_rng(0))
    assert len(centres) <= 5
    assert 0.0 < spacing < np.inf


def test_ridge_regression_shrinks_weights_but_not_the_offset() -> None:
    rng = np.random.default_rng(5)
    columns, tau = rng.normal(size=(200, 4)) + 1.0, rng.normal(size=200) + 7.0
    ridges = (0.0, 0.3, 1e9)
    bias, weights = rbfnn.ridge_weights(columns, tau, ridges)
    for i, ridge in enumerate(ridges[:2]):
        # The same problem as plain least squares with one additional row per weight.
        rows = np.vstack(
            [
                np.column_stack([np.ones(200), columns]),
                np.column_stack([np.zeros(4), np.sqrt(200 * ridge) * np.eye(4)]),
            ]
        )
        expected = np.linalg.lstsq(rows, np.concatenate([tau, np.zeros(4)]))[0]
        np.testing.assert_allclose(np.append(bias[i], weights[:, i]), expected, rtol=1e-9)
    np.testing.assert_allclose(weights[:, 2], 0.0, atol=1e-6)
    assert bias[2] == pytest.approx(tau.mean())


def test_left_out_rows_do_not_train_the_rbf(features: HysteresisFeatures) -> None:
    samples = features.rows
    z = find_candidates(features, 1)[0].z
    honest = rbfnn.cross_validate(z, samples, 10, np.random.default_rng(0))
    assert honest.shape == (len(rbfnn.WIDTH_FACTORS), len(rbfnn.RIDGES))
    # Trained on both logs, a network would fit half of an offset between them.
    moved = replace(samples, tau=samples.tau + 50.0 * samples.log_index)
    shifted = rbfnn.cross_validate(z, moved, 10, np.random.default_rng(0))
    assert np.all(np.sqrt(shifted) > 40.0)
    assert np.sqrt(honest.min()) < 1.0


# --- MLP: training ----------------------------------------------------------------------------


def teacher(hidden: int, seed: int = 2) -> Network:
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(4, hidden))
    return Network(bias=0.2, gains=rng.uniform(0.5, 1.0, hidden), theta=theta, cost=0.0)


def cost_of(network: Network, z: np.ndarray, y: np.ndarray, decay: float) -> float:
    shrunk = np.sum(network.gains**2) + np.sum(network.theta**2)
    return float(np.mean((network.output(z) - y) ** 2) + decay * shrunk)


def test_training_recovers_the_generating_network() -> None:
    z = cloud(600)
    y = teacher(2).output(z)
    start = np.random.default_rng(0).normal(size=(4, 3))
    trained = train_path(z, y, start, (1e-3, 1e-5, 1e-7, 1e-9))
    errors = [rmse(network.output(z) - y) for network in trained]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-3


def test_training_ends_at_a_flat_cost() -> None:
    z, decay = cloud(500), 1e-3
    y = teacher(3).output(z) + 0.1 * np.random.default_rng(1).normal(size=500)
    (network,) = train_path(z, y, np.random.default_rng(4).normal(size=(4, 2)), (decay,) * 6)[-1:]
    assert network.cost == pytest.approx(cost_of(network, z, y, decay))
    step = 1e-4
    for name in ("bias", "gains", "theta"):
        value = np.asarray(getattr(network, name))
        for place in np.ndindex(value.shape):
            moved = []
            for sign in (-1.0, 1.0):
                changed = value.copy()
                changed[place] += sign * step
                moved.append(cost_of(replace(network, **{name: changed}), z, y, decay))
            assert abs(moved[1] - moved[0]) / (2 * step) < 2e-3
            assert min(moved) > network.cost - 1e-6


def test_a_trained_network_becomes_an_equal_law(
    features: HysteresisFeatures, records: list[FrictionRecord]
) -> None:
    (inputs,) = find_candidates(features, 1)
    network = Network(
        bias=0.3,
        gains=np.array([0.5, -2.0, 1.0]),
        theta=np.random.default_rng(0).normal(size=(4, 3)),
        cost=0.0,
    )
    law = MlpH()._build_network_law(inputs, network, 1.5, 4.0)
    gains = [law.values[f"c_g{k}"] for k in (1, 2, 3)]
    assert gains == [8.0, 4.0, 2.0]
    expected = 1.5 + 4.0 * network.output(inputs.z)
    first = len(records[0].t)
    for data, part in zip(records, (expected[:first], expected[first:]), strict=True):
        np.testing.assert_allclose(predict(law, t=data.t, dq=data.dq), part, atol=1e-11)


def test_left_out_rows_do_not_train_the_mlp(features: HysteresisFeatures) -> None:
    samples = features.rows
    z = find_candidates(features, 1)[0].z
    y = (samples.tau - samples.tau.mean()) / samples.tau.std()
    starts = [np.random.default_rng(0).normal(size=(4, 3))]
    honest = mlp.cross_validate(z, y, samples.folds, starts)
    assert honest.shape == (len(mlp.DECAYS),)
    shifted = mlp.cross_validate(z, y + 20.0 * samples.log_index, samples.folds, starts)
    assert np.all(np.sqrt(shifted) > 15.0)
    assert np.sqrt(honest.min()) < 0.2


# --- fits -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["rbfnn_h", "mlp_h"])
@pytest.mark.parametrize("discretisation", ["exact", "euler"])
def test_a_fit_predicts_an_unseen_log_to_the_noise(
    name: str, discretisation: str, records: list[FrictionRecord]
) -> None:
    law = fit_joint(name, records, seed=0, options={"discretisation": discretisation, "cells": 2})
    unseen = record(seed=2)
    error = rmse(predict(law, t=unseen.t, dq=unseen.dq) - unseen.tau)
    assert law.discretisation == discretisation
    assert error < 0.05 * float(np.std(unseen.tau))


@pytest.mark.parametrize("name", ["rbfnn_h", "mlp_h"])
def test_a_single_log_is_left_out_in_blocks(name: str) -> None:
    law = fit_joint(name, [record(2000)], seed=3, options={"cells": 1})
    unseen = record(seed=2)
    assert rmse(predict(law, t=unseen.t, dq=unseen.dq) - unseen.tau) < 0.6


def test_a_log_mostly_at_rest_suffices_for_training() -> None:
    data = record(1500)
    rest = 1000
    padded = replace(
        data,
        t=np.concatenate([data.t, data.t[-1] + 0.01 * np.arange(1, rest + 1)]),
        **{
            name: np.concatenate([getattr(data, name), np.full(rest, value)])
            for name, value in (("dq", 0.0), ("q", 0.0), ("tau_load", 0.0), ("tau", -0.4))
        },
    )
    for name in ("rbfnn_h", "mlp_h"):
        law = fit_joint(name, [padded], seed=0, options={"cells": 1})
        error = rmse(predict(law, t=padded.t, dq=padded.dq) - padded.tau)
        assert error < 0.2 * float(np.std(padded.tau))


def test_inputs_without_spread_do_not_divide_by_zero(features: HysteresisFeatures) -> None:
    still = replace(features.rows, dq=np.zeros_like(features.rows.dq))
    inputs = NetworkInputs.from_features(
        HysteresisFeatures(rows=still, discretisation="exact"),
        find_candidates(features, 1)[0].cell,
    )
    np.testing.assert_array_equal(inputs.z, 0.0)
