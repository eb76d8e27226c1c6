"""Reports of tests, as plugin of pytest: skips in CI, and marks that the summary of CI reads."""

import os
from collections.abc import Generator

import pytest
from skips import refusal_of

QUIET = "quiet"
"""Property of tests that `.ci/repeat` repeats alone if they fail."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, object]:
    """Mark tests that need quiet, and let those fail in CI whose skip is not listed."""
    # JUnit's report has the properties of the item at its teardown, not those of other phases.
    if call.when == "setup" and item.get_closest_marker("quiet"):
        item.user_properties.append((QUIET, "true"))
    report = yield
    is_expected_failure = hasattr(report, "wasxfail")
    if report.skipped and not is_expected_failure:
        _fail_in_ci(item.config, report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, object]:
    """Let files fail in CI that are skipped for a reason that is not listed."""
    report = yield
    if report.skipped:
        _fail_in_ci(collector.config, report)
    return report


def _fail_in_ci(config: pytest.Config, report: pytest.TestReport | pytest.CollectReport) -> None:
    # Nightly tests have tools of their own, and elsewhere than in `.ci/run` others may be missing.
    is_nightly = config.getoption("--nightly", None) is not None
    if os.environ.get("ALL_TOOLS") != "true" or is_nightly:
        return
    refusal = refusal_of(report.longrepr)
    if refusal is not None:
        report.outcome = "failed"
        report.longrepr = refusal
