"""Log formats from other packages, and parts of logs with gaps."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plugin_packages import InstallPlugin

from hesr_model.errors import ConfigError, LogError
from hesr_model.logs.readers import formats
from hesr_model.logs.readers.formats import COLUMNS, FileFormat, find_format
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth

OWN = FileFormat(name="own", recognises=lambda path: path.suffix == ".own", read=COLUMNS.read)


@pytest.fixture(autouse=True)
def _forgotten() -> Iterator[None]:
    formats.formats.cache_clear()
    yield
    formats.formats.cache_clear()


def test_another_package_adds_a_format(install_plugin: InstallPlugin) -> None:
    install_plugin(formats.GROUP, own=f"{__name__}:OWN")
    assert find_format(Path("run.own")).name == "own"
    assert find_format(Path("run.csv")) is COLUMNS


def test_a_broken_format_is_named(install_plugin: InstallPlugin) -> None:
    install_plugin(formats.GROUP, own="no_such_module:FORMAT")
    with pytest.raises(ConfigError, match=r"; repair or uninstall the package\.$"):
        find_format(Path("run.csv"))
    with pytest.raises(ConfigError, match=r"^log format 'own' of the package 'my-plugins' cannot"):
        find_format(Path("run.csv"))


def test_an_invalid_format_object_is_refused(install_plugin: InstallPlugin) -> None:
    install_plugin(formats.GROUP, own="os:sep")
    with pytest.raises(ConfigError, match="entry point must name a FileFormat"):
        find_format(Path("run.csv"))


def test_a_log_with_a_gap_is_filtered_part_by_part(arm_log: Log) -> None:
    gap = replace(arm_log, t=arm_log.t + np.where(arm_log.t > 5.0, 1.0, 0.0))
    with pytest.raises(LogError, match=r"1\.005 s before row 1002"):
        smooth(gap)
    assert [len(smooth(part).t) for part in gap.parts()] == [1001, 999]
