"""Charts of friction over time, measured and predicted, with the moving error beside it."""

from collections.abc import Mapping, Sequence

import numpy as np

from cosim.report.figures.chart import Chart, Line, Panel
from cosim.report.figures.style import MEASURED, SOFT, Stroke, strokes
from cosim.report.results import Results
from cosim.report.tables.table import title
from cosim.study.results import SavedLog
from hesr_model.friction.predict import predict_band
from hesr_model.support.arrays import Array

_EDGE = Stroke(colour=SOFT, width=0.6, dash=(1.5, 1.5))

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
    """Return a row for each joint: friction torque, and the moving RMS error of each law.

    The 95 % band is that of the best law, where it is among them and has one.
    """
    torques = results.torques(log)
    t = torques["t"]
    styles = strokes(results.key_laws)
    rows = []
    for k, short, name in results.numbered:
        measured = torques[f"tau{k}"] - torques[f"tau_rb{k}"]
        predicted = {law: torques[f"{law}.tau_f{k}"] for law in laws}
        rows.append(
            (
                Panel(
                    title=f"{short}: {name}",
                    y=f"friction [{results.unit('N.m', k - 1)}]",
                    lines=(
                        *_band(results, k, torques, results.best if results.best in laws else ""),
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


def _band(results: Results, joint: int, torques: Mapping[str, Array], law: str) -> tuple[Line, ...]:
    """Return both ends of a law's band as lines."""
    model = results.models.get(law)
    if model is None or not model.banded:
        return ()
    ends = predict_band(
        model.laws[joint - 1],
        t=torques["t"],
        dq=torques[f"dq{joint}"],
        q=torques[f"q{joint}"],
        tau_load=torques[f"tau_rb{joint}"],
        torque=torques[f"{law}.tau_f{joint}"],
    )
    name = f"95 % band of {title(law)}"
    return tuple(Line(name=name, x=torques["t"], y=end, stroke=_EDGE) for end in ends)
