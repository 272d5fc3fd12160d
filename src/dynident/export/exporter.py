"""The protocol of an exporter: identified model -> a text for other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.export.identified import Identified
from dynident.export.written import Written

__all__ = ["Exporter", "Reader", "States"]

Array = NDArray[np.float64]
States = tuple[Array, Array, Array]
Reader = Callable[[str, Identified, States], Array]


class Exporter(Protocol):
    """One format: a frozen dataclass without settings."""

    @property
    def format(self) -> str:
        """The name of the format."""

    @property
    def readers(self) -> Mapping[str, Reader]:
        """Functions that load a text again, by name: each returns its torque (N, n) at states q, dq, ddq (N, n)."""

    def file(self, identified: Identified) -> str:
        """Return the usual name of the file."""

    def write(self, identified: Identified) -> Written:
        """Return the text; ModelError where the format cannot hold the model."""

    def torque(self, identified: Identified, states: States) -> Array:
        """Return the torque (N, n) of the terms that the format can hold."""
