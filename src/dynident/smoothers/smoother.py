"""The protocol of a smoother: Log -> Motion, that is position to velocity and acceleration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError
from dynident.log import Log, Motion
from dynident.splines import noise_sigma

__all__ = [
    "BY_JOINT",
    "Adapts",
    "FindsPeriod",
    "HasSubstitute",
    "KnowsNoise",
    "Smoother",
    "as_used",
    "ends_mask",
    "position_noise",
]

BY_JOINT = "by joint"
"""Marks a setting, as ``Annotated[..., BY_JOINT]``, that may be a mapping by the names of the joints."""


class Smoother(Protocol):
    """Converts a ``Log`` to a ``Motion``.

    A smoother is a frozen dataclass of settings. It keeps t, tau, joints and source, does not use tau, and masks out
    the samples near the ends at which its derivatives are not reliable. It raises InputError where the log is too
    short, and MissingInputError where the log has not the motion that it is made for.
    """

    def __call__(self, log: Log) -> Motion:
        """Return q, dq, ddq (N, n) at the samples of the log."""


@runtime_checkable
class KnowsNoise(Protocol):
    """A smoother that can be given the noise of the positions."""

    @property
    def sigma(self) -> float | Mapping[str, float] | None:
        """Standard deviation of the position noise (rad, m): one value or by joint; None where it is estimated."""


@runtime_checkable
class Adapts(Protocol):
    """A smoother that chooses by the log how much to smooth."""

    def as_used(self, motion: Motion) -> Smoother:
        """Return the smoother that smooths any log as much as it has smoothed that of ``motion``: a linear one."""


@runtime_checkable
class FindsPeriod(Protocol):
    """A smoother of motion that repeats, which may look for one period of all joints."""

    def of_period(self, motion: Motion) -> Smoother:
        """Return the same smoother with the period that it has used for a motion."""


@runtime_checkable
class HasSubstitute(Protocol):
    """A smoother that is made for some motions only: MissingInputError says that a log has none of these."""

    def substitute(self) -> Smoother | None:
        """Return what smooths any other log that is only judged, not fitted; None where nothing does."""


def as_used(smoother: Smoother, motion: Motion) -> Smoother:
    """Return the linear smoother that has made ``motion``: the smoother itself where it does not adapt to the log."""
    return smoother.as_used(motion) if isinstance(smoother, Adapts) else smoother


def position_noise(log: Log) -> NDArray[np.float64]:
    """Return the standard deviation (n) of the noise in the positions of a log; found once, as many smoothers ask."""
    if log not in _NOISE:
        _NOISE[log] = noise_sigma(log.t, log.q)
    return _NOISE[log]


_NOISE: WeakKeyDictionary[Log, NDArray[np.float64]] = WeakKeyDictionary()


def ends_mask(log: Log, start: float, stop: float) -> NDArray[np.bool_]:
    """Return a mask (N) without the first ``start`` and the last ``stop`` seconds; InputError where none is left."""
    mask = (log.t >= log.t[0] + start) & (log.t <= log.t[-1] - stop)
    if not mask.any():
        raise InputError(
            f"{log.source}: {log.t[-1] - log.t[0]:.4g} s are too short: the derivatives are not reliable in the first "
            f"{start:.4g} s and the last {stop:.4g} s. Record longer, or smooth less."
        )
    return np.asarray(mask)
