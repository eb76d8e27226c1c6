"""Views of the arm of a closed loop: a window of MuJoCo's viewer, or a video."""
