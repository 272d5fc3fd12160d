"""Whether a value keeps to a JSON schema."""

from collections.abc import Iterator
from typing import Any

from jsonschema import Draft202012Validator

WORDS = {
    *("$schema", "$defs", "$ref", "title", "description", "default", "format"),
    *("type", "enum", "const", "pattern", "anyOf", "oneOf"),
    *("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"),
    *("prefixItems", "items", "minItems", "maxItems"),
    *("properties", "required", "additionalProperties", "minProperties"),
}


def wrong(schema: dict[str, Any], value: Any) -> list[str]:
    """Return where a value breaks a schema; AssertionError for a word that no validator knows."""
    assert set(_words(schema)) <= WORDS
    return [f"{error.json_path}: {error.message}" for error in Draft202012Validator(schema).iter_errors(value)]


def _words(schema: Any) -> Iterator[str]:
    """Yield the words of a schema and of all in it; a validator ignores those that it does not know."""
    if not isinstance(schema, dict):
        return
    yield from schema
    for word, inner in schema.items():
        entries = inner.values() if word in ("properties", "$defs") else inner if isinstance(inner, list) else [inner]
        if word not in ("default", "enum", "const"):
            for entry in entries:
                yield from _words(entry)
