"""Repeated seeds of a twin's prediction study: variation, statistics and command."""

import json
from pathlib import Path

import numpy as np
import pytest
from small_study import STUDY, hesr_here
from small_twin import MOTIONS

from cosim.study.study import Study
from hesr.extras.studies.seeds import run_seeds, simulate_draw
from hesr_model.errors import ConfigError
from hesr_model.support.files import models_folder

TWIN = models_folder() / "uf850"


@pytest.fixture
def study(tmp_path: Path) -> Path:
    text = STUDY.format(robot=TWIN / "robot.toml", plant=TWIN / "plant.toml")
    (tmp_path / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    path = tmp_path / "study.toml"
    path.write_text(text.replace('"parfam_h"', '"lugre"', 1), encoding="utf-8")
    return path


def test_a_seed_determines_its_draw(study: Path) -> None:
    read = Study.read(study)
    first, again, other = (simulate_draw(read, seed, ["stribeck"]) for seed in (1, 1, 2))
    assert first == again
    assert set(first["unseen"]) == {"stribeck", "true friction"}
    assert np.all(
        np.abs(np.log(np.divide(first["unseen"]["stribeck"], other["unseen"]["stribeck"]))) > 1e-3
    )


@pytest.mark.ci
def test_the_command_runs_all_seeds(study: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    hesr = hesr_here(capsys, monkeypatch)
    answer = hesr("run", study, "--seeds", "2", "-o", tmp_path / "out")
    assert answer.code == 0, answer.err
    found = json.loads((tmp_path / "out" / "seeds.json").read_text(encoding="utf-8"))
    assert (found["seeds"], found["reference"]) == (2, "lugre")
    scores = found["tests"]["unseen"]
    drawn = [
        simulate_draw(Study.read(study), 3 + k, ["stribeck", "lugre"])["unseen"] for k in range(2)
    ]
    for joint, spread in enumerate(scores["rmse"]["stribeck"]):
        values = [d["stribeck"][joint] for d in drawn]
        assert spread["mean"] == pytest.approx(np.mean(values), rel=1e-12, abs=0.0)
        # Student's quantile for one degree of freedom, and the standard error of two values.
        half = 12.7062047 * abs(values[0] - values[1]) / 2.0
        assert spread["high"] - spread["mean"] == pytest.approx(half, rel=1e-6)
        ratio = np.sqrt(np.prod([d["stribeck"][joint] / d["lugre"][joint] for d in drawn]))
        assert scores["ratios"]["stribeck"][joint]["mean"] == pytest.approx(
            ratio, rel=1e-12, abs=0.0
        )
        assert f"{spread['mean']:.3f} [" in answer.out


def test_unsuitable_studies_are_refused(study: Path) -> None:
    with pytest.raises(ConfigError, match=r"'seeds' is 1; at least 2 are needed"):
        run_seeds(study, 1)
    text = study.read_text(encoding="utf-8")
    no_laws = study.with_name("none.toml")
    lines = [line for line in text.splitlines() if not line.startswith("laws")]
    no_laws.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(ConfigError, match="'seeds' needs the key 'laws'"):
        run_seeds(no_laws, 2)
    measured = study.with_name("measured.toml")
    before, _, after = text.partition("[twin]")
    measured.write_text(before + after[after.index("[logs]") :], encoding="utf-8")
    with pytest.raises(ConfigError, match="'seeds' needs a digital twin"):
        run_seeds(measured, 2)
