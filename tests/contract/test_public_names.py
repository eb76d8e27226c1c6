"""Names of `import hesr_model`: few, documented, and the same for type checkers as at run time."""

import ast
import inspect
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from containing import OneSentence

import hesr_model
from hesr_model import FrictionModel, FrictionRecord, fit, registry
from hesr_model.errors import FitError, HesrError, SimulationError
from hesr_model.friction.predict import predict
from hesr_model.friction.records import predict_record

SOURCE = Path(hesr_model.__file__)


def test_every_public_name_exists_and_is_documented() -> None:
    assert set(hesr_model.__all__) <= set(dir(hesr_model))
    for name in hesr_model.__all__:
        value = getattr(hesr_model, name)
        assert value.__name__ == name
        assert inspect.getdoc(value)
    with pytest.raises(AttributeError, match="module 'hesr_model' has no attribute 'fitt'"):
        _ = hesr_model.fitt


def test_type_checkers_see_the_same_names() -> None:
    stub = ast.parse(SOURCE.with_suffix(".pyi").read_text(encoding="utf-8")).body
    imports = [node for node in stub if isinstance(node, ast.ImportFrom)]
    assert len(imports) == len(stub)
    assert sorted(node.names[0].asname or "" for node in imports) == hesr_model.__all__
    for node in imports:
        assert node.names[0].name == node.names[0].asname
        found = getattr(hesr_model, node.names[0].name)
        assert found is getattr(import_module(node.module or ""), node.names[0].name)
    assert (SOURCE.parent / "py.typed").is_file()


def test_the_import_loads_no_modules() -> None:
    code = (
        "import sys; before = set(sys.modules); import hesr_model; "
        "print(*set(sys.modules) - before)"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    ours = {name for name in loaded if name.startswith("hesr_model")}
    assert ours == {"hesr_model", "hesr_model.support", "hesr_model.support.lazy"}
    assert not {"numpy", "sympy", "scipy", "pinocchio"} & set(loaded)


def records(
    log: str, joints: tuple[str, ...] = ("a", "b"), rows: int = 800
) -> list[FrictionRecord]:
    """A log of joints whose friction has memory, with an arbitrary initial state."""
    t = 0.01 * np.arange(rows)
    made = []
    for k, joint in enumerate(joints):
        q = np.sin((1.0 + 0.3 * k) * t) + 0.4 * np.sin(2.7 * t + k)
        dq = np.gradient(q, t)
        memory = np.tanh(30.0 * (dq + 0.02 * np.gradient(dq, t)))
        tau = (4.0 + k) * memory + 3.0 * dq + 0.05 * np.random.default_rng(k).normal(size=rows)
        made.append(
            FrictionRecord(
                log=log,
                joint=joint,
                t=t,
                dq=dq,
                q=q,
                tau_load=10.0 * np.sin(q),
                tau=tau,
                gear_ratio=101.0,
            )
        )
    return made


@pytest.fixture(scope="module")
def model() -> FrictionModel:
    return fit("lugre", records("one"), records("two"), seed=3, robot="bench")


def test_fit_gives_a_model_of_all_joints(model: FrictionModel) -> None:
    assert (model.law, model.robot, model.joints) == ("lugre", "bench", ("a", "b"))
    assert model.provenance["seed"] == 3
    assert len(model.training_rmse) == 2
    again = fit("lugre", records("one"), records("two"), seed=3, robot="bench")
    assert again == model


def test_options_reach_the_estimator() -> None:
    with pytest.raises(FitError, match="law 'lugre' does not take these options"):
        fit("lugre", records("one"), options={"fast": True})


def test_predict_over_a_log_equals_the_records(model: FrictionModel) -> None:
    log = records("three")
    found = model.predict(log)
    assert found.shape == (800, 2)
    for k, record in enumerate(log):
        np.testing.assert_array_equal(found[:, k], predict_record(model.laws[k], record))


def test_predict_estimates_the_start_if_the_law_does() -> None:
    log = records("one")
    estimated = fit("parfam_hx", log)
    assert estimated.laws[0].start_samples
    arrays = {n: np.column_stack([getattr(r, n) for r in log]) for n in ("dq", "q", "tau_load")}
    without = estimated.predict(t=log[0].t, **arrays)
    measured = np.column_stack([r.tau for r in log])
    first = slice(0, 5)
    assert np.abs(estimated.predict(log) - measured)[first].mean() <= (
        np.abs(without - measured)[first].mean()
    )


def test_predict_over_arrays_equals_the_laws(model: FrictionModel) -> None:
    log = records("three")
    dq = np.column_stack([record.dq for record in log])
    found = model.predict(t=log[0].t, dq=dq)
    for k, law in enumerate(model.laws):
        np.testing.assert_array_equal(found[:, k], predict(law, t=log[0].t, dq=dq[:, k]))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"dq": np.zeros(10)},
            "'dq' has the shape (10,)",
        ),
        (
            {"tau_load": np.zeros((10, 3))},
            "'tau_load' has the shape (10, 3)",
        ),
        (
            {"t": np.array([0.0, 0.1, 0.1, *np.arange(1.0, 8.0)])},
            "t[2] is 0.1 s after 0.1",
        ),
    ],
)
def test_arrays_of_wrong_shape_are_refused(
    model: FrictionModel, change: dict[str, np.ndarray], sentence: str
) -> None:
    arrays = {"t": 0.1 * np.arange(10), "dq": np.zeros((10, 2))} | change
    with pytest.raises(SimulationError) as caught:
        model.predict(**arrays)
    assert str(caught.value) == OneSentence(sentence)


def test_records_of_other_joints_are_refused(model: FrictionModel) -> None:
    with pytest.raises(SimulationError) as caught:
        model.predict(records("three")[::-1])
    assert "friction model 'lugre': the records" in str(caught.value)


def test_predict_without_a_motion_is_a_type_error(model: FrictionModel) -> None:
    with pytest.raises(TypeError, match="arrays 't' and 'dq'"):
        model.predict(t=[0.0])  # type: ignore[call-overload]  # the mistake


@pytest.mark.parametrize(
    ("logs", "sentence"),
    [
        ([], "law 'lugre': no log given"),
        (
            [records("one"), records("two", ("a", "c"))],
            "law 'lugre': logs have different joints, a, b and a, c.",
        ),
    ],
)
def test_incompatible_logs_are_refused(logs: list[list[FrictionRecord]], sentence: str) -> None:
    with pytest.raises(FitError) as caught:
        fit("lugre", *logs)
    assert str(caught.value) == OneSentence(sentence)


def test_an_unknown_law_is_refused_by_name() -> None:
    with pytest.raises(HesrError, match=f"law 'no' is unknown; known are {', '.join(registry())}"):
        fit("no", records("one"))


def test_a_record_without_a_required_input_is_refused() -> None:
    needy = [name for name, law in registry().items() if "gear_ratio" in law.needs]
    assert needy
    lacking = [replace(record, gear_ratio=None) for record in records("one")]
    with pytest.raises(FitError, match="needs the key 'gear_ratio'"):
        fit(needy[0], lacking)
