"""Results of experiments: figures, verdict and plot."""

from collections.abc import Sequence

import numpy as np

from hesr_model.audit.properties import Curve, Figure, Plot, PropertyResult
from hesr_model.support.arrays import Array

_UNITS = {
    "amplitude": "rad/s",
    "break-away": "N.m",
    "log10 rate": "N.m/s",
    "moved": "mrad",
    "position": "mrad",
    "stretch": "mrad",
    "time": "s",
    "torque": "N.m",
    "velocity": "rad/s",
    "work taken, share": "",
}


def curve(label: str, x: Array, y: Array, *, closed: bool = False, most: int = 80) -> Curve:
    """Return a line of at most `most` finite points (N,), rounded to four digits."""
    finite = np.isfinite(x) & np.isfinite(y)
    x, y = x[finite], y[finite]
    keep = np.unique(np.linspace(0, len(x) - 1, min(len(x), most)).round().astype(int))
    if closed and len(keep):
        keep = np.append(keep, keep[0])
    rounded = [tuple(float(f"{v:.4g}") for v in part[keep]) for part in (x, y)]
    return Curve(label=label, x=rounded[0], y=rounded[1])


def plot(x: str, y: str, *curves: Curve) -> Plot:
    """Return lines over axes with these names."""
    return Plot(x=x, y=y, units=(_UNITS[x], _UNITS[y]), curves=curves)


def figures(*measured: tuple[str, float | None, str]) -> tuple[Figure, ...]:
    """Return figures from name, value and SI unit."""
    return tuple(Figure(name=name, value=value, unit=unit) for name, value, unit in measured)


def judged(
    *measured: tuple[str, float | None, str], wrong: Sequence[str], plot: Plot | None = None
) -> PropertyResult:
    """Return a result that passes if the list of sentences `wrong` is empty."""
    return PropertyResult(
        verdict="fail" if wrong else "pass",
        figures=figures(*measured),
        reason=" ".join(wrong),
        plot=plot,
    )
