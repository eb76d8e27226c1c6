"""Saved results: bit-exact round trips, and one sentence for each mistake in a file."""

import json
import os
import platform
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from containing import Containing
from hypothesis import given, settings
from hypothesis import strategies as st

from hesr_model.errors import ArtifactError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.model_file import MODEL_FORMAT
from hesr_model.inference.covariance import Covariance
from hesr_model.laws.parfam import family
from hesr_model.rigid_body.identification import RIGID_BODY_FORMAT, RigidBody
from hesr_model.support.files import models_folder, newest, provenance, sha256
from hesr_model.support.typed_files import read_json, write_json

TABLE_1 = models_folder() / "uf850" / "table1.json"
FULL = {
    "linear": ["1", "dq", "h", "dh"],
    "units": [{"g": "tanh", "arguments": ["1", "dq", "h", "dh"]}],
}


def parfam(values: list[float], **more: Any) -> FrictionLaw:
    form = family.form(FULL)
    names = [c.name for c in form.coefficients]
    return FrictionLaw(
        name="parfam_h",
        structure=FULL,
        form=form,
        values=dict(zip(names, values, strict=True)),
        **more,
    )


def model_of(*laws: FrictionLaw) -> FrictionModel:
    return FrictionModel(
        law="parfam_h",
        robot="bench",
        joints=tuple(f"j{k}" for k, _ in enumerate(laws, start=1)),
        laws=laws,
        sample_time=1.0 / 94.0,
        provenance={"seed": 3, "files": [], "note": "é"},
    )


@pytest.fixture(scope="module")
def table_1() -> FrictionModel:
    return FrictionModel.read(TABLE_1)


# --- round trips ------------------------------------------------------------------------------


def test_a_covariance_is_saved_with_its_law(tmp_path: Path) -> None:
    law = parfam([1.0] * 11, covariance=covariance_of_two(("c_h", "c_dh")))
    model_of(law).write(tmp_path / "law.json")
    found = FrictionModel.read(tmp_path / "law.json")
    assert found == model_of(law)
    assert found != model_of(replace(law, covariance=covariance_of_two(("c_h", "alpha"))))


def test_a_covariance_must_match_its_names(tmp_path: Path) -> None:
    def change(data: dict[str, Any]) -> None:
        first(data)["covariance"] = {
            "names": ["alpha"], "within": [[1.0, 0.0], [0.0, 1.0]], "between": 1.0, "degrees": 0.0,
            "carried": [[0.0]],
        }  # fmt: skip

    assert "shape (2, 2); expected (1, 1)" in refused(changed(tmp_path, change))


def test_a_published_model_survives_a_round_trip(table_1: FrictionModel, tmp_path: Path) -> None:
    table_1.write(tmp_path / "law.json")
    assert FrictionModel.read(tmp_path / "law.json") == table_1


@settings(max_examples=30)
@given(
    st.lists(st.floats(-1e100, 1e100), min_size=11, max_size=11),
    st.floats(-1e3, 1e3),
    st.sampled_from(["exact", "euler"]),
)
def test_every_number_is_read_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, values: list[float], start: float, how: str
) -> None:
    path = tmp_path_factory.mktemp("artifact") / "law.json"
    model = model_of(parfam(values, discretisation=how, start=(start,)), parfam(values))
    model.write(path)
    found = FrictionModel.read(path)
    assert found == model
    # Equality ignores the sign of a zero.
    numbers = [np.array([*law.values.values(), *law.start]) for law in (*model.laws, *found.laws)]
    assert numbers[0].tobytes() == numbers[2].tobytes()
    assert numbers[1].tobytes() == numbers[3].tobytes()


def test_the_same_model_gives_the_same_bytes(table_1: FrictionModel, tmp_path: Path) -> None:
    for name in ("a.json", "b.json"):
        table_1.write(tmp_path / name)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_a_file_holds_kind_names_values_and_units(table_1: FrictionModel, tmp_path: Path) -> None:
    table_1.write(tmp_path / "law.json")
    data = json.loads((tmp_path / "law.json").read_text(encoding="utf-8"))
    assert data["format"] == MODEL_FORMAT
    first = data["joints"][0]
    assert first["joint"] == "joint1"
    assert first["coefficients"]["alpha"] == {"value": 11.37, "unit": "1/s"}
    assert first["structure"]["units"][0]["g"] == "tanh"
    assert first["discretisation"] == "euler"
    assert first["start"] == [0.0]


