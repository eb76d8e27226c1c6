"""Temperature in friction, fitted to logs."""
