"""Neural networks with the inputs of the paper, for comparison with symbolic laws."""
