"""The fixture of all tests of this folder."""

import numpy as np
import pytest
from pytest_regressions.num_regression import NumericRegressionFixture
from unchanged import Unchanged, leaves


@pytest.fixture
def unchanged(num_regression: NumericRegressionFixture) -> Unchanged:
    """Check numbers against those beside the test."""

    def check(of: object, *, rtol: float = 1e-6, atol: float = 1e-9) -> None:
        found = {name: np.asarray(value) for name, value in leaves(of) if len(value)}
        num_regression.check(found, default_tolerance={"rtol": rtol, "atol": atol})

    return check
