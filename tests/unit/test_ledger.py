"""Ledgers of readers: what was meant is refused, what was not is a warning."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from containing import OneSentence

from hesr_model.audit.properties import read_properties
from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.ledger import Ledger, find_close_names, format_suggestion

USED = {"arm": ("name", "joint"), "joint": ("name", "limit")}
IRRELEVANT = {"joint": {"colour": "it is drawn"}}


def refusal(ledger: Ledger) -> str:
    with pytest.raises(ConfigError) as error:
        ledger.require_nothing_meant()
    return str(error.value)


def read(text: str) -> Ledger:
    ledger = Ledger("arm.xml", "part")
    ledger.compare_elements(ElementTree.fromstring(text), USED, IRRELEVANT)
    return ledger


def test_close_names_in_any_case_are_suggested_with_the_closest_first() -> None:
    assert find_close_names("Gian", ["gain", "gains", "loss"]) == ["gain", "gains"]
    assert find_close_names("gain", ["loss"]) == []
    assert format_suggestion(["a", "b"]) == "did you mean 'a' or 'b'?"
    assert format_suggestion([]) == ""


def test_used_and_irrelevant_names_are_not_left_over() -> None:
    ledger = read("<arm name='a'><joint name='b' colour='red'/><joint limit='1'/></arm>")
    assert ledger.findings() == []
    ledger.require_nothing_meant()


def test_a_misspelt_name_is_refused() -> None:
    assert refusal(read("<arm><joint limt='1'/></arm>")) == OneSentence(
        "arm.xml: ", "'limt' is no part of <joint>; did you mean 'limit'?"
    )
    # Elements may repeat, so that one may stand beside those that are spelt well.
    assert "did you mean 'joint'" in refusal(read("<arm><joint/><jiont/></arm>"))


def test_a_name_of_another_element_is_refused() -> None:
    assert "did you mean 'joint.limit'?" in refusal(read("<arm limit='1'/>"))


def test_other_names_are_a_warning() -> None:
    ledger = read("<arm><plugin speed='1'><joint limt='2'/></plugin></arm>")
    ledger.require_nothing_meant()
    (finding,) = ledger.findings()
    assert (finding.check, finding.severity) == ("left-over", "warning")
    assert finding.found == "1 part not used: 'plugin' of <arm>"


def test_a_name_that_is_given_was_not_meant() -> None:
    ledger = Ledger("a.ssv", "parameter")
    ledger.compare("arm", ["mass1", "mass2"], ["mass1"])
    ledger.require_nothing_meant()
    assert [item.name for item in ledger.left_over] == ["mass2"]


def test_data_is_compared_with_what_was_understood() -> None:
    ledger = Ledger("law.json", "key")
    data = {"joints": [{"start": 1}, {"start": 2, "strat": 3}], "old": 4, "later": 5}
    known = {"joints": ({"start": 1}, {"start": 2, "stop": None})}
    ledger.compare_data(data, known, {"old": "of version 1"})
    assert [(item.place, item.name, item.meant) for item in ledger.left_over] == [
        ("", "later", ()),
        ("joints.1", "strat", ()),
    ]
    ledger.compare_data({"joints": [{}, {"stpo": 1}]}, known, {})
    with pytest.raises(ArtifactError, match=r"'stpo' .*'stop'"):
        ledger.require_nothing_meant(ArtifactError)


def test_a_key_of_another_table_was_meant_there() -> None:
    ledger = Ledger("law.json", "key")
    ledger.compare_data({"rate": 1, "log": {}}, {"log": {"rate": None}}, {})
    assert "did you mean 'log.rate'?" in refusal(ledger)


def change_audits(data: dict[str, Any]) -> None:
    for joint in data["joints"]:
        joint["audit"] = {"odd": ["value"]}


def write_again(path: Path) -> str:
    written = path.with_name("again.json")
    FrictionModel.read(path).write(written)
    return written.read_text("utf-8")


def change_expectations(data: dict[str, Any]) -> None:
    data["expectations"] = {"odd": ["value"]}


@pytest.mark.parametrize(
    ("name", "change", "read"),
    [
        ("law.json", change_audits, write_again),
        ("properties.json", change_expectations, read_properties),
    ],
)
def test_irrelevant_keys_of_json_change_nothing(
    name: str,
    change: Callable[[dict[str, Any]], None],
    read: Callable[[Path], Any],
    tmp_path: Path,
) -> None:
    original = tmp_path / "original" / name
    original.parent.mkdir()
    original.write_bytes((Path(__file__).parents[1] / "version_1" / name).read_bytes())
    data = json.loads(original.read_text("utf-8"))
    before = json.dumps(data)
    change(data)
    assert json.dumps(data) != before
    changed = tmp_path / name
    changed.write_text(json.dumps(data), encoding="utf-8")
    assert read(changed) == read(original)
