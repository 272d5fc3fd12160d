"""Changes of values in a YAML text that leave all else as it is, byte for byte: comments, blanks, order, quotes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Any, Final, Literal

from dynident.files.yaml_text import (
    BREAKS,
    Entry,
    Place,
    block_lines,
    column_of,
    fits_line,
    line_end,
    line_start,
    load_yaml,
    pair_lines,
    parse_tree,
    skip_gap,
    to_flow,
    to_key,
)
from dynident.runtime import ConfigError

_BREAK = re.compile(rf"\r\n|[{BREAKS}]")
KeyPath = tuple[str | int, ...]
Changes = Mapping[KeyPath, Any]


def replace_entry(text: str, inside: Place, index: int, value: Any) -> str:
    """Return the text with another value of the entry ``index`` of the collection ``inside``."""
    entry, flow_text = inside.entries[index], to_flow(value)
    place, after = entry.value, entry.after
    # on the line of the key where the value fits there, else as a block below it
    if inside.flow or inside.kind == "sequence" or after is None or fits_line(text[: after + 1], flow_text, value):
        if after is not None and _is_below(text, entry):
            between, rest = text[after : _previous_line_end(text, place.start)], text[line_end(text, place.end) :]
            return f"{text[:after]} {flow_text}{between}{rest}"
        lead = "" if not place.empty else ": " if after is None else " "
        return f"{text[: place.start]}{lead}{flow_text}{text[place.end :]}"
    end = line_end(text, place.end)
    block = _join_lines(text, ["", *block_lines(value, column_of(text, entry.start) + 2)])
    if _is_below(text, entry):
        return f"{text[: _previous_line_end(text, place.start)]}{block}{text[end:]}"
    # what stands between key and value, such as a comment, stays; blanks at its end go
    head = text[: place.start]
    head = text[:after] if not head[after:].strip() else head.rstrip(" \t")
    return f"{head}{text[place.end : end]}{block}{text[end:]}"


def insert_entry(text: str, inside: Place, index: int, key: Any, value: Any) -> str:
    """Return the text with a new entry before entry ``index`` of a collection, or at its end.

    The ``key`` is not used in a sequence.
    """
    entries = inside.entries
    if inside.flow:
        # in brackets the entry is inserted with its comma
        new = to_flow(value) if inside.kind == "sequence" else f"{to_key(key)}: {to_flow(value)}"
        if not entries:
            at = inside.inside + 1
            pad = " " if text[at : at + 1] == "}" else ""
            return f"{text[:at]}{pad}{new}{pad}{text[at:]}"
        at = entries[index - 1].end if index else entries[0].start
        return f"{text[:at]}{f', {new}' if index else f'{new}, '}{text[at:]}"
    column = column_of(text, entries[0].start)
    block = [f"- {to_flow(value)}"] if inside.kind == "sequence" else pair_lines(key, value, column)
    indented = [f"{' ' * column}{line}" for line in block]
    # a block entry goes on lines of its own, after those of the entry before
    if index:
        at = line_end(text, entries[index - 1].end)
        return f"{text[:at]}{_join_lines(text, ['', *indented])}{text[at:]}"
    at = entries[0].start
    return f"{text[:at]}{_join_lines(text, [*indented, '']).lstrip(' ')}{' ' * column}{text[at:]}"


def remove_entry(text: str, inside: Place, index: int) -> str:
    """Return the text without one of several entries of a collection; a comment on its line goes, too."""
    start, end = (_flow_span if inside.flow else _block_span)(text, inside.entries, index)
    return f"{text[:start]}{text[end:]}"


def _flow_span(text: str, entries: tuple[Entry, ...], index: int) -> tuple[int, int]:
    start, end = entries[index].start, entries[index].end
    comma = skip_gap(text, end)
    stop = comma + 1 if text[comma : comma + 1] == "," else end
    line_begin = line_start(text, start)
    tail = text[stop : line_end(text, stop)].strip()
    if not text[line_begin:start].strip() and (not tail or tail.startswith("#")):  # a line of its own
        return _previous_line_end(text, start), line_end(text, stop)
    # the last entry of a line takes the comma before it along, not the line break after it
    if index == len(entries) - 1 and line_start(text, entries[index - 1].end) == line_begin:
        return entries[index - 1].end, end
    return start, stop + len(text[stop:]) - len(text[stop:].lstrip(" \t"))


def _block_span(text: str, entries: tuple[Entry, ...], index: int) -> tuple[int, int]:
    start, stop = entries[index].start, line_end(text, entries[index].end)
    if not text[line_start(text, start) : start].strip():
        # with a line of its own the break goes, too; at the end of the text the break before it
        line_begin = line_start(text, start)
        after = _BREAK.match(text, stop)
        return (line_begin, after.end()) if after else (_previous_line_end(text, start), stop)
    following = entries[index + 1].start  # the first entry behind the dash of a list
    return start, following if not text[stop:following].strip() else stop


def _is_below(text: str, entry: Entry) -> bool:
    """Return whether the value of an entry is a block mapping or list below its key."""
    place, after = entry.value, entry.after or entry.start
    block = place.kind in ("mapping", "sequence") and not place.flow
    return block and line_start(text, place.start) > after


def _previous_line_end(text: str, at: int) -> int:
    """Return the end of the line before that of a character."""
    line_begin = line_start(text, at)
    return line_begin - 2 if text[:line_begin].endswith("\r\n") else max(line_begin - 1, 0)


def _join_lines(text: str, parts: list[str]) -> str:
    """Join lines with the line break of the text."""
    match = _BREAK.search(text)
    return (match.group() if match else "\n").join(parts)


@dataclass(frozen=True)
class _RemovedMarker:
    def __repr__(self) -> str:
        return "REMOVED"


REMOVED: Final = _RemovedMarker()  # stands for a value that is taken out, with its key


@dataclass(frozen=True)
class EditStep:
    """One entry of a mapping or list to be put, added (before the index that ends its path) or dropped."""

    kind: Literal["put", "add", "drop"]
    path: tuple[Any, ...]
    value: Any = None


def edit_yaml(text: str, changes: Changes, source: str = "configuration") -> str:
    """Return a YAML text with values changed, added or removed (``REMOVED``) at key paths.

    A path consists of keys of mappings and indices of lists: ``("train", 0, "window")``; an index one past the
    last adds an entry. Missing mappings on the way are added. Only the entries of a mapping or list that differ
    are changed; a comment is removed only with the value on its line. After each step the text is parsed again
    and compared with the expected content.

    Raises ConfigError, with the place, for a path that does not exist, for a value behind an alias, or with an
    anchor that aliases use, as others would change with it, and where a value can only be changed by hand.

    >>> print(edit_yaml("min_speed: 0.1 # rad/s, friction", {("min_speed",): 0.2, ("rests",): "keep"}))
    min_speed: 0.2 # rad/s, friction
    rests: keep
    """
    data = _to_plain(load_yaml(text, source), None)
    if not isinstance(data, dict) or not data:
        raise ConfigError(f"{source}: holds no settings, each of which has a key; nothing can be changed in it.")
    # the steps are computed on the content first; each then edits the text and must give that content
    for step in list(_edit_steps(data, _apply_changes(data, changes, source), ())):
        text, data = _apply_step(text, data, step, source)
    return text


def format_path(path: Iterable[Any]) -> str:
    """Return a key path as messages show it: ``train[0].window``."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).removeprefix(".")


