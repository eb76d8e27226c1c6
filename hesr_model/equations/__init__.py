"""Components as equations: named expressions with memory, lowered to every target."""
