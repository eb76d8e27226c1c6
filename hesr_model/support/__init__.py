"""Shared support: files, processes, progress, configuration."""
