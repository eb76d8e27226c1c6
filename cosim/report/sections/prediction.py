"""Prediction of torque on unseen motions (Table II, Fig. 4 and 5), and friction loops."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from cosim.report import paper
from cosim.report.figures.chart import Chart, Line, Panel
from cosim.report.figures.plots import loops as loop_panels
from cosim.report.figures.plots import ratios
from cosim.report.figures.style import MEASURED, SOFT, Stroke, strokes, write
from cosim.report.markup import Pictures
from cosim.report.results import Results
from cosim.report.tables.scores import MEASURES, bands, errors, other_truths, position_errors
from cosim.report.tables.table import ResultTable, named, number, row_of, title
from cosim.study.results import SavedLog
from cosim.study.scores import BASELINE, ORACLE, input_classes
from hesr_model.friction.predict import predict_band
from hesr_model.friction.registry import papers_law
from hesr_model.support.arrays import Array

_NETWORK = "rbfnn_h"
"""Law that Fig. 5 of the paper compares with its own."""
WINDOW = 10.0
"""Time span of a static figure [s]; the zooming view shows all."""
MOVING = 0.25
"""Window of the moving error [s]; it averages out noise."""
_LOOPS = 20.0
"""Time span of friction loops [s]."""
_POINTS = 400
"""Maximum number of points of a friction loop in the page, fewer for more than 3 joints."""
_EDGE = Stroke(colour=SOFT, width=0.6, dash=(1.5, 1.5))


def errors_of_tests(results: Results, pictures: Pictures) -> dict[str, Any]:
    """Compare all laws on every test set."""
    split = {band.test for band in results.run.bands}
    tests = []
    for k, test in enumerate(results.tests):
        scores, log = results.comparisons[test], results.log_of(test)
        simulated = results.simulated.get(test)
        whole, *parts = (_errors(results, test, measure) for measure in MEASURES)
        tests.append(
            {
                "name": test,
                "errors": whole,
                "parts": parts,
                "traces": _traces(results, pictures, test, log)
                if log and (k == 0 or test not in split)
                else None,
                "simulated": simulated and position_errors(test, simulated, results.sliding),
                "bands": bands(test, scores) if scores.bands else None,
            }
        )
    truths, run = results.truths, results.run
    return {
        "ratios": _ratios(results, pictures),
        "tests": tests,
        "truths": truths and other_truths(results.comparisons, truths, run.truth),
        "paper": _paper(results) if run.robot == paper.ROBOT else None,
    }


def _ratios(results: Results, pictures: Pictures) -> Markup:
    test = results.tests[0]
    scores = results.comparisons[test].ratios
    if not scores.laws:
        return Markup()
    laws = {title(law): row for law, row in scores.laws.items()}
    reference = "its reference" if scores.references else title(scores.reference)
    return pictures.figure(
        "ratios",
        ratios(laws, results.joints, x=f"RMSE / RMSE of {reference}"),
        f"Error of every law over that of {reference} on ‘{test}’, with 95 % intervals (bootstrap "
        "of blocks of time). Left of the line is better. The reference of a law is the strongest "
        "classic law of the same inputs or fewer; the claim is about these logs.",
        alt=f"For each law and joint, a dot at its error relative to {reference} and its interval.",
    )


def _errors(results: Results, name: str, measure: str = "rmse") -> ResultTable:
    scores, inputs = results.comparisons[name], input_classes(results.models)
    return errors(name, scores, measure, inputs, results.sliding)


def _paper(results: Results) -> ResultTable:
    return ResultTable(
        caption="Table II of the paper: RMSE of the predicted torque [N.m] on the measured robot",
        head=("law", *results.joints),
        rows=[
            row_of(named(law), *(number(v, 4) for v in values))
            for law, values in paper.TABLE_II.items()
        ],
    )


def _key_laws(results: Results) -> list[str]:
    """Return at most three laws for a static figure."""
    laws = results.shown(BASELINE, papers_law(), results.best)
    return laws if len(laws) > 1 else results.key_laws[:3]


def _traces(results: Results, pictures: Pictures, test: str, log: SavedLog) -> Markup:
    window = (0.0, WINDOW) if log.duration > 1.5 * WINDOW else None
    laws = _key_laws(results)
    what = f"the first {WINDOW:g} s of {log.name}" if window else log.name
    names = ", ".join(map(title, laws))
    return pictures.chart(
        f"torque_{results.tests.index(test) + 1}",
        _chart(results, log, laws, window=window),
        f"Friction torque on {what} (left) and the RMS error of the laws over {MOVING:g} s "
        "(right), as Fig. 4 of the paper. Laws without memory have the largest errors near "
        f"reversals. The zooming view shows the whole log. Shown: {names}.",
        alt=f"Friction torque over time on {log.name} for each joint, measured and predicted by "
        f"{names}; next to it the moving error, with peaks at velocity reversals.",
    )


def chirp(results: Results, pictures: Pictures) -> dict[str, Any] | None:
    """Compare the laws on both sides of a chirp's middle frequency."""
    bands_of = results.run.bands
    tests = [
        {
            "name": test,
            "traces": _split(results, pictures, test),
            "errors": [_errors(results, band.name) for band in bands_of if band.test == test],
        }
        for test in dict.fromkeys(band.test for band in bands_of)
    ]
    return {"tests": tests} if tests else None


