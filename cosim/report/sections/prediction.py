"""How well the laws predict torque on motions that no fit has seen (Table II, Fig. 4 and 5)."""

from collections.abc import Sequence

from markupsafe import Markup

from cosim.report import paper
from cosim.report.markup import (
    Pictures,
    Row,
    Section,
    Table,
    by_inputs,
    decimals,
    details,
    fixed,
    heading,
    joined,
    number,
    paragraph,
    table,
)
from cosim.report.results import PAPERS, Results
from cosim.report.sections.traces import torque_chart
from cosim.scoring import ORACLE, Comparison, Ratio

_WINDOW = 10.0  # [s] of a picture; the view that zooms shows all
_MEASURES = {
    "rmse_moving": "while moving (|dq| > 0.02 {speed})",
    "rmse_reversal": "within 0.1 s of velocity reversals",
}


def section(results: Results, pictures: Pictures) -> Section:
    """Compare all laws on every test set."""
    parts = [
        paragraph(
            "Each figure is that of the exported FMU itself, driven over the logs through FMPy. "
            "Laws compare fairly within a class of equal inputs: v velocity, q position, load the "
            "rigid-body torque, start a state that is estimated from the first torques."
        )
    ]
    for k, test in enumerate(results.tests):
        parts += [heading(f"Test set ‘{test}’"), *_of_test(results, pictures, test, first=k == 0)]
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
    for test in tests:
        parts += _of_bands(results, pictures, test)
    return Section(key="chirp", title="Chirp: beyond the trained frequencies", html=joined(*parts))


def _of_test(results: Results, pictures: Pictures, test: str, *, first: bool) -> list[Markup]:
    scores = results.comparisons[test]
    parts = [table(_errors(results, test, scores, "rmse", "over all rows"))]
    log = results.log_of(test)
    split = {band.test for band in results.run.bands}
    if log is not None and first:
        parts.append(_traces(results, pictures, test))
    more = [
        table(_errors(results, test, scores, measure, words.format(speed=results.unit("rad/s"))))
        for measure, words in _MEASURES.items()
    ]
    parts.append(details("Moving rows and reversals by themselves", *more))
    if log is not None and not first and test not in split:
        parts.append(_traces(results, pictures, test))
    return parts


def _errors(results: Results, name: str, scores: Comparison, measure: str, words: str) -> Table:
    values = {law: [getattr(s, measure) for s in row] for law, row in scores.laws.items()}
    joints = range(len(scores.joints))
    best = [
        min((v for law, row in values.items() if law != ORACLE and (v := row[k]) is not None),
            default=None)
        for k in joints
    ]  # fmt: skip
    places = [decimals(row[k] for row in values.values()) for k in joints]
    ratios = scores.ratios if measure == "rmse" else {}
    beside = f"; small: ratio to {results.title(scores.reference)} with its 95\u00a0% interval"
    rows = []
    if measure == "rmse":
        spread = next(iter(scores.laws.values()))
        rows.append(Row(head="(std of friction)", quiet=True, cells=[
            fixed(s.tau_std, n) for s, n in zip(spread, places, strict=True)
        ]))  # fmt: skip
    for inputs, laws in by_inputs(list(values), results.run.inputs).items():
        rows.append(Row(head=f"inputs {inputs}" if inputs else "for comparison"))
        rows += [
            Row(
                head=_named(results, law),
                cells=[
                    fixed(
                        values[law][k],
                        places[k],
                        best=values[law][k] == best[k] and law != ORACLE,
                        beside=_ratio(ratios[law][k]) if law in ratios else "",
                    )
                    for k in joints
                ],
            )
            for law in laws
        ]  # fmt: skip
    return Table(
        caption=f"{name}: RMSE of the predicted torque [{results.unit('N.m')}] {words}"
        f"{beside if ratios else ''}",
        head=("law", *results.joints),
        rows=rows,
    )


def _named(results: Results, law: str) -> str:
    return f"{results.title(law)} (the paper’s)" if law == PAPERS else results.title(law)


