"""Job of `hesr test X.fmu --on LEADERBOARD.toml`."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from cosim.workflow.answer import PluginJob
from hesr.extras.leaderboard.board_file import BoardFile
from hesr.extras.leaderboard.leaderboard import LeaderboardResult, entries_of, run_leaderboard
from hesr.extras.leaderboard.tables import write_page
from hesr_model.support.progress import Stages, silent


def _run(
    path: Path,
    *,
    fmus: Sequence[str | Path],
    output: Path | None = None,
    trust: bool = False,
    progress: Stages = silent,
) -> LeaderboardResult:
    """Score FMUs, given as FILE or ROBOT=FILE, and write the page."""
    from cosim.workflow.arguments import remember_trust

    rules = BoardFile.read(path)
    entries = entries_of([str(fmu) for fmu in fmus], rules)
    remember_trust((entry.fmu for entry in entries), trust=trust)
    board = run_leaderboard(rules, entries, progress=partial(progress, "scoring entries"))
    if output is not None:
        write_page(board, output)
    return replace(board, files=(output,) if output else ())


JOB = PluginJob("test", "robots", _run)
