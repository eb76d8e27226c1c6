"""Checks of an FMU before others see it: any FMU, all problems at once."""

from fmu_src.check.report import Problem, Report
from fmu_src.check.run import check
from fmu_src.run.archive import opened

__all__ = ["Problem", "Report", "check", "opened"]
