"""Tables and page of a leaderboard."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path

from markupsafe import Markup

from cosim.report import markup
from cosim.report.markup import Section, details, joined, paragraph, write_sections
from cosim.report.tables import table
from cosim.report.tables.laws import legend, properties
from hesr.extras.leaderboard.board_file import Interval, Kind
from hesr.extras.leaderboard.leaderboard import Leaderboard, ScoredRobot, Standing
from hesr_model.units import unit_of_joints


def write_page(board: Leaderboard, path: Path) -> None:
    """Write the page."""
    sections = [Section(key="standings", title="Standings", html=_standings(board))]
    found = {s.name: s.properties for s in board.standings if s.properties is not None}
    if found:
        sliding = [slides for robot in board.robots for slides in robot.sliding]
        html = joined(markup.table(properties(found, full=True)), markup.table(legend(sliding)))
        sections.append(Section(key="properties", title="Properties", html=html))
    rules = joined(_rules(board), markup.table(logs(board)), markup.table(entries(board.standings)))
    sections.append(Section(key="rules", title="Rules, logs and entries", html=rules))
    count = len(board.standings)
    measured = len(board.logs)
    write_sections(
        path,
        title=f"HESR leaderboard: {board.arena}",
        heading=f"Leaderboard ‘{board.arena}’",
        summary=paragraph(
            f"{count} friction {'FMUs' if count != 1 else 'FMU'} on {measured} "
            f"{'logs' if measured != 1 else 'log'}. An entry is any FMU with the connectors of a "
            "friction FMU."
        ),
        sections=sections,
    )


def _standings(board: Leaderboard) -> Markup:
    parts = []
    entered = [r for r in board.robots if any(s.robot == r.name for s in board.standings)]
    for robot, whole in zip(entered, standings(board), strict=True):
        kinds = next(s.relative for s in board.standings if s.robot == robot.name)
        inner = (markup.table(by_joint(board, robot, kind)) for kind in kinds)
        parts += [markup.table(whole), details(f"{robot.name}, joint by joint", *inner)]
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


_HEADS = {"all": "all rows", "moving": "moving", "reversals": "reversals", "rests": "rests"}


def standings(board: Leaderboard) -> Iterator[table.ResultTable]:
    """Yield the standings of each robot."""
    for robot in board.robots:
        of_robot = [s for s in board.standings if s.robot == robot.name]
        if not of_robot:
            continue
        kinds = list(of_robot[0].relative)
        battery = of_robot[0].properties is not None
        timed = of_robot[0].step is not None
        rows = []
        for group, members in groupby(of_robot, key=lambda s: s.group):
            listed = list(members)
            alone = sum(s.leads for s in listed) == 1
            rows.append(table.row_of(f"inputs {group}"))
            for standing in listed:
                cells = [
                    _cell(standing.relative[kind], best=alone and standing.leads and kind == "all")
                    for kind in kinds
                ]
                cells.append(_cell(standing.ratio))
                if battery:
                    cells.append(table.TableCell(text=_passed(standing)))
                if timed and standing.step is not None:
                    cells.append(table.number(1e6 * standing.step, 2))
                name = f"{standing.name} (foreign)" if standing.foreign else standing.name
                rows.append(table.row_of(name, *cells))
        yield table.ResultTable(
            caption=f"{board.arena}, {robot.name}: error of the torque over the size of friction, "
            "with 95\u00a0% intervals",
            head=(
                "entry",
                *(_HEADS[kind] for kind in kinds),
                "ratio to leader",
                *(["properties"] if battery else []),
                *(["µs per step"] if timed else []),
            ),
            rows=rows,
            note="Intervals of ratios are simultaneous for a class. Bold: significantly better "
            "than all others of the class.",
        )


def by_joint(board: Leaderboard, robot: ScoredRobot, kind: Kind) -> table.ResultTable:
    """Return the RMSE by joint on rows of one kind."""
    of_robot = [s for s in board.standings if s.robot == robot.name]
    values = [s.joints[kind] for s in of_robot]
    places = [table.decimals(column) for column in zip(*values, strict=True)]
    unit = unit_of_joints("N.m", robot.sliding)
    spread = [table.fixed(s, n) for s, n in zip(robot.tau_std, places, strict=True)]
    return table.ResultTable(
        caption=f"{robot.name}: RMSE of the torque [{unit}], {_HEADS[kind]}",
        head=("entry", *table.joints(len(robot.joints))),
        rows=[
            table.row_of("(std of friction)", *spread, quiet=True),
            *(
                table.row_of(s.name, *(table.fixed(v, n) for v, n in zip(row, places, strict=True)))
                for s, row in zip(of_robot, values, strict=True)
            ),
        ],
    )


def logs(board: Leaderboard) -> table.ResultTable:
    """Return the logs."""
    rows = [table.row_of(x.name, x.robot, x.sha256, x.source, x.licence) for x in board.logs]
    head = ("log", "robot", "SHA-256", "from", "licence")
    return table.ResultTable(caption="Logs", head=head, rows=rows, numeric=False)


def entries(standings: Sequence[Standing]) -> table.ResultTable:
    """Return the entries."""
    rows = [
        table.row_of(s.name, s.robot, s.law or "–", ", ".join(s.inputs), s.sha256)
        for s in standings
    ]
    head = ("entry", "robot", "law", "inputs", "SHA-256")
    return table.ResultTable(caption="Entries", head=head, rows=rows, numeric=False)


def _cell(value: Interval | None, *, best: bool = False) -> table.TableCell:
    if value is None:
        return table.TableCell(text="–")
    return table.fixed(value.value, 3, best=best, notes=(f"{value.low:.3f}–{value.high:.3f}",))


def _passed(standing: Standing) -> str:
    found = standing.properties.joints if standing.properties else ()
    verdicts = [f.verdict for joint in found for f in joint.findings.values()]
    return f"{verdicts.count('pass')}/{verdicts.count('pass') + verdicts.count('fail')}"
