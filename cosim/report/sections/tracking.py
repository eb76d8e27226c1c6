"""The closed loop: controller (Fig. 6), Table III beside the paper's, traces (Fig. 7)."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.report import paper
from cosim.report.markup import (
    Pictures,
    Section,
    details,
    heading,
    joined,
    paragraph,
    render,
    table,
)
from cosim.report.results import Results
from cosim.report.tables.loop import mrad, places, tracking
from cosim.report.tables.table import ResultTable, TableCell, named, row_of, title

if TYPE_CHECKING:
    from cosim.loop.traces import Trace
    from cosim.loop.tracking import Tracked

_OWN, _INVERSE = Scheme(compensation="torque_error"), Scheme(compensation="servo_inversion")
_NONE = Scheme(compensation="none")


def section(results: Results, pictures: Pictures) -> Section | None:
    """Show how well the arm tracks under every law and scheme."""
    if results.loop is None:
        return None
    parts = [
        paragraph(
            "The arm itself as a co-simulation: trajectory, rigid body, friction, controller and "
            "the MuJoCo arm, each an FMU of native C. "
            f"{results.loop.tracking[0].rmse.shape[0]} random Fourier motions; errors are those of "
            "the true position."
        ),
        details("The controller", _diagram(pictures)),
        heading("The paper’s scheme, beside Table III"),
        paragraph(
            "With a servo that integrates, a perfect torque model gives no correction at all, so "
            "that good laws end where the row ‘velocity command only’ stands. The scheme shows how "
            "much harm a wrong model does, more than how much good a right one does."
        ),
        table(_beside_paper(results)),
        details("The first motion under the paper’s scheme", _figure(results, pictures, _OWN)),
        heading("Where models pay: the servo’s inverse"),
        paragraph(
            "The torque of the models goes through the inverse of the servo’s own PI, ahead by its "
            "latency; on the right with an outer position loop of "
            f"{results.run.controller['Kx']:g}/s."
        ),
        table(_inverse(results)),
        _figure(results, pictures, _INVERSE),
        details("Friction of measured velocity, and a long run", *_more(results)),
    ]
    return Section(key="tracking", title="Tracking in closed loop", html=joined(*parts))


def of_scheme(results: Results, scheme: Scheme) -> "dict[str, Tracked]":
    """Return the rows of a scheme by law."""
    rows = results.loop.tracking if results.loop else ()
    return {row.law: row for row in rows if row.scheme == scheme}


def outer(results: Results, scheme: Scheme) -> Scheme:
    """Return a scheme with the outer position loop."""
    return replace(scheme, Kx=results.run.controller["Kx"])


def _diagram(pictures: Pictures) -> Markup:
    svg = render("controller.svg")
    return pictures.drawing(
        "controller",
        svg,
        "The paper’s controller (Fig. 6): the torque that the models expect, less the measured "
        "one, drives a PD whose gains decay with the desired speed; its output corrects the "
        "velocity command of the robot’s own servo.",
        alt="Block diagram: the trajectory feeds the rigid body and the friction law; their sum is "
        "the desired torque. The measured torque is subtracted, the difference passes a PD with "
        "gains that decay with the desired speed, and is added to the desired velocity, which "
        "commands the arm.",
    )


def _beside_paper(results: Results) -> ResultTable:
    rows = _with_command(results, _OWN, _NONE)
    with_paper = results.run.robot == paper.ROBOT
    best = _best(rows)
    beside = [f"paper {short}" for short in results.joints] if with_paper else []
    none = (None,) * len(beside)
    return ResultTable(
        caption="Tracking: RMSE [mrad], mean over the motions, torque error scheme",
        head=("torque model", *beside, *results.joints),
        rows=[
            row_of(
                named(law),
                *(
                    TableCell(text="") if v is None else mrad(v, 1)
                    for v in (paper.TABLE_III.get(law, none) if with_paper else ())
                ),
                *(mrad(v, 1, best=v == b) for v, b in zip(rows[law].mean, best, strict=True)),
                quiet=law in _BOUNDS,
            )
            for law in _ordered(rows)
        ],
    )


def _inverse(results: Results) -> ResultTable:
    bare = _with_command(results, _INVERSE, _NONE)
    looped = _with_command(results, outer(results, _INVERSE), outer(results, _NONE))
    columns = [(rows, _best(rows), places(rows.values())) for rows in (bare, looped)]
    return ResultTable(
        caption="Tracking: RMSE [mrad], mean over the motions, servo inversion",
        head=("torque model", *results.joints, *(f"{j} with loop" for j in results.joints)),
        rows=[
            row_of(
                named(law),
                *(
                    mrad(v, n, best=v == b)
                    for rows, best, digits in columns
                    for v, b, n in zip(rows[law].mean, best, digits, strict=True)
                ),
                quiet=law in _BOUNDS,
            )
            for law in _ordered(bare)
            if law in looped
        ],
    )


def _with_command(results: Results, scheme: Scheme, none: Scheme) -> "dict[str, Tracked]":
    """Return the rows of a scheme by law, and that of the velocity command alone."""
    command = of_scheme(results, none)[StandIn.VELOCITY_ONLY]
    return of_scheme(results, scheme) | {StandIn.VELOCITY_ONLY: command}


_BOUNDS = (StandIn.ORACLE, StandIn.VELOCITY_ONLY)


def _ordered(rows: "dict[str, Tracked]") -> list[str]:
    """Return laws between what needs none of them: the rigid body first, the truth last."""
    laws = [law for law in rows if law not in set(StandIn)]
    return [law for law in (StandIn.BODY_ONLY, *laws, *_BOUNDS) if law in rows]


def _best(rows: "dict[str, Tracked]") -> list[float]:
    laws = [row.mean for law, row in rows.items() if law not in set(StandIn)]
    return list(np.nanmin(laws, axis=0)) if laws else []


def _figure(results: Results, pictures: Pictures, scheme: Scheme) -> Markup:
    from cosim.report.figures.chart import Chart, Line, Panel
    from cosim.report.figures.style import DESIRED, SOFT, Stroke, strokes

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

    def lines(values: "Callable[[Trace], np.ndarray]", joint: int) -> list[Line]:
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
        "(right), as Fig. 7 of the paper. On the scale of the motion most lines lie on each other; "
        "the error tells them apart.",
        alt="Position over time of each joint, desired and tracked, and beside it the absolute "
        "tracking error, which is largest for the rigid body alone.",
    )


def _more(results: Results) -> list[Markup]:
    loop = results.loop
    if loop is None:
        return []
    measured = [row for row in loop.tracking if row.scheme.source != "desired"]
    parts = []
    if measured:
        caption = "RMSE [mrad] with friction evaluated on measured or filtered velocity"
        parts.append(table(tracking(caption, measured)))
    if loop.long:
        minutes = results.run.controller["drift"]
        parts.append(table(tracking(f"One motion of {minutes:g} s: RMSE [mrad]", loop.long)))
    return parts
