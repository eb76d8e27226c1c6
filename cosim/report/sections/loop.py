"""Closed loop: controller (Fig. 6), tracking (Table III, Fig. 7), robustness."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from markupsafe import Markup

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.loop.traces import LoopOutcome, Trace, Tracked
from cosim.report import paper
from cosim.report.figures.chart import Chart, Line, Panel
from cosim.report.figures.style import DESIRED, SOFT, Stroke, strokes
from cosim.report.markup import Pictures, render
from cosim.report.results import Results
from cosim.report.tables import loop as tables
from cosim.report.tables.table import ResultTable, TableCell, named, row_of, title

Rows = Mapping[str, Tracked]
"""Rows of a scheme by law."""

_OWN, _INVERSE = Scheme(compensation="torque_error"), Scheme(compensation="servo_inversion")
_NONE = Scheme(compensation="none")
_BOUNDS = (StandIn.ORACLE, StandIn.VELOCITY_ONLY)


def tracking(results: Results, pictures: Pictures) -> dict[str, Any] | None:
    """Compare tracking errors under every law and scheme."""
    if results.loop is None:
        return None
    return {
        "motions": results.loop.tracking[0].rmse.shape[0],
        "Kx": f"{results.run.controller['Kx']:g}",
        "diagram": _diagram(pictures),
        "paper": _paper(results),
        "own": _figure(results, pictures, _OWN),
        "inverse": _inverse(results),
        "inverted": _figure(results, pictures, _INVERSE),
        "more": _more(results, results.loop),
    }


def of_scheme(results: Results, scheme: Scheme) -> dict[str, Tracked]:
    """Return the rows of a scheme by law."""
    rows = results.loop.tracking if results.loop else ()
    return {row.law: row for row in rows if row.scheme == scheme}


def outer(results: Results, scheme: Scheme) -> Scheme:
    """Return a scheme with the outer position loop."""
    return replace(scheme, Kx=results.run.controller["Kx"])


def _diagram(pictures: Pictures) -> Markup:
    return pictures.drawing(
        "controller",
        render("controller.svg"),
        "The paper’s controller (Fig. 6): the desired torque of the models minus the measured one "
        "drives a PD whose gains decay with the desired speed; its output corrects the velocity "
        "command of the robot’s own servo.",
        alt="Block diagram: the trajectory feeds the rigid body and the friction law; their sum is "
        "the desired torque. The measured torque is subtracted, the difference passes a PD with "
        "gains that decay with the desired speed, and is added to the desired velocity, which "
        "commands the arm.",
    )


def _paper(results: Results) -> ResultTable:
    rows = _with_command(results, _OWN, _NONE)
    best = _best(rows)
    published = paper.TABLE_III if results.run.robot == paper.ROBOT else {}
    extra = [f"paper {short}" for short in results.joints] if published else []
    return ResultTable(
        caption="Tracking: RMSE [mrad], mean over the motions, torque error scheme",
        head=("torque model", *extra, *results.joints),
        rows=[
            row_of(
                named(law),
                *(
                    TableCell(text="") if v is None else tables.mrad(v, 1)
                    for v in published.get(law, (None,) * len(extra))
                ),
                *(
                    tables.mrad(v, 1, best=v == b)
                    for v, b in zip(rows[law].mean, best, strict=True)
                ),
                quiet=law in _BOUNDS,
            )
            for law in _ordered(rows)
        ],
    )


def _inverse(results: Results) -> ResultTable:
    bare = _with_command(results, _INVERSE, _NONE)
    looped = _with_command(results, outer(results, _INVERSE), outer(results, _NONE))
    columns = [(rows, _best(rows), tables.places(rows.values())) for rows in (bare, looped)]
    return ResultTable(
        caption="Tracking: RMSE [mrad], mean over the motions, servo inversion",
        head=("torque model", *results.joints, *(f"{j} with loop" for j in results.joints)),
        rows=[
            row_of(
                named(law),
                *(
                    tables.mrad(v, n, best=v == b)
                    for rows, best, digits in columns
                    for v, b, n in zip(rows[law].mean, best, digits, strict=True)
                ),
                quiet=law in _BOUNDS,
            )
            for law in _ordered(bare)
            if law in looped
        ],
    )


def _with_command(results: Results, scheme: Scheme, none: Scheme) -> Rows:
    """Return the rows of a scheme by law, and that of the velocity command alone."""
    command = of_scheme(results, none)[StandIn.VELOCITY_ONLY]
    return of_scheme(results, scheme) | {StandIn.VELOCITY_ONLY: command}


def _ordered(rows: Rows) -> list[str]:
    """Return the rigid body, the laws, and the bounds."""
    laws = [law for law in rows if law not in set(StandIn)]
    return [law for law in (StandIn.BODY_ONLY, *laws, *_BOUNDS) if law in rows]


def _best(rows: Rows) -> list[float]:
    laws = [row.mean for law, row in rows.items() if law not in set(StandIn)]
    return list(np.nanmin(laws, axis=0)) if laws else []


def _figure(results: Results, pictures: Pictures, scheme: Scheme) -> Markup:
    key_laws = [law for law in results.key_laws if results.models[law].laws[0].form.memory]
    paths = {
        law: results.paths[scheme, law]
        for law in (StandIn.BODY_ONLY, *key_laws)
        if (scheme, law) in results.paths
    }
    if not paths:
        return Markup()
    styles = {StandIn.BODY_ONLY: Stroke(colour=SOFT), **strokes(results.key_laws)}
    first = next(iter(paths.values()))
    whole = [(law, path) for law, path in paths.items() if len(path.t) == len(first.t)]

    def lines(values: Callable[[Trace], np.ndarray], joint: int) -> list[Line]:
        return [
            Line(name=title(law), x=first.t, y=values(path)[:, joint], stroke=styles[law])
            for law, path in whole
        ]

    rows = []
    for k, short in enumerate(results.joints):
        desired = Line(name="desired", x=first.t, y=first.q_d[:, k], stroke=DESIRED)
        position = (*lines(lambda path: path.q, k), desired)
        error = tuple(lines(lambda path: 1e3 * np.abs(path.q - path.q_d), k))
        rows.append(
            (
                Panel(title=short, y="q [rad]", lines=position),
                Panel(title="", y="|error| [mrad]", lines=error),
            )
        )
    return pictures.chart(
        f"tracking_{scheme.name}",
        Chart(x="t [s]", rows=tuple(rows), height=1.4),
        f"The first motion under {scheme.title}: position (left) and absolute error "
        "(right), as Fig. 7 of the paper. At the scale of the motion most lines coincide; the "
        "error shows the difference.",
        alt="Position over time of each joint, desired and tracked, and next to it the absolute "
        "tracking error, which is largest for the rigid body alone.",
    )


def _more(results: Results, loop: LoopOutcome) -> dict[str, ResultTable]:
    """Return friction of measured velocity and a long run by name of the CSV file."""
    measured = [row for row in loop.tracking if row.scheme.source != "desired"]
    found = {}
    if measured:
        caption = "RMSE [mrad] with friction evaluated on measured or filtered velocity"
        found["tracking_measured_velocity"] = tables.tracking(caption, measured)
    if loop.long:
        caption = f"One motion of {results.run.controller['drift']:g} s: RMSE [mrad]"
        found["tracking_long"] = tables.tracking(caption, loop.long)
    return found


def robustness(results: Results, _: Pictures) -> dict[str, Any] | None:
    """Return tracking errors with an arm other than the identified one."""
    if results.loop is None:
        return None
    return {
        "sweeps": tables.sweeps(results.loop.sweeps),
        "overcompensation": tables.overcompensation(results.loop.overcompensation),
    }
