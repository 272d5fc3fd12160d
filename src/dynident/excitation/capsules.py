"""Capsules around the links of an arm: what its distances are computed of."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Capsule", "Made"]

Array = NDArray[np.float64]


class Made(StrEnum):
    """What a link's capsules are made of: its collision shapes, those that are seen, or only the places of joints."""

    COLLISION = "collision"
    VISUAL = "visual"
    JOINTS = "joints"


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within ``radius`` (m) of the segment from ``start`` to ``end`` (3) in the frame of a body, given by
    its place in ``Arm.bodies`` (-1: the root link, which stands still); ``link`` is the link that it is around."""

    link: str
    body: int
    start: Array
    end: Array
    radius: float
    made: Made = Made.COLLISION

    __repr__ = brief
