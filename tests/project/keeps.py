"""Whether a value keeps to a JSON schema, by the words of draft 2020-12 that the published schemas use."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = ["wrong"]

TYPES: Mapping[str, type | tuple[type, ...]] = {
    "object": dict,
    "array": list,
    "string": str,
    "number": (int, float),
    "integer": int,
    "boolean": bool,
    "null": type(None),
}
SAID = {"$schema", "$defs", "title", "description", "default", "format"}  # words that demand nothing
KNOWN = {
    *("$ref", "type", "enum", "const", "pattern", "anyOf", "oneOf"),
    *("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"),
    *("prefixItems", "items", "minItems", "maxItems"),
    *("properties", "required", "additionalProperties", "minProperties"),
}
Found = Iterator[str]


def wrong(schema: Any, value: Any, root: Mapping[str, Any], place: str = "it") -> Found:
    """Yield where a value breaks a schema; AssertionError for a word of the schema that is not known here."""
    if isinstance(schema, bool):
        yield from () if schema else (f"{place} is one too many",)
        return
    assert set(schema) <= KNOWN | SAID, set(schema) - KNOWN - SAID
    if "$ref" in schema:
        yield from wrong(root["$defs"][schema["$ref"].removeprefix("#/$defs/")], value, root, place)
    if "type" in schema and not _fits(schema["type"], value):
        yield f"{place} is no {schema['type']}"
        return
    yield from _choices(schema, value, root, place)
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield from _range(schema, value, place)
    if isinstance(value, dict):
        yield from _keys(schema, value, root, place)
    if isinstance(value, list):
        yield from _items(schema, value, root, place)


def _fits(names: str | list[str], value: Any) -> bool:
    for name in [names] if isinstance(names, str) else names:
        if isinstance(value, TYPES[name]) and not (isinstance(value, bool) and name != "boolean"):
            return True
    return False


def _choices(schema: Mapping[str, Any], value: Any, root: Mapping[str, Any], place: str) -> Found:
    if "enum" in schema and value not in schema["enum"]:
        yield f"{place} is not among {schema['enum']}"
    if "const" in schema and value != schema["const"]:
        yield f"{place} is not {schema['const']}"
    if "pattern" in schema and not re.search(schema["pattern"], value):
        yield f"{place} does not match"
    for word in ("anyOf", "oneOf"):
        hits = [one for one in schema.get(word, ()) if not list(wrong(one, value, root))]
        if word in schema and (not hits or (word == "oneOf" and len(hits) > 1)):
            yield f"{place} fits {len(hits)} of {word}"


def _range(schema: Mapping[str, Any], value: float, place: str) -> Found:
    low, high = schema.get("minimum", -math.inf), schema.get("maximum", math.inf)
    above, below = schema.get("exclusiveMinimum", -math.inf), schema.get("exclusiveMaximum", math.inf)
    if not (low <= value <= high and above < value < below):
        yield f"{place} is out of range"


def _keys(schema: Mapping[str, Any], value: dict[str, Any], root: Mapping[str, Any], place: str) -> Found:
    known = schema.get("properties", {})
    yield from (f"{place} lacks {key}" for key in schema.get("required", ()) if key not in value)
    if len(value) < schema.get("minProperties", 0):
        yield f"{place} is empty"
    for key, item in value.items():
        yield from wrong(known.get(key, schema.get("additionalProperties", True)), item, root, f"{place}.{key}")


def _items(schema: Mapping[str, Any], value: list[Any], root: Mapping[str, Any], place: str) -> Found:
    if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", math.inf):
        yield f"{place} has {len(value)} items"
    first, rest = schema.get("prefixItems", []), schema.get("items", True)
    for k, item in enumerate(value):
        yield from wrong(first[k] if k < len(first) else rest, item, root, f"{place}[{k}]")
