"""What physics and the user demand of parameters, and two ways to keep to it: a conic program, and a barrier."""

from dynident.constraints.barrier import Barrier, Penalised
from dynident.constraints.constraints import (
    SIGNED,
    Body,
    Constraints,
    Corners,
    Demand,
    Interval,
    Limit,
    bodies_of,
    box,
    interval,
    physics,
    scales,
    signs,
    total,
)

__all__ = [
    "SIGNED", "Barrier", "Body", "Constraints", "Corners", "Demand", "Interval", "Limit", "Penalised", "bodies_of",
    "box", "interval", "physics", "scales", "signs", "total",
]  # fmt: skip
