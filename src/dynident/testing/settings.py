"""What every part with settings promises: they can be written down, and build the same part again."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError
from pathlib import Path

from dynident.io.families import Family
from dynident.io.parts import built, with_settings

__all__ = ["builds_itself_from_its_settings", "cannot_be_changed"]


def cannot_be_changed(part: object) -> None:
    """Raise AssertionError unless the part is a frozen dataclass."""
    try:
        part.anything = 1  # type: ignore[attr-defined]
    except FrozenInstanceError:
        return
    raise AssertionError("it is no frozen dataclass")


def builds_itself_from_its_settings(family: Family, part: object) -> None:
    """Raise AssertionError unless the settings of a part, through JSON, build an equal one."""
    told = json.loads(json.dumps(family.describe(part), allow_nan=False))
    again = built(with_settings(family, type(part), told, Path()))
    assert again == part, f"{part} is described as {told}, which builds {again}"
