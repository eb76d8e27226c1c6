"""Components as equations: named expressions with memory, from which everything is lowered."""
