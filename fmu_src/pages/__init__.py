"""Documentation of FMUs: data sheet, picture, interactive page."""
