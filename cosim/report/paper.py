"""What the paper reports of its robot, a UFACTORY 850: Tables II and III."""

from cosim.loop.closed_loop import StandIn

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
