"""Answer of `hesr monitor` for the logs of one robot."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.report.tables.table import ResultTable
from cosim.workflow.answer import Answer, shortened
from hesr.extras.adaptive.monitor import FollowedLogs
from hesr.extras.adaptive.page import alarm_table, state_table
from hesr_model.findings import Finding
from hesr_model.support.typed_json import to_json

_MOST_ALARMS = 12


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Monitoring(Answer, FollowedLogs):
    """Alarms and states over logs."""

    format = "hesr-monitoring-1"
    findings: Sequence[Finding] = ()
    files: Sequence[Path] = ()

    def summary(self) -> str:
        """Return the alarms and the last state of each joint."""
        count = len(self.alarms)
        lines = [f"{count} change{'s' * (count != 1)} of friction found."]
        lines += [
            f"{one.log}, {one.joint}, {one.time:.1f} s: {one.change} than known ({one.kind}); "
            f"likely cause: {one.points_to}"
            for one in self.alarms[:_MOST_ALARMS]
        ]
        if count > _MOST_ALARMS:
            lines.append(f"{count - _MOST_ALARMS} more alarms: --verbose lists them.")
        for one in self.states[-len(self.model.joints) :]:
            level, viscosity, offset = one.intervals()
            lines.append(f"{one.joint}: level {level}, viscous factor {viscosity}, offset {offset}")
        return shortened(lines, self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return alarms and states."""
        return [alarm_table(self), state_table(self)]

    def result(self) -> Any:
        """Return states and alarms."""
        return {
            "states": [to_json(one) for one in self.states],
            "alarms": [to_json(one) | {"points_to": one.points_to} for one in self.alarms],
        }
