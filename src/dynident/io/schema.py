"""JSON schemas (draft 2020-12) of the configuration and of ``result.json``, for editors and other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from dynident.io.fields import Section
from dynident.io.result_format import ResultFile
from dynident.io.settings import Config

__all__ = ["SCHEMAS", "config_schema", "result_schema", "section_schema"]

DRAFT = "https://json-schema.org/draft/2020-12/schema"
LIMITS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
NOT_FINITE = ["Infinity", "-Infinity", "NaN"]


class _Results(GenerateJsonSchema):
    """Numbers of a result, which need not be finite."""

    def float_schema(self, schema: core_schema.FloatSchema) -> dict[str, Any]:
        return {"anyOf": [super().float_schema(schema), {"enum": NOT_FINITE}]}


def config_schema() -> dict[str, Any]:
    """Return the schema of the configuration, with the settings of all kinds of parts that are installed."""
    return section_schema(Config, "dynident configuration")


def section_schema(section: type[Section], title: str) -> dict[str, Any]:
    """Return the schema of a file with these settings."""
    schema: dict[str, Any] = _renamed(section.model_json_schema())
    return {"$schema": DRAFT, **schema, "title": title}


def result_schema() -> dict[str, Any]:
    """Return the schema of ``result.json``."""
    return {"$schema": DRAFT, **ResultFile.model_json_schema(schema_generator=_Results)}


def _renamed(schema: Any) -> Any:
    """Return a schema with limits in its own words: pydantic keeps those of numbers that a function reads."""
    if isinstance(schema, Mapping):
        number = schema.get("type") in ("number", "integer")
        return {LIMITS[key] if number and key in LIMITS else key: _renamed(value) for key, value in schema.items()}
    return [_renamed(one) for one in schema] if isinstance(schema, list) else schema


SCHEMAS: Mapping[str, Callable[[], dict[str, Any]]] = {"config": config_schema, "result": result_schema}
