"""The closed loop: controller (Fig. 6), Table III beside the paper's, traces (Fig. 7)."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from cosim.closed_loop import BODY_ONLY, ORACLE, VELOCITY_ONLY
from cosim.report import paper
from cosim.report.markup import (
    Cell,
    Pictures,
    Row,
    Section,
    Table,
    decimals,
    details,
    fixed,
    heading,
    joined,
    paragraph,
    render,
    table,
)
from cosim.report.results import PAPERS, Results

if TYPE_CHECKING:
    from cosim.studies.tracking import Tracked

_OWN = "torque_error"  # the paper's scheme
_INVERSE = "servo_inversion"
_NAMES = {
    "none": "velocity command only",
    _OWN: "torque error (the paper’s scheme)",
    _INVERSE: "servo inversion",
}


def section(results: Results, pictures: Pictures) -> Section | None:
    """Show how well the arm tracks under every law and scheme."""
    if results.loop is None:
        return None
    parts = [
        paragraph(
            "The arm itself as a co-simulation: trajectory, rigid body, friction, controller and "
            "the "
            "MuJoCo arm, each an FMU of native C. "
            f"{results.loop.tables[0].rmse.shape[0]} random Fourier motions; errors are those of "
            "the true position."
        ),
        _diagram(pictures),
        heading("The paper’s scheme, beside Table III"),
        paragraph(
            "With a servo that integrates, a perfect torque model gives no correction at all, so "
            "that good laws end where the row ‘velocity command only’ stands. The scheme shows how "
            "much harm a wrong model does, more than how much good a right one does."
        ),
        table(_beside_paper(results)),
        _figure(results, pictures, _OWN),
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


def mrad(value: float, places: int, *, best: bool = False) -> Cell:
    """Return the cell of an angle in mrad; a run that failed has none."""
    if not np.isfinite(value):
        return Cell(text="stopped")
    return fixed(1e3 * value, places, best=best)


def _places(rows: "Iterable[Tracked]") -> list[int]:
    """Return the decimals of each column of angles."""
    laws = [row.mean for row in rows if row.law != ORACLE]
    return [decimals(1e3 * np.array(column), 2) for column in zip(*laws, strict=True)]


def of_scheme(results: Results, scheme: str) -> "dict[str, Tracked]":
    """Return the rows of a scheme by law."""
    tables = results.loop.tables if results.loop else ()
    return {row.law: row for row in tables if row.scheme == scheme}


def outer(results: Results, scheme: str) -> str:
    """Return the name of a scheme with the outer position loop."""
    return f"{scheme}, Kx = {results.run.controller['Kx']:g}"


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


def _beside_paper(results: Results) -> Table:
    rows = of_scheme(results, _OWN) | {
        law: row for law, row in of_scheme(results, "none").items() if law == VELOCITY_ONLY
    }
    with_paper = results.run.robot == paper.ROBOT
    best = _best(rows)
    table_rows = []
    for law in _ordered(rows):
        own = [
            Cell(text="") if v is None else mrad(v, 1)
            for v in paper.TABLE_III.get(law, (None,) * 3)
        ]
        here = [mrad(v, 1, best=v == b) for v, b in zip(rows[law].mean, best, strict=True)]
        table_rows.append(
            Row(
                head=named(results, law),
                cells=[*(own if with_paper else ()), *here],
                quiet=law in (ORACLE, VELOCITY_ONLY),
            )
        )
    beside = [f"paper {short}" for short in results.joints] if with_paper else []
    return Table(
        caption="Tracking: RMSE [mrad], mean over the motions, torque error scheme",
        head=("torque model", *beside, *results.joints),
        rows=table_rows,
    )


def _inverse(results: Results) -> Table:
    bare, looped = (
        of_scheme(results, _INVERSE),
        of_scheme(results, outer(results, _INVERSE)),
    )
    bare |= {k: v for k, v in of_scheme(results, "none").items() if k == VELOCITY_ONLY}
    looped |= {k: v for k, v in of_scheme(results, outer(results, "none")).items()
               if k == VELOCITY_ONLY}  # fmt: skip
    columns = [(rows, _best(rows), _places(rows.values())) for rows in (bare, looped)]
    return Table(
        caption="Tracking: RMSE [mrad], mean over the motions, servo inversion",
        head=("torque model", *results.joints, *(f"{j} with loop" for j in results.joints)),
        rows=[
            Row(
                head=named(results, law),
                cells=[
                    mrad(v, n, best=v == b)
                    for rows, best, places in columns
                    for v, b, n in zip(rows[law].mean, best, places, strict=True)
                ],
                quiet=law in (ORACLE, VELOCITY_ONLY),
            )
            for law in _ordered(bare)
            if law in looped
        ],
    )


def _ordered(rows: "dict[str, Tracked]") -> list[str]:
    """Return laws between what needs none of them: the rigid body first, the truth last."""
    last = (ORACLE, VELOCITY_ONLY)
    laws = [law for law in rows if law not in (BODY_ONLY, *last)]
    return [law for law in (BODY_ONLY, *laws, *last) if law in rows]


def _best(rows: "dict[str, Tracked]") -> list[float]:
    laws = [row.mean for law, row in rows.items() if not law.startswith("(")]
    return list(np.nanmin(laws, axis=0)) if laws else []


def named(results: Results, law: str) -> str:
    """Return what stands in the place of a torque model in words."""
    if law == PAPERS:
        return f"{results.title(law)} (the paper’s)"
    return "true friction and rigid body" if law == ORACLE else results.title(law)


def scheme_name(name: str) -> str:
    """Return the name of a scheme in words."""
    first, *more = name.split(", ")
    return ", ".join((_NAMES.get(first, first), *more))


def _figure(results: Results, pictures: Pictures, scheme: str) -> Markup:
    from cosim.figures.chart import Chart, Line, Panel
    from cosim.figures.style import DESIRED, SOFT, Stroke, strokes

    named = [BODY_ONLY, *(law for law in results.key_laws if law not in ("stribeck", "parfam_v"))]
    paths = {law: results.paths[scheme, law] for law in named if (scheme, law) in results.paths}
    if not paths:
        return Markup()
    styles = {BODY_ONLY: Stroke(colour=SOFT), **strokes(results.key_laws)}
    first = next(iter(paths.values()))
    rows = []
    for k, short in enumerate(results.joints):
        lines = [
            Line(name=results.title(law), x=first.t, y=1e3 * np.abs(path.q - path.q_d)[:, k],
                 stroke=styles[law])
            for law, path in paths.items()
            if len(path.t) == len(first.t)
        ]  # fmt: skip
        actual = [
            Line(name=results.title(law), x=first.t, y=path.q[:, k], stroke=styles[law])
            for law, path in paths.items()
            if len(path.t) == len(first.t)
        ]
        desired = Line(name="desired", x=first.t, y=first.q_d[:, k], stroke=DESIRED)
        rows.append(
            (
                Panel(title=short, y="q [rad]", lines=(*actual, desired)),
                Panel(title="", y="|error| [mrad]", lines=tuple(lines)),
            )
        )
    return pictures.chart(
        f"tracking_{scheme}",
        Chart(x="t [s]", rows=tuple(rows), height=1.4),
        f"The first motion under {scheme_name(scheme)}: position (left) and absolute error "
        "(right), as Fig. 7 of the paper. On the scale of the motion most lines lie on each other; "
        "the error tells them apart.",
        alt="Position over time of each joint, desired and tracked, and beside it the absolute "
        "tracking error, which is largest for the rigid body alone.",
    )


def _more(results: Results) -> list[Markup]:
    loop = results.loop
    if loop is None:
        return []
    measured = [row for row in loop.tables if "friction of" in row.scheme]
    parts = []
    if measured:
        caption = "RMSE [mrad] with friction evaluated on measured or filtered velocity"
        parts.append(table(_plain(results, caption, measured, end=False)))
    if loop.long:
        minutes = results.run.controller["drift"]
        caption = f"One motion of {minutes:g} s: RMSE [mrad]; small: mean error of its last tenth"
        parts.append(table(_plain(results, caption, loop.long, end=True)))
    return parts


def _plain(results: Results, caption: str, rows: "Sequence[Tracked]", *, end: bool) -> Table:
    table_rows, places = [], _places(rows)
    for scheme in dict.fromkeys(row.scheme for row in rows):
        table_rows.append(Row(head=scheme_name(scheme)))
        for row in rows:
            if row.scheme == scheme:
                cells = [mrad(v, n) for v, n in zip(row.mean, places, strict=True)]
                if end:
                    cells = [
                        Cell(text=c.text, value=c.value, beside=f"({1e3 * e:.3g})")
                        if c.value is not None
                        else c
                        for c, e in zip(cells, row.last[0], strict=True)
                    ]
                table_rows.append(Row(head=named(results, row.law), cells=cells))
    return Table(caption=caption, head=("torque model", *results.joints), rows=table_rows)
