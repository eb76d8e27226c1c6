"""Findings of `hesr check` for other programs: JUnit and SARIF 2.1.0."""

import json
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from fmu_src.check.rules import RULES, find_rule
from fmu_src.check.run import Report
from hesr_model.findings import Finding, Severity
from hesr_model.support.files import written_whole

_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
_LEVELS: Mapping[Severity, str] = {"error": "error", "warning": "warning", "advice": "note"}


def write_junit(path: Path, reports: Sequence[Report]) -> None:
    """Write a test suite per file and a test case per rule; errors are failures."""
    root = ET.Element("testsuites", name="hesr check")
    for report in reports:
        findings_by_rule: dict[str, list[Finding]] = {}
        for finding in report.problems:
            findings_by_rule.setdefault(finding.check, []).append(finding)
        failure_count = sum(_has_error(findings) for findings in findings_by_rule.values())
        suite_attributes = {
            "name": str(report.path),
            "tests": str(len(findings_by_rule) or 1),
            "errors": "0",
        }
        suite = ET.SubElement(
            root, "testsuite", suite_attributes, failures=str(failure_count), skipped="0"
        )
        for name, findings in (findings_by_rule or {"check": []}).items():
            case = ET.SubElement(suite, "testcase", name=name, classname=str(report.path))
            case_text = "\n".join(f"{finding.severity}: {finding.found}" for finding in findings)
            if _has_error(findings):
                failure = ET.SubElement(case, "failure", message=findings[0].found, type=name)
                failure.text = case_text
            elif findings:
                ET.SubElement(case, "system-out").text = case_text
    ET.indent(root)
    with written_whole(path) as temporary:
        temporary.write_bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n")


def _has_error(findings: Iterable[Finding]) -> bool:
    return any(finding.severity == "error" for finding in findings)


def write_sarif(path: Path, reports: Sequence[Report]) -> None:
    """Write a run with all rules and a result per finding."""
    # Rules of plug-ins follow ours in the order of their findings.
    rule_indices = {name: k for k, name in enumerate(RULES)}
    results = []
    for report in reports:
        for finding in report.problems:
            rule_index = rule_indices.setdefault(finding.check, len(rule_indices))
            results.append(_build_sarif_result(report.path, finding, rule_index))
    driver = {
        "name": "hesr check",
        "version": installed("hesr"),
        "rules": [_build_sarif_rule(name) for name in rule_indices],
    }
    data = {
        "$schema": _SCHEMA,
        "version": "2.1.0",
        "runs": [{"tool": {"driver": driver}, "results": results}],
    }
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def _build_sarif_result(path: Path, finding: Finding, rule_index: int) -> dict[str, Any]:
    location = {"physicalLocation": {"artifactLocation": {"uri": path.as_posix()}}}
    return {
        "ruleId": finding.check,
        "ruleIndex": rule_index,
        "level": _LEVELS[finding.severity],
        "message": {"text": finding.found},
        "locations": [location],
    }


def _build_sarif_rule(name: str) -> dict[str, Any]:
    rule = find_rule(name)
    return {
        "id": name,
        "shortDescription": {"text": rule.finds},
        "help": {"text": f"{rule.finds} ({rule.clause})"},
        "helpUri": rule.link,
        "defaultConfiguration": {"level": _LEVELS[rule.severity]},
    }
