"""What of a robot can change, in words: in the report of a fleet, and while a robot is watched."""

from __future__ import annotations

from dynident.regression import GroupKind
from dynident.report.page import number

__all__ = ["kind_words", "signed"]

KINDS = {
    GroupKind.FRICTION: "friction of {}",
    GroupKind.PAYLOAD: "payload at {}",
    GroupKind.OFFSET: "offset of {}",
    GroupKind.RIPPLE: "ripple of {}",
    GroupKind.RESIDUAL: "torque that the model leaves at {}",
}


def kind_words(kind: GroupKind, joint: str) -> str:
    """Word what can change, such as "friction of elbow"."""
    return KINDS[kind].format(joint)


def signed(value: float) -> str:
    """Return the size of a change with its sign, in three digits."""
    return f"{'+' if value > 0 else ''}{number(float(value), 3)}"
