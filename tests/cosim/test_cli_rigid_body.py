"""Rigid-body commands beyond plain identification."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from small_study import Hesr, hesr_here, uf850
from small_twin import MOTIONS

from cosim.loop.excite import excite
from cosim.loop.motions import Motions
from fmu_src.arm.plant import Plant
from hesr_model.rigid_body.identification import RigidBody

ROBOT = uf850("robot.toml")


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("logs")
    (folder / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    return excite(Motions.read(folder / "motions.toml"), Plant.read(uf850("plant.toml")), folder)


def test_excite_writes_a_motion_its_reverse_and_a_picture(hesr: Hesr, tmp_path: Path) -> None:
    settings = tmp_path / "settings.toml"
    limits = "[limits]\nvelocity = [2.0, 2.0, 2.0]\n"
    settings.write_text(
        f"harmonics = 4\nperiod = [10.0, 12.0]\nstarts = 1\n{limits}", encoding="utf-8"
    )
    answer = hesr("excite", ROBOT, "-o", tmp_path / "motion.csv", "--settings", settings)
    assert answer.code == 0, answer.err
    condition, median = map(
        float, re.findall(r"condition number ([\d.]+).*?: ([\d.]+) in the median", answer.out)[0]
    )
    assert condition < median
    for name in ("motion.csv", "motion_reversed.csv", "motion.png"):
        assert (tmp_path / name).stat().st_size > 1000
    rows = np.genfromtxt(tmp_path / "motion.csv", delimiter=",", names=True)
    assert abs(rows["dq1"][0]) < 1e-9


def test_limits_that_admit_no_motion_are_refused(hesr: Hesr, tmp_path: Path) -> None:
    settings = tmp_path / "settings.toml"
    limits = "[limits]\nvelocity = [2.0, 2.0, 2.0]\ntorque = [200.0, 1e-4, 1e-4]\n"
    settings.write_text(limits, encoding="utf-8")
    answer = hesr("excite", ROBOT, "-o", tmp_path / "motion.csv", "--settings", settings)
    assert answer.code == 2
    assert answer.err.count("\n") == 1
    assert "the limits allow no motion" in answer.err
    assert not (tmp_path / "motion.csv").exists()


def test_a_physical_body_is_reported_as_such(
    hesr: Hesr, logs: dict[str, Path], tmp_path: Path
) -> None:
    output = tmp_path / "body.json"
    answer = hesr("identify", logs["excitation"], "--robot", ROBOT, "--physical", "-o", output)
    assert answer.code == 0, answer.err
    assert RigidBody.read(output).physical
    assert "Rigid body: physically possible." in answer.out


def test_the_body_is_chosen_unless_it_is_stated(
    hesr: Hesr, logs: dict[str, Path], tmp_path: Path
) -> None:
    output = tmp_path / "body.json"
    identify = ("identify", logs["excitation"], "--robot", ROBOT, "-o", output)
    answer = hesr(*identify)
    assert answer.code == 0, answer.err
    body = RigidBody.read(output)
    assert body.kind in ("nominal", "physical")  # the model file is the truth of the twin
    assert body.left_out_rmse.shape == (3,)
    assert body.sentence in answer.out
    assert hesr(*identify, "--body", "free").code == 0
    assert RigidBody.read(output).kind == "free"
    answer = hesr(*identify, "--body", "free", "--physical")
    assert answer.code == 2
    assert "--physical and --body free exclude each other" in answer.err


@pytest.mark.ci
def test_a_body_is_refined_with_the_fitted_friction(
    hesr: Hesr, logs: dict[str, Path], tmp_path: Path
) -> None:
    first, law, second = (tmp_path / f"{n}.json" for n in ("first", "law", "second"))
    runs = [
        ("identify", logs["excitation"], "--robot", ROBOT, "-o", first),
        (
            "fit",
            logs["sweep"],
            "--robot",
            ROBOT,
            "--rigid-body",
            first,
            "--law",
            "lugre",
            "-o",
            law,
        ),
        (
            "identify",
            logs["excitation"],
            "--robot",
            ROBOT,
            "--friction",
            law,
            "--rigid-body",
            first,
            "-o",
            second,
        ),
    ]
    for run in runs:
        answer = hesr(*run)
        assert answer.code == 0, answer.err
    before, after = RigidBody.read(first), RigidBody.read(second)
    assert np.all(np.abs(after.friction[:, 0]) < np.abs(before.friction[:, 0]))
    names = [file["name"] for file in json.loads(second.read_text())["provenance"]["files"]]
    assert {"law.json", "first.json"} <= set(names)


def test_a_log_without_payload_gives_a_zero_payload(
    hesr: Hesr, logs: dict[str, Path], tmp_path: Path
) -> None:
    body, loaded = tmp_path / "body.json", tmp_path / "loaded.json"
    pair = (logs["excitation"], "--reversed", logs["excitation_reversed"], "--robot", ROBOT)
    assert hesr("identify", *pair, "-o", body).code == 0
    answer = hesr("identify", *pair, "--payload", body, "-o", loaded)
    assert answer.code == 2
    assert answer.err.count("\n") == 1
    assert "payload" in answer.err
    assert not loaded.exists()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--friction", "law.json"), "--friction and --rigid-body must be given together"),
        (("--rigid-body", "b.json"), "--friction and --rigid-body must be given together"),
        (("--payload", "b.json", "--body", "free"), "--payload excludes --body"),
        (("--payload", "b.json", "--method", "paper"), "--payload excludes"),
        (("--method", "paper", "--body", "nominal"), "--method paper excludes --body nominal"),
        (
            ("--physical", "--friction", "law.json", "--rigid-body", "b.json"),
            "--body and --physical exclude --friction",
        ),
    ],
)
def test_exclusive_options_are_refused(
    hesr: Hesr, logs: dict[str, Path], tmp_path: Path, options: tuple[str, ...], sentence: str
) -> None:
    output = tmp_path / "body.json"
    answer = hesr("identify", logs["excitation"], "--robot", ROBOT, *options, "-o", output)
    assert answer.code == 2
    assert answer.err.startswith(f"hesr: {sentence}")
    assert answer.err.count("\n") == 1
    assert not output.exists()


def test_law_options_use_toml_syntax(hesr: Hesr, logs: dict[str, Path], tmp_path: Path) -> None:
    body, law = tmp_path / "body.json", tmp_path / "law.json"
    assert hesr("identify", logs["excitation"], "--robot", ROBOT, "-o", body).code == 0
    fit = ("fit", logs["sweep"], "--robot", ROBOT, "--rigid-body", body, "-o", law)
    answer = hesr(*fit, "--law", "parfam_v", "--option", "functions=tanh")
    assert answer.code == 2
    assert answer.err.startswith("hesr: --option is 'functions=tanh'; expected KEY=VALUE")
    answer = hesr(*fit, "--law", "parfam_v", "--option", 'functions=["tanh"]')
    assert answer.code == 0, answer.err
    assert json.loads(law.read_text())["provenance"]["options"] == {"functions": ["tanh"]}
