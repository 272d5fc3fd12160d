"""Error messages for settings: the place such as ``train[0].window``, the fault, the value, the choices."""

from __future__ import annotations

import re
from collections.abc import Sequence
from reprlib import repr as short
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from dynident.errors import choices

__all__ = ["worded"]

MOST = 12  # places in a message


def worded(error: ValidationError, data: Any, source: str) -> str:
    """Return the message to a user for settings ``data`` from ``source``, one line for each place."""
    lines: dict[str, list[str]] = {}
    for details in _causes(error.errors()):
        lines.setdefault(_path(details["loc"], data), []).append(_words(details))
    words = [f"{path}: {' or '.join(parts)}" if path else " or ".join(parts) for path, parts in lines.items()]
    return f"{source}: " + "\n  ".join(words[:MOST] + ([f"and {len(words) - MOST} more"] if words[MOST:] else []))


def _causes(found: list[ErrorDetails]) -> list[ErrorDetails]:
    """Leave out the lists that are too short only because an item of theirs is wrong."""
    places = [details["loc"] for details in found]

    def follows(details: ErrorDetails) -> bool:
        depth = len(details["loc"])
        return details["type"] == "too_short" and any(
            len(place) > depth and place[:depth] == details["loc"] for place in places
        )

    return [details for details in found if not follows(details)]


def _path(loc: Sequence[int | str], data: Any) -> str:
    """Return the place of an error as ``train[0].window``, without the tags that pydantic adds."""
    words = ""
    for part in loc:
        keys = {str(key): key for key in data} if isinstance(data, dict) else {}
        if isinstance(data, list) and isinstance(part, int):
            words, data = f"{words}[{part}]", data[part] if part < len(data) else None
        elif str(part) in keys:
            words, data = f"{words}.{part}", data[keys[str(part)]]
        elif part != "[key]" and not str(part).startswith(("function-", "literal[", "dict[")):
            words, data = f"{words}.{part}", None
    return words.removeprefix(".")


def _words(details: ErrorDetails) -> str:
    """Return the message for one error of pydantic."""
    kind, context = details["type"], details.get("ctx", {})
    got = f"; got {short(details['input'])}"
    if kind == "missing":
        return "is missing"
    if kind in ("unknown_key", "words"):
        return details["msg"]
    if kind == "value_error":
        return f"{context['error']}{got}"
    if kind in ("literal_error", "enum"):
        wrong = str(details["input"])
        known = re.findall(r"'([^']*)'", context["expected"]) or re.split(", | or ", context["expected"])
        return f"{wrong!r} is not a choice; {choices(wrong, known)}"
    if kind.endswith(("dict_type", "mapping_type", "model_type", "attributes_type")):
        empty = "; if all lines are comments, complete them and delete the # in front"
        return f"a mapping (`key: value` lines) is expected{got}{empty if details['input'] is None else ''}"
    if kind == "too_short":
        return f"needs at least {context['min_length']} entry{got}"
    if kind == "tuple_type":
        return f"a list is expected{got}"
    return details["msg"].replace("Input should", "should") + got
