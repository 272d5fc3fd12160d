"""Results from before the format had a version: their values in the form of version 1, with what they lack.

They hold the recipe as texts, the smoother in the form in which Python prints it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from dynident.errors import InputError
from dynident.identification import OldResult, SourceFile, Sources
from dynident.io.config import parse_config
from dynident.io.families import ESTIMATORS, SMOOTHERS
from dynident.io.recipe import build_recipe
from dynident.io.result_format import FORMAT, VERSION
from dynident.io.settings import Config
from dynident.smoothers import Smoother, TimeShifted

__all__ = ["is_version_0", "upgraded"]

TEXT, ORIGIN, SMOOTHER = "configuration", "configuration file", "smoother used"
LACKS = ("covariances", "base parameters", "validations", "calibration", "mass matrix", "notes")


def is_version_0(data: Mapping[str, Any]) -> bool:
    """Whether the values of a file are those of a result without a version."""
    settings = data.get("settings")
    if not (isinstance(settings, dict) and isinstance(data.get("parameters"), list)):
        return False
    return {TEXT, ORIGIN, SMOOTHER} <= settings.keys() and all(isinstance(one, str) for one in settings.values())


def upgraded(data: Mapping[str, Any], source: str, *, allow_code: bool = False) -> dict[str, Any]:
    """Return the values of a result without a version as version 1 has them.

    Raises InputError, led by ``source``, where they cannot be read, ConfigError where the configuration cannot.
    """
    settings, rows = data["settings"], data["parameters"]
    config = parse_config(
        settings[TEXT], Path(settings[ORIGIN]).parent, f"{source}, its configuration", allow_code=allow_code
    )
    if not all(isinstance(row, dict) and {"name", "value", "std"} <= row.keys() for row in rows):
        raise InputError(f"{source}: its `parameters` need name, value and std; identify again.")
    parameters = [_parameter(row) for row in rows]
    variance = np.square([_number(row["std"]) for row in rows])
    covariance = np.where(np.eye(len(rows), dtype=bool), variance, np.nan)  # how errors go together is not known
    return {
        "format": FORMAT,
        "version": VERSION,
        "parameters": parameters,
        "validations": [],
        "recipe": _recipe(config, settings, source),
        "calibration": {"smoother": None, "time_offset": None, "base_tilt": None},
        "base_parameters": {"on_data": None, "structural": None, "unexcited": []},
        "estimate": {
            "rank": data.get("rank", len(rows)),
            "condition": _number(data.get("condition")),
            "residual": {"sigma": [], "samples": 0, "weights": None},
            "consistency": None,
            "notes": [],
            "covariance": covariance.tolist(),
            "interval": None,
            "information": None,
        },
        "mass_matrix": None,
        "warnings": [{"kind": OldResult.__name__, "version": 0, "lacks": LACKS}],
        "model": {"name": "", "joints": []},
        "provenance": asdict(_sources(settings, data.get("versions", {}))),
    }


def _parameter(row: Mapping[str, Any]) -> dict[str, Any]:
    robust = row.get("std_hac")
    return {
        "name": row["name"],
        "value": "NaN" if row["value"] is None else row["value"],
        "std": _number(row["std"]),
        "std_hac": _number(robust) if "std_hac" in row else None,
        "unit": row.get("unit", ""),
        "provenance": row.get("verdict"),
    }


def _recipe(config: Config, settings: Mapping[str, str], source: str) -> dict[str, Any]:
    recipe = build_recipe(config)
    smoother: Smoother | None = next((one for one in recipe.smoothers if repr(one) == settings[SMOOTHER]), None)
    if smoother is None:
        words = f"its smoother {settings[SMOOTHER]} is none that its configuration makes now; identify again."
        raise InputError(f"{source}: {words}")
    (offset,) = _numbers(settings, "delay used", 1, source) or [0.0]
    return {
        "smoother": SMOOTHERS.describe(TimeShifted(smoother, offset) if offset else smoother),
        "estimator": ESTIMATORS.describe(recipe.estimator),
        "filter": None if recipe.filter is None else asdict(recipe.filter),
        "min_speed": recipe.min_speed,
        "time_offset": offset,
        "base_tilt": _numbers(settings, "lean used", 2, source) or None,
        "restart": recipe.restart,
    }


def _sources(settings: Mapping[str, str], versions: Mapping[str, str]) -> Sources:
    robot, lead = settings.get("model file"), "SHA-256 of "
    logs = (SourceFile(key.removeprefix(lead), value) for key, value in settings.items() if key.startswith(lead))
    return Sources(
        SourceFile(settings[ORIGIN], text=settings[TEXT]),
        None if robot is None else SourceFile(robot, settings.get("model file SHA-256", "")),
        tuple(logs),
        versions,
    )


def _number(value: object) -> float:
    """Return a number of the file, in which null stands for one that is not finite."""
    return float(value) if isinstance(value, int | float) else float("inf")


def _numbers(settings: Mapping[str, str], key: str, count: int, source: str) -> list[float]:
    """Return the finite numbers that a text holds, separated by commas, none where there is none; else InputError."""
    if key not in settings:
        return []
    try:
        found = [float(word) for word in settings[key].strip("()").split(",")]
    except ValueError:
        found = []
    if len(found) != count or not np.isfinite(found).all():
        raise InputError(f"{source}: settings: {key} is {settings[key]!r}, not {count} finite numbers; identify again.")
    return found
