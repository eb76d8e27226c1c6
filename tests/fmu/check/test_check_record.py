"""The record of an FMU says what it was made from, and a check whether it is unchanged."""

import json
from pathlib import Path

import pytest
from fmu_files import BINARY, MODEL, check, members, said, write

from fmu_src.export.record import MEMBER


def test_a_record_names_sources_versions_and_certificates(table1_fmu: Path) -> None:
    record = json.loads(members(table1_fmu)[MEMBER])
    assert record["law"] == "parfam_h"
    assert record["hesr"]
    assert "versions" in record["provenance"] or "source" in record["provenance"]
    assert all(entry["passivity"] for entry in record["joints"])
    assert set(record["sha256"]) == {*members(table1_fmu)} - {MEMBER}


def test_an_exported_fmu_is_unchanged(table1_fmu: Path) -> None:
    report = check(table1_fmu)
    assert report.record
    assert report.to_json()["record"] == report.record


CHANGES: dict[str, tuple[str, bytes | None]] = {
    "changed": (MODEL, b"<fmiModelDescription/>"),
    "missing": (BINARY, None),
    "added": ("extra/more.txt", b"more"),
    "invalid": (MEMBER, b"[]"),
    "nested": (MEMBER, b"[" * 10000),
    "not text": (MEMBER, bytes([255, 254])),
    "hashes": (MEMBER, b'{"format": "hesr-record-1", "sha256": 3}'),
}


@pytest.mark.parametrize("kind", CHANGES)
def test_each_change_is_named(table1_fmu: Path, tmp_path: Path, kind: str) -> None:
    name, changed_data = CHANGES[kind]
    content = members(table1_fmu)
    content.pop(name, None)
    if changed_data is not None:
        content[name] = changed_data
    path = write(tmp_path / "Changed.fmu", content)
    [sentence] = said(path, "archive-changed")
    assert name in sentence
    assert not check(path).record


def test_an_fmu_of_others_has_no_record(table1_fmu: Path, tmp_path: Path) -> None:
    content = members(table1_fmu)
    del content[MEMBER]
    path = write(tmp_path / "Other.fmu", content)
    assert not check(path).record
    assert said(path, "archive-changed") == []
