"""Components as equations in C: the generated functions, and the tables of their variables."""
