"""Changes values in a YAML text and leaves all else as it is, byte for byte: comments, blanks, order, quotes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Any, Final, Literal

from dynident.errors import ConfigError
from dynident.io.yaml_splice import added, dropped, put
from dynident.io.yaml_text import load_yaml
from dynident.io.yaml_tree import Place, tree_of

__all__ = ["REMOVED", "Changes", "KeyPath", "edited", "place_words"]

KeyPath = tuple[str | int, ...]
Changes = Mapping[KeyPath, Any]


@dataclass(frozen=True)
class _Removed:
    def __repr__(self) -> str:
        return "REMOVED"


REMOVED: Final = _Removed()  # stands for a value that is taken out, with its key


@dataclass(frozen=True)
class Step:
    """One entry of a mapping or list to be put, added (before the index that ends its path) or dropped."""

    kind: Literal["put", "add", "drop"]
    path: tuple[Any, ...]
    value: Any = None


def edited(text: str, changes: Changes, source: str = "configuration") -> str:
    """Return a YAML text with values changed, added or removed (``REMOVED``) at key paths.

    A path is of keys of mappings and indices of lists: ``("train", 0, "window")``; an index one behind the last adds an
    entry. Mappings that are missing on the way are added. Of a mapping or list only the entries that differ are
    changed; a comment goes only with the value that is removed on its line. After each step the text is read again and
    compared with what is meant.

    Raises ConfigError, with the place, for a path that does not exist, for a value behind an alias, or with an anchor
    that aliases use, as others would change with it, and where a value can only be changed by hand.

    >>> print(edited("min_speed: 0.1 # rad/s, friction", {("min_speed",): 0.2, ("rests",): "keep"}))
    min_speed: 0.2 # rad/s, friction
    rests: keep
    """
    data = _plain(load_yaml(text, source), None)
    if not isinstance(data, dict) or not data:
        raise ConfigError(f"{source}: holds no settings, each of which has a key; nothing can be changed in it.")
    for step in list(_steps(data, _meant(data, changes, source), ())):
        text, data = _stepped(text, data, step, source)
    return text


def place_words(path: Iterable[Any]) -> str:
    """Return a key path as messages have it: ``train[0].window``."""
    return "".join(f"[{one}]" if isinstance(one, int) else f".{one}" for one in path).removeprefix(".")


def _meant(data: Any, changes: Changes, source: str) -> Any:
    """Return the content with all changes."""
    root = [deepcopy(data)]
    for path, value in changes.items():
        inside: Any = root
        key: Any = 0
        for k, part in enumerate(path):
            below = inside[key] if key in _keys(inside) else None
            if below is None and not isinstance(part, int):
                below = {}
            if not isinstance(below, dict | list) or isinstance(below, list) != isinstance(part, int):
                what = "a list" if isinstance(below, list) else "a mapping" if isinstance(below, dict) else "one value"
                raise ConfigError(f"{source}: {place_words(path[:k])} is {what}; there is no {place_words(path)}.")
            _set(inside, key, below, path[:k], source)
            inside, key = below, _own_key(below, part)
        _set(inside, key, _plain(value, inside[key] if key in _keys(inside) else None), path, source)
    return root[0]


def _keys(inside: Any) -> Any:
    return inside if isinstance(inside, dict) else range(len(inside))


def _own_key(inside: Any, key: Any) -> Any:
    """Return a key as the file has it: names that are numbers need no quotes there."""
    return next((one for one in inside if str(one) == key), key) if isinstance(inside, dict) else key


def _set(inside: Any, key: Any, value: Any, path: KeyPath, source: str) -> None:
    if isinstance(inside, list):
        if not 0 <= key <= len(inside) or (value is REMOVED and key == len(inside)):
            raise ConfigError(f"{source}: {place_words(path)}: the list has {len(inside)} entries, from 0.")
        inside[key : key + 1] = [] if value is REMOVED else [value]
    elif value is REMOVED:
        inside.pop(key, None)
    else:
        inside[key] = value


def _plain(value: Any, before: Any) -> Any:
    """Return a copy in types that YAML has, no part in it twice, the keys of mappings as the file has them."""
    if isinstance(value, Mapping):
        own = before if isinstance(before, dict) else {}
        keys = {key: _own_key(own, key) for key in value}
        return {keys[key]: _plain(one, own.get(keys[key])) for key, one in value.items()}
    return [_plain(one, None) for one in value] if isinstance(value, list | tuple) else value


def _steps(now: Any, meant: Any, path: tuple[Any, ...]) -> Iterator[Step]:
    """Yield the steps from one content to another, in an order in which each finds the indices as they are."""
    if _same(now, meant):
        return
    if isinstance(now, dict) and isinstance(meant, dict) and meant:
        for key, value in meant.items():
            if key in now:
                yield from _steps(now[key], value, (*path, key))
            else:
                yield Step("add", (*path, key), value)
        yield from (Step("drop", (*path, key)) for key in now if key not in meant)
    elif isinstance(now, list) and isinstance(meant, list) and now and meant:
        yield from _list_steps(now, meant, path)
    else:
        yield Step("put", path, meant)


def _list_steps(now: list[Any], meant: list[Any], path: tuple[Any, ...]) -> Iterator[Step]:
    """Yield the steps of a list from its end on; entries in one place that differ are changed inside."""
    matcher = SequenceMatcher(None, [_text(one) for one in now], [_text(one) for one in meant], autojunk=False)
    for kind, i, j, k, m in reversed(matcher.get_opcodes()):
        both = min(j - i, m - k) if kind != "equal" else 0
        yield from (Step("add", (*path, i + both), one) for one in reversed(meant[k + both : m]) if kind != "equal")
        yield from (Step("drop", (*path, n)) for n in range(j - 1, i + both - 1, -1) if kind != "equal")
        for n in range(both):
            yield from _steps(now[i + n], meant[k + n], (*path, i + n))


def _text(value: Any) -> str:
    """Return a text that is the same for the same content."""
    if isinstance(value, dict):
        return f"{{{', '.join(sorted(f'{key!r}: {_text(one)}' for key, one in value.items()))}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    return repr(float(value)) if isinstance(value, int) and not isinstance(value, bool) else repr(value)


def _same(one: Any, other: Any) -> bool:
    return one is other or _text(one) == _text(other)


def _stepped(text: str, data: Any, step: Step, source: str) -> tuple[str, Any]:
    """Return text and content after a step; ConfigError where the text would say anything else than is meant."""
    inside, index = _located(text, step, source)
    expected = _applied(data, step)
    if step.kind == "drop":
        new = dropped(text, inside, index)
    elif step.kind == "put" and index < len(inside.entries):
        new = put(text, inside, index, step.value)
    else:
        new = added(text, inside, index, step.path[-1], step.value)
    try:
        same = _same(load_yaml(new, source), expected)
    except ConfigError:
        same = False
    if not same:
        raise ConfigError(
            f"{source}: {place_words(step.path)} cannot be changed without harm to the lines beside it; write it by "
            "hand."
        )
    return new, expected


def _applied(data: Any, step: Step) -> Any:
    """Return the content after a step."""
    copied = inside = deepcopy(data)
    *way, last = step.path
    for key in way:
        inside = inside[key]
    if step.kind == "drop":
        del inside[last]
    elif step.kind == "add" and isinstance(inside, list):
        inside.insert(last, step.value)
    else:
        inside[last] = step.value
    return copied


def _located(text: str, step: Step, source: str) -> tuple[Place, int]:
    """Return the mapping or list of a step, and the index of its entry there, one behind the last where there is none.

    Raises ConfigError where an alias or an anchor is on the way, or in what goes.
    """
    tree = tree_of(text)
    used = set() if tree is None else {one.anchor for one in _walk(tree) if one.kind == "alias"}
    place: Any = tree
    *way, last = step.path
    for k, key in enumerate(way):
        _refuse_shared(place, used, step.path[:k], source)
        place = place.entries[_found(place, key, step.path[: k + 1], source)].value
    _refuse_shared(place, used, way, source)
    index = _index(place, last)
    if step.kind == "add":
        return place, last if isinstance(last, int) and place.kind == "sequence" else len(place.entries)
    if step.kind == "drop":
        index = _found(place, last, step.path, source)
    if index < len(place.entries):
        for one in _walk(place.entries[index].value):
            if one.kind != "alias":
                _refuse_shared(one, used, step.path, source)
    return place, index


def _walk(place: Place) -> Iterator[Place]:
    yield place
    for entry in place.entries:
        yield from _walk(entry.value)


def _index(place: Place, key: Any) -> int:
    """Return the index of an entry, the number of entries where it is not in the text of the mapping itself."""
    if place.kind == "sequence":
        return int(key)
    found = (k for k, one in enumerate(place.entries) if not one.merged and _text(one.key) == _text(key))
    return next(found, len(place.entries))


def _found(place: Place, key: Any, path: Iterable[Any], source: str) -> int:
    index = _index(place, key)
    if index == len(place.entries):
        raise ConfigError(
            f"{source}: line {place.line}: {place_words(path)} comes from elsewhere by `<<`; write it out here, then "
            "change it."
        )
    return index


def _refuse_shared(place: Place, used: set[str | None], path: Iterable[Any], source: str) -> None:
    """Raise ConfigError for an alias, and for a value that aliases repeat."""
    where = f"{source}: line {place.line}: {place_words(path)}"
    if place.kind == "alias":
        raise ConfigError(
            f"{where} is the alias *{place.anchor} of what is written elsewhere; write it out here, then change it."
        )
    if place.anchor is not None and place.anchor in used:
        raise ConfigError(
            f"{where} has the anchor &{place.anchor}, and would change wherever *{place.anchor} stands, too; write "
            "that out, then change it."
        )
