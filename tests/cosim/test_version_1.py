"""Files from before results were typed can be read and are written unchanged."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.loop.traces import LoopOutcome
from cosim.study.results import SavedRun
from cosim.study.scores import Comparison
from hesr_model.audit import audit
from hesr_model.audit.properties import read_properties, write_properties
from hesr_model.errors import ArtifactError
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.support.typed_files import from_json, to_json

FILES = Path(__file__).parents[1] / "version_1"


def written(name: str) -> Any:
    return json.loads((FILES / name).read_text(encoding="utf-8"))


def test_a_friction_model_is_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Everything is unchanged except the audit, which is derived and no longer run."""
    monkeypatch.setattr(audit, "audit", lambda *_: pytest.fail("the audit was run"))
    model = FrictionModel.read(FILES / "law.json")
    expected = written("law.json")
    for joint in expected["joints"]:
        assert joint.pop("audit")
    assert model.to_json() == expected
    model.write(tmp_path / "law.json")
    text = json.loads((tmp_path / "law.json").read_text(encoding="utf-8"))
    assert list(text["joints"][0]) == list(expected["joints"][0])


def test_a_rigid_body_is_read(tmp_path: Path) -> None:
    expected = written("rigid_body.json")
    assert expected.pop("physical") is False
    expected["kind"] = "free"
    RigidBody.read(FILES / "rigid_body.json").write(tmp_path / "body.json")
    assert json.loads((tmp_path / "body.json").read_text(encoding="utf-8")) == expected


def test_the_scores_of_a_run_are_read() -> None:
    for data in written("evaluation.json").values():
        found = to_json(from_json(Comparison, data, Path("x"), "scores"))
        for ratios in found["ratios"]["laws"].values():
            for ratio in ratios:
                newer_keys = ("p", "adjusted_p", "others")
                assert {key: ratio.pop(key) for key in newer_keys} == dict.fromkeys(newer_keys)
                ratio.pop("on_other_logs", None)
        assert found["ratios"].pop("references") == {}
        assert found["ratios"].pop("by_joint") == {}
        assert all(not scores.pop("rmse_rest") for scores in found["laws"].values())
        newer = {"leading": [], "per_log": None, "bands": {}, "detectable": [], "seconds": []}
        newer |= {"zero_phase": {}, "unseparated": [], "log_count": 0}
        assert found == data | newer


def test_the_description_of_a_run_is_read() -> None:
    expected = written("run.json") | {"truth": "", "written": {}}
    del expected["format"]
    assert to_json(SavedRun.read(FILES / "run.json")) == expected


def test_the_findings_of_the_physics_checks_are_read(tmp_path: Path) -> None:
    write_properties(tmp_path / "found.json", read_properties(FILES / "properties.json"))
    found = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    for model in found["laws"].values():
        for joint in model["joints"]:
            for newer in ("nested", "start", "drive"):
                assert joint["findings"].pop(newer)["verdict"] == "not run"
            for finding in joint["findings"].values():
                assert finding["plot"].pop("units") == ["", ""]  # they were part of the labels
    assert found["laws"] == written("properties.json")["laws"]


def test_a_closed_loop_with_schemes_as_text_is_read() -> None:
    data = written("closed_loop.json")
    loop = from_json(LoopOutcome, data, Path("closed_loop.json"), "a closed loop")
    assert to_json(loop) == data
    first, *_, lost = loop.tracking
    assert first.law is StandIn.VELOCITY_ONLY
    assert np.all(np.isnan(lost.mean))
    assert lost.failures
    assert {row.scheme.source for row in loop.tracking} == {"desired", "measured", "filtered"}
    assert {row.scheme.Kx for row in loop.tracking} == {0.0, 5.0}
    assert "payload 1 kg, identified" in {row.scheme.change for row in loop.sweeps}


@pytest.mark.parametrize(
    "scheme",
    [
        Scheme(compensation="none"),
        Scheme(compensation="torque_error", Kx=1.0 / 3.0),
        Scheme(compensation="servo_inversion", Kx=-20.0, source="filtered", friction_gain=1e-7),
        Scheme(compensation="none", source="measured", change="payload 1 kg, identified: known"),
    ],
)
def test_a_scheme_equals_its_name(scheme: Scheme) -> None:
    assert Scheme.from_name(scheme.name) == scheme


@pytest.mark.parametrize(
    "name", ["", "pid", "none, Kx = fast", "none, friction of true velocity", "none, none", "none:"]
)
def test_an_unknown_scheme_is_reported_with_file_and_key(name: str) -> None:
    data = written("closed_loop.json")
    data["long"][1]["scheme"] = name
    with pytest.raises(ArtifactError) as caught:
        from_json(LoopOutcome, data, Path("closed_loop.json"), "a closed loop")
    said = str(caught.value)
    assert said.startswith("closed_loop.json: not a closed loop (key 'long.1.scheme")
    assert said.endswith(".")
