"""Export: a component in, an FMU out."""
