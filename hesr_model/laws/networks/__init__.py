"""Neural networks with the inputs of the paper."""
