"""Job of `hesr monitor FLEET.toml`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.report.tables.table import ResultTable
from cosim.workflow.answer import Answer, PluginJob, shortened
from hesr.extras.fleet.result import Fleet, all_tables
from hesr.extras.fleet.study import FleetStudy
from hesr_model.findings import Finding
from hesr_model.support.progress import Stages, silent
from hesr_model.support.typed_files import to_json


def _run(
    path: Path, *, output: Path | None = None, workers: int | None = None, progress: Stages = silent
) -> "FleetResult":
    """Process all robots, by default into ``results/NAME``."""
    from hesr.extras.fleet.run import PAGE, TABLE, run_fleet

    folder = output or Path("results") / FleetStudy.read(path).name
    fleet = run_fleet(path, folder, workers=workers, progress=progress)
    findings = [
        Finding(check="logs", where=one.robot, found=one.sentences[0]) for one in fleet.broken
    ]
    files = (folder / PAGE, folder / TABLE)
    return FleetResult(**vars(fleet), findings=findings, files=files)


JOB = PluginJob("monitor", "types", _run)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FleetResult(Answer, Fleet):
    """Result of a fleet; unused logs are errors."""

    format = "hesr-fleet-1"
    findings: Sequence[Finding] = ()
    files: Sequence[Path] = ()

    def summary(self) -> str:
        """Return the largest deviations and changes."""
        deviating = {one.robot for one in self.deviants}
        worse = [one for one in self.changes if one.worse]
        lines = [
            f"{len(self.robots)} robots: {len(deviating)} deviate from their type, "
            f"{len({one.robot for one in worse})} got worse."
        ]
        if self.reused:
            lines.append(f"Complete before: {self.reused} robots.")
        lines += [
            f"{one.robot}, {one.joint or 'rigid body'}: {one.name} is {one.value:.3g}, its type "
            f"has {one.median:.3g} (z = {one.z:.1f})"
            for one in self.deviants[:5]
        ]
        lines += [
            f"{one.robot}, {one.joint}: {one.kind} changed by {100 * one.change:+.0f} % of "
            f"friction; likely cause: {one.points_to}"
            for one in worse[:5]
        ]
        lines += [finding.sentence for finding in self.findings[:5]]
        return shortened(lines, self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return the tables."""
        return list(all_tables(self))

    def result(self) -> Any:
        """Return deviations, changes and unusable logs."""
        return {
            "folder": str(self.folder),
            "robots": len(self.robots),
            "reused": self.reused,
            "deviants": [to_json(one) for one in self.deviants],
            "changes": [to_json(one) for one in self.changes],
            "not_used": {one.robot: one.sentences for one in self.broken},
        }
