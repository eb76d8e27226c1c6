"""Ledgers of readers: each name in a file is used, known to be irrelevant, or left over.

A name that was left over and resembles one that is missing, or that belongs elsewhere, was meant:
the file is refused, since a default would be used instead. The others are a warning.
"""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Any
from xml.etree.ElementTree import Element

from hesr_model.errors import ConfigError, HesrError
from hesr_model.findings import Finding, caution, log_findings
from hesr_model.support.text import count_noun, join_few, join_with_or, quote

_log = logging.getLogger(__name__)
MISSPELT = "name.misspelt"
_MAX_SUGGESTIONS = 3
_MAX_LISTED = 5  # names in a finding
MAX_NAME_LENGTH = 40  # characters of a name in a finding
_MIN_SIMILARITY = 0.6  # of names that are suggested, as a share of equal letters
Names = Mapping[str, Iterable[str]]  # of attributes and child elements, by element
Reasons = Mapping[str, Mapping[str, str]]  # why they are irrelevant


def find_close_names(
    name: str,
    candidates: Iterable[str],
    max_count: int = _MAX_SUGGESTIONS,
    cutoff: float = _MIN_SIMILARITY,
) -> list[str]:
    """Return the candidates that resemble a name in any case of letters, the closest first."""
    matcher = SequenceMatcher(b=name.lower())
    shares: dict[str, float] = {}
    for candidate in candidates:
        matcher.set_seq1(candidate.lower())
        # The quick ratio is an upper bound; systems have thousands of names.
        if matcher.quick_ratio() >= cutoff and matcher.ratio() >= cutoff:
            shares[candidate] = matcher.ratio()
    return sorted(shares, key=lambda candidate: -shares[candidate])[:max_count]


def list_left_over(where: str, texts: Sequence[str]) -> str:
    """Join the first few left-overs of a file; write all of them to the log of HESR."""
    _log.debug("%s: all that is left over: %s", where, ", ".join(texts))
    hint = " (--verbose lists all)" if len(texts) > _MAX_LISTED else ""
    return join_few(texts, _MAX_LISTED) + hint


def format_suggestion(names: Sequence[str]) -> str:
    """Return "did you mean 'a', 'b' or 'c'?", or "" without names."""
    if not names:
        return ""
    return f"did you mean {join_with_or([quote(name) for name in names])}?"


@dataclass(frozen=True, kw_only=True)
class LeftOver:
    """A name that a reader has not used, its place, and what may have been meant."""

    place: str
    name: str
    meant: tuple[str, ...]

    @property
    def text(self) -> str:
        """The name, with its place if it has one."""
        name = quote(self.name[:MAX_NAME_LENGTH])
        return f"{name} of {self.place}" if self.place else name


