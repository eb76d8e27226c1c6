"""Charts of friction over time, measured and predicted, with the moving error beside it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cosim.figures.chart import Chart, Line, Panel
from cosim.figures.style import MEASURED, strokes
from cosim.report.results import Results
from cosim.saved import SavedLog
from cosim.tables.table import title

Array = NDArray[np.float64]

WINDOW = 0.25
"""[s] Of a moving error: single errors of noise hide which law errs, and where."""


def moving_rms(t: Array, error: Array) -> Array:
    """Root of the mean squared error (N,) within `WINDOW` around each of the times t (N,) [s]."""
    total = np.concatenate([[0.0], np.cumsum(error**2)])
    first, last = (np.searchsorted(t, t + way * 0.5 * WINDOW) for way in (-1.0, 1.0))
    return np.asarray(np.sqrt((total[last] - total[first]) / np.maximum(last - first, 1)))


def torque_chart(
    results: Results,
    log: SavedLog,
    laws: Sequence[str],
    *,
    marks: tuple[tuple[float, str], ...] = (),
    window: tuple[float, float] | None = None,
) -> Chart:
    """Return a row for each joint: friction torque, and the moving RMS error of each law."""
    torques = results.torques(log)
    t = torques["t"]
    styles = strokes(results.key_laws)
    rows = []
    for k, (short, name) in enumerate(
        zip(results.joints, results.run.joints, strict=True), start=1
    ):
        measured = torques[f"tau{k}"] - torques[f"tau_rb{k}"]
        predicted = {law: torques[f"{law}.tau_f{k}"] for law in laws}
        rows.append(
            (
                Panel(
                    title=f"{short}: {name}",
                    y=f"friction [{results.unit('N.m', k - 1)}]",
                    lines=(
                        Line(name="measured", x=t, y=measured, stroke=MEASURED),
                        *(
                            Line(name=title(law), x=t, y=tau, stroke=styles[law])
                            for law, tau in predicted.items()
                        ),
                    ),
                    marks=marks,
                ),
                Panel(
                    title="",
                    y=f"RMS error [{results.unit('N.m', k - 1)}]",
                    lines=tuple(
                        Line(name=title(law), x=t, y=moving_rms(t, tau - measured),
                             stroke=styles[law])
                        for law, tau in predicted.items()
                    ),
                    marks=marks,
                ),
            )
        )  # fmt: skip
    return Chart(x="t [s]", rows=tuple(rows), height=1.5, window=window)
