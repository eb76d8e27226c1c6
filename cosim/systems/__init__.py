"""Systems of FMUs as one file: SSP for other engines, or an FMU that holds the whole system."""
