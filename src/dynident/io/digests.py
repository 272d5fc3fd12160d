"""What tells settings from others, and what is in the files that they name."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from dynident.io.opener import real
from dynident.io.robot import SUFFIXES, fingerprint, robot_text

__all__ = ["settings_digest"]


def settings_digest(folder: Path, *settings: Any) -> str:
    """Return what tells settings from others, of which the content of the files in a ``folder`` that they name counts.

    Raises ModelError where a robot file, or a Python file, cannot be read.
    """
    text = json.dumps([_content(one, folder) for one in settings], sort_keys=True, default=str)
    return sha256(text.encode()).hexdigest()[:12]


def _content(value: Any, folder: Path) -> Any:
    """Return settings in which the content of a robot file, or of a Python file, stands for its name."""
    if isinstance(value, Mapping):
        return {str(key): _content(one, folder) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_content(one, folder) for one in value]
    if not isinstance(value, str):
        return value
    if value.lower().endswith(SUFFIXES):
        return sha256(robot_text(real(folder / value)).encode()).hexdigest()
    place, colon, name = value.rpartition(":")
    return f"{fingerprint(real(folder / place))}{colon}{name}" if place.endswith(".py") else value
