"""Finite differences without any smoothing: the article's "raw data" method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, choices
from dynident.log import Log, Motion

__all__ = ["Difference", "forward"]

Array = NDArray[np.float64]


def forward(t: Array, x: Array) -> Array:
    """Return (x[i+1] - x[i]) / (t[i+1] - t[i]), eqs. (47)-(48); the last row repeats the one before it."""
    out = np.empty_like(x)
    out[:-1] = np.diff(x, axis=0) / np.diff(t)[:, None]
    out[-1] = out[-2]
    return out


@dataclass(frozen=True)
class Difference:
    """Forward differences, eqs. (47)-(49), or central differences of second order, at the actual sample times.

    ``scheme`` is "forward" or "central". The mask leaves out the last two samples (forward), or the first and the last
    (central). Calling it returns a ``Motion``; raises InputError for fewer than 5 samples, ConfigError for another
    scheme.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(1001) * 0.01
    >>> log = dy.Log(t, q=np.sin(t)[:, None], tau=np.cos(t)[:, None], joints=("hinge",))
    >>> dy.Difference("central")(log)
    <Motion 'log': 1001 samples of hinge; 0 to 10 s, 100 Hz; 999 usable; central differences>
    """

    scheme: Literal["forward", "central"] = "forward"

    def __post_init__(self) -> None:
        if self.scheme not in ("forward", "central"):
            raise ConfigError(f"difference scheme {self.scheme!r}: {choices(self.scheme, ('forward', 'central'))}")

    @property
    def method(self) -> str:
        """The method in words."""
        return f"{self.scheme} differences"

    def __call__(self, log: Log) -> Motion:
        """Differentiate; q itself is left as measured."""
        if len(log) < 5:
            raise InputError(f"{log.source}: differences need at least 5 samples, got {len(log)}.")
        mask = np.ones(len(log), dtype=bool)
        if self.scheme == "forward":
            dq = forward(log.t, log.q)
            ddq = forward(log.t, dq)
            mask[-2:] = False
        else:
            dq = np.gradient(log.q, log.t, axis=0)
            ddq = self._second(log.t, log.q)
            mask[[0, -1]] = False
        how = {"method": self.method}
        return Motion(log.t, log.q, dq, ddq, log.tau, log.joints, mask, log.source, how)

    @staticmethod
    def _second(t: Array, q: Array) -> Array:
        """Return the three-point second difference on a non-uniform grid; the ends repeat their neighbours."""
        h = np.diff(t)[:, None]
        slope = np.diff(q, axis=0) / h
        out = np.empty_like(q)
        out[1:-1] = 2 * np.diff(slope, axis=0) / (h[1:] + h[:-1])
        out[0], out[-1] = out[1], out[-2]
        return out
