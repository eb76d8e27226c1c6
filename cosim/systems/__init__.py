"""Systems of FMUs: SSP for other engines, or one FMU that holds the whole system."""
