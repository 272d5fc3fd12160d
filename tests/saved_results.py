"""What tests ask of a ``result.json``."""

from __future__ import annotations

from typing import Any

__all__ = ["errors_by_log", "runs_by_log"]


def errors_by_log(result: dict[str, Any], role: str) -> dict[str, dict[str, Any]]:
    return {one["name"]: one["errors"] for one in result["validations"] if one["role"] == role}


def runs_by_log(result: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {one["name"]: one["free_run"] for one in result["validations"]}
