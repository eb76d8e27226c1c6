"""Commands for friction that is followed: the adaptive FMU, and the monitor of logs."""

from dataclasses import replace
from pathlib import Path

from adaptive_models import model
from fmpy import read_model_description
from small_study import hesr_here

from hesr_model.artifacts import write_model
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.laws.lugre import LuGre


def test_an_adaptive_fmu(tmp_path: Path, capsys, monkeypatch) -> None:
    hesr = hesr_here(capsys, monkeypatch)
    law, fmu = tmp_path / "law.json", tmp_path / "Adaptive.fmu"
    values = {"sigma_0": 4e4, "sigma_1": 0.0, "sigma_2": 14.0, "F_c": 12.0, "F_s": 14.0,
              "v_s": 0.1, "tau_0": 0.3}  # fmt: skip
    own = FrictionLaw(name="lugre", form=LuGre.form({}), values=values)
    write_model(law, replace(model(own), law="lugre"))
    for more, sentence in (
        (("--power",), "--adaptive goes with neither --power nor --properties."),
        (("--format", "modelica"), "--adaptive needs --format fmu, but the format is 'modelica'."),
    ):
        answer = hesr("export", law, "--adaptive", *more, "-o", fmu)
        assert (answer.code, answer.err.strip()) == (2, f"hesr: {sentence}")
    answer = hesr("export", law, "--adaptive", "-o", fmu)
    assert answer.code == 0, answer.err
    assert {v.name for v in read_model_description(fmu).modelVariables} >= {"level[1]", "adapt"}
