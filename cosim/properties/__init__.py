"""The property battery: the same experiments on every friction law, run on its FMUs."""
