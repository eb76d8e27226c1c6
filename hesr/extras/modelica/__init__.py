"""A friction model as a Modelica package."""
