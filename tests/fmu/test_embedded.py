"""The model embedded in an FMU."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from fmu_src import export_fmu
from fmu_src.friction.embedded_model import EMBEDDED_MODEL, read_embedded_model
from hesr_model.errors import ArtifactError
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange

pytestmark = pytest.mark.ci

STRUCTURE = {
    "linear": ["1", "dq", "h", "h_load"],
    "units": [{"g": "tanh", "arguments": ["h"]}],
    "state": "bristle",
    "ripple": {"gear_ratio": 101.0, "orders": [2, 8]},
}


def model() -> FrictionModel:
    """A model with all optional parts."""
    form = estimator("parfam_hx").form(STRUCTURE)
    values = {c.name: 0.1 + 0.01 * k for k, c in enumerate(form.coefficients)}
    law = FrictionLaw(
        name="parfam_hx",
        structure=STRUCTURE,
        form=form,
        values=values,
        start=(0.25,),
        start_samples=5,
        standard_errors={"c_h": 0.02},
    )
    plain = FrictionLaw(
        name="stribeck",
        form=estimator("stribeck").form({}),
        values={"F_c": 1.0 / 3.0, "F_s": 2.0, "v_s": 0.1, "sigma_2": 3.0, "tau_0": 1e-17},
        discretisation="euler",
    )
    trained = TrainedRange(
        sample_time=0.01, dq=(-1.0, 1.0), q=(-2.0, 1.0), tau_load=(-5.0, 9.0), tau=(-9.0, 9.0)
    )
    return FrictionModel(
        law="mixed",
        robot="bench",
        joints=("j1", "j2"),
        laws=(law, plain),
        sample_time=0.01,
        trained=(trained, replace(trained, dq=(-0.5, 0.6))),
        provenance={"seed": 3, "files": [{"name": "log.csv", "sha256": "0" * 64}]},
    )


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_fmu(model(), tmp_path_factory.mktemp("embedded") / "Friction.fmu")


def test_the_embedded_model_is_unchanged(fmu: Path) -> None:
    assert read_embedded_model(fmu) == model()


def test_the_fmu_of_an_extracted_model_is_identical(fmu: Path, tmp_path: Path) -> None:
    found = read_embedded_model(fmu)
    assert found is not None
    again = export_fmu(found, tmp_path / "Friction.fmu")
    assert again.read_bytes() == fmu.read_bytes()


def test_the_published_model_is_extracted(table1: FrictionModel, table1_fmu: Path) -> None:
    assert read_embedded_model(table1_fmu) == table1


def changed(fmu: Path, target: Path, change: Callable[[bytes], bytes | None]) -> Path:
    """The FMU with another model or without one."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            data: bytes | None = old.read(name)
            if name == EMBEDDED_MODEL:
                data = change(old.read(name))
            if data is not None:
                new.writestr(name, data)
    return target


def test_an_fmu_without_a_model_gives_none(fmu: Path, tmp_path: Path) -> None:
    assert read_embedded_model(changed(fmu, tmp_path / "bare.fmu", lambda _: None)) is None


def without(key: str) -> Callable[[bytes], bytes]:
    def change(data: bytes) -> bytes:
        read = json.loads(data)
        del read[key]
        return json.dumps(read).encode()

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data[:-20], "friction_model.json is damaged"),
        (lambda data: b"\xff\xfe" + data, "friction_model.json is damaged"),
        (lambda _: b"[]", "not a friction model"),
        (lambda _: b"null", "not a friction model"),
        (without("joints"), "'joints' is missing"),
        (without("sample_time"), "'sample_time' is missing"),
        (lambda data: data.replace(b'"stribeck"', b'"strybeck"'), "law 'strybeck' is unknown"),
        (lambda data: data.replace(b'"bristle"', b'"brittle"'), "state 'brittle' is unknown"),
        (lambda data: data.replace(b'"N.m.s/rad"', b'"N.m"'), "has the unit 'N.m'"),
    ],
)
def test_a_damaged_model_names_the_fmu(
    fmu: Path, tmp_path: Path, change: Callable[[bytes], bytes], said: str
) -> None:
    damaged = changed(fmu, tmp_path / "damaged.fmu", change)
    with pytest.raises(ArtifactError) as caught:
        read_embedded_model(damaged)
    assert str(caught.value).startswith(f"{damaged}: ")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_files_than_fmus_are_refused(fmu: Path, tmp_path: Path) -> None:
    missing, text, cut = (tmp_path / name for name in ("missing.fmu", "text.fmu", "cut.fmu"))
    text.write_text("no archive", encoding="utf-8")
    cut.write_bytes(fmu.read_bytes()[:2000])
    for file, said in (
        (missing, "no such file"),
        (text, "not a readable FMU"),
        (cut, "not a readable FMU"),
        (tmp_path, "is not a file"),
    ):
        with pytest.raises(ArtifactError, match=said) as caught:
            read_embedded_model(file)
        assert str(file) in str(caught.value)
