"""Sweeps: many runs of one system of FMUs, on all cores or a cluster."""
