"""Torque on unseen motions (Table II, Fig. 4 and 5), friction loops, and the closed loop."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.loop.traces import Tracked
from cosim.report.figures.chart import Chart, Figure, Line, Panel
from cosim.report.figures.plots import loops as loop_panels
from cosim.report.figures.plots import ratios
from cosim.report.figures.style import DESIRED, MEASURED, SOFT, Stroke, strokes
from cosim.report.markup import render
from cosim.report.results import Results
from cosim.report.tables import loop as loop_tables
from cosim.report.tables import replicates as replicate_tables
from cosim.report.tables import scores as tables
from cosim.report.tables.table import ResultTable, title
from cosim.study.replicates import TRAINING
from cosim.study.results import SavedLog
from cosim.study.scores import BASELINE, ORACLE, input_classes
from hesr_model.fitting.estimator import papers_law
from hesr_model.friction.band import LEVEL
from hesr_model.friction.model import compute_band
from hesr_model.support.arrays import Array

_NETWORK = "rbfnn_h"  # law compared with ParFam-H in Fig. 5 of the paper
WINDOW = 10.0  # [s] in static figures
MOVING = 0.25  # window of the moving error [s]; it averages out noise
_LOOPS = 20.0  # time span of friction loops [s]
_POINTS = 400  # points of a loop in the page, fewer for more than 3 joints
_EDGE = Stroke(colour=SOFT, width=0.6, dash=(1.5, 1.5))


def errors_of_tests(results: Results) -> dict[str, Any]:
    """Compare all laws on every test set."""
    run = results.run
    test = results.tests[0]
    law_ratios = results.comparisons[test].ratios
    reference = "its reference" if law_ratios.fair else title(law_ratios.reference)
    ratios_by_title = {title(law_name): row for law_name, row in law_ratios.laws.items()}
    values: dict[str, Any] = {
        "test": test,
        "has_tests": results.has_tests,
        "reference": reference,
        "ratios": None,
        "moving": f"{MOVING:g}",
        "window": f"{WINDOW:g}",
        "tests": [_test(results, test) for test in results.tests],
        "training": _replicates(results, TRAINING),
        "left_out": tables.cross_validation(results.models, results.sliding),
        "truths": None,
        "family": tables.describe_true_friction(run.truth),
        "paper": None,
    }
    if ratios_by_title:
        x = f"RMSE / RMSE of {reference}"
        values["ratios"] = ratios(ratios_by_title, results.joints, x=x)
    if results.truths:
        table = tables.compare_truths(results.comparisons, results.truths, run.truth)
        values["truths"] = table
    if run.robot == loop_tables.ROBOT:
        values["paper"] = loop_tables.table_ii(results.joints)
    return values


def _test(results: Results, test: str) -> dict[str, Any]:
    """Return the values of one test set."""
    comparison = results.comparisons[test]
    log = results.find_log(test)
    simulated = results.simulated.get(test)
    table, *parts = (_errors(results, test, measure) for measure in tables.MEASURES)
    laws = _key_laws(results)
    window = None
    if log and log.duration > 1.5 * WINDOW:
        window = (0.0, WINDOW)
    values: dict[str, Any] = {
        "name": test,
        "errors": table,
        "parts": parts,
        "replicates": _replicates(results, test),
        "log": log,
        "laws": ", ".join(map(title, laws)),
        "window": window,
        "traces": None,
        "simulated": None,
        "bands": None,
        "separations": None,
    }
    # The chapter on chirps draws the logs with bands.
    is_split = test != results.tests[0] and test in {band.test for band in results.run.bands}
    if log and not is_split:
        values["traces"] = _chart(results, log, laws, window=window)
    if simulated:
        table = tables.position_errors(test, simulated, comparison, results.sliding)
        values["simulated"] = table
    if comparison.bands:
        values["bands"] = tables.bands(test, comparison)
    # Left-out rows are not a test; the table of recommended laws has their intervals.
    if results.has_tests:
        verdict = results.verdict
        recommended_laws = verdict.laws if verdict and verdict.test == test else ()
        values["separations"] = tables.separations(test, comparison, recommended_laws)
    return values


def _replicates(results: Results, name: str) -> dict[str, Any]:
    """Return what repeats of the errors on logs with a name."""
    saved = results.replicates.get(name)
    laws = results.recommended
    sentences = replicate_tables.describe_replicates(results.replicates, name, laws)
    if saved is None:
        return {"sentences": sentences, "split": None, "shares": None}
    chosen_laws = replicate_tables.choose_laws(saved, laws)
    return {
        "sentences": sentences,
        "split": replicate_tables.split_of_laws(name, saved, chosen_laws, results.sliding),
        "shares": replicate_tables.shares_of_laws(name, saved),
    }


def _errors(results: Results, name: str, measure: str = "rmse") -> ResultTable:
    comparison = results.comparisons[name]
    inputs = input_classes(results.models)
    return tables.errors(name, comparison, measure, inputs, results.sliding, results.run.left_out)


def _key_laws(results: Results) -> list[str]:
    """Return the laws of the figures of errors; a law alone compares with nothing."""
    laws = results.find_fitted(BASELINE, papers_law(), results.best)
    if len(laws) > 1:
        return laws
    return results.key_laws[:3]


def chirp(results: Results) -> dict[str, Any] | None:
    """Compare the laws on both sides of a chirp's middle frequency."""
    bands = results.run.bands
    if not bands:
        return None
    laws = results.find_fitted(_NETWORK, papers_law(), results.best)
    if len(laws) < 2:
        laws = _key_laws(results)
    tests = []
    for test in dict.fromkeys(band.test for band in bands):
        log = results.find_log(test)
        parts = [band for band in bands if band.test == test]
        marks = tuple((band.start, "split") for band in parts if band.start > 0.0)
        tests.append(
            {
                "name": test,
                "key": f"split_{results.tests.index(test) + 1}",
                "log": log,
                "traces": _chart(results, log, laws, marks=marks) if log else None,
                "errors": [_errors(results, band.name) for band in parts],
            }
        )
    return {"tests": tests, "laws": ", ".join(map(title, laws)), "moving": f"{MOVING:g}"}


