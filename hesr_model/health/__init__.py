"""Checks of logs against themselves, a robot and a fit."""