@pytest.fixture
def rigid_body() -> RigidBody:
    rng = np.random.default_rng(0)
    names = ("j1.m", "j1.mx", "j2.m", "j2.mx")
    return RigidBody(
        robot="bench",
        joints=("j1", "j2"),
        names=names,
        parameters=rng.normal(size=4) / 3.0,
        base=(0, 3),
        standard_errors=rng.uniform(size=2),
        condition=23.4567890123456789,
        ridge=0.0,
        friction=rng.normal(size=(2, 3)),
        rmse=rng.uniform(size=2),
        rows=4000,
        logs=("one", "two"),
        method="stacked",
        weighting="wls",
        covariance=covariance_of_two(("j1.m", "j2.mx")),
    )


def covariance_of_two(names: tuple[str, str]) -> Covariance:
    root = np.random.default_rng(1).normal(size=(2, 2)) / 3.0
    return Covariance(
        names=names, within=root @ root.T, between=7.0 / 3.0, degrees=5.5, carried=root.T @ root
    )


def test_a_rigid_body_is_read_back_bit_for_bit(rigid_body: RigidBody, tmp_path: Path) -> None:
    path = tmp_path / "rigid_body.json"
    replace(rigid_body, provenance={"seed": None}).write(path)
    found = RigidBody.read(path)
    for name in ("parameters", "standard_errors", "friction", "rmse"):
        assert getattr(found, name).tobytes() == getattr(rigid_body, name).tobytes()
        assert getattr(found, name).shape == getattr(rigid_body, name).shape
    for name in (
        *("robot", "joints", "names", "base", "condition", "ridge", "rows", "logs"),
        *("method", "weighting"),
    ):
        assert getattr(found, name) == getattr(rigid_body, name)
    assert found.covariance == rigid_body.covariance


def test_older_files_without_a_covariance_are_read(rigid_body: RigidBody, tmp_path: Path) -> None:
    path = tmp_path / "rigid_body.json"
    replace(rigid_body, provenance={"seed": None}).write(path)
    data = read_json(path, "hesr-rigid-body-1")
    del data["covariance"]
    write_json(path, {"format": "hesr-rigid-body-1", **data})
    assert RigidBody.read(path).covariance is None
    data = json.loads(path.read_text())
    assert data["format"] == RIGID_BODY_FORMAT
    assert data["provenance"] == {"seed": None}
    assert data["base"] == ["j1.m", "j2.mx"]


