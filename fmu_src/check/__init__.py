"""Checks of any FMU, all problems at once."""

from fmu_src.check.report import Report
from fmu_src.check.run import check
from fmu_src.run.archive import opened

__all__ = ["Report", "check", "opened"]
