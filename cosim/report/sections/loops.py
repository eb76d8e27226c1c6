"""Friction loops: torque over velocity of every law, on the log of a test set."""

from cosim.report.figures.plots import loops
from cosim.report.markup import Pictures, Section, details, joined, paragraph
from cosim.report.results import Results
from cosim.report.tables.table import title
from cosim.study.scores import ORACLE

_SPAN = 20.0  # [s] of the log that are drawn; more hide each other


def section(results: Results, pictures: Pictures) -> Section | None:
    """Draw the loops of each joint, the first one open and the others folded away."""
    test = results.tests[0]
    log = results.log_of(test)
    if log is None:
        return None
    torques = results.torques(log)
    rows = torques["t"] - torques["t"][0] <= _SPAN
    parts = []
    for k, short, name in results.numbered:
        dq = torques[f"dq{k}"][rows]
        measured = (torques[f"tau{k}"] - torques[f"tau_rb{k}"])[rows]
        laws = {
            title(law): (dq, torques[f"{law}.tau_f{k}"][rows])
            for law in (*results.laws, ORACLE)
            if f"{law}.tau_f{k}" in torques
        }
        drawn = pictures.figure(
            f"loops_{k}",
            loops(
                (dq, measured),
                laws,
                x=f"dq of {short} [{results.unit('rad/s', k - 1)}]",
                y=f"friction [{results.unit('N.m', k - 1)}]",
            ),
            f"Friction of {name} over its velocity near reversals on {log.name}: grey as measured, "
            "blue the law. A law of velocity alone is one curve; one with memory opens into loops, "
            "and the best follow the measured ones.",
            alt=f"For each law a small panel of friction torque over velocity of {name}; laws "
            "without memory are a single curve, the others are loops as the measured friction is.",
        )
        parts.append(drawn if k == 1 else details(f"{short}: {name}", drawn))
    return Section(
        key="loops",
        title="Friction loops",
        html=joined(
            paragraph(f"Torque over velocity, {_SPAN:g} s of the test set ‘{test}’, by law."),
            *parts,
        ),
    )
