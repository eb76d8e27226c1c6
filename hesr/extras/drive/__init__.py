"""Motors under friction as FMUs: torque in, speed and angle out."""
