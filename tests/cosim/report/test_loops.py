"""The report's panels of friction over velocity."""

import numpy as np
import pytest

from cosim.report.figures.plots import loops


def test_a_joint_without_slow_motion_is_drawn_completely() -> None:
    dq, tau = np.linspace(0.8, 1.0, 50), np.linspace(3.0, 4.0, 50)
    figure = loops((dq, tau), {"LuGre": (dq, tau)}, x="dq", y="tau")
    (axis,) = figure.axes
    law = axis.lines[-1].get_xydata()
    assert law[:, 0] == pytest.approx(dq)
    assert law[:, 1] == pytest.approx(tau)
    assert axis.get_xlim() == (-1.0, 1.0)
