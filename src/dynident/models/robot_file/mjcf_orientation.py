"""The orientations that an MJCF may give, as rotation matrices."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.models.robot_file.xml import angles, numbers, rotation, unit

__all__ = ["ANGULAR", "ORIENTATIONS", "orientation", "upward"]

Array = NDArray[np.float64]
ORIENTATIONS = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}  # with the count of their numbers
ANGULAR = ("euler", "axisangle")
UP = np.array([0.0, 0.0, 1.0])


def orientation(key: str, attributes: Mapping[str, str], where: str, degrees: bool, sequence: str) -> Array:
    """Return the rotation (3, 3) that the attribute ``key`` gives; ModelError, led by ``where``, if it is none.

    Angles are in ``degrees`` or rad; ``sequence`` is the ``eulerseq`` of the file.
    """
    values = numbers(attributes, key, "", where, ORIENTATIONS[key])
    if key in ANGULAR:
        turns = np.deg2rad(values) if degrees else angles(attributes, key, "", where, ORIENTATIONS[key])
        return _euler(turns, where, sequence) if key == "euler" else rotation(unit(values[:3], where), turns[3])
    if key == "quat":
        return _quat(values, where)
    if key == "xyaxes":
        x = unit(values[:3], where)
        y = unit(values[3:] - (values[3:] @ x) * x, where)
        return np.column_stack([x, y, np.cross(x, y)])
    return upward(unit(values, where))


def _quat(values: Array, where: str) -> Array:
    half = float(np.linalg.norm(values[1:]))
    if not values.any():
        raise ModelError(f"{where}: quat is zero; write '1 0 0 0' for no rotation.")
    return rotation(values[1:] / half if half else UP, 2 * float(np.arctan2(half, values[0])))


def upward(z: Array) -> Array:
    """Return the shortest rotation (3, 3) that takes the z axis to the unit vector ``z`` (3)."""
    sine = np.cross(UP, z)
    size = float(np.linalg.norm(sine))
    return rotation(sine / size if size else np.array([1.0, 0.0, 0.0]), float(np.arctan2(size, z[2])))


def _euler(turns: Array, where: str, sequence: str) -> Array:
    """Return the rotation (3, 3); lower-case axes of ``eulerseq`` turn with the body, upper-case ones do not."""
    if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
        raise ModelError(f"{where}: eulerseq = {sequence!r}; give three of x, y, z, or X, Y, Z.")
    out = np.eye(3)
    for letter, angle in zip(sequence, turns, strict=True):
        turn = rotation(np.eye(3)["xyz".index(letter.lower())], angle)
        out = out @ turn if letter.islower() else turn @ out
    return out
