"""The arm of a closed loop to look at: in the viewer of MuJoCo, or as a video."""
