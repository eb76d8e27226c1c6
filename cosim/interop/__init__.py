"""FMUs and systems of them in engines that share no code with ours, compared with our own results.

`engines` runs each engine in a process of its own, `reference` says what it should give by its own
way of coupling, `matrix` puts both together.
"""
