"""Constraints from physics and from the user, and two ways to enforce them: a conic program, and a barrier."""

from dynident.estimators.constraints.barrier import Barrier, Penalised
from dynident.estimators.constraints.constraints import (
    SIGNED,
    BodyConstraint,
    Bounds,
    Constraints,
    Corners,
    Limit,
    PsdConstraint,
    bodies_of,
    box,
    interval,
    physics,
    scales,
    signs,
    total,
    with_mass,
)
from dynident.estimators.constraints.sizes import sized

__all__ = [
    "SIGNED",
    "Barrier",
    "BodyConstraint",
    "Bounds",
    "Constraints",
    "Corners",
    "Limit",
    "Penalised",
    "PsdConstraint",
    "bodies_of",
    "box",
    "interval",
    "physics",
    "scales",
    "signs",
    "sized",
    "total",
    "with_mass",
]  # fmt: skip
