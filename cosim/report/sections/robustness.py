"""What the closed loop bears when the arm is not what was identified."""

from cosim.report.markup import Pictures, Section, details, joined, paragraph, table
from cosim.report.results import Results
from cosim.report.tables.loop import overcompensation, sweeps


def section(results: Results, pictures: Pictures) -> Section | None:
    """Show what the loop bears when the arm changes."""
    del pictures
    if results.loop is None:
        return None
    changes = [table(one) for one in sweeps(results.loop.sweeps)]
    return Section(
        key="robustness",
        title="Robustness",
        html=joined(
            paragraph(
                "The same loop when the arm is not what was identified: payloads, warm and cold "
                "friction, latency, wrong servo gains, more noise. A run that left the joint "
                "limits is ‘stopped’."
            ),
            details("The paper’s scheme", *changes[:1]),
            *changes[1:],
            table(overcompensation(results.loop.overcompensation)),
        ),
    )
