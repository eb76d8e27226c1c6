"""Duration and size of a report."""

from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from small_results import write_results

from cosim.report.page import write_report


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_results(tmp_path_factory.mktemp("results"))


def test_report(benchmark: BenchmarkFixture, results: Path) -> None:
    page = benchmark.pedantic(write_report, args=(results,), rounds=3)
    benchmark.extra_info["MB"] = page.stat().st_size / 1e6
