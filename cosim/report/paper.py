"""Tables II and III of the paper, for a UFACTORY 850."""

from collections.abc import Sequence

from cosim.loop.closed_loop import StandIn
from cosim.report.tables.loop import mrad
from cosim.report.tables.table import ResultTable, number, row_of, title

ROBOT = "uf850"

TABLE_II = {
    "lugre": (6.3703, 5.9744, 2.4627),
    "stribeck": (6.4110, 6.1804, 3.2741),
    "rbfnn_h": (5.1865, 7.7713, 2.3954),
    "parfam_v": (6.0660, 5.2261, 2.6997),
    "parfam_h": (4.2823, 5.1197, 1.9257),
}
"""RMSE of the predicted torque by law and joint [N.m]."""

TABLE_III = {
    StandIn.BODY_ONLY: (0.0417, 0.0744, 0.0324),
    "lugre": (0.0202, 0.0612, 0.0336),
    "rbfnn_h": (0.0204, 0.0477, 0.0267),
    "parfam_h": (0.0177, 0.0377, 0.0233),
}
"""RMSE of tracking by law and joint [rad]."""


def table_ii(joints: Sequence[str]) -> ResultTable:
    """Return Table II."""
    return ResultTable(
        caption="Table II of the paper: RMSE of the predicted torque [N.m] on the measured robot",
        head=("law", *joints),
        rows=[row_of(title(law), *(number(v, 4) for v in row)) for law, row in TABLE_II.items()],
    )


def table_iii(joints: Sequence[str]) -> ResultTable:
    """Return Table III."""
    return ResultTable(
        caption="Table III of the paper: RMSE of tracking [mrad] on the measured robot",
        head=("torque model", *joints),
        rows=[row_of(title(law), *(mrad(v, 1) for v in row)) for law, row in TABLE_III.items()],
    )
