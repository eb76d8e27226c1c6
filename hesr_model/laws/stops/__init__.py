"""ParFam-S: stops with symbolic bounds, whose passivity is certified."""
