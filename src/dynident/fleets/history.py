"""What the statistics of a fleet work on: the base parameters of one robot from log to log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief

__all__ = ["History"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class History:
    """The base parameters of one robot, from K logs in the order of their dates.

    ``days`` (K) since the first log of the fleet; ``value`` (K, b) by least squares on each log alone; ``information``
    (K, b, b), the inverse of its covariance (with correlated residuals accounted for), zero in directions that the log
    does not show. What the model leaves has a history of its own, with the logarithm of each joint's residual as value.
    """

    robot: str
    logs: tuple[str, ...]
    days: Array
    value: Array
    information: Array

    __repr__ = brief

    def __post_init__(self) -> None:
        k, b = self.value.shape
        if (len(self.logs), self.days.shape, self.information.shape) != (k, (k,), (k, b, b)):
            raise InputError(f"{self.robot}: the shapes of the logs, days, values and information do not match.")
        if np.any(np.diff(self.days) < 0):
            raise InputError(f"{self.robot}: the logs are not in the order of their dates.")
