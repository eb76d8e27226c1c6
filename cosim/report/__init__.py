"""The report of a run: one page that needs nothing but itself, made from saved results alone."""

from cosim.report.page import write_report

__all__ = ["write_report"]
