"""A copy of a user's XML file in which only the given places change.

Parsers of XML lose quotes, line ends and the order of attributes. So the tags are found as MuJoCo
reads them (comments may have any dashes), and all other bytes are kept.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.sax.saxutils import quoteattr, unescape

from hesr_model.errors import ExportError

MARK = "HESR:"
"""Beginning of a comment that a further export replaces."""
_TOKEN = re.compile(
    rb"(?P<comment><!--.*?-->)|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|(?P<type><!DOCTYPE)"
    rb"|<(?P<closes>/?)(?P<name>[^\s<>/!?\"']+)(?P<rest>(?:[^<>\"']|\"[^\"]*\"|'[^']*')*?)"
    rb"(?P<is_empty>/?)>",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(rb"([^\s=]+)\s*=\s*(\"[^\"]*\"|'[^']*')")
_ENTITIES = {"&quot;": '"', "&apos;": "'"}


@dataclass(eq=False)
class XmlElement:
    """An element in the bytes of a file.

    Attributes
    ----------
    tag : its name.
    attributes : values by name, without entities.
    parent : element around it, None for the root.
    start, content, close, end : where its tag, its content and its closing tag begin, and its end.
    children : elements in it.
    """

    tag: str
    attributes: dict[str, str]
    parent: "XmlElement | None"
    start: int
    content: int
    close: int = 0
    end: int = 0
    children: list["XmlElement"] = field(default_factory=list)

    def list_elements(self) -> Iterator["XmlElement"]:
        """Yield the element and all in it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.list_elements()

    def find_child(self, tag: str) -> "XmlElement | None":
        """Return the first child with a tag."""
        return next((child for child in self.children if child.tag == tag), None)


class XmlCopy:
    """The bytes of an XML file, and the changes of its copy.

    Raises ExportError if the file cannot be read, or is no XML.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():  # a pipe would be waited for
            raise ExportError(f"{path}: no such file.")
        try:
            self._data = path.read_bytes()
        except OSError as error:
            raise ExportError(f"{path}: cannot be read ({error.strerror}).") from error
        self._changes: list[tuple[int, int, bytes]] = []
        self._marked: tuple[int, int] | None = None
        self.root = self._parse()
        self.newline = "\r\n" if b"\r\n" in self._data else "\n"

    def _parse(self) -> XmlElement:
        """Return the root; comments of earlier exports before it are to be replaced."""
        root: XmlElement | None = None
        current: XmlElement | None = None
        position = 0
        if b"\0" in self._data:
            self.refuse("has another encoding than UTF-8")
        for token in _TOKEN.finditer(self._data):
            if b"<" in self._data[position : token.start()]:
                break
            position = token.end()
            if token["type"]:
                self.refuse("has a document type (<!DOCTYPE>), which is not read")
            if token["comment"] and root is None and self._is_marked(token):
                self._marked = token.span()
            if token["name"] is None:
                continue
            tag = token["name"].decode(errors="replace")
            if token["closes"]:
                current = self._close_element(current, tag, token)
                continue
            if current is None and root is not None:
                self.refuse("has several roots")
            element = XmlElement(
                tag=tag,
                attributes=_read_attributes(token["rest"]),
                parent=current,
                start=token.start(),
                content=token.end(),
                close=token.end(),
                end=token.end(),
            )
            root = root or element
            if current is not None:
                current.children.append(element)
            if not token["is_empty"]:
                current = element
        if root is None or current is not None or b"<" in self._data[position:]:
            self.refuse("is not well-formed XML")
        return root

    def _close_element(
        self, element: XmlElement | None, tag: str, token: re.Match[bytes]
    ) -> XmlElement | None:
        """Set the end of the open element, and return the one around it."""
        if element is None or element.tag != tag:
            self.refuse(f"closes <{tag}>, which is not open")
        element.close = token.start()
        element.end = token.end()
        return element.parent

    def _is_marked(self, token: re.Match[bytes]) -> bool:
        return token["comment"].removeprefix(b"<!--").strip().startswith(MARK.encode())

    def refuse(self, reason: str) -> NoReturn:
        """Raise ExportError about the file."""
        raise ExportError(f"{self.path}: {reason}, so that no copy can be made.")

    def set_attributes(self, element: XmlElement, values: Mapping[str, str]) -> None:
        """Set attributes of an element; new ones follow its last one."""
        name_end = element.start + 1 + len(element.tag.encode())
        places = {}
        last = name_end
        for match in _ATTRIBUTE.finditer(self._data, name_end, element.content):
            places[match[1].decode(errors="replace")] = match
            last = match.end()
        for name, value in values.items():
            if name in places:
                start, end = places[name].span(2)
                self._change(start + 1, end - 1, value)
            else:
                self._change(last, last, f" {name}={quoteattr(value)}")

    def remove_attribute(self, element: XmlElement, name: str) -> None:
        """Remove an attribute of an element, if it has it."""
        name_end = element.start + 1 + len(element.tag.encode())
        for match in _ATTRIBUTE.finditer(self._data, name_end, element.content):
            if match[1] == name.encode():
                self._change(match.start() - 1, match.end(), "")

    def set_text(self, element: XmlElement, text: str) -> None:
        """Set the text of an element without children."""
        if element.content == element.end:
            self._change(element.start, element.end, f"<{element.tag}>{text}</{element.tag}>")
        else:
            self._change(element.content, element.close, text)

    def append(self, element: XmlElement, markup: str) -> None:
        """Append markup as the last child of an element, on a line as the child before it."""
        if element.children:
            last = element.children[-1]
            before = self._data[: last.start]
            indent = before[len(before.rstrip(b" \t\r\n")) :].decode()
            self._change(last.end, last.end, indent + markup)
        elif element.content == element.end:
            self._change(element.end - 2, element.end, f">{markup}</{element.tag}>")
        else:
            self._change(element.close, element.close, markup)

    def set_comment(self, lines: Sequence[str]) -> None:
        """Set a comment before the root; it replaces that of an earlier export."""
        text = f"{self.newline}     ".join(line.replace("--", "- -") for line in lines)
        comment = f"<!-- {MARK} {text} -->"
        if self._marked is not None:
            self._change(*self._marked, comment)
        else:
            self._change(self.root.start, self.root.start, comment + self.newline)

    def _change(self, start: int, end: int, text: str) -> None:
        self._changes.append((start, end, text.encode()))

    def to_bytes(self) -> bytes:
        """Return the file with all changes."""
        parts = []
        position = 0
        for start, end, text in sorted(self._changes, key=lambda change: change[:2]):
            parts += [self._data[position:start], text]
            position = end
        return b"".join([*parts, self._data[position:]])


def _read_attributes(tag_text: bytes) -> dict[str, str]:
    attributes = {}
    for name, value in _ATTRIBUTE.findall(tag_text):
        text = value[1:-1].decode(errors="replace")
        attributes[name.decode(errors="replace")] = unescape(text, _ENTITIES)
    return attributes
