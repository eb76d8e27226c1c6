"""Plant FMU: the dynamics of a robot with friction in its joints."""