def _apply_changes(data: Any, changes: Changes, source: str) -> Any:
    """Return the content with all changes applied."""
    root = [deepcopy(data)]
    for path, value in changes.items():
        container: Any = root
        key: Any = 0
        for k, part in enumerate(path):
            # missing mappings on the way are created, lists are not
            child = container[key] if key in _container_keys(container) else None
            if child is None and not isinstance(part, int):
                child = {}
            if not isinstance(child, dict | list) or isinstance(child, list) != isinstance(part, int):
                kind = "a list" if isinstance(child, list) else "a mapping" if isinstance(child, dict) else "one value"
                raise ConfigError(f"{source}: {format_path(path[:k])} is {kind}; there is no {format_path(path)}.")
            _set_entry(container, key, child, path[:k], source)
            container, key = child, _file_key(child, part)
        # keys are written in the form that the file has, so that unchanged ones compare equal
        _set_entry(
            container,
            key,
            _to_plain(value, container[key] if key in _container_keys(container) else None),
            path,
            source,
        )
    return root[0]


def _container_keys(inside: Any) -> Any:
    return inside if isinstance(inside, dict) else range(len(inside))


def _file_key(inside: Any, key: Any) -> Any:
    """Return a key as the file has it: names that are numbers need no quotes there."""
    return next((candidate for candidate in inside if str(candidate) == key), key) if isinstance(inside, dict) else key


