"""Pictures of results; besides the picture in an FMU, the only place where matplotlib is used."""

from cosim.report.figures.excitation import excitation

__all__ = ["excitation"]
