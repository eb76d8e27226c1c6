"""Optional parts of the study of a twin: draws, alternative plants, robustness of the loop."""
