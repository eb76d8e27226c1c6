"""Servo and friction of joints from commands and positions, without a torque."""
