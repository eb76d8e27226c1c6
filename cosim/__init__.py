"""Co-simulation: systems of FMUs, run and reported."""
