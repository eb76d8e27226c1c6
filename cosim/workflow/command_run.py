"""Result of a run whose logs have no torque: summary, tables and report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.study.results import COMMAND_RUN
from cosim.workflow.answer import Answer, finding_lines, shorten_lines
from hesr_model.support.typed_files import to_json, write_json

if TYPE_CHECKING:
    from cosim.report.tables.table import ResultTable
    from cosim.servo.study import CommandOutcome
    from hesr_model.findings import Finding

REPORT = "report.html"


@dataclass(frozen=True, kw_only=True, repr=False)
class CommandRun(Answer):
    """Result of `hesr.run` for logs without torque: model with servos, FMUs and errors."""

    format = "hesr-command-run-1"
    folder: Path
    outcome: CommandOutcome

    @property
    def findings(self) -> Sequence[Finding]:  # type: ignore[override]  # those of the outcome
        """Warnings of the checks, and accepted errors."""
        return self.outcome.findings

    def heading(self) -> str:
        """Return the heading of its page."""
        return f"{self.outcome.model.robot}: friction and servos from commands"

    def introduction(self) -> str:
        """Return what the results rest on."""
        return (
            "The logs have no torque: all numbers are from commands and positions. Positions "
            "depend on ratios of torques only; what fixes their size is stated for each joint."
        )

    def summary(self) -> str:
        """Return the chosen laws, errors, scale, FMUs and the report."""
        from hesr_model.inference.choice import CHOOSE

        provenance = self.outcome.model.provenance
        lines = ["No torque in the logs: all numbers are from commands and positions."]
        lines += provenance.get(CHOOSE, ())
        lines += provenance["from_commands"]
        lines += self._error_lines()
        if self.outcome.fmus:
            lines.append(f"FMUs: {', '.join(map(str, self.outcome.fmus.values()))}")
        else:
            lines.append("No FMU: it would need torques in N.m, whose size nothing fixes.")
        lines.append(f"Report: {self.folder / REPORT}")
        return shorten_lines(lines)

    def _error_lines(self) -> list[str]:
        """Return the errors on tests, or else on the training logs."""
        tests = [errors for errors in self.outcome.errors if errors.is_test]
        sentences = []
        doubts: list[str] = []
        for errors in tests or self.outcome.errors:
            sentences.append(errors.sentence)
            doubts += errors.doubts
        return sentences + doubts

    def tables(self) -> Sequence[ResultTable | str]:
        """Return servos, laws and errors."""
        from cosim.report.tables.table import ResultTable, make_row
        from cosim.servo.study import has_scale
        from hesr_model.friction.law import equations

        model = self.outcome.model
        laws = [
            make_row(joint, law.name, "; ".join(equations(law)))
            for joint, law in zip(model.joints, model.laws, strict=True)
        ]
        shown: list[ResultTable | str] = [
            ResultTable(
                caption="Laws, from commands",
                head=("joint", "law", "torque"),
                rows=laws,
                words=(1, 2),
            ),
            *model.provenance["from_commands"],
            self._error_table("alone", "Position errors [mrad], each joint alone"),
        ]
        if has_scale(model):
            shown.append(self._error_table("coupled", "Position errors [mrad], whole plant"))
        shown.append(self._error_table("ideal", "Position errors [mrad] of ideal servos"))
        return [*shown, *finding_lines(self.findings)]

    def _error_table(self, name: str, caption: str) -> ResultTable:
        from cosim.report.tables.table import ResultTable, make_row

        joints = self.outcome.model.joints
        rows = []
        for errors in self.outcome.errors:
            role = "test" if errors.is_test else "training"
            cells = [f"{1e3 * value:.3g}" for value in getattr(errors, name)]
            rows.append(make_row(f"{errors.log} ({role})", *cells))
        return ResultTable(caption=caption, head=("log", *joints), rows=rows)

    def result(self) -> Any:
        """Return model, FMUs and errors as JSON data."""
        return {
            "folder": str(self.folder),
            "fmus": {name: str(path) for name, path in self.outcome.fmus.items()},
            "model": self.outcome.model.to_json(),
            "errors": [to_json(errors) for errors in self.outcome.errors],
        }


def write_command_report(outcome: CommandOutcome, folder: Path, shown_folder: Path) -> None:
    """Write page and data of an outcome into a folder, which will be `shown_folder`."""
    from cosim.report.result_page import write_answer

    answer = CommandRun(folder=shown_folder, outcome=outcome)
    write_answer(answer, folder / REPORT)
    write_json(folder / COMMAND_RUN, answer.to_json())
