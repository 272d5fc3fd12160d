"""What tests ask of a ``result.json``."""

from typing import Any

__all__ = ["errors_by_log", "runs_by_log"]


def errors_by_log(result: dict[str, Any], role: str) -> dict[str, dict[str, Any]]:
    return {x["name"]: x["errors"] for x in result["validations"] if x["role"] == role}


def runs_by_log(result: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {x["name"]: x["free_run"] for x in result["validations"]}