def _chart(
    results: Results,
    log: SavedLog,
    laws: Sequence[str],
    *,
    marks: tuple[tuple[float, str], ...] = (),
    window: tuple[float, float] | None = None,
) -> Chart:
    torques = results.torques(log)
    styles = strokes(results.key_laws)
    t = torques["t"]
    rows = []
    for k, short, name in results.numbered:
        unit = results.unit("N.m", k - 1)
        measured = torques[f"tau{k}"] - torques[f"tau_rb{k}"]
        predicted = {law_name: torques[f"{law_name}.tau_f{k}"] for law_name in laws}
        errors = {law_name: moving_rms(t, tau - measured) for law_name, tau in predicted.items()}
        friction_lines: list[Line] = []
        if results.best in laws:
            friction_lines += band(results, results.best, k, torques)
        friction_lines.append(Line(name="measured", x=t, y=measured, stroke=MEASURED))
        friction_lines += _lines(t, predicted, styles)
        friction = Panel(
            title=f"{short}: {name}",
            y=f"friction [{unit}]",
            lines=tuple(friction_lines),
            marks=marks,
        )
        error_lines = _lines(t, errors, styles)
        error = Panel(title="", y=f"RMS error [{unit}]", lines=error_lines, marks=marks)
        rows.append((friction, error))
    return Chart(x="t [s]", rows=tuple(rows), height=1.5, window=window)


def _lines(t: Array, laws: Mapping[str, Array], styles: Mapping[str, Stroke]) -> tuple[Line, ...]:
    return tuple(
        Line(name=title(law_name), x=t, y=y, stroke=styles[law_name])
        for law_name, y in laws.items()
    )


