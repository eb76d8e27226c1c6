"""Components as C: the generated functions, and the tables of their variables."""
