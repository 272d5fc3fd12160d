"""Messages name keys that exist."""

import ast
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dynident
from dynident.apps.fleets.config import FleetSettings
from dynident.project.result_format import config_schema, result_schema
from dynident.runtime.families import EXPORTERS

SOURCE = Path(__file__).parents[2] / "src" / "dynident"
QUOTED = re.compile(r"(?<!`)`([a-zA-Z_]\w*)(?:: \w+)?`(?!`)")  # with two backticks it is in a docstring
OTHER = {"S", "numpy_source", "partials", "shapes"}  # a keyword of the spline, methods of a term


def quoted() -> Iterator[tuple[str, str]]:
    """The identifiers in backticks of all errors raised, with their file: `key`, or `key: value`."""
    for path in SOURCE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if QUOTED.search(text) else ():
            if isinstance(node, ast.Raise) and node.exc is not None:
                texts = [
                    x.value for x in ast.walk(node.exc) if isinstance(x, ast.Constant) and isinstance(x.value, str)
                ]
                for word in QUOTED.findall(" ".join(texts)):
                    yield path.name, word


def keys(schema: Any) -> Iterator[str]:
    if isinstance(schema, dict):
        yield from schema.get("properties", {})
        for value in schema.values():
            yield from keys(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from keys(value)


def test_every_key_that_an_error_names_exists() -> None:
    reference = {*keys(config_schema()), *keys(result_schema()), *dynident.__all__, *EXPORTERS.table, *OTHER}
    reference |= FleetSettings.model_fields.keys()
    for name in dynident.__all__:
        if callable(public := getattr(dynident, name)) and not inspect.isclass(public):
            reference |= set(inspect.signature(public).parameters)
    result = list(quoted())
    assert len(result) > 20
    assert {(file, word) for file, word in result if word not in reference} == set()
    assert "joints_used" not in reference
