"""The rigid body (Fig. 3)."""

from markupsafe import Markup

from cosim.report.markup import Pictures, Section, details, joined, paragraph, table
from cosim.report.results import Results
from cosim.report.tables.table import ResultTable, number, rounded, row_of
from cosim.study.results import SavedLog
from hesr_model.rigid_body.identification import RigidBody

_INTERVAL = 1.96


def section(results: Results, pictures: Pictures) -> Section:
    """Show what was identified, and its torque beside the measured one."""
    body = results.body
    rotors = sum(name.endswith(".Ir") for name in body.names)
    more = f", {rotors} of them rotor inertias" if rotors else ""
    errors = ", ".join(rounded(e) for e in body.rmse)
    parts = [
        paragraph(
            f"{len(body.base)} base parameters carry the {len(body.names)} standard ones{more}. "
            f"They were found by {_method(body)} from {', '.join(body.logs)}, with a condition "
            f"number of {rounded(body.condition)}. What is left over the rows of the fit: "
            f"{errors} {results.unit('N.m')} RMSE."
        )
    ]
    log = results.log_of("identification")
    if log is not None:
        parts.append(_figure(results, pictures, log))
    parts.append(details("Base parameters", table(_parameters(body))))
    return Section(key="body", title="Rigid body", html=joined(*parts))


def _method(body: RigidBody) -> str:
    ways = {"stacked": "stacked least squares with friction columns", "paper": "averaging of the "
            "motion and its reverse"}  # fmt: skip
    weighted = ", weighted by the noise of each joint" if body.weighting == "wls" else ""
    return ways[body.method] + weighted


def _figure(results: Results, pictures: Pictures, log: SavedLog) -> Markup:
    from cosim.report.figures.chart import Chart, Line, Panel
    from cosim.report.figures.style import MEASURED, strokes

    torques = results.torques(log)
    t, blue = torques["t"], strokes(["rigid body"])["rigid body"]
    rows = tuple(
        (
            Panel(
                title=f"{short}: {name}",
                y=f"torque [{results.unit('N.m', k - 1)}]",
                lines=(
                    Line(name="measured", x=t, y=torques[f"tau{k}"], stroke=MEASURED),
                    Line(name="rigid body", x=t, y=torques[f"tau_rb{k}"], stroke=blue),
                ),
            ),
        )
        for k, short, name in results.numbered
    )
    return pictures.chart(
        "rigid_body",
        Chart(x="t [s]", rows=rows, height=1.35),
        f"Measured torque and the torque of the identified rigid body on {log.name} (Fig. 3 of the "
        "paper). What lies between them is friction, which changes sign with the velocity, and "
        "noise.",
        alt=f"Torque over time of each joint on {log.name}: the rigid body follows the slow course "
        "of the measured torque, which lies above it or below it by the friction.",
    )


def _parameters(body: RigidBody) -> ResultTable:
    return ResultTable(
        caption="Base parameters: m [kg], mx.. [kg.m], Ixx.. and rotor Ir [kg.m²]; each carries "
        "what depends on it",
        head=("parameter", "value", "± 95 %"),
        rows=[
            row_of(body.names[k], number(body.parameters[k], 4), number(_INTERVAL * error, 2))
            for k, error in zip(body.base, body.standard_errors, strict=True)
        ],
    )
