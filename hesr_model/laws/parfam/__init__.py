"""ParFam: parametric families of friction laws with a hysteresis state (paper, section IV)."""
