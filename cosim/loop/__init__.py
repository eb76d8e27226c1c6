"""The studies: each takes its configuration and returns a result."""