def test_provenance_names_files_with_hashes_seed_and_versions(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,q1\n")
    source = provenance(files=[path], seed=7, note="x")
    assert source["files"] == [{"name": "log.csv", "sha256": sha256(path)}]
    assert source["seed"] == 7
    assert source["note"] == "x"
    assert source["versions"]["numpy"] == version("numpy")
    assert source["versions"]["hesr"] == version("hesr")
    assert source["versions"]["python"] == platform.python_version()
    assert str(tmp_path) not in json.dumps(source)


# --- refusals ---------------------------------------------------------------------------------

Change = Callable[[dict[str, Any]], object]


def refused(path: Path, read: Callable[[Path], object] = FrictionModel.read) -> str:
    """Error sentence for a file, without the leading file name."""
    with pytest.raises(ArtifactError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith(".")
    return str(caught.value).removeprefix(f"{path}: ")


def changed(folder: Path, change: Change) -> Path:
    """The file of Table I with one change."""
    data = json.loads(TABLE_1.read_text(encoding="utf-8"))
    change(data)
    path = folder / "law.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


def first(data: dict[str, Any]) -> dict[str, Any]:
    joint: dict[str, Any] = data["joints"][0]
    return joint


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            lambda d: d.update(format="hesr-rigid-body-1"),
            "'format' is 'hesr-rigid-body-1', expected 'hesr-friction-model-1'.",
        ),
        (lambda d: d.pop("format"), "'format' is None, expected 'hesr-friction-model-1'."),
        (lambda d: d.pop("robot"), "key 'robot' is missing."),
        (lambda d: d.pop("provenance"), "key 'provenance' is missing."),
        (lambda d: first(d).pop("joint"), "key 'joints.0.joint' is missing"),
        (lambda d: first(d).pop("structure"), "key 'joints.0.structure' is missing"),
        (lambda d: first(d).pop("discretisation"), "key 'joints.0.discretisation' is missing"),
        (
            lambda d: first(d)["coefficients"]["alpha"].pop("unit"),
            "key 'joints.0.coefficients.alpha.unit' is missing",
        ),
        (
            lambda d: first(d).update(discretisation="rk4"),
            "not a friction model (key 'joints.0.discretisation': Input should be 'exact' or "
            "'euler').",
        ),
        (
            lambda d: first(d)["coefficients"]["alpha"].update(unit="1/min"),
            "coefficient 'alpha' has the unit '1/min', expected '1/s'.",
        ),
        (
            lambda d: first(d)["coefficients"].pop("beta"),
            "law 'parfam_h': coefficient 'beta' is missing; expected c_0, c_h, c_dh, c_g1, "
            "theta1_0, theta1_dq, theta1_h, theta1_dh, alpha, beta.",
        ),
        (
            lambda d: first(d)["coefficients"].update(gamma={"value": 1.0, "unit": "1"}),
            "law 'parfam_h': coefficient 'gamma' is unknown; expected c_0, c_h, c_dh, c_g1, "
            "theta1_0, theta1_dq, theta1_h, theta1_dh, alpha, beta.",
        ),
        (
            lambda d: first(d)["structure"].update(units=400 * first(d)["structure"]["units"]),
            "joint 'joint1' has 2003 coefficients",
        ),
        (
            lambda d: first(d)["coefficients"]["alpha"].update(value=float("nan")),
            "law 'parfam_h': coefficient 'alpha' is nan.",
        ),
        (
            lambda d: first(d)["coefficients"]["alpha"].update(value=float("inf")),
            "law 'parfam_h': coefficient 'alpha' is inf.",
        ),
        (
            lambda d: first(d)["coefficients"]["alpha"].update(value="fast"),
            "not a friction model (key 'joints.0.coefficients.alpha.value': Input should be a "
            "valid number, unable to parse string as a number).",
        ),
        (
            lambda d: first(d).update(start=[0.0, 0.0]),
            "law 'parfam_h': 2 start values for 1 states.",
        ),
        (
            lambda d: first(d).update(start=[float("nan")]),
            "law 'parfam_h': start value of 'h' is nan.",
        ),
        (
            lambda d: d.update(sample_time=0.0),
            "model 'parfam_h': sample time is 0.0",
        ),
        (lambda d: d.update(joints=[]), "friction model 'parfam_h': 0 laws for 0 joints."),
        (
            lambda d: first(d)["structure"].update(linear=["1", "ddq"]),
            "ParFam feature 'ddq' is unknown; known are 1, dq, h, dh, h_load, h_bump.",
        ),
        (
            lambda d: first(d)["structure"].update(linear=[["h"]]),
            "ParFam feature '['h']' is unknown; known are 1, dq, h, dh, h_load, h_bump.",
        ),
        (
            lambda d: first(d)["structure"].update(linear=["h", "h"]),
            "friction law: 'c_h' is used twice",
        ),
        (
            lambda d: first(d)["structure"].update(depth=2),
            "keys ['depth', 'linear', 'units']; expected 'linear'",
        ),
        (
            lambda d: first(d)["structure"]["units"][0].update(g="tan"),
            "ParFam unit {'g': 'tan', 'arguments': ['1', 'dq', 'h', 'dh']} needs 'g' from tanh, "
            "sin, cos, exp and 'arguments'.",
        ),
        (
            lambda d: first(d)["structure"]["units"][0].update(arguments=[]),
            "ParFam unit {'g': 'tanh', 'arguments': []}",
        ),
        (
            lambda d: first(d).update(law="stribeck", structure={"k": 1}),
            "law 'stribeck' has no structure, found {'k': 1}.",
        ),
    ],
)
def test_mistakes_in_a_model_are_reported(tmp_path: Path, change: Change, sentence: str) -> None:
    assert refused(changed(tmp_path, change)) == Containing(sentence)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.update(joints=3),
        lambda d: d.update(joints=["joint1"]),
        lambda d: d.update(sample_time="soon"),
        lambda d: d.update(sample_time=None),
        lambda d: first(d).update(law=["parfam_h"]),
        lambda d: first(d).update(coefficients=[1.0, 2.0]),
        lambda d: first(d)["coefficients"].update(alpha=11.37),
        lambda d: first(d).update(structure=None),
        lambda d: first(d)["structure"].update(units=[3]),
        lambda d: first(d)["structure"].update(linear=None),
        lambda d: first(d).update(start=0.0),
        lambda d: first(d).update(start=["h"]),
        lambda d: d.update(provenance=[1]),
    ],
)
def test_data_of_another_kind_are_refused(tmp_path: Path, change: Change) -> None:
    assert refused(changed(tmp_path, change)).startswith("not a friction model (")


