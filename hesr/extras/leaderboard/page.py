"""Page of a leaderboard."""

from pathlib import Path

from markupsafe import Markup

from cosim.report.markup import Section, details, joined, paragraph, table, write_sections
from cosim.report.tables.laws import legend, properties
from hesr.extras.leaderboard import tables
from hesr.extras.leaderboard.leaderboard import Leaderboard


def write_page(board: Leaderboard, path: Path) -> None:
    """Write the page."""
    sections = [Section(key="standings", title="Standings", html=_standings(board))]
    if found := {s.name: s.properties for s in board.standings if s.properties is not None}:
        sliding = [slides for robot in board.robots for slides in robot.sliding]
        html = joined(table(properties(found, full=True)), table(legend(sliding)))
        sections.append(Section(key="properties", title="Properties", html=html))
    rules = joined(_rules(board), table(tables.logs(board)), table(tables.entries(board.standings)))
    sections.append(Section(key="rules", title="Rules, logs and entries", html=rules))
    count, logs = len(board.standings), len(board.logs)
    write_sections(
        path,
        title=f"HESR leaderboard: {board.arena}",
        heading=f"Leaderboard ‘{board.arena}’",
        summary=paragraph(
            f"{count} friction {'FMUs' if count != 1 else 'FMU'} on {logs} "
            f"{'logs' if logs != 1 else 'log'}. An entry is any FMU with the connectors of a "
            "friction FMU."
        ),
        sections=sections,
    )


def _standings(board: Leaderboard) -> Markup:
    parts = []
    entered = [r for r in board.robots if any(s.robot == r.name for s in board.standings)]
    for robot, whole in zip(entered, tables.standings(board), strict=True):
        kinds = next(s.relative for s in board.standings if s.robot == robot.name)
        inner = (table(tables.by_joint(board, robot, kind)) for kind in kinds)
        parts += [table(whole), details(f"{robot.name}, joint by joint", *inner)]
    return joined(*parts)


def _rules(board: Leaderboard) -> Markup:
    classes = "; ".join(f"{name}: {', '.join(may)}" for name, may in board.classes.items())
    return paragraph(
        f"The first {board.warm_up:g} s of each log are replayed but not scored. Errors are "
        "measured less predicted friction torque over its standard deviation, over all rows and "
        f"joints. Intervals: bootstrap of blocks of {board.block:g} s within these logs; they do "
        "not cover other logs. The class of an entry is the smallest that allows the inputs with "
        f"an effect on its torque ({classes})."
    )
