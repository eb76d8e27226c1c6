"""Charts of friction over time, measured and predicted, with the absolute error beside it."""

from collections.abc import Sequence

import numpy as np

from cosim.figures.chart import Chart, Line, Panel
from cosim.figures.style import MEASURED, strokes
from cosim.report.results import Results
from cosim.saved import SavedLog
from cosim.tables.table import title


def torque_chart(
    results: Results,
    log: SavedLog,
    laws: Sequence[str],
    *,
    marks: tuple[tuple[float, str], ...] = (),
    window: tuple[float, float] | None = None,
) -> Chart:
    """Return a row for each joint: friction torque, and the absolute error of each law."""
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
                    y=f"|error| [{results.unit('N.m', k - 1)}]",
                    lines=tuple(
                        Line(name=title(law), x=t, y=np.abs(tau - measured),
                             stroke=styles[law])
                        for law, tau in predicted.items()
                    ),
                    marks=marks,
                ),
            )
        )  # fmt: skip
    return Chart(x="t [s]", rows=tuple(rows), height=1.5, window=window)
