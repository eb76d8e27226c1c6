"""Job of `hesr test X.fmu --on LEADERBOARD.toml`."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from cosim.report.tables.table import ResultTable
from cosim.workflow.answer import Answer, PluginJob, shorten_lines
from hesr.extras.leaderboard.board_file import BoardFile
from hesr.extras.leaderboard.leaderboard import FORMAT, Leaderboard, entries_of, run_leaderboard
from hesr.extras.leaderboard.tables import standings, write_page
from hesr_model.support.progress import Stages, silent
from hesr_model.support.typed_files import to_json


def _run(
    path: Path,
    *,
    fmus: Sequence[str | Path],
    output: Path | None = None,
    trust: bool = False,
    progress: Stages = silent,
) -> "LeaderboardResult":
    """Score FMUs, given as FILE or ROBOT=FILE, and write the page."""
    from cosim.workflow.arguments import remember_trust

    rules = BoardFile.read(path)
    entries = entries_of([str(fmu) for fmu in fmus], rules)
    remember_trust((entry.fmu for entry in entries), trust=trust)
    board = run_leaderboard(rules, entries, progress=partial(progress, "scoring entries"))
    if output is not None:
        write_page(board, output)
    return LeaderboardResult(**vars(board), files=(output,) if output else ())


JOB = PluginJob("test", "robots", _run)


@dataclass(frozen=True, kw_only=True, repr=False)
class LeaderboardResult(Answer, Leaderboard):
    """Result of a leaderboard file."""

    format = FORMAT
    files: Sequence[Path] = ()

    def summary(self) -> str:
        """Return the leaders of each class."""
        lines = [
            f"{one.robot}, inputs {one.group}: {one.name} leads"
            for one in self.standings
            if one.leads
        ]
        return shorten_lines(lines, self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return the standings."""
        return list(standings(self))

    def result(self) -> Any:
        """Return the leaderboard."""
        return to_json(Leaderboard(**{f.name: getattr(self, f.name) for f in fields(Leaderboard)}))
