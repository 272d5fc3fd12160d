"""Where the values of a YAML text stand in it, for changes that leave all else as it is."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import yaml

from dynident.errors import brief
from dynident.io.yaml_text import ConfigLoader

__all__ = ["BREAKS", "Entry", "Place", "line_end", "line_start", "skipped", "tree_of"]

BREAKS = "\n\r\x85\u2028\u2029"  # what ends a line in YAML 1.1
_GAP = re.compile(rf"(?:[\ufeff \t{BREAKS}]|(?<![^\ufeff \t{BREAKS}])#[^{BREAKS}]*)*")
_MERGE = "tag:yaml.org,2002:merge"


@dataclass(frozen=True)
class Place:
    """A value in a text, from character ``start``, its anchor and tag among it, to ``end``, without what follows it.

    ``inside`` is where its content begins. ``kind`` is "scalar", "mapping", "sequence" or "alias"; of an alias,
    ``anchor`` is the one that it names. ``flow`` says whether the value stands in brackets.
    """

    kind: str
    start: int
    inside: int
    end: int
    line: int
    anchor: str | None = None
    flow: bool = False
    entries: tuple[Entry, ...] = ()

    __repr__ = brief

    @property
    def empty(self) -> bool:
        """Whether there is nothing in the text: null."""
        return self.kind == "scalar" and self.start == self.end


@dataclass(frozen=True)
class Entry:
    """An entry of a mapping or sequence: from ``start``, its key or dash, to the end of its value.

    ``key`` is None in a sequence, and ``after`` is where the value may begin: behind the colon or the dash; None where
    a key has no colon. ``merged`` marks ``<<``, whose value is a mapping that others may overrule.
    """

    start: int
    after: int | None
    value: Place
    key: Any = None
    merged: bool = False

    __repr__ = brief

    @property
    def end(self) -> int:
        """Where its value ends."""
        return self.value.end


class _Composer(ConfigLoader):
    """Keeps what the nodes of PyYAML forget: which one is an alias, and what stands before a value."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        node: Any = super().compose_node(parent, index)
        node = yaml.ScalarNode("alias", "", event.start_mark, event.end_mark) if _is_alias(event) else node
        node.alias, node.anchor = _is_alias(event), event.anchor
        node.marks = (event.anchor is not None) + (getattr(event, "tag", None) is not None)
        return node


def _is_alias(event: object) -> bool:
    return isinstance(event, yaml.AliasEvent)


def tree_of(text: str) -> Place | None:
    """Return where all values of a YAML text, one that ``load_yaml`` reads, are; None where it holds none."""
    loader = _Composer(text)
    node = loader.get_single_node()
    return None if node is None else _place(text, node, loader)


def skipped(text: str, at: int) -> int:
    """Return the next character that is neither blank nor in a comment."""
    found = _GAP.match(text, at)
    return found.end() if found else at


def line_start(text: str, at: int) -> int:
    """Return where the line begins."""
    return max(text.rfind(one, 0, at) for one in BREAKS) + 1 or int(text.startswith("\ufeff"))


def line_end(text: str, at: int) -> int:
    """Return where the line ends, before its break."""
    found = [text.find(one, at) for one in BREAKS]
    return min((one for one in found if one >= 0), default=len(text))


def _place(text: str, node: Any, loader: _Composer) -> Place:
    start, end = node.start_mark.index, node.end_mark.index
    inside = start
    for _ in range(0 if node.alias else node.marks):
        inside = skipped(text, inside + len(re.split(r"\s", text[inside:end], maxsplit=1)[0]))
    kind = "alias" if node.alias else node.id
    place = Place(kind, start, inside, end, node.start_mark.line + 1, node.anchor)
    if isinstance(node, yaml.ScalarNode):
        return replace(place, end=start + len(text[start:end].rstrip())) if node.style in ("|", ">") else place
    flow = bool(node.flow_style)
    opened = flow and text[inside : inside + 1] in ("{", "[")
    entries = _entries(text, node, inside + opened, loader)
    last = entries[-1].end if entries else inside
    return replace(place, end=end if opened else last, flow=flow, entries=entries)


def _entries(text: str, node: Any, at: int, loader: _Composer) -> tuple[Entry, ...]:
    """Return the entries of a collection whose content begins at a character."""
    entries: list[Entry] = []
    for one in node.value:
        begin = skipped(text, at)
        begin = skipped(text, begin + 1) if entries and text[begin : begin + 1] == "," else begin
        if isinstance(node, yaml.MappingNode):
            entry = _pair(text, begin, one[0], one[1], loader)
        else:
            entry = Entry(begin, begin if node.flow_style else begin + 1, _place(text, one, loader))
        entries.append(entry)
        at = entry.end
    return tuple(entries)


def _pair(text: str, begin: int, key: Any, value: Any, loader: _Composer) -> Entry:
    """Return the entry of a mapping; a key without a colon has its empty value at its own end."""
    colon = skipped(text, key.end_mark.index)
    there = text[colon : colon + 1] == ":"
    place = _place(text, value, loader)
    if not there:
        place = replace(place, start=key.end_mark.index, inside=key.end_mark.index, end=key.end_mark.index)
    merged = key.tag == _MERGE and key.value == "<<"
    name = None if key.alias or merged else loader.construct_object(key, deep=True)
    return Entry(begin, colon + 1 if there else None, place, name, merged)
