"""A torque as text, from which its values, derivatives, NumPy source and equation follow.

Its functions are those of ``LAW_FUNCTIONS``. Derivatives are by a step along the imaginary axis, which loses no digits
(Squire and Trapp, 1998, "Using complex variables to estimate derivatives of real functions").
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from types import CodeType, MappingProxyType
from typing import Any

import numpy as np

from dynident.runtime.arrays import Array

IMAGINARY_STEP = 1e-80  # its square is beyond the digits of any velocity that counts
_NAME = re.compile(r"\b[A-Za-z_]\w*")


def smooth_sign(x: Any, width: Array, band: Array | float = 0.0) -> Any:
    """Return tanh(x / width), the sign where the width is zero, and zero where abs(x) <= band > 0."""
    sharp = np.sign(np.real(x))
    if width.any():
        # a divisor of one where the width is zero: there the smooth sign is not used
        smooth = np.tanh(x / np.where(width > 0, width, 1.0))
        sharp = smooth if width.all() else np.where(width > 0, smooth, sharp)
    return np.where((band == 0) | (np.abs(np.real(x)) > band), sharp, 0.0) if np.any(band) else sharp


LAW_FUNCTIONS: Mapping[str, Any] = MappingProxyType(
    {"abs": lambda x: x * np.sign(np.real(x)) if np.iscomplexobj(x) else np.abs(x), "sign": smooth_sign}
    | {name: getattr(np, name) for name in ("cos", "exp", "maximum", "sin", "sqrt", "tanh", "where")}
)
"""The functions that a law may hold; ``sign(x, width, band)`` is ``smooth_sign``."""


@cache
def names_in(law: str) -> tuple[str, ...]:
    """Return what a law names, in its order, without its functions."""
    return tuple(name for name in dict.fromkeys(_NAME.findall(law)) if name not in LAW_FUNCTIONS)


def functions_in(law: str) -> set[str]:
    """Return the functions of a law."""
    return LAW_FUNCTIONS.keys() & _NAME.findall(law)


def rename(law: str, names: Mapping[str, str]) -> str:
    """Return the law with other names."""
    return _NAME.sub(lambda name: names.get(name[0], name[0]), law)


@cache
def _compile(law: str) -> CodeType:
    return compile(law, "<law>", "eval")


def evaluate_law(law: str, values: Mapping[str, Any], shape: tuple[int, ...]) -> Array:
    """Return the torque for the values of all names, as an array of this shape."""
    torque = eval(_compile(law), {"__builtins__": {}, **LAW_FUNCTIONS, **values})  # noqa: S307 - the text of a class
    return np.asarray(torque if np.shape(torque) == shape else np.full(shape, torque))


def differentiate_law(law: str, values: Mapping[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    """Return the derivative of the torque by one of its names, as an array of this shape."""
    displaced = {**values, name: values[name] + 1j * IMAGINARY_STEP}
    return np.imag(evaluate_law(law, displaced, shape)) / IMAGINARY_STEP
