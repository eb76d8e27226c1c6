"""Refusals of schemas: a code, a place and a key for each bad value."""

import ast
import pickle
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import cosim
import fmu_src
import hesr
import hesr_model
from cosim.loop.motions import Motions
from cosim.study.study import Study
from cosim.systems.system import SystemSpec
from fmu_src.arm.table import SignalTable
from hesr.extras.fleet.study import FleetStudy
from hesr.extras.sweep.study import SweepStudy
from hesr_model.errors import ConfigError
from hesr_model.findings import Finding
from hesr_model.health.examine import HealthError, require_sound
from hesr_model.motions.excitation import ExcitationSettings
from hesr_model.robots.description import RobotDescription
from hesr_model.support.typed_files import Config

PLACE = Path("folder/file.toml")
ROBOT = {"name": "r", "model": "r.urdf", "joints": ["a", "b"]}
STUDY = {"name": "s", "robot": "r.toml", "logs": {"identification": ["i"], "test": {"t": ["x"]}}}
COMPONENT = {"name": "one", "fmu": "one.fmu"}
SYSTEM = {"step": 0.1, "stop": 1.0, "components": [COMPONENT]}
INPUT = {"variables": ["one.u"], "low": 0.0, "high": 1.0}
SWEEP = {
    "system": "s.toml",
    "runs": 8,
    "inputs": [INPUT],
    "outputs": [{"name": "y", "signal": "one.y"}],
}
FLEET = {"types": {"arm": {"robot": "r.toml", "logs": "arm/*"}}}
SINE = {
    "name": "m",
    "kind": "sine",
    "frequency": 1.0,
    "amplitude": [1.0],
    "offset": [0.0],
    "periods": 1,
}
SINES = {"motions": [SINE]}
SIGNALS = {"outputs": {"q": {"unit": "rad", "sensors": [{"s": 1.0}]}}}
LOSSES = {"joints": ["a"], "constant": [1.0]}
UNIT = [[1.0, 0.0], [0.0, 1.0]]


