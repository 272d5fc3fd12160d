"""Random motions within the limits: where a search begins, and what a design is to be compared with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError
from dynident.excitation.interior import Interior

__all__ = ["random_motion"]

Array = NDArray[np.float64]
POSES = 20  # that are tried
SHRINK = 0.8
SMALL = 1e-3  # of the limits: a motion this small is none
BACKED = 0.95  # of the largest size that keeps to the limits


def random_motion(interior: Interior, rng: np.random.Generator) -> Array:
    """Return coefficients (n, K) of a random motion that keeps to all limits, about as large as they allow.

    It is about a random pose; each joint uses a random share of what its own limits allow, and all are made smaller
    together until torques and distances are kept. Raises ConfigError where the arm can stand in no pose, InputError
    where it can move about none.
    """
    n, K = len(interior.limits.joints), interior.family.size
    for pose in interior.feasible.poses(POSES, rng):
        shape = rng.normal(size=(n, K))
        shape[:, 0] = -interior.functions[0, :, 1:].mean(axis=0) @ shape[:, 1:].T
        about = np.zeros((n, K))
        about[:, 0] = pose
        use = rng.uniform(0.3, 1.0, n)
        moved = about + shape * (use * _largest(interior, about, shape))[:, None]
        x = _shrunk(interior, about, moved)
        if x is not None:
            return x
    raise InputError("no random motion keeps to the limits; look at the obstacles, the clearance and the limits.")


def _largest(interior: Interior, about: Array, shape: Array) -> Array:
    """Return how much (n) of a shape each joint's own limits allow about a pose."""
    low, high = np.zeros(len(about)), np.full(len(about), 1e3)
    for _ in range(40):
        size = np.sqrt(np.maximum(low, 1e-9) * high)
        x = about + size[:, None] * shape
        fits = (interior.room(x) > 0).all(axis=(0, 1))
        low, high = np.where(fits, size, low), np.where(fits, high, size)
    return low


def _shrunk(interior: Interior, about: Array, moved: Array) -> Array | None:
    """Return the largest motion found between a pose and a motion that keeps to the limits; None for hardly any."""
    size = 1.0
    while not interior.keeps(about + size * (moved - about)):
        size *= SHRINK
        if size < SMALL:
            return None
    good, bad = size, min(size / SHRINK, 1.0)
    for _ in range(5):
        middle = (good + bad) / 2
        good, bad = (middle, bad) if interior.keeps(about + middle * (moved - about)) else (good, middle)
    return about + BACKED * good * (moved - about)
