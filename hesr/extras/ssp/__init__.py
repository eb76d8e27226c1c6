"""Systems of FMUs as SSPs, for other tools."""