def changed(data: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Return data with other values by dotted key; None removes a key."""
    result = dict(data)
    for dotted, value in changes.items():
        key, _, rest = dotted.partition(".")
        if rest:
            result[key] = changed(result.get(key, {}), {rest: value})
        elif value is None:
            del result[key]
        else:
            result[key] = value
    return result


# Schema, valid data, changes, code, key.
REFUSALS: list[tuple[type[Config], dict[str, Any], dict[str, Any], str, str]] = [
    (RobotDescription, ROBOT, {"nmae": "r"}, "key.unknown", "nmae"),
    (RobotDescription, ROBOT, {"name": None}, "key.missing", "name"),
    (
        RobotDescription,
        ROBOT,
        {"log.columns": {"q": "", "dq": ""}},
        "log.no_motion",
        "log.columns.q",
    ),
    (RobotDescription, ROBOT, {"log.filter_cutoff": 0}, "value.greater_than", "log.filter_cutoff"),
    (RobotDescription, ROBOT, {"log.unit": "deg"}, "key.unknown", "log.unit"),
    (RobotDescription, ROBOT, {"log.units.q": "feet"}, "log.unit", "log.units.q"),
    (RobotDescription, ROBOT, {"log.units.t": 0.0}, "log.unit_zero", "log.units.t"),
    (RobotDescription, ROBOT, {"log.columns": ["t", "t"]}, "log.names_differ", "log.columns.names"),
    (
        RobotDescription,
        ROBOT,
        {"log.columns.q_link": "l{}", "transmission.matrix": UNIT},
        "robot.q_link",
        "log.columns.q_link",
    ),
    (
        RobotDescription,
        ROBOT,
        {"transmission.matrix": [[1.0], [1.0]]},
        "transmission.square",
        "transmission.matrix",
    ),
    (
        RobotDescription,
        ROBOT,
        {"transmission.matrix": [[1.0, 0.0], [0.0, 0.0]]},
        "transmission.ratio_zero",
        "transmission.matrix.1.1",
    ),
    (
        RobotDescription,
        ROBOT,
        {"transmission": {"matrix": UNIT, "friction": ["joint"]}},
        "transmission.friction_entries",
        "transmission.friction",
    ),
    (
        RobotDescription,
        ROBOT,
        {"transmission.matrix": [[1.0, 1.0], [1.0, 1.0]]},
        "transmission.singular",
        "transmission.matrix",
    ),
    (
        RobotDescription,
        ROBOT,
        {"transmission.matrix": UNIT, "gear_ratio": [2.0, 2.0]},
        "robot.gear_ratio",
        "gear_ratio",
    ),
    (Study, STUDY, {"robot": None}, "key.missing", "robot"),
    (Study, STUDY, {"logs.tests": {}}, "key.unknown", "logs.tests"),
    (Study, STUDY, {"logs.test.t": []}, "study.test_empty", "logs.test.t"),
    (Study, STUDY, {"logs.test.t": ["i"]}, "study.test_trained", "logs.test.t"),
    (Study, STUDY, {"laws": ["lugre", "lugre"]}, "study.names", "laws"),
    (Study, STUDY, {"bands": [{"test": "t", "name": "t"}]}, "study.names", "logs.test"),
    (Study, STUDY, {"bands": [{"test": "u", "name": "b"}]}, "study.band_test", "bands"),
    (Study, STUDY, {"refinement": "in_turn"}, "study.refinement_law", "refinement.law"),
    (
        Study,
        STUDY,
        {"physical": True, "body": "free"},
        "study.body",
        "body",
    ),
    (
        Study,
        STUDY,
        {"twin": {"plant": "p", "motions": "m", "truth": "t"}},
        "study.truth_signals",
        "twin.signals",
    ),
    (SystemSpec, SYSTEM, {"step": None}, "key.missing", "step"),
    (SystemSpec, SYSTEM, {"step": 0.3}, "system.multiple", "stop"),
    (SystemSpec, SYSTEM, {"step": 1e-12}, "system.most_steps", "stop"),
    (
        SystemSpec,
        SYSTEM,
        {"components": [COMPONENT | {"step": 0.15}]},
        "system.multiple",
        "components.0.step",
    ),
    (SystemSpec, SYSTEM, {"components": [COMPONENT, COMPONENT]}, "system.names", "components"),
    (SweepStudy, SWEEP, {"inputs": []}, "sweep.nothing", "inputs"),
    (SweepStudy, SWEEP, {"runs": None}, "sweep.runs", "runs"),
    (SweepStudy, SWEEP, {"design": "grid"}, "sweep.grid_runs", "runs"),
    (SweepStudy, SWEEP, {"design": "sobol", "runs": 7}, "sweep.sobol", "runs"),
    (SweepStudy, SWEEP, {"inputs": [INPUT, INPUT]}, "sweep.names", "inputs"),
    (SweepStudy, SWEEP, {"inputs": [INPUT | {"low": 2.0}]}, "sweep.range", "inputs.0.low"),
    (
        SweepStudy,
        SWEEP,
        {"inputs": [INPUT | {"mean": 1.0}]},
        "sweep.distribution",
        "inputs.0.variables",
    ),
    (
        SweepStudy,
        SWEEP,
        {"inputs": [INPUT | {"variables": ["one.u", "one.u"]}]},
        "sweep.listed_twice",
        "inputs.0.variables",
    ),
    (
        SweepStudy,
        SWEEP,
        {"correlated": [{"variables": ["one.a"], "mean": [0.0, 1.0], "covariance": [[1.0]]}]},
        "sweep.sizes",
        "correlated.0.covariance",
    ),
    (
        SweepStudy,
        SWEEP,
        {"correlated": [{"variables": ["one.a"], "mean": [0.0], "covariance": [[-1.0]]}]},
        "sweep.covariance",
        "correlated.0.covariance",
    ),
    (FleetStudy, FLEET, {"types": {}}, "value.too_short", "types"),
    (FleetStudy, FLEET, {"types.arm.log": "x"}, "key.unknown", "types.arm.log"),
    (FleetStudy, FLEET, {"types.arm.robot": None}, "key.missing", "types.arm.robot"),
    (FleetStudy, FLEET, {"level": 1.0}, "value.less_than", "level"),
    (Motions, SINES, {"motions": [SINE, SINE]}, "motions.names", "motions"),
    (ExcitationSettings, {}, {"period": [3.0, 2.0]}, "excitation.period", "period"),
    (
        ExcitationSettings,
        {},
        {"limits.position": [[0.0, 1.0], [1.0, 0.0]]},
        "limits.position",
        "limits.position.1",
    ),
    (
        SignalTable,
        SIGNALS,
        {"outputs.q.noise": [0.0, 0.0]},
        "table.entries",
        "outputs.q.noise",
    ),
    (SignalTable, SIGNALS, {"losses": LOSSES | {"direct": [1.0]}}, "losses.needs", "losses.speed"),
    (
        SignalTable,
        SIGNALS,
        {"losses": LOSSES | {"load": [1.0]}},
        "losses.carriers",
        "losses.carriers",
    ),
]


def refusal(schema: type[Config], data: dict[str, Any]) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        schema.from_data(PLACE, data)
    return caught.value


@pytest.mark.parametrize(("schema", "data"), {r[0]: r[1] for r in REFUSALS}.items())
def test_the_data_are_valid_before_they_are_changed(schema, data) -> None:
    schema.from_data(PLACE, data)


@pytest.mark.parametrize(("schema", "data", "changes", "code", "key"), REFUSALS)
def test_a_refusal_has_code_place_and_key(schema, data, changes, code, key) -> None:
    error = refusal(schema, changed(data, changes))
    assert (error.code, error.where, error.key) == (code, str(PLACE), key)
    assert re.fullmatch(r"folder/file\.toml: [^\n]+[.?]", str(error))


def test_a_refusal_keeps_its_attributes_between_processes() -> None:
    error = pickle.loads(pickle.dumps(refusal(Study, changed(STUDY, {"robot": None}))))
    assert (error.code, error.where, error.key) == ("key.missing", str(PLACE), "robot")


def test_a_place_in_front_keeps_code_and_key() -> None:
    error = ConfigError("key 'q' is 0.", code="log.unit", key="log.units.q").add_place("robot.toml")
    assert (error.code, error.where, error.key) == ("log.unit", "robot.toml", "log.units.q")
    assert str(error) == "robot.toml: key 'q' is 0."


def test_missing_keys_are_named_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        RobotDescription.from_data(PLACE, {"log": {}})
    assert caught.value.code == "key.missing"
    assert "'name', 'model' and 'joints'" in str(caught.value)


def read_raised_texts() -> Iterator[tuple[str, str]]:
    """Yield place and text of each string in a `raise` of the product, but the command line's."""
    for package in (hesr_model, fmu_src, cosim, hesr):
        folder = Path(package.__file__).parent
        for path in sorted(folder.rglob("*.py")):
            if path.is_relative_to(Path(hesr.__file__).parent / "cli"):
                continue
            tree = ast.parse(path.read_text(encoding="utf-8"))
            raised = [node for node in ast.walk(tree) if isinstance(node, ast.Raise)]
            for node in (part for statement in raised for part in ast.walk(statement)):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    yield f"{path.name}:{node.lineno}", node.value


def test_errors_of_python_name_parameters_and_no_options() -> None:
    """The command line replaces parameters by options (`format_for_command_line`)."""
    texts = list(read_raised_texts())
    assert len(texts) > 500
    options = [(place, text) for place, text in texts if re.search(r"(?<![\w-])--[a-z]", text)]
    assert options == []


def test_refused_logs_are_accepted_in_the_words_of_the_caller() -> None:
    finding = Finding(check="torque-sign", found="the torque of 'j1' has another sign")
    with pytest.raises(HealthError) as caught:
        require_sound([finding, replace(finding, check="zeros")], ())
    assert "accept=['torque-sign', 'zeros']." in str(caught.value)
    sentence = caught.value.format_for_command_line({"accept": "--accept"})
    assert "--accept torque-sign --accept zeros." in sentence
