"""Well-known arms: their usual limits of acceleration and jerk, which robot files do not have, from ``arms.yaml``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from dynident.files.yaml_text import load_yaml
from dynident.models.robot_files import RobotJointLimits

NUMBERED = "numbered"
_UNIVERSAL_ROBOTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
UNIVERSAL_ROBOTS = tuple(f"{name}_joint" for name in _UNIVERSAL_ROBOTS)
LIMIT_TOLERANCE = 0.01  # of a limit: files round degrees to radians


@dataclass(frozen=True)
class KnownArm:
    """An arm: its ``name``, the ``source`` of its limits, and by joint name these, such as ``{"jerk": 5000.0}``."""

    name: str
    source: str
    limits: Mapping[str, Mapping[str, float]]


def find_arm(limits: Mapping[str, RobotJointLimits]) -> KnownArm | None:
    """Return the arm that has joints of these names in this order, with these limits; None where no arm fits."""
    names = list(limits)
    for entry in _table():
        kinds = [kind for kind in ("velocity", "upper") if kind in entry]
        if _has_names(entry["joints"], names) and all(_has_values(entry[kind], kind, limits) for kind in kinds):
            columns = {kind: _each(entry[kind], len(names)) for kind in ("acceleration", "jerk") if kind in entry}
            by_joint = {name: {kind: values[k] for kind, values in columns.items()} for k, name in enumerate(names)}
            return KnownArm(entry["name"], entry["source"], by_joint)
    return None


@cache
def _table() -> Sequence[Mapping[str, Any]]:
    path = Path(__file__).with_name("arms.yaml")
    table: Sequence[Mapping[str, Any]] = load_yaml(path.read_text(encoding="utf-8"), path.name)
    return table


def is_universal_robot(names: Sequence[str]) -> bool:
    """Return whether joints are called as those of Universal Robots, in their order and with any prefix."""
    ends = UNIVERSAL_ROBOTS
    return len(names) == len(ends) and all(name.endswith(end) for name, end in zip(names, ends, strict=True))


def _has_names(pattern: str, names: Sequence[str]) -> bool:
    """Return whether joints are called as in the table."""
    if pattern != NUMBERED:
        return is_universal_robot(names)
    return len(names) > 1 and [re.sub(r"\d+$", "", name) + str(k) for k, name in enumerate(names, 1)] == list(names)


def _each(value: float | Sequence[float], count: int) -> list[float]:
    return list(value) if isinstance(value, Sequence) else [value] * count


def _has_values(values: float | Sequence[float], kind: str, limits: Mapping[str, RobotJointLimits]) -> bool:
    expected = _each(values, len(limits))
    actual = [getattr(joint, kind) for joint in limits.values()]
    return len(expected) == len(actual) and all(
        value is not None and abs(value - wanted) <= LIMIT_TOLERANCE * wanted
        for value, wanted in zip(actual, expected, strict=True)
    )
