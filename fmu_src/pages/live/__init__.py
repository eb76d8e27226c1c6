"""The FMU's own C, live in a page: compiled to WebAssembly, with sliders and without a network."""
