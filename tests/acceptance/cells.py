"""Combinations of law, structure, format, version of FMI and start corner that are tried.

Each pair of values that some artefact can have occurs in at least one cell; the first cells cover
most pairs, so that the gate runs these.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

NO_FMI = 0
CORNERS = ("defaults", "minimum", "maximum", "zero")
"""Start values: as declared; or the least and largest allowed value, and 0, of each fixed parameter
and start value."""


class Cell(NamedTuple):
    """An artefact, and how it starts."""

    law: str
    structure: str
    format: str
    fmi: int
    corner: str

    @property
    def pairs(self) -> list[tuple[int, str | int, int, str | int]]:
        """Each two values, with their places."""
        return [(a, self[a], b, self[b]) for a, b in combinations(range(len(self)), 2)]

    def __str__(self) -> str:
        return "-".join(map(str, self)).replace(" ", "_")


def possible_cells(
    structures: Mapping[str, Sequence[str]], formats: Mapping[str, "Scope"]
) -> list[Cell]:
    """Return every cell whose artefact exists.

    Parameters
    ----------
    structures : structures that each law can have.
    formats : structures, versions and corners of each format.
    """
    cells = []
    for law, possible in structures.items():
        for name, scope in formats.items():
            for structure in possible:
                if structure in scope.structures and law not in scope.refused_laws:
                    cells += [
                        Cell(law, structure, name, fmi, corner)
                        for fmi, corner in product(scope.versions, scope.corners)
                    ]
    return cells


class Scope(NamedTuple):
    """Values that occur together with a format."""

    structures: Sequence[str]
    versions: Sequence[int] = (2, 3)
    corners: Sequence[str] = CORNERS
    refused_laws: Sequence[str] = ()


def chosen_cells(possible: Sequence[Cell]) -> list[Cell]:
    """Return a few cells that hold every pair of values, those with most new pairs first."""
    numbers: dict[tuple[int, str | int, int, str | int], int] = {}
    rows = [[numbers.setdefault(pair, len(numbers)) for pair in cell.pairs] for cell in possible]
    pairs_of_cells = np.array(rows)
    is_missing = np.ones(len(numbers), dtype=bool)
    chosen = []
    while is_missing.any():
        best = int(np.argmax(is_missing[pairs_of_cells].sum(axis=1)))
        chosen.append(possible[best])
        is_missing[pairs_of_cells[best]] = False
    return chosen
