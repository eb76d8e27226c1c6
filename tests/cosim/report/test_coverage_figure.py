"""The figure of the coverage of logs without a model for comparison."""

import numpy as np

from cosim.report.figures.chart import Line, Stroke
from cosim.report.figures.motions import JointView, joints


def test_panels_state_a_missing_model() -> None:
    t = np.linspace(0.0, 1.0, 20)
    line = Line(name="logged", x=t, y=t, stroke=Stroke(colour="C0"))
    view = JointView(
        name="j1", unit="rad/s", velocities=(line,), friction=None, covered=t, loads=None
    )
    _, friction, covered, loads = joints([view]).axes
    assert [text.get_text() for text in friction.texts] == ["no model"]
    assert [text.get_text() for text in loads.texts] == ["no model"]
    assert not covered.texts