def _ratio(ratio: Ratio) -> str:
    return f"{ratio.value:.2f} ({ratio.low:.2f}–{ratio.high:.2f})"


def _shown(results: Results) -> list[str]:
    """Return the laws of a static picture: more than three hide each other."""
    wanted = ("stribeck", PAPERS, results.best)
    laws = [law for law in dict.fromkeys(wanted) if law in results.models]
    return laws if len(laws) > 1 else results.key_laws[:3]


def _traces(results: Results, pictures: Pictures, test: str) -> Markup:
    log = results.log_of(test)
    if log is None:
        return Markup()
    window = (0.0, _WINDOW) if log.duration > 1.5 * _WINDOW else None
    chart = torque_chart(results, log, _shown(results), window=window)
    what = f"the first {_WINDOW:g} s of {log.name}" if window else log.name
    names = ", ".join(results.title(law) for law in _shown(results))
    return pictures.chart(
        f"torque_{_key(results, test)}",
        chart,
        f"Friction torque on {what} (left) and the absolute error of the laws (right), as Fig. 4 "
        "of "
        "the paper. Look at the reversals, where laws without a memory err most. The view that "
        f"zooms shows the whole log. Shown: {names}.",
        alt=f"Friction torque over time on {log.name} for each joint, measured and predicted by "
        f"{names}; beside it the absolute error, with peaks at velocity reversals.",
    )


def _of_bands(results: Results, pictures: Pictures, test: str) -> list[Markup]:
    parts: list[Markup] = []
    of_test = [band for band in results.run.bands if band.test == test]
    log = results.log_of(test)
    if log is not None:
        marks = tuple((band.start, "split") for band in of_test if band.start > 0.0)
        laws = [law for law in dict.fromkeys(("rbfnn_h", PAPERS, results.best)) if law in
                results.models]  # fmt: skip
        laws = laws if len(laws) > 1 else _shown(results)
        names = ", ".join(results.title(law) for law in laws)
        parts.append(
            pictures.chart(
                f"split_{_key(results, test)}",
                torque_chart(results, log, laws, marks=marks),
                f"Friction torque and absolute error on {log.name}, with its split (Fig. 5 of the "
                f"paper). Shown: {names}.",
                alt=f"Friction torque over time on {log.name} for each joint, measured and by "
                f"{names}, with a dashed line at the split; beside it the absolute error.",
            )
        )
    scores = [(band.name, results.comparisons[band.name]) for band in of_test]
    parts.append(table(_split(results, scores)))
    return parts


def _split(results: Results, scores: Sequence[tuple[str, Comparison]]) -> Table:
    joints = range(len(results.joints))
    best = {
        name: [min(row[k].rmse for law, row in c.laws.items() if law != ORACLE) for k in joints]
        for name, c in scores
    }
    places = {
        name: [decimals(row[k].rmse for row in c.laws.values()) for k in joints]
        for name, c in scores
    }
    return Table(
        caption=f"RMSE of the predicted torque [{results.unit('N.m')}] on the parts",
        head=("law", *(f"{name}: {short}" for name, _ in scores for short in results.joints)),
        rows=[
            Row(
                head=_named(results, law),
                cells=[
                    fixed(c.laws[law][k].rmse, places[name][k],
                          best=law != ORACLE and c.laws[law][k].rmse == best[name][k])
                    for name, c in scores
                    for k in joints
                ],
            )
            for law in scores[0][1].laws
        ],
    )  # fmt: skip


def _paper(results: Results) -> Markup:
    return table(
        Table(
            caption="Table II of the paper: RMSE of the predicted torque [N.m] on the measured "
            "robot",
            head=("law", *results.joints),
            rows=[
                Row(head=_named(results, law), cells=[number(v, 4) for v in values])
                for law, values in paper.TABLE_II.items()
            ],
        )
    )


def _key(results: Results, test: str) -> str:
    return str(results.tests.index(test) + 1)
