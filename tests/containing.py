"""Comparison of a text with the parts that it must contain."""


class Containing:
    """Equal to each text that contains all parts in this order.

    Tests state the values and names that a sentence must mention instead of repeating it.
    """

    def __init__(self, *parts: str) -> None:
        self.parts = parts

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, str):
            return NotImplemented
        place = 0
        for part in self.parts:
            place = other.find(part, place)
            if place < 0:
                return False
            place += len(part)
        return True

    # A class with its own equality has no hash; typeshed declares a method.
    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(map(repr, self.parts))})"


class OneSentence(Containing):
    """Equal to each sentence of one line that contains all parts."""

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, str):
            return NotImplemented
        is_sentence = other.count("\n") <= 1 and other.removesuffix("\n").endswith((".", "?"))
        return is_sentence and super().__eq__(other)

    # A class with its own equality has no hash; typeshed declares a method.
    __hash__ = None  # type: ignore[assignment]
