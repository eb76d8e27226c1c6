"""The circle of measuring on the twin: plan, simulated log, inspection, run, next plan."""

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from containing import Containing
from documents import ROOT
from small_study import hesr_here

import hesr
from cosim.study.forecast import FORMAT, SUFFIX, Forecast
from cosim.study.verdict import read_verdict
from hesr.extras.excite.sequel import Knowledge
from hesr_model.errors import ArgumentError, ConfigError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.inference.covariance import Covariance
from hesr_model.laws.lugre import LuGre
from hesr_model.logs.tables import read_table

VALUES = {
    "sigma_0": 3000.0,
    "sigma_1": 10.0,
    "sigma_2": 15.0,
    "F_c": 10.0,
    "F_s": 13.0,
    "v_s": 0.08,
    "tau_0": 0.0,
}


def commands(text: str) -> list[list[str]]:
    """Return the commands of indented lines, with continued ones joined."""
    lines = text.replace("\\\n", " ").split("\n")
    return [shlex.split(line) for line in lines if line.startswith("    hesr ")]


@pytest.mark.ci
def test_the_circle_closes_without_an_edit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "twin"
    made = hesr.new(folder, twin=True)
    assert made.joints == ("joint1", "joint2", "joint3")
    circle = commands((folder / "README.txt").read_text(encoding="utf-8"))
    assert [words[1] for words in circle] == [*["excite", "simulate", "inspect", "run"] * 2]
    assert circle == commands((ROOT / "docs" / "measure.md").read_text(encoding="utf-8"))[1:]
    call = hesr_here(capsys, monkeypatch)
    monkeypatch.chdir(folder)
    for words in circle:
        answer = call(*words[1:])
        assert answer.code == 0, f"{words}: {answer.err}"
    plan = folder / "logs" / f"next_friction{SUFFIX}"
    assert plan.read_bytes() == (folder / f"next_friction{SUFFIX}").read_bytes()
    expected = Forecast.from_logs([folder / "logs" / "next_friction.csv"])
    assert expected is not None
    verdict = read_verdict(folder / "results" / "next")
    assert verdict is not None
    assert verdict.planned.startswith("Planned motion: standard errors are ")
    assert verdict.planned in " ".join(verdict.sentences)
    models = {
        law: FrictionModel.read(folder / "results" / "next" / "laws" / f"{law}.json")
        for law in expected.widths
    }
    assert 0.5 < np.median(list(expected.ratios(models).values())) < 2.5
    # Laws of the first run were fitted to the planned motion only.
    log, motion = (read_table(folder / part / "next_friction.csv") for part in ("logs", "."))
    planned = motion.numbers(["t", "q1", "q2", "q3"])
    recorded = log.numbers(["t", "q1", "q2", "q3"])
    assert np.abs(recorded - planned[: len(recorded)]).max() < 0.06
    # Every motion has a log now.
    with pytest.raises(ConfigError, match="has a log"):
        hesr.simulate(folder / "twin.toml")
    other, settings = folder / "other.toml", folder / "two.toml"
    text = (folder / "robot.toml").read_text(encoding="utf-8")
    text = text.replace('["joint1", "joint2", "joint3"]', '["joint2", "joint3"]')
    other.write_text(text.replace("[101.0, 101.0, 101.0]", "[101.0, 101.0]"), encoding="utf-8")
    settings.write_text("[limits]\nvelocity = [1.0, 1.0]\n", encoding="utf-8")
    after, output = folder / "results" / "next", folder / "x.csv"
    with pytest.raises(ConfigError, match="results of this version"):
        hesr.excite(other, settings=settings, after=after, output=output)


def test_a_twin_has_no_other_robot(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="'twin' excludes 'robot'; it"):
        hesr.new(tmp_path / "twin", "arm.urdf", twin=True)
    made = hesr.new(tmp_path / "twin", twin=True)
    names = {file.name for file in made.folder.iterdir()}
    assert names == {
        *("robot.toml", "uf850.xml", "plant.toml", "arm.toml"),
        *("twin.toml", "motion.toml", "README.txt"),
    }
    with pytest.raises(ArgumentError, match="'only' is for a sweep"):
        hesr.simulate(made.folder / "twin.toml", only=3)


