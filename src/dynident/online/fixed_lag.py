"""The smoothing spline of a stream: the motion of a sample is final a fixed lag after it.

Each window of samples is smoothed with what is before it, as far as that matters, and with a lag after it. A spline
forgets what is beyond its ends like |z|^k over k samples (``smoothers/overlap.py``), so the motion differs from that of
the spline through the whole recording by |z|^lag of the error that there would be without a lag, and by nothing else:
stamps need not be even, and the ends are those of a natural spline.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.checks import GAP
from dynident.errors import ConfigError, InputError, brief, listed
from dynident.log import Motion
from dynident.smoothers import decay
from dynident.splines import Fixed, smooth

__all__ = ["FixedLag", "Smoothed"]

Array = NDArray[np.float64]
ACCURACY = 1e-10  # what is left of the error at a cut, by default
ENDS = 6.0  # bandwidths at the ends of a recording that are not usable, as of ``Spline``
WINDOW = 64  # samples that are smoothed together at least, as each call has its cost
FEWEST = 3  # samples of a spline
LONGEST = 50_000  # samples of a lag: those of a bandwidth that double precision allows
CLOSEST = 1e-6  # of a step: stamps that are closer are the same


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A final ``motion``, and whether it ``ends`` a stretch without gaps: what follows is smoothed by itself."""

    motion: Motion
    ends: bool = False

    __repr__ = brief


