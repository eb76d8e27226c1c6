"""Robot, logs and their checks; rigid body (Fig. 3); provenance."""

from importlib.metadata import version
from typing import Any

from markupsafe import Markup

from cosim.report.figures.chart import Chart, Line, Panel
from cosim.report.figures.style import MEASURED, strokes
from cosim.report.figures.zoom import can_zoom
from cosim.report.results import Results
from cosim.report.tables.table import (
    ResultTable,
    TableRow,
    format_significant,
    make_row,
    number,
)
from cosim.study.results import HEALTH, SavedLog, read_findings
from cosim.study.study import LEFT_OUT
from cosim.study.verdict import VERDICT
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.support.extras import install_command

_INTERVAL = 1.96  # half width of a 95 % interval in standard errors
_ROLES = {
    "identification": "rigid body",
    "training": "training of the laws",
    LEFT_OUT: "errors on left-out rows",
}
_FILES = ("evaluation.json", "rigid_body.json", VERDICT, HEALTH)
"""Linked files of a run, in addition to FMUs."""
_METHODS = {
    "stacked": "stacked least squares with friction columns",
    "paper": "averaging of the motion and its reverse",
}


def data(results: Results) -> dict[str, Any]:
    """Return robot, logs and findings."""
    run = results.run
    findings = sorted(read_findings(results.folder), key=lambda finding: not finding.logs)
    scope = "laws were judged on rows that they were not fitted to"
    if results.has_tests:
        scope = "no log of a test set was used for training"
    return {
        "run": run,
        "joints": ", ".join(f"{short} {name}" for _, short, name in results.numbered),
        "gears": ", ".join(f"{g:g}" for g in run.gear_ratio),
        "samples": [log.name for log in run.logs if log.sample],
        "findings": findings,
        "of_logs": sum(bool(finding.logs) for finding in findings),
        "logs": ResultTable(
            caption=f"Logs and their uses; {scope}",
            words=(1,),
            head=("log", "use", "rows", "duration [s]", "rate [Hz]"),
            rows=list(map(_make_log_row, run.logs)),
        ),
    }


def _make_log_row(log: SavedLog) -> TableRow:
    roles = [_ROLES.get(role, f"test ‘{role}’") for role in log.roles]
    return make_row(
        log.name,
        ", ".join(roles) or "–",
        number(log.rows, max(3, len(str(log.rows)))),
        number(log.duration, 4),
        number(log.rate, 4),
    )


def body(results: Results) -> dict[str, Any]:
    """Return the identified parameters and their torque."""
    body = results.body
    log = results.find_log("identification")
    method = _METHODS[body.method]
    if body.weighting == "wls":
        method += ", weighted by the residual of each joint"
    return {
        "body": body,
        "rotors": sum(name.endswith(".Ir") for name in body.names),
        "method": method,
        "condition": format_significant(body.condition),
        "errors": ", ".join(map(format_significant, body.rmse)),
        "log": log,
        "torques": _torques(results, log) if log else None,
        "parameters": parameters(body),
    }


def _torques(results: Results, log: SavedLog) -> Chart:
    torques = results.torques(log)
    t = torques["t"]
    blue = strokes(["rigid body"])["rigid body"]
    rows = []
    for k, short, name in results.numbered:
        lines = (
            Line(name="measured", x=t, y=torques[f"tau{k}"], stroke=MEASURED),
            Line(name="rigid body", x=t, y=torques[f"tau_rb{k}"], stroke=blue),
        )
        y = f"torque [{results.unit('N.m', k - 1)}]"
        rows.append((Panel(title=f"{short}: {name}", y=y, lines=lines),))
    return Chart(x="t [s]", rows=tuple(rows), height=1.35)


def parameters(body: RigidBody) -> ResultTable:
    """Return the table of identified parameters."""
    units = "m [kg], mx.. [kg.m], Ixx.. and rotor Ir [kg.m²]"
    if any(name.endswith(".const") for name in body.names):
        units += "; springs: k [N.m/rad], others [N.m]"
    if body.gears:
        units += "; elastic gears: friction of motor and link, SI units"
    rows = []
    for k, error in zip(body.base, body.standard_errors, strict=True):
        rows.append(_make_parameter_row(body.names[k], body.parameters[k], error))
    for gear in body.gears:
        for name, (value, error) in gear.parameters.items():
            rows.append(_make_parameter_row(f"{gear.joint}.{name}", value, error))
    return ResultTable(
        caption=f"Base parameters: {units}; each includes the parameters that depend on it",
        head=("parameter", "value", "± 95 %"),
        rows=rows,
    )


def _make_parameter_row(name: str, value: float, error: float) -> TableRow:
    """Return the row of a parameter with its standard error."""
    return make_row(name, number(value, 4), number(_INTERVAL * error, 2))


def provenance(results: Results) -> dict[str, Any]:
    """Return command, versions, files and hashes."""
    run = results.run
    files = dict.fromkeys((log.file, log.sha256) for log in run.logs)
    logs = {log.sha256 for log in run.logs}
    for file in results.provenance.get("files", ()):
        if file["sha256"] not in logs:
            files[file["name"], file["sha256"]] = None
    fmus = dict.fromkeys((results.fmu, *(f"fmus/{law_name}.fmu" for law_name in results.models)))
    hash_rows = [make_row(name, Markup("<code>{}</code>").format(digest)) for name, digest in files]
    return {
        "run": run,
        "versions": ", ".join(f"{name} {number}" for name, number in run.versions.items()),
        "bokeh": version("bokeh") if can_zoom() else "",
        "install_bokeh": install_command("report"),
        "files": [file for file in [*fmus, *_FILES] if (results.folder / file).is_file()],
        "hashes": ResultTable(
            caption="SHA-256 of the input files",
            head=("file", "SHA-256"),
            rows=hash_rows,
            numeric=False,
        ),
    }
