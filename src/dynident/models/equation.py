"""What a term computes, as an equation for people to read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["FUNCTIONS", "Equation"]

Array = NDArray[np.float64]


def _sign(x: Array, band: float = 0.0) -> Array:
    return np.where(np.abs(x) > band, np.sign(x), 0.0)


FUNCTIONS: Mapping[str, Any] = MappingProxyType(
    {"abs": np.abs, "cos": np.cos, "exp": np.exp, "sign": _sign, "sin": np.sin, "sqrt": np.sqrt, "tanh": np.tanh}
)
"""The functions that an equation may hold; ``sign(x, band)`` is 0 where abs(x) <= band."""


@dataclass(frozen=True)
class Equation:
    """The torque of a term at one joint, or of a motor that is coupled to several, as text.

    ``torque`` is a Python expression of the motion ``q``, ``dq``, ``ddq`` of the joint or motor, of the time ``t`` (s)
    since the recording began, the ``load`` and the state ``z`` that the term remembers, of ``symbols``, one for each
    of ``parameters`` (names), and of ``constants``: symbol, value and unit. Its functions are those of FUNCTIONS; an
    underscore begins a subscript, as in "F_c * sign(dq)". ``where`` holds further symbols with their expressions.
    ``on`` names the joints that the torque acts on, with its factor there; ``motor`` is the name of a motor, whose
    position is the sum of the positions times these factors.
    """

    torque: str
    symbols: tuple[str, ...]
    constants: tuple[tuple[str, float, str], ...] = ()
    where: tuple[tuple[str, str], ...] = ()
    parameters: tuple[str, ...] = ()
    on: tuple[tuple[str, float], ...] = ()
    motor: str = ""