class FixedLag:
    """A smoothing spline per joint, with as much smoothing in a stream as a ``Spline`` had in a recording.

    ``bandwidth`` (n) s is that of a motion (``motion.smoothing["bandwidth"]``), ``step`` (s) the mean time between
    samples. A sample's motion is final once those of the next ``lag`` (s) are there, and is returned with those of its
    window, ``every`` samples together. A ``lag`` of None is so long that 1e-10 is left of the error at a cut: about 33
    bandwidths. A time between samples above 12 steps is a gap, at which a spline ends and another begins.

    The mask leaves out ``ends`` times a bandwidth and a step at both ends of a stretch, as that of ``Spline``.

    Raises ConfigError for a setting that is not positive, or a lag of more than 50 000 samples.

    >>> import numpy as np
    >>> from dynident.online import FixedLag
    >>> stream = FixedLag(("hinge",), step=0.01, bandwidth=[0.02], lag=0.2, every=50)
    >>> t = np.arange(200) * 0.01
    >>> for one in stream.push(t, np.sin(t)[:, None], np.cos(t)[:, None]):
    ...     print(one.motion)
    <Motion 'stream': 50 samples of hinge; 0 to 0.49 s, 100 Hz; 32 usable; natural cubic smoothing spline, fixed lag>
    <Motion 'stream': 50 samples of hinge; 0.5 to 0.99 s, 100 Hz; 50 usable; natural cubic smoothing spline, fixed lag>
    <Motion 'stream': 50 samples of hinge; 1 to 1.49 s, 100 Hz; 50 usable; natural cubic smoothing spline, fixed lag>
    >>> print(f"left of the error at a cut: {stream.left[0]:.1e}")
    left of the error at a cut: 8.5e-04
    """

    def __init__(
        self,
        joints: Sequence[str],
        step: float,
        bandwidth: ArrayLike,
        lag: float | None = None,
        every: int | None = None,
        ends: float = ENDS,
        source: str = "stream",
    ) -> None:
        self.joints, self.step, self.source, self._ends = tuple(joints), float(step), source, ends
        self.bandwidth = np.asarray(bandwidth, dtype=float)
        n = len(self.joints)
        if not 0 < self.step < math.inf:
            raise ConfigError(f"step = {step} s; give the time between samples.")
        if self.bandwidth.shape != (n,) or not (np.isfinite(self.bandwidth) & (self.bandwidth >= 0)).all():
            raise ConfigError(f"bandwidth = {self.bandwidth} s; give a number from 0 for each of {listed(joints, 6)}.")
        self._decay = max(decay(float(one), self.step) for one in self.bandwidth)
        self._before = math.ceil(math.log(ACCURACY) / math.log(self._decay)) + FEWEST if self._decay < 1 else LONGEST
        self._lag = self._before if lag is None else round(lag / self.step) if 0 <= lag < math.inf else 0
        self._every = max(WINDOW, self._lag) if every is None else every
        if (lag is not None and not lag >= 0) or not 2 <= self._every <= LONGEST or not self._lag < LONGEST:
            raise ConfigError(
                f"a lag of {lag} s, {self._lag} samples, and a bandwidth of {self.bandwidth.max():.3g} s: give a lag "
                f"from 0, and one of at most {LONGEST} samples, in windows of 2 to {LONGEST} (every = {every})."
            )
        self._lag = max(self._lag, FEWEST - 1)
        size = self._before + self._every + self._lag
        self._t, self._q, self._tau = np.empty(size), np.empty((size, n)), np.empty((size, n))
        self._filled = self._done = 0  # samples that are held, and those of them whose motion was returned
        self._settings = np.array([self.step, self._lag, self._every, ends, *self.bandwidth])
        self._begin = self._last = math.nan  # the first and the last stamp of this stretch

    def __repr__(self) -> str:
        return f"<FixedLag of {listed(self.joints, 6)}: {self.lag:.3g} s, bandwidth to {self.bandwidth.max():.3g} s>"

    @property
    def lag(self) -> float:
        """The time (s) after a sample that its motion takes into account."""
        return self._lag * self.step

    @property
    def latest(self) -> float:
        """The time (s) after a sample by which its motion is returned: the lag and a window."""
        return (self._lag + self._every) * self.step

    @property
    def left(self) -> Array:
        """The share (n) that the lag leaves of the error of the motion at the newest sample."""
        return np.array([decay(float(one), self.step) ** self._lag for one in self.bandwidth])

    def push(self, t: ArrayLike, q: ArrayLike, tau: ArrayLike) -> tuple[Smoothed, ...]:
        """Take samples, t (B) s, q and tau (B, n), and return the motion of those that are final, without overlap.

        Columns are in the order of ``joints``. The motion does not depend on how many are given at a time. Raises
        InputError for a shape that does not fit, a value that is not finite, or a time that does not increase; none of
        the samples is taken then.
        """
        time, n = np.atleast_1d(np.asarray(t, dtype=float)), len(self.joints)
        positions, torques = (np.asarray(x, dtype=float) for x in (q, tau))
        if len(time) == 1:
            positions, torques = (x[None] if x.shape == (n,) else x for x in (positions, torques))
        steps = self._checked(time, positions, torques)
        found = list[Smoothed]()
        wide = np.flatnonzero(steps > GAP * self.step).tolist()
        for start, stop in zip([0, *wide], [*wide, len(time)], strict=True):
            if start in wide:
                found += self.finish()
            found += self._take(time[start:stop], positions[start:stop], torques[start:stop])
        return tuple(found)

    def finish(self) -> tuple[Smoothed, ...]:
        """Return the rest of the motion, with a natural spline's end at the last sample; what follows begins anew."""
        found = self._smoothed(self._filled, ended=True) if self._filled >= FEWEST else ()
        self._filled = self._done = 0
        self._begin = math.nan
        return found

    @property
    def state(self) -> dict[str, Array]:
        """All that it holds, as arrays, to be saved; ``restore`` takes them again."""
        held = slice(0, self._filled)
        counts = np.array([self._done, self._begin, self._last])
        signals = {"t": self._t[held].copy(), "q": self._q[held].copy(), "tau": self._tau[held].copy()}
        return signals | {"counts": counts, "settings": self._settings}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a saved state of the same settings; InputError where it does not fit them."""
        if not np.array_equal(state["settings"], self._settings):
            raise InputError("the saved window is of another step, bandwidth or lag, or of other joints; start anew.")
        held = len(state["t"])
        for own, name in ((self._t, "t"), (self._q, "q"), (self._tau, "tau")):
            own[:held] = state[name]
        self._filled, self._done = held, int(state["counts"][0])
        self._begin, self._last = (float(one) for one in state["counts"][1:])

    def _checked(self, t: Array, q: Array, tau: Array) -> Array:
        """Return the steps (B) before each sample, nan before the first of all."""
        shape = len(t), len(self.joints)
        if not shape == q.shape == tau.shape:
            raise InputError(f"{self.source}: q and tau have shapes {q.shape} and {tau.shape}; they must be {shape}.")
        for name, x in (("t", t), ("q", q), ("tau", tau)):
            if not np.isfinite(x).all():
                k = int(np.flatnonzero(~np.isfinite(x).reshape(len(t), -1).all(axis=1))[0])
                raise InputError(f"{self.source}: {name} of sample {k} is {x[k]}; leave out what is not finite.")
        steps = np.diff(t, prepend=self._last)
        if (wrong := steps <= CLOSEST * self.step).any():
            k = int(np.flatnonzero(wrong)[0])
            raise InputError(
                f"{self.source}: the stamp {float(t[k])!r} s does not follow that before it; leave it out."
            )
        return steps

    def _take(self, t: Array, q: Array, tau: Array) -> list[Smoothed]:
        """Take samples without a gap between them."""
        found, taken = list[Smoothed](), 0
        if len(t) and math.isnan(self._begin):
            self._begin = float(t[0])
        while taken < len(t):
            room = self._done + self._every + self._lag - self._filled
            part, into = slice(taken, taken + room), slice(self._filled, self._filled + min(room, len(t) - taken))
            self._t[into], self._q[into], self._tau[into] = t[part], q[part], tau[part]
            taken, self._filled, self._last = into.stop - into.start + taken, into.stop, float(self._t[into.stop - 1])
            if self._filled == self._done + self._every + self._lag:
                found += self._smoothed(self._filled - self._lag)
                self._drop()
        return found

    def _drop(self) -> None:
        """Let go of the samples that no longer matter."""
        if (first := self._done - self._before) > 0:
            for x in (self._t, self._q, self._tau):
                x[: self._filled - first] = x[first : self._filled].copy()
            self._filled, self._done = self._filled - first, self._before

    def _smoothed(self, stop: int, *, ended: bool = False) -> tuple[Smoothed, ...]:
        """Return the motion of what was not returned before, up to ``stop``."""
        held, new = slice(0, self._filled), slice(self._done, stop)
        rule = Fixed(lam=(self.bandwidth**4 / self.step).tolist())
        fit = smooth(self._t[held], self._q[held], rule, sigma=1.0, names=[f"joint {name!r}" for name in self.joints])
        t = self._t[new].copy()
        margin = self._ends * (float(self.bandwidth.max()) + self.step)
        mask = t >= self._begin + margin
        if ended:
            mask &= t <= self._last - margin
        how = {"method": "natural cubic smoothing spline, fixed lag", "bandwidth": tuple(self.bandwidth.tolist())}
        q, dq, ddq = (fit.derivative(order)[new] for order in range(3))
        self._done = stop
        motion = Motion(t, q, dq, ddq, self._tau[new].copy(), self.joints, mask, self.source, how)
        return (Smoothed(motion, ended),)
