"""How well the laws predict torque on motions that no fit has seen (Table II, Fig. 4 and 5)."""

from markupsafe import Markup

from cosim.report import paper
from cosim.report.markup import Pictures, Section, details, heading, joined, paragraph, table
from cosim.report.results import Results
from cosim.report.sections.traces import WINDOW as MOVING
from cosim.report.sections.traces import torque_chart
from cosim.report.tables.scores import MEASURES, errors, other_truths, position_errors
from cosim.report.tables.scores import bands as band_table
from cosim.report.tables.table import ResultTable, named, number, row_of, title
from cosim.study.results import SavedLog
from cosim.study.scores import BASELINE, input_classes
from hesr_model.friction.registry import papers_law

_NETWORK = "rbfnn_h"
"""Law that Fig. 5 of the paper compares with its own."""
_WINDOW = 10.0  # [s] of a picture; the view that zooms shows all


def section(results: Results, pictures: Pictures) -> Section:
    """Compare all laws on every test set."""
    parts = [
        paragraph(
            "Each figure is that of the exported FMU itself, driven over the logs through FMPy. "
            "Laws compare fairly within a class of equal inputs: v velocity, q position, load the "
            "rigid-body torque. Rows with + start begin as the first measured torques say, which "
            "nobody has who runs the FMU."
        )
    ]
    for k, test in enumerate(results.tests):
        parts += [heading(f"Test set ‘{test}’"), *_of_test(results, pictures, test, first=k == 0)]
    if results.truths:
        parts += [
            heading("Under other truths of the twin"),
            paragraph(
                "The same motions with other friction in the arm: body and laws are found anew "
                "there. What wins under one truth only is at home there, and may be nowhere else."
            ),
            table(other_truths(results.comparisons, results.truths, results.run.truth)),
        ]
    if results.run.robot == paper.ROBOT:
        parts.append(details("Table II of the paper, for the same robot", _paper(results)))
    return Section(key="prediction", title="Prediction on unseen motions", html=joined(*parts))


def bands(results: Results, pictures: Pictures) -> Section | None:
    """Compare the laws on both sides of a chirp's middle frequency."""
    tests = list(dict.fromkeys(band.test for band in results.run.bands))
    if not tests:
        return None
    parts = [
        paragraph(
            "The laws were trained at low frequencies. A chirp that goes beyond them shows whether "
            "they extrapolate; it is split where it leaves what was trained (0.6 Hz in the paper)."
        )
    ]
    first, *others = tests
    parts += _of_bands(results, pictures, first)
    parts += [details(f"‘{test}’", *_of_bands(results, pictures, test)) for test in others]
    return Section(key="chirp", title="Chirp: beyond the trained frequencies", html=joined(*parts))


def _of_test(results: Results, pictures: Pictures, test: str, *, first: bool) -> list[Markup]:
    whole, *parts = (_errors(results, test, measure) for measure in MEASURES)
    shown, scores = [whole], results.comparisons[test]
    log = results.log_of(test)
    split = {band.test for band in results.run.bands}
    if log is not None and first:
        shown.append(_traces(results, pictures, test, log))
    if test in results.simulated:
        found = position_errors(test, results.simulated[test], results.sliding)
        shown.append(details("As simulators: torque in, position out", table(found)))
    if scores.bands:
        shown.append(details("Do the bands hold what they say?", table(band_table(test, scores))))
    shown.append(details("Moving rows and reversals by themselves", *parts))
    if log is not None and not first and test not in split:
        traces = _traces(results, pictures, test, log)
        shown.append(details(f"Torque over time on ‘{test}’", traces))
    return shown


def _errors(results: Results, name: str, measure: str = "rmse") -> Markup:
    scores, inputs = results.comparisons[name], input_classes(results.models)
    return table(errors(name, scores, measure, inputs, results.sliding))


def _shown(results: Results) -> list[str]:
    """Return the laws of a static picture: more than three hide each other."""
    wanted = (BASELINE, papers_law(), results.best)
    laws = [law for law in dict.fromkeys(wanted) if law in results.models]
    return laws if len(laws) > 1 else results.key_laws[:3]


def _traces(results: Results, pictures: Pictures, test: str, log: SavedLog) -> Markup:
    window = (0.0, _WINDOW) if log.duration > 1.5 * _WINDOW else None
    chart = torque_chart(results, log, _shown(results), window=window)
    what = f"the first {_WINDOW:g} s of {log.name}" if window else log.name
    names = ", ".join(title(law) for law in _shown(results))
    return pictures.chart(
        f"torque_{_key(results, test)}",
        chart,
        f"Friction torque on {what} (left) and the RMS error of the laws over {MOVING:g} s "
        "(right), as Fig. 4 of the paper. Look at the reversals, where laws without a memory err "
        f"most. The view that zooms shows the whole log. Shown: {names}.",
        alt=f"Friction torque over time on {log.name} for each joint, measured and predicted by "
        f"{names}; beside it the moving error, with peaks at velocity reversals.",
    )


def _of_bands(results: Results, pictures: Pictures, test: str) -> list[Markup]:
    parts: list[Markup] = []
    of_test = [band for band in results.run.bands if band.test == test]
    log = results.log_of(test)
    if log is not None:
        marks = tuple((band.start, "split") for band in of_test if band.start > 0.0)
        laws = [law for law in dict.fromkeys((_NETWORK, papers_law(), results.best)) if law in
                results.models]  # fmt: skip
        laws = laws if len(laws) > 1 else _shown(results)
        names = ", ".join(title(law) for law in laws)
        parts.append(
            pictures.chart(
                f"split_{_key(results, test)}",
                torque_chart(results, log, laws, marks=marks),
                f"Friction torque and RMS error over {MOVING:g} s on {log.name}, with its split "
                f"(Fig. 5 of the paper). Shown: {names}.",
                alt=f"Friction torque over time on {log.name} for each joint, measured and by "
                f"{names}, with a dashed line at the split; beside it the moving error.",
            )
        )
    return parts + [_errors(results, band.name) for band in of_test]


def _paper(results: Results) -> Markup:
    return table(
        ResultTable(
            caption="Table II of the paper: RMSE of the predicted torque [N.m] on the measured "
            "robot",
            head=("law", *results.joints),
            rows=[
                row_of(named(law), *(number(v, 4) for v in values))
                for law, values in paper.TABLE_II.items()
            ],
        )
    )


def _key(results: Results, test: str) -> str:
    return str(results.tests.index(test) + 1)
