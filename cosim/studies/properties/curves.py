"""Lines of small plots, short enough for a file and a page."""

import numpy as np

from cosim.batch import Array
from hesr_model.friction.audit.properties import Curve


def curve(label: str, x: Array, y: Array, *, closed: bool = False, most: int = 80) -> Curve:
    """Return a line of a plot in at most so many points of four digits, all of them finite.

    x and y are (N,), in the units of the plot's axes.
    """
    finite = np.isfinite(x) & np.isfinite(y)
    x, y = x[finite], y[finite]
    keep = np.unique(np.linspace(0, len(x) - 1, min(len(x), most)).round().astype(int))
    if closed and len(keep):
        keep = np.append(keep, keep[0])
    rounded = [tuple(float(f"{v:.4g}") for v in part[keep]) for part in (x, y)]
    return Curve(label=label, x=rounded[0], y=rounded[1])
