"""The digital twin of an arm, simulated by MuJoCo."""
