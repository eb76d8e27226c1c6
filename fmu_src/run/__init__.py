"""Run FMUs: archives, instances, the sandbox, the master and reference results."""
