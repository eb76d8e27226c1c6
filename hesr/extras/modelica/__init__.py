"""Friction models as Modelica packages."""
