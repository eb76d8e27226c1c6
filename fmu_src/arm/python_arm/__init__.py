"""The arm simulated in Python: a PythonFMU export, and the oracle for the native FMU."""
