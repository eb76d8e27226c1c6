"""The robot, its logs, and what the checks found in them."""

from markupsafe import Markup

from cosim.report.markup import Pictures, Section, details, joined, listing, paragraph, table
from cosim.report.results import Results
from cosim.report.tables.table import ResultTable, number, row_of
from cosim.study.results import read_findings

_FEW = 3  # findings that stand open


def section(results: Results, pictures: Pictures) -> Section:
    """Say which robot it is, and which log served for what."""
    del pictures
    run = results.run
    source = (
        "The logs come from a digital twin: MuJoCo moves the arm, and its friction is made of "
        "MuJoCo's own parts, so that it is of the form of no law below. Its true friction is known."
        if run.twin
        else "The logs were measured. The true friction is not known, and there is no closed loop."
    )
    if samples := [log.name for log in run.logs if log.sample]:
        source = (
            f"Sample data, not measured: {', '.join(samples)} were simulated by 'hesr new', with "
            "friction and noise of plausible size. What is learnt from them says nothing about a "
            "real robot."
        )
    joints = ", ".join(f"{short} {name}" for _, short, name in results.numbered)
    gears = (
        f" Gear ratios: {', '.join(f'{g:g}' for g in run.gear_ratio)}." if run.gear_ratio else ""
    )
    logs = ResultTable(
        caption="Logs, and what they served for; no log of a test set was trained on",
        words=(1,),
        head=("log", "served for", "rows", "duration [s]", "rate [Hz]"),
        rows=[
            row_of(
                log.name,
                _roles(log.roles),
                number(log.rows, max(3, len(str(log.rows)))),
                number(log.duration, 4),
                number(log.rate, 4),
            )
            for log in run.logs
        ],
    )
    return Section(
        key="data",
        title="Robot, data and their health",
        html=joined(
            paragraph(f"Robot {run.robot}, model {run.model}, joints {joints}.{gears}"),
            paragraph(source),
            _health(results),
            table(logs),
        ),
    )


def _health(results: Results) -> Markup:
    """Say what the checks found: in logs first, then in fits; many are folded away."""
    findings = sorted(read_findings(results.folder), key=lambda finding: not finding.logs)
    if not findings:
        return paragraph("The checks of logs and fits found nothing wrong or odd.")
    items = listing(found.sentence for found in findings)
    said = f"The checks found {len(findings)} odd thing{'s' if len(findings) > 1 else ''}"
    if len(findings) <= _FEW:
        return joined(paragraph(f"{said}:"), items)
    logs = sum(bool(finding.logs) for finding in findings)
    return details(f"{said}: {logs} in logs, {len(findings) - logs} in what was fitted", items)


def _roles(roles: tuple[str, ...]) -> str:
    names = {"identification": "rigid body", "training": "training of the laws"}
    return ", ".join(names.get(role, f"test ‘{role}’") for role in roles) or "–"