def lugre(**values: float) -> FrictionLaw:
    return FrictionLaw(name="lugre", form=LuGre.form({}), values=VALUES | values)


def rows(speed: float, seconds: float = 20.0) -> dict[str, np.ndarray]:
    t = np.arange(0.0, seconds, 0.005)
    dq = speed * np.sin(2.0 * np.pi * 0.5 * t)
    return {"t": t, "dq": dq, "q": np.zeros_like(t), "tau_load": np.zeros_like(t)}


def with_covariance(law: FrictionLaw, names: tuple[str, ...]) -> FrictionLaw:
    matrix = np.eye(len(names))
    covariance = Covariance(
        names=names, within=matrix, between=1.0, degrees=0.0, carried=np.zeros_like(matrix)
    )
    return replace(law, covariance=covariance, standard_errors=dict.fromkeys(names, 1.0))


def known_of(law: FrictionLaw, log: dict[str, np.ndarray]) -> Knowledge:
    """What a run would know of a law that is right, with noise of 1 N.m."""
    torque = predict(law, t=log["t"], dq=log["dq"], q=log["q"], tau_load=log["tau_load"])
    noise = np.random.default_rng(0).normal(size=len(torque))
    return Knowledge(laws={"lugre": law}, logs=[log], torques=[torque + noise], speed=1.0)


def test_the_same_rows_again_shrink_errors_by_the_root_of_two() -> None:
    law = with_covariance(lugre(), ("sigma_2", "F_c", "v_s"))
    known = known_of(law, rows(0.5))
    for ratio in known.predict_shrinkage(law, rows(0.5)).values():
        assert ratio == pytest.approx(np.sqrt(0.5), rel=1e-6)
    assert known.predict_shrinkage(lugre(), rows(0.5)) == {}
    faster = known.predict_shrinkage(law, rows(1.0))
    assert faster["sigma_2"] < 0.6  # viscous friction shows at speed


def test_unseen_speeds_and_laws_that_differ_are_worth_more() -> None:
    law = with_covariance(lugre(), ("F_c", "sigma_2"))
    known = known_of(law, rows(0.1))
    assert known.score(rows(0.8)) > known.score(rows(0.1))
    other = with_covariance(lugre(v_s=0.3, F_s=20.0), ("F_c", "sigma_2"))
    both = replace(known, laws={"lugre": law, "other": other})
    gain = 0.25 * np.log1p(1.0) / 100
    assert both.score(rows(0.1)) > known.score(rows(0.1)) + gain


def test_a_better_law_promises_larger_errors_of_the_others() -> None:
    law, truth = with_covariance(lugre(), ("F_c", "sigma_2")), lugre(v_s=0.02)
    fast, slow = rows(0.8), rows(0.04)  # the laws differ at slow speeds
    known = known_of(law, fast)
    shrinking = known.predict_shrinkage(law, slow)
    assert known.predict_ratios(law, slow) == shrinking  # no law is better
    assert known.predict_ratios(lugre(), slow) == {}
    wrong = replace(known_of(truth, fast), laws={"lugre": law, "other": truth})
    for name, ratio in wrong.predict_ratios(law, slow).items():
        assert ratio > 2.0 * shrinking[name]


def test_a_run_is_compared_with_its_plan(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    assert Forecast.from_logs([log]) is None
    widths = {"lugre": {"j": {"F_c": 2.0, "sigma_2": 1.0}}, "dahl": {"j": {"F_c": 1.0}}}
    data = {"format": FORMAT, "widths": widths, "detectable": {"j": 1.1}}
    log.with_suffix(SUFFIX).write_text(json.dumps(data), encoding="utf-8")
    plan = Forecast.from_logs([tmp_path / "other.csv", log])
    assert plan is not None
    law = replace(lugre(), standard_errors={"F_c": 2.2, "sigma_2": 3.0})
    model = FrictionModel(law="lugre", robot="r", joints=("j",), laws=(law,), sample_time=0.005)
    ratios = plan.ratios({"lugre": model})
    assert ratios == {("lugre", "j", "F_c"): 1.1, ("lugre", "j", "sigma_2"): 3.0}
    assert plan.sentence({"lugre": model}, {"j": 1.2}) == Containing(
        "2.05 of the expected", "50 % of them within 25 %", "20 % show (10 % expected)"
    )
    assert plan.sentence({}, {}) == ""
