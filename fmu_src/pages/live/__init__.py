"""Interactive pages: the FMU's own C, compiled to WebAssembly, with sliders, without a network."""
