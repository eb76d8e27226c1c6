"""Systems of FMUs as SSPs and as one FMU, for other tools."""
