"""Safe loading of YAML within the size of a configuration; aliases count as often as they are used."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import yaml
from yaml.reader import Reader

from dynident.runtime import ConfigError, brief

# what no line may hold: names in quotes are escaped by then, so that this is left in comments only
UNPRINTABLE = re.compile(f"{Reader.NON_PRINTABLE.pattern}|[\n\r\x85\u2028\u2029]")
MAX_NESTING = 50  # levels of lists and mappings

MAX_CHARACTERS, MAX_NODES = 1_000_000, 50_000
MAX_DIGITS, _INT_TAG = 300, "tag:yaml.org,2002:int"  # a float has no more digits before its point
_BOOL_TAG, _STR_TAG = "tag:yaml.org,2002:bool", "tag:yaml.org,2002:str"
BREAKS = "\n\r\x85\u2028\u2029"  # what ends a line in YAML 1.1
_GAP = re.compile(rf"(?:[\ufeff \t{BREAKS}]|(?<![^\ufeff \t{BREAKS}])#[^{BREAKS}]*)*")
_MERGE_TAG = "tag:yaml.org,2002:merge"


MAX_LINE_WIDTH = 120  # columns of a line that a mapping or a list is written on


class ConfigLoader(yaml.SafeLoader):
    """YAML loader with a limit of nodes; keys such as ``on`` are texts, not the truth values of YAML 1.1."""

    count = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Count a node."""
        self.count += 1
        if self.count > MAX_NODES:
            raise _TooManyError
        return super().compose_node(parent, index)

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Read keys as texts."""
        node = super().compose_mapping_node(anchor)
        for key, _ in node.value:
            key.tag = _STR_TAG if key.tag == _BOOL_TAG else key.tag
        return node


class _TooManyError(Exception):
    """More nodes than a configuration may have."""


def load_yaml(text: str, source: str) -> Any:
    """Return the content of a YAML text; ConfigError where it is not valid, too large, or repeats a key."""
    if len(text) > MAX_CHARACTERS:
        raise ConfigError(f"{source}: has {len(text)} characters; {MAX_CHARACTERS} are the most that are read.")
    try:
        loader = ConfigLoader(text)
        tree = loader.get_single_node()
        # nodes are counted before they are constructed: nested aliases grow exponentially
        _count_nodes(tree, {}, source)
        doubled = next(_doubled_keys(tree, set()), None)
        data = None if tree is None else loader.construct_document(tree)
        if is_deep(data):
            raise RecursionError
    except ConfigError:
        raise
    except RecursionError:
        raise ConfigError(f"{source}: its lists and mappings are nested too deep; no setting is.") from None
    except _TooManyError:
        raise ConfigError(
            f"{source}: has more than {MAX_NODES} values, those of aliases counted each time; write fewer."
        ) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise ConfigError(f"{source}: {where}{error.problem}; the file must be valid YAML.") from error
    except Exception as error:  # values such as 2022-99-99 fail in many ways inside the YAML reader
        raise ConfigError(f"{source}: is not valid YAML ({type(error).__name__}: {error}).") from error
    if doubled is not None:
        line = doubled.start_mark.line + 1
        raise ConfigError(f"{source}: line {line}: the key {doubled.value!r} is given twice; keep one of them.")
    return data


def _count_nodes(node: yaml.Node | None, node_counts: dict[int, int], source: str) -> int:
    """Return the number of nodes with aliases written out; ``node_counts`` caches those of visited nodes.

    Raises ConfigError for a number of more digits than any setting has.
    """
    if not isinstance(node, yaml.MappingNode | yaml.SequenceNode):
        if node is not None and node.tag == _INT_TAG and len(node.value) > MAX_DIGITS:
            raise ConfigError(
                f"{source}: line {node.start_mark.line + 1}: {node.value[:20]}... is a number of {len(node.value)} "
                "digits; no setting is so large."
            )
        return 1
    if id(node) not in node_counts:
        node_counts[id(node)] = MAX_NODES  # where an alias is inside its own anchor
        inside = chain.from_iterable(node.value) if isinstance(node, yaml.MappingNode) else node.value
        node_counts[id(node)] = 1 + sum(_count_nodes(child, node_counts, source) for child in inside)
        if node_counts[id(node)] > MAX_NODES:
            raise _TooManyError
    return node_counts[id(node)]


def _doubled_keys(node: yaml.Node | None, visited: set[int]) -> Iterator[yaml.Node]:
    """Yield the keys that repeat in their mapping; each node is visited once, as ``visited`` tells."""
    if node is None or id(node) in visited:
        return
    visited.add(id(node))
    if isinstance(node, yaml.MappingNode):
        keys = [key for key, _ in node.value if isinstance(key, yaml.ScalarNode)]  # others are refused as keys
        counts = Counter(key.value for key in keys)
        yield from (key for key in reversed(keys) if counts[key.value] > 1)
        for child in chain.from_iterable(node.value):
            yield from _doubled_keys(child, visited)
    elif isinstance(node, yaml.SequenceNode):
        for child in node.value:
            yield from _doubled_keys(child, visited)


def is_deep(data: object) -> bool:
    """Whether lists and mappings are nested deeper than any settings or results are, or in a ring."""
    # one level per round, keyed by identity: a ring never ends, but shared parts are not multiplied
    level = {id(data): data}
    for _ in range(MAX_NESTING):
        level = {id(node): node for part in level.values() for node in _children(part)}
    return any(isinstance(node, Mapping | list) for node in level.values())


def _children(value: object) -> Iterable[object]:
    if isinstance(value, Mapping):
        return value.values()
    return value if isinstance(value, list) else ()


@dataclass(frozen=True)
class Place:
    """A value in a text, from character ``start``, including its anchor and tag, to ``end``.

    ``inside`` is where its content begins. ``kind`` is "scalar", "mapping", "sequence" or "alias"; for an alias,
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
    """Composer that keeps what PyYAML drops: whether a node is an alias, and how many marks stand before a value."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        node: Any = super().compose_node(parent, index)
        # PyYAML returns the node of the anchor for an alias: a scalar stands for the alias itself
        node = yaml.ScalarNode("alias", "", event.start_mark, event.end_mark) if _is_alias(event) else node
        node.alias, node.anchor = _is_alias(event), event.anchor
        node.marks = (event.anchor is not None) + (getattr(event, "tag", None) is not None)
        return node


def _is_alias(event: object) -> bool:
    return isinstance(event, yaml.AliasEvent)


def parse_tree(text: str) -> Place | None:
    """Return the positions of all values of a YAML text that ``load_yaml`` reads; None where it holds none."""
    loader = _Composer(text)
    node = loader.get_single_node()
    return None if node is None else _make_place(text, node, loader)


def skip_gap(text: str, at: int) -> int:
    """Return the next position that is neither blank nor in a comment."""
    match = _GAP.match(text, at)
    return match.end() if match else at


def line_start(text: str, at: int) -> int:
    """Return where the line begins."""
    return max(text.rfind(mark, 0, at) for mark in BREAKS) + 1 or int(text.startswith("\ufeff"))


def line_end(text: str, at: int) -> int:
    """Return where the line ends, before its break."""
    positions = [text.find(mark, at) for mark in BREAKS]
    return min((mark for mark in positions if mark >= 0), default=len(text))


def _make_place(text: str, node: Any, loader: _Composer) -> Place:
    start, end = node.start_mark.index, node.end_mark.index
    inside = start
    # skip anchor and tag, each a word
    for _ in range(0 if node.alias else node.marks):
        inside = skip_gap(text, inside + len(re.split(r"\s", text[inside:end], maxsplit=1)[0]))
    kind = "alias" if node.alias else node.id
    place = Place(kind, start, inside, end, node.start_mark.line + 1, node.anchor)
    if isinstance(node, yaml.ScalarNode):
        # PyYAML counts blank lines after a block scalar as part of it
        return replace(place, end=start + len(text[start:end].rstrip())) if node.style in ("|", ">") else place
    flow = bool(node.flow_style)
    has_bracket = flow and text[inside : inside + 1] in ("{", "[")
    entries = _make_entries(text, node, inside + has_bracket, loader)
    last = entries[-1].end if entries else inside
    # a block collection ends with its last entry; PyYAML counts up to the next key
    return replace(place, end=end if has_bracket else last, flow=flow, entries=entries)


def _make_entries(text: str, node: Any, at: int, loader: _Composer) -> tuple[Entry, ...]:
    """Return the entries of a collection whose content begins at a position."""
    entries: list[Entry] = []
    for child in node.value:
        begin = skip_gap(text, at)
        # step over the comma between entries in brackets
        begin = skip_gap(text, begin + 1) if entries and text[begin : begin + 1] == "," else begin
        if isinstance(node, yaml.MappingNode):
            entry = _mapping_entry(text, begin, child[0], child[1], loader)
        else:
            entry = Entry(begin, begin if node.flow_style else begin + 1, _make_place(text, child, loader))
        entries.append(entry)
        at = entry.end
    return tuple(entries)


def _mapping_entry(text: str, begin: int, key: Any, value: Any, loader: _Composer) -> Entry:
    """Return the entry of a mapping; a key without a colon has an empty value at its own end."""
    colon = skip_gap(text, key.end_mark.index)
    has_colon = text[colon : colon + 1] == ":"
    place = _make_place(text, value, loader)
    if not has_colon:
        place = replace(place, start=key.end_mark.index, inside=key.end_mark.index, end=key.end_mark.index)
    merged = key.tag == _MERGE_TAG and key.value == "<<"
    name = None if key.alias or merged else loader.construct_object(key, deep=True)
    return Entry(begin, colon + 1 if has_colon else None, place, name, merged)


def to_flow(value: Any) -> str:
    """Return a value of plain types as YAML on one line, in a form that can stand within brackets."""
    if isinstance(value, Mapping):
        entries = ", ".join(f"{to_key(key)}: {to_flow(child)}" for key, child in value.items())
        return f"{{ {entries} }}" if entries else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(to_flow, value))}]"
    return _to_scalar(value)


def _to_scalar(value: Any) -> str:
    style = '"' if isinstance(value, str) and not value.isprintable() else None
    text = yaml.dump(
        [value],
        Dumper=yaml.SafeDumper,
        default_flow_style=True,
        default_style=style,
        width=math.inf,
        allow_unicode=style is None,
    )
    return str(text).strip()[1:-1]


def to_key(key: Any) -> str:
    """Return a key as YAML; ``on`` needs no quotes, as keys are never read as truth values."""
    return "on" if key == "on" else _to_scalar(key)


def pair_lines(key: Any, value: Any, column: int) -> list[str]:
    """Return the lines of an entry of a mapping that begins at a column."""
    line = f"{to_key(key)}: {to_flow(value)}"
    if fits_line(" " * column, line, value):
        return [line]
    return [f"{to_key(key)}:", *block_lines(value, 2)]


def block_lines(value: Mapping[Any, Any] | list[Any], column: int) -> list[str]:
    """Return the lines of a mapping or list, one or more for each entry, indented to a column."""
    if isinstance(value, Mapping):
        lines = [line for key, child in value.items() for line in pair_lines(key, child, column)]
    else:
        lines = [f"- {to_flow(child)}" for child in value]
    return [f"{' ' * column}{line}" for line in lines]


def fits_line(before: str, flow_text: str, value: Any) -> bool:
    """Return whether a value fits on a line after the text ``before``."""
    return (
        not (isinstance(value, Mapping | list) and value)
        or column_of(before, len(before)) + len(flow_text) <= MAX_LINE_WIDTH
    )


def column_of(text: str, at: int) -> int:
    """Return how far a place is from the start of its line."""
    return at - line_start(text, at)
