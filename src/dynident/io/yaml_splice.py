"""One entry of a YAML text put, added or dropped; the text beside it stays as it is."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import yaml

from dynident.io.yaml_tree import BREAKS, Entry, Place, line_end, line_start, skipped

__all__ = ["added", "dropped", "flow", "put"]

WIDEST = 120  # columns of a line that a mapping or a list is written on
_BREAK = re.compile(rf"\r\n|[{BREAKS}]")


def put(text: str, inside: Place, index: int, value: Any) -> str:
    """Return the text with another value of the entry ``index`` of the collection ``inside``."""
    entry, one = inside.entries[index], flow(value)
    place, after = entry.value, entry.after
    if inside.flow or inside.kind == "sequence" or after is None or _fits(text[: after + 1], one, value):
        if after is not None and _is_below(text, entry):
            return f"{text[:after]} {one}{text[after : _before(text, place.start)]}{text[line_end(text, place.end) :]}"
        lead = "" if not place.empty else ": " if after is None else " "
        return f"{text[: place.start]}{lead}{one}{text[place.end :]}"
    end = line_end(text, place.end)
    block = _join(text, ["", *_block(value, _column(text, entry.start) + 2)])
    if _is_below(text, entry):
        return f"{text[: _before(text, place.start)]}{block}{text[end:]}"
    head = text[: place.start]
    head = text[:after] if not head[after:].strip() else head.rstrip(" \t")
    return f"{head}{text[place.end : end]}{block}{text[end:]}"


def added(text: str, inside: Place, index: int, key: Any, value: Any) -> str:
    """Return the text with a new entry before entry ``index`` of a collection, or at its end; the ``key`` is not used
    in a sequence."""
    entries = inside.entries
    if inside.flow:
        new = flow(value) if inside.kind == "sequence" else f"{_key(key)}: {flow(value)}"
        if not entries:
            at = inside.inside + 1
            pad = " " if text[at : at + 1] == "}" else ""
            return f"{text[:at]}{pad}{new}{pad}{text[at:]}"
        at = entries[index - 1].end if index else entries[0].start
        return f"{text[:at]}{f', {new}' if index else f'{new}, '}{text[at:]}"
    column = _column(text, entries[0].start)
    block = [f"- {flow(value)}"] if inside.kind == "sequence" else _pair(key, value, column)
    indented = [f"{' ' * column}{line}" for line in block]
    if index:
        at = line_end(text, entries[index - 1].end)
        return f"{text[:at]}{_join(text, ['', *indented])}{text[at:]}"
    at = entries[0].start
    return f"{text[:at]}{_join(text, [*indented, '']).lstrip(' ')}{' ' * column}{text[at:]}"


def dropped(text: str, inside: Place, index: int) -> str:
    """Return the text without one entry of a collection of several; with its line goes the comment behind it."""
    start, end = (_dropped_flow if inside.flow else _dropped_block)(text, inside.entries, index)
    return f"{text[:start]}{text[end:]}"


def flow(value: Any) -> str:
    """Return a value of plain types as YAML on one line, which can stand within brackets."""
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_key(key)}: {flow(one)}" for key, one in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(flow, value))}]"
    return _scalar(value)


def _scalar(value: Any) -> str:
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


def _key(key: Any) -> str:
    """Return a key; ``on`` needs no quotes, as keys are never read as truth values."""
    return "on" if key == "on" else _scalar(key)


def _pair(key: Any, value: Any, column: int) -> list[str]:
    """Return the lines of an entry of a mapping that begins at a column."""
    one = f"{_key(key)}: {flow(value)}"
    if _fits(" " * column, one, value):
        return [one]
    return [f"{_key(key)}:", *_block(value, 2)]


def _block(value: Mapping[Any, Any] | list[Any], column: int) -> list[str]:
    """Return the lines of a mapping or list of which each entry has its own, moved to a column."""
    if isinstance(value, Mapping):
        found = [line for key, one in value.items() for line in _pair(key, one, column)]
    else:
        found = [f"- {flow(one)}" for one in value]
    return [f"{' ' * column}{line}" for line in found]


def _fits(before: str, one: str, value: Any) -> bool:
    """Whether a value can stand behind what is before it on its line."""
    return not (isinstance(value, Mapping | list) and value) or _column(before, len(before)) + len(one) <= WIDEST


def _dropped_flow(text: str, entries: tuple[Entry, ...], index: int) -> tuple[int, int]:
    start, end = entries[index].start, entries[index].end
    comma = skipped(text, end)
    stop = comma + 1 if text[comma : comma + 1] == "," else end
    first = line_start(text, start)
    rest = text[stop : line_end(text, stop)].strip()
    if not text[first:start].strip() and (not rest or rest.startswith("#")):  # a line of its own
        return _before(text, start), line_end(text, stop)
    if index == len(entries) - 1 and line_start(text, entries[index - 1].end) == first:
        return entries[index - 1].end, end
    return start, stop + len(text[stop:]) - len(text[stop:].lstrip(" \t"))


def _dropped_block(text: str, entries: tuple[Entry, ...], index: int) -> tuple[int, int]:
    start, stop = entries[index].start, line_end(text, entries[index].end)
    if not text[line_start(text, start) : start].strip():
        first = line_start(text, start)
        after = _BREAK.match(text, stop)
        return (first, after.end()) if after else (_before(text, start), stop)
    following = entries[index + 1].start  # the first entry behind the dash of a list
    return start, following if not text[stop:following].strip() else stop


def _is_below(text: str, entry: Entry) -> bool:
    """Whether the value of an entry is a mapping or list in lines of their own, below the key."""
    place, after = entry.value, entry.after or entry.start
    block = place.kind in ("mapping", "sequence") and not place.flow
    return block and line_start(text, place.start) > after


def _column(text: str, at: int) -> int:
    return at - line_start(text, at)


def _before(text: str, at: int) -> int:
    """Return the end of the line before that of a character."""
    first = line_start(text, at)
    return first - 2 if text[:first].endswith("\r\n") else max(first - 1, 0)


def _join(text: str, parts: list[str]) -> str:
    """Return lines with the break that the text has."""
    found = _BREAK.search(text)
    return (found.group() if found else "\n").join(parts)
