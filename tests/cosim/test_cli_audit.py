"""The command `hesr test --kind passivity`: proofs, cycles and unreadable input."""

from pathlib import Path

import pytest
from small_study import Hesr, hesr_here

from hesr_model.fitting.estimator import registry
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def test_table_i_is_refuted_by_its_cycles(hesr: Hesr) -> None:
    answer = hesr("test", "uf850-table1", "--verbose")
    assert answer.code == 1, answer.err
    assert answer.out.startswith("uf850-table1: passivity refuted on joint1, joint2; ")
    assert "; tested on 816 sequences " in answer.out
    assert " on joint3" in answer.out.splitlines()[0]
    assert hesr("test", "uf850-table1", "--fail-on", "never", "--quiet").code == 0
    said = " ".join(answer.out.split())
    assert "joint1: not passive, refuted by a cycle: 12.4 J per cycle" in said
    assert "joint2: not passive, refuted by a cycle: 20.6 J per cycle" in said
    assert "joint3: tested on 816 sequences " in said


def test_a_law_of_stops_is_proven_passive(hesr: Hesr, tmp_path: Path) -> None:
    structure = {"stops": [["1", 0]], "viscous": ["1"]}
    law = FrictionLaw(
        name="parfam_s",
        structure=structure,
        form=registry()["parfam_s"].form(structure),
        values={"F_1": 2.0, "sigma_2": 3.0, "tau_0": 0.1},
    )
    model = FrictionModel(
        law="parfam_s", robot="bench", joints=("j1",), laws=(law,), sample_time=0.01
    )
    model.write(tmp_path / "law.json")
    said = " ".join(hesr("test", tmp_path / "law.json", "--verbose").out.split())
    assert "j1: passive, proven at any step: S = 3e-05 x_1^2 + 0.1 q; F(x_1) = 2 >= 0" in said


def test_other_artifacts_than_laws_are_refused(hesr: Hesr) -> None:
    answer = hesr("test", "lugre")
    assert answer.code == 2
    assert "neither a friction model (.json)" in answer.err
