"""Checks of an FMU before others see it: any FMU, all problems at once."""

from fmu_src.archive import opened
from fmu_src.check.report import Problem, Report
from fmu_src.check.run import check

__all__ = ["Problem", "Report", "check", "opened"]