def moving_rms(t: Array, error: Array) -> Array:
    """Return the RMS error (N,) within a window of `MOVING` around each time."""
    # Differences of one running sum give the sums of all windows.
    total = np.concatenate([[0.0], np.cumsum(error**2)])
    first = np.searchsorted(t, t - 0.5 * MOVING)
    last = np.searchsorted(t, t + 0.5 * MOVING)
    row_counts = np.maximum(last - first, 1)  # a gap of the log leaves an empty window
    return np.asarray(np.sqrt((total[last] - total[first]) / row_counts))


def band(
    results: Results, law_name: str, number: int, torques: Mapping[str, Array]
) -> tuple[Line, ...]:
    """Return both ends of a law's 95 % band as lines, if it has one."""
    model = results.models.get(law_name)
    if model is None or not model.banded:
        return ()
    numbers = range(1, len(results.joints) + 1)

    def stack_joints(column: str) -> Array:
        return np.column_stack([torques[f"{column}{k}"] for k in numbers])

    load = "tau_load" if "tau_load1" in torques else "tau_rb"
    ends = compute_band(
        model,
        t=torques["t"],
        dq=stack_joints("dq"),
        q=stack_joints("q"),
        tau_load=stack_joints(load),
        torque=stack_joints(f"{law_name}.tau_f"),
        coverage=LEVEL,
    )
    name = f"95 % band of {title(law_name)}"
    k = number - 1
    return tuple(Line(name=name, x=torques["t"], y=end[:, k], stroke=_EDGE) for end in ends)


