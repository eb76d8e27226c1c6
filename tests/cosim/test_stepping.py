"""Time of a component after a number of communication steps of its system."""

from pathlib import Path

import numpy as np
import pytest
from fakes import Fake

from fmu_src.run.master import Station


@pytest.mark.parametrize(
    ("every", "steps", "time"), [(1, 0, 0.0), (1, 7, 0.7), (4, 3, 0.0), (4, 8, 0.8), (4, 11, 0.8)]
)
def test_a_component_ends_at_its_own_last_step(every: int, steps: int, time: float) -> None:
    slave = Fake(Path("fake.fmu"), name="fake")
    station = Station(
        slave=slave,
        every=every,
        inputs=slave.buffer([]),
        sources=np.zeros(0, dtype=np.intp),
        outputs=slave.buffer([]),
    )
    assert station.compute_time(steps, 0.1) == pytest.approx(time, abs=1e-15)