class Ledger:
    """The names in a file that its reader has left over.

    Parameters
    ----------
    where : the file.
    noun : what the names are, such as "parameter".
    """

    def __init__(self, where: str, noun: str) -> None:
        self._where = where
        self._noun = noun
        self.left_over: list[LeftOver] = []

    def compare(
        self,
        place: str,
        names: Iterable[str],
        known: Iterable[str],
        homes: Names | None = None,
        *,
        may_repeat: bool = False,
        irrelevant: Iterable[str] = (),
    ) -> None:
        """Record the names at a place that are not known; `homes` are known names elsewhere.

        Unless names may repeat, one that is given already cannot be the one that was meant; nor can
        one that is `irrelevant`.
        """
        stated_names = dict.fromkeys(names)
        used_names = dict.fromkeys(known)
        missing = [name for name in used_names if may_repeat or name not in stated_names]
        known_names = {*used_names, *irrelevant}
        for name in stated_names:
            if name in known_names:
                continue
            exact = [
                join_key(home, name)
                for home, home_names in (homes or {}).items()
                if name in home_names
            ]
            meant = (*find_close_names(name, missing), *exact)[:_MAX_SUGGESTIONS]
            self.left_over.append(LeftOver(place=place, name=name, meant=meant))

    def compare_elements(
        self, root: Element, used: Names, irrelevant: Reasons, *, finds_homes: bool = True
    ) -> None:
        """Record unknown attributes and elements of an XML file, by local names.

        With `finds_homes` a name that belongs to another element was meant for that one.
        """
        stack = [root]
        while stack:
            element = stack.pop()
            kind = get_local_name(element)
            attributes = map(get_local_name, element.attrib)
            children = {
                child: get_local_name(child) for child in element if isinstance(child.tag, str)
            }
            homes: dict[str, Iterable[str]] = {}
            if finds_homes:
                homes = {other: used[other] for other in used if other != kind}
            place = f"<{kind}>"
            reasons = irrelevant.get(kind, {})
            used_names = tuple(used.get(kind, ()))  # the root may be of another format
            self.compare(place, attributes, used_names, homes, irrelevant=reasons)
            self.compare(
                place, children.values(), used_names, homes, may_repeat=True, irrelevant=reasons
            )
            stack += [child for child, name in children.items() if name in used]

    def compare_data(self, data: Any, known: Any, irrelevant: Mapping[str, str]) -> None:
        """Record the keys of nested data that are not in the same data as it was understood.

        `irrelevant` has reasons by place, without the numbers of entries in lists.
        """
        for place, names, known_names in _pair_tables(data, known):
            table = ".".join(part for part in place.split(".") if not part.isdigit())
            relevant = [name for name in names if join_key(table, name) not in irrelevant]
            if not known_names.keys() >= set(relevant):
                self.compare(place, relevant, known_names, list_tables(known))

    def require_nothing_meant(self, error: type[HesrError] = ConfigError) -> None:
        """Raise `error` for a name that was meant as another one; log the others as a warning."""
        self.refuse_misspelt(error)
        log_findings(self.findings())

    def refuse_misspelt(self, error: type[HesrError] = ConfigError) -> None:
        """Raise `error` for the first name that was meant as another one."""
        for item in self.left_over:
            if item.meant:
                place = f" of {item.place}" if item.place else ""
                raise error(
                    f"{self._where}: {quote(item.name)} is no {self._noun}{place}; "
                    f"{format_suggestion(item.meant)}",
                    code=MISSPELT,
                    where=self._where,
                    key=join_key(item.place, item.name),
                )

    def findings(self) -> list[Finding]:
        """Return one warning that names what was left over, if anything was."""
        if not self.left_over:
            return []
        names = list(dict.fromkeys(item.text for item in self.left_over))
        count = count_noun(len(names), self._noun)
        return [
            caution(
                check="left-over",
                where=self._where,
                found=f"{count} not used: {list_left_over(self._where, names)}",
                remedy="remove what is not needed, or correct its name",
            )
        ]


def get_local_name(element: Element | str) -> str:
    """Return the name of an element or attribute without its namespace."""
    if isinstance(element, str):
        return element.rpartition("}")[2]
    return str(element.tag).rpartition("}")[2]


def _pair_tables(
    data: Any, known: Any, place: str = ""
) -> Iterator[tuple[str, Mapping[str, Any], Mapping[str, Any]]]:
    """Yield place, table and known table of nested data."""
    if isinstance(data, Mapping) and isinstance(known, Mapping):
        yield place, data, known
        pairs = [(key, data[key], known[key]) for key in data.keys() & known.keys()]
    elif isinstance(data, list | tuple) and isinstance(known, list | tuple):
        pairs = list(zip(map(str, range(len(data))), data, known, strict=False))
    else:
        pairs = []
    for key, inner, inner_known in pairs:
        yield from _pair_tables(inner, inner_known, join_key(place, key))


def list_tables(known: Any) -> dict[str, Mapping[str, Any]]:
    """Return each table in nested data by its place."""
    return {place: names for place, names, _ in _pair_tables(known, known)}


def join_key(place: str, name: object) -> str:
    """Return a dotted key."""
    return ".".join(part for part in (place, str(name)) if part)
