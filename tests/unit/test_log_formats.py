"""Formats that other packages bring, and parts that only `parts()` gives."""

from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import ConfigError, LogError
from hesr_model.logs.readers import formats
from hesr_model.logs.readers.formats import COLUMNS, FileFormat, format_of
from hesr_model.logs.robot_log import RobotLog
from hesr_model.logs.signals import smooth

OWN = FileFormat(name="own", recognises=lambda path: path.suffix == ".own", read=COLUMNS.read)


@pytest.fixture(autouse=True)
def _forgotten() -> Iterator[None]:
    formats.formats.cache_clear()
    yield
    formats.formats.cache_clear()


def entries(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint(name="own", value=value, group=formats.GROUP)
    monkeypatch.setattr(formats, "entry_points", lambda **_: [entry])


def test_another_package_brings_a_format(monkeypatch: pytest.MonkeyPatch) -> None:
    entries(f"{__name__}:OWN", monkeypatch)
    assert format_of(Path("run.own")).name == "own"
    assert format_of(Path("run.csv")) is COLUMNS


def test_a_format_that_cannot_be_used_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    entries("no_such_module:FORMAT", monkeypatch)
    told = "log format 'own' cannot be loaded"
    with pytest.raises(ConfigError, match=r"; mend its package or uninstall it\.$"):
        format_of(Path("run.csv"))
    with pytest.raises(ConfigError, match=told):
        format_of(Path("run.csv"))
    entries("os:sep", monkeypatch)
    with pytest.raises(ConfigError, match=r"is a str; the entry point must name a FileFormat\."):
        format_of(Path("run.csv"))


def test_a_log_with_a_gap_is_filtered_part_by_part_only(arm_log: RobotLog) -> None:
    gap = replace(arm_log, t=arm_log.t + np.where(arm_log.t > 5.0, 1.0, 0.0))
    with pytest.raises(LogError, match=r"rows are missing for 1\.005 s before row 1002 of"):
        smooth(gap)
    assert [len(smooth(part).t) for part in gap.parts()] == [1001, 999]
