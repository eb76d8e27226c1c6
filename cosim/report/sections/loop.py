"""Closed loop: controller (Fig. 6), tracking (Table III, Fig. 7), robustness."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.loop.traces import Tracked
from cosim.report import paper
from cosim.report.figures.chart import Chart, Line, Panel
from cosim.report.figures.style import DESIRED, SOFT, Stroke, strokes
from cosim.report.markup import render
from cosim.report.results import Results
from cosim.report.tables import loop as tables
from cosim.report.tables.table import title

_OWN, _INVERSE = Scheme(compensation="torque_error"), Scheme(compensation="servo_inversion")
_CAPTION = "Tracking: RMSE [mrad], mean over the motions"


def tracking(results: Results) -> dict[str, Any] | None:
    """Compare tracking errors under every law and scheme."""
    if results.loop is None:
        return None
    desired, measured = (
        [row for row in results.loop.tracking if (row.scheme.source == "desired") == wanted]
        for wanted in (True, False)
    )
    own = [row for row in desired if not row.scheme.Kx]
    more = {}
    if measured:
        caption = "RMSE [mrad] with friction evaluated on measured or filtered velocity"
        more["tracking_measured_velocity"] = tables.tracking(caption, measured)
    if results.loop.long:
        caption = f"One motion of {results.run.controller['drift']:g} s: RMSE [mrad]"
        more["tracking_long"] = tables.tracking(caption, results.loop.long)
    if results.run.robot == paper.ROBOT:
        more["paper_tracking"] = paper.table_iii(results.joints)
    return {
        "motions": desired[0].rmse.shape[0],
        "Kx": f"{results.run.controller['Kx']:g}",
        "diagram": render("controller.svg"),
        "own": tables.tracking(f"{_CAPTION}, torque error scheme", _under(_OWN, own)),
        "inverse": tables.tracking(f"{_CAPTION}, servo inversion", _under(_INVERSE, desired)),
        "figures": {scheme.name: _figure(results, scheme) for scheme in (_OWN, _INVERSE)},
        "titles": {scheme.name: scheme.title for scheme in (_OWN, _INVERSE)},
        "more": more,
    }


def _under(scheme: Scheme, rows: Sequence[Tracked]) -> list[Tracked]:
    kinds = (scheme.compensation, "none")
    return [row for kind in kinds for row in rows if row.scheme.compensation == kind]


def _figure(results: Results, scheme: Scheme) -> Chart | None:
    laws = [law for law in results.key_laws if results.models[law].laws[0].form.memory]
    keys = [(scheme, law) for law in (StandIn.BODY_ONLY, *laws)]
    paths = {key[1]: results.paths[key] for key in keys if key in results.paths}
    if not paths:
        return None
    styles = {StandIn.BODY_ONLY: Stroke(colour=SOFT), **strokes(results.key_laws)}
    first = next(iter(paths.values()))
    rows = []
    for k, short in enumerate(results.joints):
        desired = Line(name="desired", x=first.t, y=first.q_d[:, k], stroke=DESIRED)
        position, error = (
            tuple(
                Line(name=title(law), x=first.t, y=values[law][:, k], stroke=styles[law])
                for law, path in paths.items()
                if len(path.t) == len(first.t)
            )
            for values in (
                {law: path.q for law, path in paths.items()},
                {law: 1e3 * np.abs(path.q - path.q_d) for law, path in paths.items()},
            )
        )
        rows.append(
            (
                Panel(title=short, y="q [rad]", lines=(*position, desired)),
                Panel(title="", y="|error| [mrad]", lines=error),
            )
        )
    return Chart(x="t [s]", rows=tuple(rows), height=1.4)


def following(results: Results) -> dict[str, Any] | None:
    """Return predicted following errors of the robot on a log with commands."""
    if results.following is None:
        return None
    found = results.following
    return {
        "found": found,
        "sentence": tables.benefit(found, results.sliding),
        "errors": tables.following(found, results.sliding),
    }


def robustness(results: Results) -> dict[str, Any] | None:
    """Return tracking errors with an arm other than the identified one."""
    if results.loop is None or not results.loop.sweeps:
        return None
    return {
        "sweeps": tables.sweeps(results.loop.sweeps),
        "overcompensation": tables.overcompensation(results.loop.overcompensation),
    }