def _set_entry(inside: Any, key: Any, value: Any, path: KeyPath, source: str) -> None:
    if isinstance(inside, list):
        if not 0 <= key <= len(inside) or (value is REMOVED and key == len(inside)):
            raise ConfigError(f"{source}: {format_path(path)}: the list has {len(inside)} entries, from 0.")
        inside[key : key + 1] = [] if value is REMOVED else [value]
    elif value is REMOVED:
        inside.pop(key, None)
    else:
        inside[key] = value


def _to_plain(value: Any, before: Any) -> Any:
    """Return a copy in YAML types without shared parts; keys of mappings are as the file has them."""
    if isinstance(value, Mapping):
        previous = before if isinstance(before, dict) else {}
        keys = {key: _file_key(previous, key) for key in value}
        return {keys[key]: _to_plain(child, previous.get(keys[key])) for key, child in value.items()}
    return [_to_plain(child, None) for child in value] if isinstance(value, list | tuple) else value


def _edit_steps(current: Any, target: Any, path: tuple[Any, ...]) -> Iterator[EditStep]:
    """Yield the steps from one content to another, ordered so that the indices of each step are still valid."""
    if _is_same(current, target):
        return
    # an emptied mapping, and an empty or emptied list, are replaced as a whole
    if isinstance(current, dict) and isinstance(target, dict) and target:
        for key, value in target.items():
            if key in current:
                yield from _edit_steps(current[key], value, (*path, key))
            else:
                yield EditStep("add", (*path, key), value)
        yield from (EditStep("drop", (*path, key)) for key in current if key not in target)
    elif isinstance(current, list) and isinstance(target, list) and current and target:
        yield from _list_edit_steps(current, target, path)
    else:
        yield EditStep("put", path, target)


def _list_edit_steps(current: list[Any], target: list[Any], path: tuple[Any, ...]) -> Iterator[EditStep]:
    """Yield the steps of a list from its end on; differing entries at one position are changed inside."""
    matcher = SequenceMatcher(
        None,
        [_canonical_text(entry) for entry in current],
        [_canonical_text(entry) for entry in target],
        autojunk=False,
    )
    # from the end, so that added and dropped entries do not shift the indices of later steps
    for kind, i, j, k, m in reversed(matcher.get_opcodes()):
        common = min(j - i, m - k) if kind != "equal" else 0
        yield from (
            EditStep("add", (*path, i + common), entry) for entry in reversed(target[k + common : m]) if kind != "equal"
        )
        yield from (EditStep("drop", (*path, n)) for n in range(j - 1, i + common - 1, -1) if kind != "equal")
        for n in range(common):
            yield from _edit_steps(current[i + n], target[k + n], (*path, i + n))


def _canonical_text(value: Any) -> str:
    """Return a text that is equal for equal content."""
    if isinstance(value, dict):
        return f"{{{', '.join(sorted(f'{key!r}: {_canonical_text(child)}' for key, child in value.items()))}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_canonical_text, value))}]"
    return repr(float(value)) if isinstance(value, int) and not isinstance(value, bool) else repr(value)


def _is_same(value: Any, other_value: Any) -> bool:
    return value is other_value or _canonical_text(value) == _canonical_text(other_value)


