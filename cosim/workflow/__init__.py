"""Workflow functions, one per command, shared by the command line and `import hesr`."""
