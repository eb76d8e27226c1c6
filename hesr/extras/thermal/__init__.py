"""Temperature dependence of friction, fitted to logs."""
