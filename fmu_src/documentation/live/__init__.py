"""The FMU's own C alive in a page: compiled to WebAssembly, with sliders and without a network."""
