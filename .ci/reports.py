"""Reports that the steps of `.ci/run` leave: failures, tests that need quiet, and seconds."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

REPEATED = "repeated"
"""Name of the report of tests that were repeated alone."""

LONGEST = 160  # characters of a reason


class Result(NamedTuple):
    """The result of a test in a step."""

    step: str
    test: str
    reason: str | None
    """First line of why it failed; None if it did not."""
    needs_quiet: bool
    seconds: float


class UnreadableReportError(Exception):
    """A report that a killed step did not complete."""


def test_id(case: ET.Element) -> str:
    """Return the node id of a test case."""
    file = case.get("file") or ""
    module = file.removesuffix(".py").replace("/", ".")
    inner = (case.get("classname") or "").removeprefix(module).lstrip(".")
    names = [inner.replace(".", "::")] if inner and file else []
    return "::".join([file or case.get("classname") or "", *names, case.get("name") or ""])


def read_report(report: Path) -> Iterator[Result]:
    """Yield the results of a step."""
    try:
        cases = list(ET.parse(report).iter("testcase"))
    except (ET.ParseError, OSError) as error:
        raise UnreadableReportError(report.name) from error
    for case in cases:
        properties = {entry.get("name") for entry in case.iter("property")}
        yield Result(
            report.stem,
            test_id(case),
            _reason(case),
            "quiet" in properties,
            float(case.get("time") or 0),
        )


def _reason(case: ET.Element) -> str | None:
    for kind in ("failure", "error"):
        for node in case.findall(kind):
            lines = (node.get("message") or node.text or "").strip().splitlines()
            return lines[0][:LONGEST] if lines else kind
    return None


def read_reports(folder: Path) -> tuple[list[Result], list[str]]:
    """Return the results of all steps but the repeated ones, and the unreadable reports."""
    results: list[Result] = []
    unreadable: list[str] = []
    for report in sorted(folder.glob("*.xml")):
        if report.stem == REPEATED:
            continue
        try:
            results += read_report(report)
        except UnreadableReportError:
            unreadable.append(report.name)
    return results, unreadable


def passed_alone(folder: Path) -> set[str]:
    """Return the tests that passed when they were repeated alone."""
    report = folder / f"{REPEATED}.xml"
    if not report.is_file():
        return set()
    return {result.test for result in read_report(report) if result.reason is None}
