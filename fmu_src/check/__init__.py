"""Checks of any FMU, imported lazily so that readers in the sandbox start quickly."""

from typing import TYPE_CHECKING

from hesr_model.support.lazy import lazy

if TYPE_CHECKING:
    from fmu_src.check.report import Report
    from fmu_src.check.run import check
    from fmu_src.run.archive import opened

__all__ = ["Report", "check", "opened"]

_HOMES = {
    "Report": "fmu_src.check.report",
    "check": "fmu_src.check.run",
    "opened": "fmu_src.run.archive",
}

if not TYPE_CHECKING:  # seen by type checkers above
    __getattr__, __dir__ = lazy(__name__, _HOMES)
