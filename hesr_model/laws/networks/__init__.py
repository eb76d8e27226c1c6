"""Networks of the paper's inputs, with which symbolic laws are compared."""
