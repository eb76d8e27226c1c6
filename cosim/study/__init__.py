"""Studies: from logs to laws, FMUs, scores and a verdict."""
