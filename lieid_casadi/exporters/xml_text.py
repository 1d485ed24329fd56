"""XML text: safe comments and attributes, and edits that leave all other characters unchanged."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

# all that XML 1.0 does not allow, not even as a reference
_FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def attribute(text: str) -> str:
    """Return a quoted attribute value; characters that XML does not allow become U+FFFD."""
    return quoteattr(allowed(text))


def allowed(text: str) -> str:
    """Return text in which characters that XML does not allow are U+FFFD."""
    return _FORBIDDEN.sub("\ufffd", text)


def comment(text: str) -> str:
    """Return text that is safe in an XML comment, in one line."""
    shown = "".join(" " if unicodedata.category(c)[0] == "C" else c for c in text)
    return re.sub(r"-(?=-)|-$", "- ", " ".join(shown.split()))


QUOTES = b"\"'"


@dataclass
class Element:
    """One element and its position, in bytes of the UTF-8 text."""

    tag: str
    attributes: dict[str, str]
    start: int
    opened: int
    end: int
    empty: bool
    children: list[Element] = field(default_factory=list)

    def find(self, tag: str) -> Element | None:
        """Return the first child of a tag."""
        return next((child for child in self.children if child.tag == tag), None)


class XmlText:
    """A well-formed XML text with edits that are applied together."""

    def __init__(self, text: str) -> None:
        self._data = text.encode("utf-8")
        self._edits: list[tuple[int, int, str]] = []
        self.root = _parse(self._data)

    def replace(self, element: Element, text: str) -> None:
        """Replace an element by a text."""
        self._edits.append((element.start, element.end, text))

    def add_child(self, parent: Element, text: str) -> None:
        """Insert a text before the first child of an element, on its own line."""
        outer = self._indentation(parent)
        inner = outer + "  "
        shifted = text.replace("\n", "\n" + inner)
        if not parent.empty:
            self._edits.append((parent.opened, parent.opened, f"\n{inner}{shifted}"))
            return
        tag = self._data[parent.start : parent.opened].decode("utf-8").rstrip()
        opened = tag[: -len("/>")].rstrip() + ">"
        body = f"{opened}\n{inner}{shifted}\n{outer}</{parent.tag}>"
        self._edits.append((parent.start, parent.end, body))

    def replace_child(self, parent: Element, tag: str, text: str) -> None:
        """Replace the first child of a tag by a text, or add it."""
        child = parent.find(tag)
        if child is None:
            self.add_child(parent, text)
        else:
            self.replace(child, text.replace("\n", "\n" + self._indentation(child)))

    def set_attributes(self, element: Element, values: Mapping[str, str | None]) -> None:
        """Set attributes of a start tag, None to remove one; the others stay as they are."""
        tag = self._data[element.start : element.opened].decode("utf-8")
        end = "/>" if element.empty else ">"
        tag, space = tag[: -len(end)], ""
        for name, value in values.items():
            stated = re.search(rf"""\s{re.escape(name)}\s*=\s*("[^"]*"|'[^']*')""", tag)
            text = "" if value is None else f" {name}={attribute(value)}"
            if stated is not None:
                tag = tag[: stated.start()] + text + tag[stated.end() :]
            elif text:
                tag, space = tag.rstrip() + text, tag[len(tag.rstrip()) :] or space
        self._edits.append((element.start, element.opened, tag + space + end))

    def edited(self) -> str:
        """Return the text with all edits."""
        data = self._data
        for start, end, text in sorted(self._edits, reverse=True):
            data = data[:start] + text.encode("utf-8") + data[end:]
        return data.decode("utf-8")

    def _indentation(self, element: Element) -> str:
        line = self._data.rfind(b"\n", 0, element.start) + 1
        before = self._data[line : element.start].decode("utf-8")
        return before if not before.strip() else ""


def _parse(data: bytes) -> Element:
    parser = expat.ParserCreate("utf-8")
    document = Element("", {}, 0, 0, len(data), empty=False)
    open_elements = [document]

    def started(tag: str, attributes: dict[str, str]) -> None:
        start = parser.CurrentByteIndex
        opened, empty = _tag_end(data, start)
        element = Element(tag, attributes, start, opened, opened, empty)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    def ended(_: str) -> None:
        element = open_elements.pop()
        if not element.empty:
            element.end = data.index(b">", parser.CurrentByteIndex) + 1

    parser.StartElementHandler = started
    parser.EndElementHandler = ended
    parser.Parse(data, True)
    return document.children[0]


def _tag_end(data: bytes, start: int) -> tuple[int, bool]:
    """Return where a start tag ends, and whether it ends its element too."""
    quote = 0
    for position in range(start, len(data)):
        byte = data[position]
        if quote:
            quote = 0 if byte == quote else quote
        elif byte in QUOTES:
            quote = byte
        elif byte == ord(">"):
            return position + 1, data[position - 1] == ord("/")
    raise ValueError("a tag without an end")  # expat refuses such a text