def _apply_step(text: str, data: Any, step: EditStep, source: str) -> tuple[str, Any]:
    """Return text and content after a step; ConfigError where the text would not have the expected content."""
    inside, index = _locate(text, step, source)
    expected = _apply_to_content(data, step)
    if step.kind == "drop":
        new = remove_entry(text, inside, index)
    elif step.kind == "put" and index < len(inside.entries):
        new = replace_entry(text, inside, index, step.value)
    else:
        new = insert_entry(text, inside, index, step.path[-1], step.value)
    try:
        # the safeguard of all text editing: whatever a splice did, the parsed result decides
        is_expected = _is_same(load_yaml(new, source), expected)
    except ConfigError:
        is_expected = False
    if not is_expected:
        raise ConfigError(
            f"{source}: {format_path(step.path)} cannot be changed without harm to the lines beside it; write it by "
            "hand."
        )
    return new, expected


def _apply_to_content(data: Any, step: EditStep) -> Any:
    """Return the content after a step."""
    content = container = deepcopy(data)
    *parents, last = step.path
    for key in parents:
        container = container[key]
    if step.kind == "drop":
        del container[last]
    elif step.kind == "add" and isinstance(container, list):
        container.insert(last, step.value)
    else:
        container[last] = step.value
    return content


def _locate(text: str, step: EditStep, source: str) -> tuple[Place, int]:
    """Return the mapping or list of a step, and the index of its entry there, one past the last for a new one.

    Raises ConfigError where an alias or an anchor is on the way, or in what is removed.
    """
    tree = parse_tree(text)
    aliased_anchors = set() if tree is None else {node.anchor for node in _walk_tree(tree) if node.kind == "alias"}
    # no level on the way may be shared by an alias or an anchor
    place: Any = tree
    *parents, last = step.path
    for k, key in enumerate(parents):
        _refuse_shared(place, aliased_anchors, step.path[:k], source)
        place = place.entries[_require_index(place, key, step.path[: k + 1], source)].value
    _refuse_shared(place, aliased_anchors, parents, source)
    index = _entry_index(place, last)
    if step.kind == "add":
        return place, last if isinstance(last, int) and place.kind == "sequence" else len(place.entries)
    if step.kind == "drop":
        index = _require_index(place, last, step.path, source)
    if index < len(place.entries):
        # a removed part may hold an anchor that others refer to
        for node in _walk_tree(place.entries[index].value):
            if node.kind != "alias":
                _refuse_shared(node, aliased_anchors, step.path, source)
    return place, index


def _walk_tree(place: Place) -> Iterator[Place]:
    yield place
    for entry in place.entries:
        yield from _walk_tree(entry.value)


def _entry_index(place: Place, key: Any) -> int:
    """Return the index of an entry; the number of entries where it is not in the text of the mapping itself."""
    if place.kind == "sequence":
        return int(key)
    indices = (
        k
        for k, entry in enumerate(place.entries)
        if not entry.merged and _canonical_text(entry.key) == _canonical_text(key)
    )
    return next(indices, len(place.entries))


def _require_index(place: Place, key: Any, path: Iterable[Any], source: str) -> int:
    index = _entry_index(place, key)
    if index == len(place.entries):
        raise ConfigError(
            f"{source}: line {place.line}: {format_path(path)} comes from elsewhere by `<<`; write it out here, then "
            "change it."
        )
    return index


def _refuse_shared(place: Place, aliased_anchors: set[str | None], path: Iterable[Any], source: str) -> None:
    """Raise ConfigError for an alias, and for a value that aliases repeat."""
    where = f"{source}: line {place.line}: {format_path(path)}"
    if place.kind == "alias":
        raise ConfigError(
            f"{where} is the alias *{place.anchor} of what is written elsewhere; write it out here, then change it."
        )
    if place.anchor is not None and place.anchor in aliased_anchors:
        raise ConfigError(
            f"{where} has the anchor &{place.anchor}, and would change wherever *{place.anchor} stands, too; write "
            "that out, then change it."
        )
