"""Results to be shown."""

from pathlib import Path

import pytest
from small_study import Run


@pytest.fixture(params=["part", pytest.param("whole", marks=pytest.mark.ci)])
def results(request: pytest.FixtureRequest) -> Path:
    """Results of a whole study, and of one without closed loop, variants and bands."""
    if request.param == "whole":
        found: Path = request.getfixturevalue("small_results")
        return found
    run: Run = request.getfixturevalue("study_run")
    return run.results