def loops(results: Results) -> dict[str, Any] | None:
    """Draw torque over velocity by joint: key laws in the page, all laws in files."""
    test = results.tests[0]
    log = results.find_log(test)
    if log is None:
        return None
    torques = results.torques(log)
    is_shown = torques["t"] - torques["t"][0] <= _LOOPS
    shown_torques = {column: values[is_shown] for column, values in torques.items()}
    points = min(_POINTS, 3 * _POINTS // len(results.joints))
    key_laws = [law_name for law_name in results.key_laws if law_name in results.laws]
    figures = []
    for k, short, name in results.numbered:
        figures.append(
            {
                "joint": name,
                "heading": f"{short}: {name}",
                "few": _draw_loops(results, shown_torques, k, key_laws, points),
                "whole": _draw_loops(results, shown_torques, k, results.laws, None),
            }
        )
    return {"test": test, "log": log, "span": f"{_LOOPS:g}", "figures": figures}


def _draw_loops(
    results: Results,
    torques: Mapping[str, Array],
    number: int,
    laws: Sequence[str],
    points: int | None,
) -> Figure:
    """Draw the friction of one joint over its velocity: measured, by laws, and the true one.

    The figure has at most `points` points of a law; None is all.
    """
    dq = torques[f"dq{number}"]
    measured = torques[f"tau{number}"] - torques[f"tau_rb{number}"]
    loops_by_title = {}
    for law_name in (*laws, ORACLE):
        column = f"{law_name}.tau_f{number}"
        if column in torques:
            loops_by_title[title(law_name)] = (dq, torques[column])
    j = number - 1
    return loop_panels(
        (dq, measured),
        loops_by_title,
        x=f"dq of {results.joints[j]} [{results.unit('rad/s', j)}]",
        y=f"friction [{results.unit('N.m', j)}]",
        points=points,
    )


_TORQUE_ERROR_SCHEME = Scheme(compensation="torque_error")
_INVERSION_SCHEME = Scheme(compensation="servo_inversion")
_DRAWN_SCHEMES = (_TORQUE_ERROR_SCHEME, _INVERSION_SCHEME)
_CAPTION = "Tracking: RMSE [mrad], mean over the motions"


def tracking(results: Results) -> dict[str, Any] | None:
    """Compare tracking errors under every law and scheme."""
    if results.loop is None:
        return None
    desired_rows = [row for row in results.loop.tracking if row.scheme.source == "desired"]
    measured_rows = [row for row in results.loop.tracking if row.scheme.source != "desired"]
    rows_without_kx = [row for row in desired_rows if not row.scheme.Kx]
    further_tables = {}
    if measured_rows:
        caption = "RMSE [mrad] with friction evaluated on measured or filtered velocity"
        further_tables["tracking_measured_velocity"] = loop_tables.tracking(caption, measured_rows)
    if results.loop.long:
        caption = f"One motion of {results.run.controller['drift']:g} s: RMSE [mrad]"
        further_tables["tracking_long"] = loop_tables.tracking(caption, results.loop.long)
    if results.run.robot == loop_tables.ROBOT:
        further_tables["paper_tracking"] = loop_tables.table_iii(results.joints)
    return {
        "motions": desired_rows[0].rmse.shape[0],
        "Kx": f"{results.run.controller['Kx']:g}",
        "diagram": render("controller.svg"),
        "own": loop_tables.tracking(
            f"{_CAPTION}, torque error scheme", _select_rows(_TORQUE_ERROR_SCHEME, rows_without_kx)
        ),
        "inverse": loop_tables.tracking(
            f"{_CAPTION}, servo inversion", _select_rows(_INVERSION_SCHEME, desired_rows)
        ),
        "figures": {scheme.name: _figure(results, scheme) for scheme in _DRAWN_SCHEMES},
        "titles": {scheme.name: scheme.title for scheme in _DRAWN_SCHEMES},
        "more": further_tables,
    }


def _select_rows(scheme: Scheme, rows: Sequence[Tracked]) -> list[Tracked]:
    """Return the rows of a scheme, then those without compensation."""
    compensated_rows = [row for row in rows if row.scheme.compensation == scheme.compensation]
    plain_rows = [row for row in rows if row.scheme.compensation == "none"]
    return compensated_rows + plain_rows


def _figure(results: Results, scheme: Scheme) -> Chart | None:
    """Draw positions and their errors with a scheme, by joint; None if no path is saved."""
    laws = [
        law_name for law_name in results.key_laws if results.models[law_name].laws[0].form.memory
    ]
    paths = {
        law_name: results.paths[scheme, law_name]
        for law_name in (StandIn.BODY_ONLY, *laws)
        if (scheme, law_name) in results.paths
    }
    if not paths:
        return None
    styles = {StandIn.BODY_ONLY: Stroke(colour=SOFT), **strokes(results.key_laws)}
    first_path = next(iter(paths.values()))
    t = first_path.t
    # Paths of runs that stopped early have other times.
    complete_paths = {law_name: path for law_name, path in paths.items() if len(path.t) == len(t)}
    rows = []
    for k, short in enumerate(results.joints):
        positions = {law_name: path.q[:, k] for law_name, path in complete_paths.items()}
        errors = {
            law_name: 1e3 * np.abs(path.q - path.q_d)[:, k]
            for law_name, path in complete_paths.items()
        }
        desired_line = Line(name="desired", x=t, y=first_path.q_d[:, k], stroke=DESIRED)
        position_lines = (*_lines(t, positions, styles), desired_line)
        position = Panel(title=short, y="q [rad]", lines=position_lines)
        error = Panel(title="", y="|error| [mrad]", lines=_lines(t, errors, styles))
        rows.append((position, error))
    return Chart(x="t [s]", rows=tuple(rows), height=1.4)


def following(results: Results) -> dict[str, Any] | None:
    """Return predicted following errors of the robot on a log with commands."""
    following_errors = results.following
    if following_errors is None:
        return None
    return {
        "following": following_errors,
        "sentence": loop_tables.benefit(following_errors, results.sliding),
        "errors": loop_tables.following(following_errors, results.sliding),
    }


def robustness(results: Results) -> dict[str, Any] | None:
    """Return tracking errors with an arm other than the identified one."""
    if results.loop is None or not results.loop.sweeps:
        return None
    return {
        "sweeps": loop_tables.sweeps(results.loop.sweeps),
        "overcompensation": loop_tables.overcompensation(results.loop.overcompensation),
    }
