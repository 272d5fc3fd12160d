"""Outliers of a log: what its positions and torques alone show, and the log without them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, MissingInputError, brief, called
from dynident.log import Log, Motion
from dynident.smoothers.smoother import HasSubstitute, Smoother
from dynident.smoothers.time_offset import unshifted
from dynident.splines import bridged, frozen, spikes, stretches, torn_ends

__all__ = ["FEW", "MANY", "SUBSTITUTE", "Suspects", "few", "motion_of", "repaired", "suspects"]

Mask = NDArray[np.bool_]

SUBSTITUTE = "smoothed in place of"  # what a substitute smooths a motion for: the class of a smoother
FEW = 0.01  # share of a joint's samples: if more are spikes, they belong to the signal
SOME = 0.25  # the same of frozen positions
MANY = 0.5  # the same of frozen and clipped torques, which a fit to the others shows to be wrong
NEARLY_ALL = 0.99  # share of all torques: if more are suspect, too few are left for that fit
CLIPPED = 10  # least number of values at exactly the largest or smallest
AT_ONCE, OFTEN = 3, 2  # of which so many follow each other, so often
MARGIN = 8  # samples beside a frozen stretch whose derivatives are those of the bridge


@dataclass(frozen=True, eq=False)
class Suspects:
    """Where (N, n) positions and torques of a log look wrong: spikes, frozen stretches, values at a limit, and torques
    that never change (``torque_dead``) while those of other joints do.

    The torques are only suspects: whether they are wrong, a model must say.
    """

    position_spikes: Mask
    position_frozen: Mask
    torque_spikes: Mask
    torque_frozen: Mask
    torque_clipped: Mask
    torque_dead: Mask

    __repr__ = brief

    @cached_property
    def positions(self) -> Mask:
        """The positions (N, n) that are to be replaced: of joints in which they are few enough to be outliers."""
        found: Mask = np.logical_or(few(self.position_spikes, FEW), few(self.position_frozen, SOME))
        return found

    @cached_property
    def torques(self) -> Mask:
        """All suspect torques (N, n); none where they are nearly all of the log."""
        found = self.torque_spikes | self.torque_frozen | self.torque_clipped | self.torque_dead
        return found if found.mean() <= NEARLY_ALL else np.zeros_like(found)


_SEEN: WeakKeyDictionary[Log, Suspects] = WeakKeyDictionary()


def few(found: Mask, most: float) -> Mask:
    """Return what was found (N, n) in the joints in which its share is at most ``most``."""
    return np.asarray(found & (found.mean(axis=0) <= most))


def suspects(log: Log) -> Suspects:
    """Return where the positions and torques of a log look wrong; looked for once."""
    if log not in _SEEN:
        _SEEN[log] = _suspects(log)
    return _SEEN[log]


def _suspects(log: Log) -> Suspects:
    clipped = _clipped(log.tau)
    held = frozen(log.t, log.tau) & ~clipped
    q, tau = (spikes(log.t, x) | torn_ends(log.t, x) for x in (log.q, log.tau))
    constant = np.ptp(log.tau, axis=0) == 0
    dead = np.broadcast_to(constant & ~constant.all(), log.tau.shape)  # where all are, the whole arm may swing freely
    return Suspects(q, frozen(log.t, log.q), tau & ~clipped, held, clipped, dead)


def _clipped(tau: NDArray[np.float64]) -> Mask:
    """Return which torques (N, n) are exactly the largest or the smallest, other than zero, again and again."""
    found = np.zeros(tau.shape, dtype=bool)
    for j, column in enumerate(tau.T):
        for extreme in {float(column.min()), float(column.max())} - {0.0}:
            at = column == extreme
            long = [part for part in stretches(at) if part.stop - part.start >= AT_ONCE]
            if at.sum() >= CLIPPED and not at.all() and len(long) >= OFTEN:
                found[:, j] |= at
    return found


def repaired(log: Log, *, torque: bool) -> Log:
    """Return the log with outliers among the positions replaced by what is around them, and not kept for the fit.

    With ``torque``, suspect torques are not kept either, until a model says that they are right.
    """
    seen = suspects(log)
    wrong = seen.positions
    q = log.q
    if wrong.any():
        columns = (bridged(log.t, x, gone) for x, gone in zip(log.q.T, wrong.T, strict=True))
        q = np.stack(list(columns), axis=1)
    stuck: Mask = np.asarray(seen.position_frozen & wrong)
    lost = np.asarray(_widened(stuck) | wrong).any(axis=1, keepdims=True)
    out = lost | (seen.torques & torque)
    keep = ~out if log.keep is None else ~out & log.keep
    return replace(log, q=q, keep=keep) if out.any() else log


def _widened(found: Mask) -> Mask:
    if not found.any():
        return found
    from scipy.ndimage import binary_dilation  # seldom needed

    return np.asarray(binary_dilation(found, np.ones((2 * MARGIN + 1, 1))))


def motion_of(smoother: Smoother, log: Log, *, judged: bool = False) -> Motion:
    """Return the motion of a log, of which the fit keeps what the log keeps.

    Where the log is only ``judged``, not fitted, and has not the motion that the smoother is made for, the substitute
    of this smooths it: its ``smoothing`` then has the key ``SUBSTITUTE``. Excluded samples are neither in its mask nor
    kept. Raises the errors of the smoother, and ConfigError where its motion has not the samples of the log.
    """
    motion = _judged(smoother, log) if judged else called(smoother, log, Motion)
    if len(motion) != len(log):
        name = type(unshifted(smoother)).__name__
        raise ConfigError(
            f"{log.source}: the smoother {name} returns {len(motion)} samples for {len(log)}; "
            "return all of them, and mask out those that must not be used."
        )
    if log.excluded is None:
        return motion if log.keep is None else replace(motion, keep=log.keep)
    used = np.broadcast_to(~log.excluded[:, None], log.q.shape)
    return replace(motion, mask=motion.mask & ~log.excluded, keep=used if log.keep is None else used & log.keep)


def _judged(smoother: Smoother, log: Log) -> Motion:
    """Return the motion by a smoother, or by its substitute where it does not apply."""
    try:
        return called(smoother, log, Motion)
    except MissingInputError:
        other = smoother.substitute() if isinstance(smoother, HasSubstitute) else None
        if other is None:
            raise
    motion = called(other, log, Motion)
    return replace(motion, smoothing={**motion.smoothing, SUBSTITUTE: type(unshifted(smoother)).__name__})
