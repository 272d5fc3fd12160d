"""Long things in few words: names in a row, and the text that stands for a noun with large fields."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, fields
from typing import Any

__all__ = ["brief", "changed", "listed", "shortened"]

FEW = 3  # items and numbers that are shown
LONGEST, WHOLE = 80, 400  # letters of a field, and of all


def listed(names: Iterable[str], most: int = 12) -> str:
    """Return names in a row, no more than ``most`` of them, and how many more there are."""
    every = list(names)
    return ", ".join(every[:most]) + (f" and {len(every) - most} more" if len(every) > most else "")


def shortened(names: Sequence[str], width: int) -> list[str]:
    """Return names, of which the longer ones are cut in the middle to ``width`` letters, such that they stay distinct.

    >>> shortened(["left_arm_shoulder_pan_joint", "left_arm_shoulder_lift_joint", "gripper"], 16)
    ['left_arm…n_joint', 'left_arm…t_joint', 'gripper']
    """
    width = max(width, 2)
    long = [name for name in dict.fromkeys(names) if len(name) > width]
    cuts = sorted(range(width), key=lambda tail: abs(2 * tail + 1 - width))  # half of the letters before the cut first
    tail = max(cuts, key=lambda tail: len({_middle(name, width, tail) for name in long})) if long else 0
    return [name if len(name) <= width else _middle(name, width, tail) for name in names]


def _middle(name: str, width: int, tail: int) -> str:
    return f"{name[: width - 1 - tail]}…{name[len(name) - tail :]}"


def brief(noun: Any) -> str:
    """Return the line that stands for a dataclass where it is displayed, as its ``__repr__``: large fields by size."""
    shown = (f"{one.name}={_short(getattr(noun, one.name))}" for one in fields(noun) if one.repr)
    return _cut(f"{type(noun).__name__}({', '.join(shown)})", WHOLE)


def changed(noun: Any) -> str:
    """Return the line that stands for settings where they are displayed: the fields that differ from their defaults."""
    shown = (f"{one.name}={_short(getattr(noun, one.name))}" for one in fields(noun) if _differs(noun, one))
    return _cut(f"{type(noun).__name__}({', '.join(shown)})", WHOLE)


def _differs(noun: Any, one: Field[Any]) -> bool:
    usual = one.default if one.default_factory is MISSING else one.default_factory()
    return bool(getattr(noun, one.name) != usual)


def _short(value: Any) -> str:
    if hasattr(value, "dtype"):  # an array
        few = value.ndim == 1 and value.size <= FEW
        return f"[{', '.join(f'{x:.4g}' for x in value)}]" if few else f"array{value.shape}"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return "{" + listed((f"{key}: {_short(one)}" for key, one in value.items()), FEW) + "}"
    if isinstance(value, tuple | list):
        return "(" + listed(map(_short, value), FEW) + ")"
    return _cut(repr(value), LONGEST)


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[:longest]}..."