def test_an_unknown_law_lists_the_known_ones(tmp_path: Path) -> None:
    said = refused(changed(tmp_path, lambda d: first(d).update(law="lugree")))
    assert said.startswith("law 'lugree' is unknown; known are ")
    for name in ("stribeck", "lugre", "parfam_h"):
        assert name in said


def test_other_files_are_refused(tmp_path: Path) -> None:
    assert refused(tmp_path / "none.json") == "no such file."
    path = tmp_path / "law.json"
    for content in (b"", b"{", b"\xff\xfe{}", b"{'format': 1}"):
        path.write_bytes(content)
        assert refused(path).startswith("not a readable JSON file (")
    for content in ("[]", "3", "null", '"hesr-friction-model-1"'):
        path.write_text(content)
        assert refused(path) == "'format' is None, expected 'hesr-friction-model-1'."
    assert refused(tmp_path).startswith("not a readable JSON file (")


def test_mistakes_in_a_rigid_body_are_reported(rigid_body: RigidBody, tmp_path: Path) -> None:
    path = tmp_path / "rigid_body.json"
    rigid_body.write(path)
    data = json.loads(path.read_text())

    def said(change: Change) -> str:
        copy = json.loads(json.dumps(data))
        change(copy)
        path.write_text(json.dumps(copy))
        return refused(path, RigidBody.read)

    assert said(lambda d: d.pop("parameters")) == "key 'parameters' is missing."
    assert said(lambda d: d.pop("friction")) == "key 'friction' is missing."
    assert said(lambda d: d.update(format=MODEL_FORMAT)) == (
        "'format' is 'hesr-friction-model-1', expected 'hesr-rigid-body-1'."
    )
    for change in (
        lambda d: d.update(parameters=[1.0]),
        lambda d: d["parameters"].update({"j1.m": "heavy"}),
        lambda d: d.update(base=["j9.m"]),
        lambda d: d.update(rows=None),
        lambda d: d.update(friction=[["x"]]),
    ):
        assert said(change).startswith("not a rigid body (")


def test_a_file_of_another_format_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text('{"format": "hesr-study-1"}')
    with pytest.raises(ArtifactError, match="expected 'a-format'"):
        read_json(path, "a-format")


def test_json_without_an_object_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    for text in ("[]", "7", '"key"'):
        path.write_text(text)
        with pytest.raises(ArtifactError, match=r"JSON file \(it holds no keys\)"):
            read_json(path)


def test_non_finite_numbers_are_never_written(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text("{}")
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(path, {"x": float("nan")})
    assert path.read_text() == "{}"
    assert [p.name for p in tmp_path.iterdir()] == ["x.json"]


# --- no code from files -----------------------------------------------------------------------


def test_nothing_in_a_file_is_run_as_code(tmp_path: Path) -> None:
    """Replace every text of a file in turn by code that would create a file."""
    trace = tmp_path / "trace"
    code = f"__import__('pathlib').Path({str(trace)!r}).touch()"

    def places(data: Any) -> list[tuple[Any, Any]]:
        items = data.items() if isinstance(data, dict) else enumerate(data)
        found = []
        for key, value in list(items):
            if isinstance(value, (dict, list)):
                found += places(value)
            else:
                found.append((data, key))
        return found

    exec(code)
    assert trace.exists()  # the code does work
    trace.unlink()
    for k in range(len(places(json.loads(TABLE_1.read_text())))):

        def replace(data: dict[str, Any], k: int = k) -> None:
            holder, key = places(data)[k]
            holder[key] = code

        path = changed(tmp_path, replace)
        with suppress(ArtifactError):
            FrictionModel.read(path)
        assert not trace.exists()


def test_derived_files_have_the_date_of_the_newest_input(tmp_path: Path) -> None:
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for file, seconds in zip(files, (1_700_000_000, 1_600_000_000), strict=True):
        file.touch()
        os.utime(file, (0, seconds))
    assert newest(files) == "2023-11-14T22:13:20+00:00"
