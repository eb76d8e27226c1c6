"""ParFam-S: stops with symbolic bounds and certified passivity."""
