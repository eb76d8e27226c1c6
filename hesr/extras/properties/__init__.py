"""Physics checks: the same experiments on the FMUs of every friction law."""
