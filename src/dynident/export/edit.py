"""Edits an XML text in place: what is not edited is preserved byte by byte.

The standard library's trees lose comments, quotes and the order of attributes when they are written. Here expat only
locates the elements; an edit replaces the bytes of one attribute or element.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from dynident.models.robot_file import exact

__all__ = ["Node", "Text"]

_START = re.compile(rb"""<[^\s/>]+(?:\s+[^\s=/>]+\s*=\s*(?:"[^"]*"|'[^']*'))*\s*/?>""")
_ATTRIBUTE = re.compile(rb"""\s+([^\s=/>]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(eq=False)
class Node:
    """An element: where its start tag begins and ends, where its end tag begins, and where it ends (bytes)."""

    tag: str
    attributes: Mapping[str, str]
    start: int
    inside: int
    close: int = 0
    end: int = 0
    children: list[Node] = field(default_factory=list)

    @property
    def empty(self) -> bool:
        """Whether the element is one tag, ``<a/>``."""
        return self.close == self.inside == self.end

    def find(self, tag: str) -> Node | None:
        """Return the first child of that name."""
        return next((child for child in self.children if child.tag == tag), None)

    def walk(self) -> Iterator[Node]:
        """Yield the element and all below it, in the order of the text."""
        yield self
        for child in self.children:
            yield from child.walk()


class Text:
    """The text of a well-formed XML file, with its elements and the edits made so far."""

    def __init__(self, xml: str) -> None:
        self._bytes = xml.encode()
        self._edits: list[tuple[int, int, bytes]] = []
        self.root = self._parsed()

    def _parsed(self) -> Node:
        parser = expat.ParserCreate("utf-8")
        open_ones: list[Node] = []
        roots: list[Node] = []

        def start(tag: str, attributes: dict[str, str]) -> None:
            """Note where an element begins and its start tag ends."""
            at = parser.CurrentByteIndex
            found = _START.match(self._bytes, at)
            assert found, "expat has read this start tag"  # noqa: S101
            node = Node(tag, attributes, at, found.end())
            (open_ones[-1].children if open_ones else roots).append(node)
            open_ones.append(node)

        def end(_: str) -> None:
            """Note where the content of an element ends, and the element."""
            node = open_ones.pop()
            one_tag = self._bytes[node.inside - 2 : node.inside] == b"/>"
            node.close = node.inside if one_tag else parser.CurrentByteIndex
            node.end = node.close if one_tag else self._bytes.index(b">", node.close) + 1

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.Parse(self._bytes, True)
        return roots[0]

    def set(self, node: Node, values: Mapping[str, str]) -> None:
        """Set attributes; those that the element lacks are added after its others."""
        spans = {
            match[1].decode(): match.span(2) for match in _ATTRIBUTE.finditer(self._bytes, node.start, node.inside)
        }
        last = max((stop for _, stop in spans.values()), default=node.start + 1 + len(node.tag.encode()))
        added = "".join(f" {key}={quoteattr(value)}" for key, value in values.items() if key not in spans)
        for key, value in values.items():
            if key in spans:
                self._replace(*spans[key], quoteattr(value))
        if added:
            self._replace(last, last, added)

    def write_exact_angles(self, node: Node, key: str, count: int = 3) -> None:
        """Write the last ``count`` numbers (rad) of an attribute as the exact angles used in the model."""
        words = node.attributes.get(key, "").split()
        new = [repr(exact(word)) if exact(word) != float(word) else word for word in words[-count:]]
        if new != words[-count:]:
            self.set(node, {key: " ".join([*words[:-count], *new])})

    def drop(self, node: Node, keys: tuple[str, ...]) -> None:
        """Remove attributes that the element has."""
        for match in _ATTRIBUTE.finditer(self._bytes, node.start, node.inside):
            if match[1].decode() in keys:
                self._replace(*match.span(), "")

    def delete(self, node: Node) -> None:
        """Remove an element, with the whitespace before it."""
        start = node.start
        while self._bytes[start - 1 : start].isspace():
            start -= 1
        self._replace(start, node.end, "")

    def replace(self, node: Node, element: str) -> None:
        """Replace an element by another."""
        self._replace(node.start, node.end, element)

    def insert(self, parent: Node, *lines: str) -> None:
        """Insert an element, given in lines, before the first child of another, with the same indentation."""
        gap = self._gap(parent)
        block = "".join(gap + line for line in lines)
        if parent.empty:
            self._replace(parent.inside - len("/>"), parent.inside, f">{block}{self._before(parent)}</{parent.tag}>")
        else:
            tail = "" if parent.children else self._before(parent)
            self._replace(parent.inside, parent.inside, block + tail)

    def __str__(self) -> str:
        out = self._bytes
        for start, stop, new in sorted(self._edits, key=lambda edit: edit[:2], reverse=True):
            out = out[:start] + new + out[stop:]
        return out.decode()

    def _replace(self, start: int, stop: int, new: str) -> None:
        self._edits.append((start, stop, new.encode()))

    def _gap(self, parent: Node) -> str:
        """Return the line break and whitespace before the first child, or what they would be."""
        if parent.children:
            return self._before(parent.children[0])
        before = self._before(parent)
        return before + "  " if before else ""

    def _before(self, node: Node) -> str:
        """Return the line break and blanks before an element; nothing where it does not begin its line."""
        head = self._bytes[: node.start]
        blanks = head[len(head.rstrip(b" \t\r\n")) :].decode()
        line = blanks.rfind("\n")
        return "" if line < 0 else ("\r\n" if blanks[:line].endswith("\r") else "\n") + blanks[line + 1 :]