def _split(results: Results, pictures: Pictures, test: str) -> Markup:
    log = results.log_of(test)
    if log is None:
        return Markup()
    starts = [band.start for band in results.run.bands if band.test == test]
    laws = results.shown(_NETWORK, papers_law(), results.best)
    laws = laws if len(laws) > 1 else _key_laws(results)
    names = ", ".join(map(title, laws))
    return pictures.chart(
        f"split_{results.tests.index(test) + 1}",
        _chart(results, log, laws, marks=tuple((at, "split") for at in starts if at > 0.0)),
        f"Friction torque and RMS error over {MOVING:g} s on {log.name}, with its split "
        f"(Fig. 5 of the paper). Shown: {names}.",
        alt=f"Friction torque over time on {log.name} for each joint, measured and by "
        f"{names}, with a dashed line at the split; next to it the moving error.",
    )


def _chart(
    results: Results,
    log: SavedLog,
    laws: Sequence[str],
    *,
    marks: tuple[tuple[float, str], ...] = (),
    window: tuple[float, float] | None = None,
) -> Chart:
    """Return friction torque and moving error of the laws, one row per joint.

    The best law also has its 95 % band, if it is shown.
    """
    torques, styles = results.torques(log), strokes(results.key_laws)
    t, rows = torques["t"], []
    for k, short, name in results.numbered:
        unit = results.unit("N.m", k - 1)
        measured = torques[f"tau{k}"] - torques[f"tau_rb{k}"]
        predicted = {law: torques[f"{law}.tau_f{k}"] for law in laws}
        friction = (
            *(band(results, results.best, k, torques) if results.best in laws else ()),
            Line(name="measured", x=t, y=measured, stroke=MEASURED),
            *(Line(name=title(a), x=t, y=tau, stroke=styles[a]) for a, tau in predicted.items()),
        )
        moving = tuple(
            Line(name=title(law), x=t, y=moving_rms(t, tau - measured), stroke=styles[law])
            for law, tau in predicted.items()
        )
        heading, y = f"{short}: {name}", f"friction [{unit}]"
        rows.append(
            (
                Panel(title=heading, y=y, lines=friction, marks=marks),
                Panel(title="", y=f"RMS error [{unit}]", lines=moving, marks=marks),
            )
        )
    return Chart(x="t [s]", rows=tuple(rows), height=1.5, window=window)


def moving_rms(t: Array, error: Array) -> Array:
    """Return the RMS error (N,) within a window of `MOVING` around each of the times t (N,)."""
    total = np.concatenate([[0.0], np.cumsum(error**2)])
    first, last = (np.searchsorted(t, t + way * 0.5 * MOVING) for way in (-1.0, 1.0))
    return np.asarray(np.sqrt((total[last] - total[first]) / np.maximum(last - first, 1)))


def band(results: Results, law: str, joint: int, torques: Mapping[str, Array]) -> tuple[Line, ...]:
    """Return both ends of a law's 95 % band as lines, if it has one."""
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


def loops(results: Results, pictures: Pictures) -> dict[str, Any] | None:
    """Draw torque over velocity, one figure per joint: of key laws, and of all laws in files."""
    test = results.tests[0]
    log = results.log_of(test)
    if log is None:
        return None
    torques = results.torques(log)
    rows = torques["t"] - torques["t"][0] <= _LOOPS
    figures = []
    points = min(_POINTS, 3 * _POINTS // len(results.joints))
    for k, short, name in results.numbered:
        dq = torques[f"dq{k}"][rows]
        measured = (torques[f"tau{k}"] - torques[f"tau_rb{k}"])[rows]
        laws = {
            title(law): (dq, torques[f"{law}.tau_f{k}"][rows])
            for law in (*results.laws, ORACLE)
            if f"{law}.tau_f{k}" in torques
        }
        x = f"dq of {short} [{results.unit('rad/s', k - 1)}]"
        y = f"friction [{results.unit('N.m', k - 1)}]"
        write(loop_panels((dq, measured), laws, x=x, y=y), pictures.folder / f"loops_{k}")
        few = {name: laws[name] for name in map(title, (*results.key_laws, ORACLE)) if name in laws}
        drawn = pictures.shown(
            f"loops_{k}",
            loop_panels((dq, measured), few, x=x, y=y, points=points),
            f"Friction of {name} over its velocity near reversals on {log.name}: measured (grey) "
            "and predicted (blue). A law of velocity alone is one curve; laws with memory open "
            "into loops, and the best follow the measured ones.",
            alt=f"For each law a small panel of friction torque over velocity of {name}; laws "
            "without memory are a single curve, the others are loops like the measured friction.",
        )
        figures.append((f"{short}: {name}", drawn))
    return {"test": test, "span": f"{_LOOPS:g}", "figures": figures}
