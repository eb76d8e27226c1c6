"""Friction laws and models: expressions, predictions, bands and temperature."""
