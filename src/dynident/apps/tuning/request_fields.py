"""The types of what the page sends: a request with others is not of the page, and is answered with 400."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TypeGuard

from dynident.runtime import as_number

TEXTS = ("search", "tab", "control", "now", "before", "kept")
NUMBERS = ("at", "n_clicks", "n_intervals")
STORES = ("last", "zoomed", "rested")  # mappings of such fields


def is_well_formed(content: object) -> bool:
    """Return whether the fields of a request past Dash, or the inputs and states of one of Dash, have their types."""
    if not isinstance(content, Mapping):
        return False
    entries = [content.get(name) or [] for name in ("inputs", "state")]
    if not all(isinstance(entry, list) for entry in entries):
        return False
    # Dash names a component and its property; those of a pattern are lists, which the page keeps to itself
    pairs = [
        (entry["id"] if entry.get("property") == "data" else entry.get("property"), entry.get("value"))
        for entry in (*entries[0], *entries[1])
        if isinstance(entry, Mapping) and isinstance(entry.get("id"), str)
    ]
    is_window = content.get("control") == "exclude"
    return all(_has_type(name, value, is_window=is_window) for name, value in (*pairs, *content.items()))


def _has_type(name: object, value: object, *, is_window: bool) -> bool:
    if name == "value":
        return _is_pair(value) if is_window else value is None or isinstance(value, str) or _is_number(value)
    if value is None:
        return True
    if name in TEXTS:
        return isinstance(value, str)
    if name in NUMBERS:
        return _is_number(value)
    if name == "degree":  # that of a slider, of which a browser gives the text
        return _is_number(value) or (isinstance(value, str) and _is_number_text(value))
    if name in STORES:
        return isinstance(value, Mapping) and is_well_formed({**value, "inputs": None, "state": None})
    return name != "zoom" or (_is_pair(value) and all(_is_number(end) for end in value))


def _is_pair(value: object) -> TypeGuard[list[object]]:
    return isinstance(value, list) and len(value) == 2


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(as_number(value))


def _is_number_text(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
