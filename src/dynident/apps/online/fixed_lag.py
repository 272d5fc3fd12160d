"""Smoothing spline of a stream: the motion of a sample is final a fixed lag after it.

Each window of samples is smoothed with the samples before it, as far as they matter, and with a lag
after it. A spline forgets what is beyond its ends like |z|^k over k samples (``motion/smoothers/smoother.py``),
so the motion differs from that of the spline through the whole recording by |z|^lag of the error that
there would be without a lag, and by nothing else: stamps need not be even, and the ends are those of a
natural spline.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynident.checks import MAX_GAP_STEPS
from dynident.motion.log import Motion
from dynident.motion.smoothers import decay
from dynident.motion.splines import Fixed, smooth
from dynident.runtime import ConfigError, InputError, Noun, join_names
from dynident.runtime.arrays import Array, as_numbers

SIGNALS = ("t", "q", "dq", "ddq", "tau", "mask", "memory")
MIN_SAMPLES = 2  # samples of a motion
DEFAULT_ACCURACY = 1e-10  # what is left of the error at a cut, by default
SOURCE = "stream"  # what messages and motions call it
END_BANDWIDTHS = 6.0  # bandwidths at the ends of a recording that are not usable, as of ``Spline``
MIN_WINDOW = 64  # samples that are smoothed together at least, as each call has its cost
MIN_SPLINE_SAMPLES = 3  # samples of a spline
MAX_LAG = 50_000  # samples of a lag: those of a bandwidth that double precision allows
MIN_STEP_SHARE = 1e-6  # of a step: stamps that are closer are the same


class Context:
    """Holds ``before`` samples of a motion that were delivered, and those that wait for ``after`` further ones.

    The first sample held is a ``multiple`` of samples after the first usable one, as a decimation of all
    usable samples needs it.
    """

    def __init__(self, before: int = 0, after: int = 0, multiple: int = 1) -> None:
        self.before, self.after, self.multiple = before, after, multiple
        self.held: Motion | None = None
        self._done = 0  # samples of these that were delivered

    def push(self, motion: Motion | None, *, ended: bool = False) -> tuple[Motion, slice] | None:
        """Take the next part; return all that is held, and which samples of it are delivered now; None for none.

        Where a stretch has ``ended`` all that are left are delivered; the next part then begins another.
        """
        buffered = motion if self.held is None else self.held if motion is None else join_motions(self.held, motion)
        if buffered is None:
            return None
        stop = len(buffered) if ended else len(buffered) - self.after
        # one sample alone is no motion: wait until there are two
        delivered = slice(self._done, stop if stop >= self._done + MIN_SAMPLES else self._done)
        first_kept = self._first_kept(buffered, delivered.stop)
        self.held, self._done = cut_motion(buffered, slice(first_kept, None)), delivered.stop - first_kept
        if ended:
            self.clear()
        return (buffered, delivered) if delivered.start < delivered.stop else None

    def clear(self) -> None:
        """Begin anew."""
        self.held, self._done = None, 0

    @property
    def state(self) -> dict[str, Array]:
        """What it holds, as arrays; nothing where it is empty."""
        if self.held is None:
            return {}
        signals = {name: getattr(self.held, name) for name in SIGNALS}
        return {"done": np.array(float(self._done))} | {
            name: np.array(x, dtype=float) for name, x in signals.items() if x is not None
        }

    def restore(self, state: Mapping[str, Array], like: Motion) -> None:
        """Continue from a saved state; ``like`` is any motion of the same joints and source."""
        self.clear()
        if "t" in state:
            signals: dict[str, Any] = {name: state.get(name) for name in SIGNALS}
            signals["mask"] = np.asarray(state["mask"]) > 0
            self.held, self._done = replace(like, **signals), int(state["done"])

    def _first_kept(self, buffered: Motion, delivered_count: int) -> int:
        """Return the index of the first sample to keep, after so many were delivered."""
        index = min(max(delivered_count - self.before, 0), len(buffered) - MIN_SAMPLES)
        usable = int(np.argmax(buffered.mask))
        # decimation counts from the first usable sample: keep whole multiples, so that the same samples remain
        return usable + (index - usable) // self.multiple * self.multiple if index > usable else index


def cut_motion(motion: Motion, rows: slice) -> Motion:
    """Return some samples of a motion, at least two, with its memory."""
    pairs = ((name, getattr(motion, name)) for name in SIGNALS)
    signals: dict[str, Any] = {name: None if x is None else x[rows] for name, x in pairs}
    return replace(motion, **signals)


def join_motions(earlier: Motion, later: Motion) -> Motion:
    """Join two motions that follow each other, without the memory where one has none."""
    pairs = ((name, getattr(earlier, name), getattr(later, name)) for name in SIGNALS)
    signals: dict[str, Any] = {name: None if a is None or b is None else np.concatenate([a, b]) for name, a, b in pairs}
    return replace(later, **signals)


class FinalMotion(Noun):
    """A final ``motion``, and whether it ``ends`` a stretch without gaps: the next one is smoothed by itself."""

    motion: Motion
    ends: bool = False


class StreamSmoothing(Noun):
    """How a stream is smoothed: the mean time ``step`` (s) between its samples, and the ``bandwidth`` (n) s of its
    motion (``motion.smoothing["bandwidth"]``).
    """

    step: float
    bandwidth: Array


class FixedLag:
    """Smoothing spline for each joint, with as much smoothing in a stream as a ``Spline`` had in a recording.

    The motion of a sample is final once the samples of the next ``lag`` (s) are there, and
    is returned together with that of its ``window`` (samples). A ``lag`` of None is so long that 1e-10 is
    left of the error at a cut: about 33 bandwidths. A time between samples above 12 steps is a gap, at which
    a spline ends and another begins.

    The mask leaves out ``ends`` times a bandwidth and a step at both ends of a stretch, like that of
    ``Spline``.

    Raises ConfigError for a setting that is not positive, or a lag of more than 50 000 samples.

    >>> import numpy as np
    >>> from dynident.apps.online import FixedLag, StreamSmoothing
    >>> stream = FixedLag(("hinge",), StreamSmoothing(0.01, np.array([0.02])), lag=0.2, window=50)
    >>> t = np.arange(200) * 0.01
    >>> for block in stream.push(t, np.sin(t)[:, None], np.cos(t)[:, None]):
    ...     print(block.motion)
    <Motion 'stream': 50 samples of hinge; 0 to 0.49 s, 100 Hz; 32 usable; natural cubic smoothing spline, fixed lag>
    <Motion 'stream': 50 samples of hinge; 0.5 to 0.99 s, 100 Hz; 50 usable; natural cubic smoothing spline, fixed lag>
    <Motion 'stream': 50 samples of hinge; 1 to 1.49 s, 100 Hz; 50 usable; natural cubic smoothing spline, fixed lag>
    >>> print(f"left of the error at a cut: {stream.remaining_error[0]:.1e}")
    left of the error at a cut: 8.5e-04
    """

    def __init__(
        self,
        joints: Sequence[str],
        smoothing: StreamSmoothing,
        lag: float | None = None,
        window: int | None = None,
        ends: float = END_BANDWIDTHS,
    ) -> None:
        self.joints, self.step, self._ends = tuple(joints), float(smoothing.step), ends
        self.bandwidth = np.asarray(smoothing.bandwidth, dtype=float)
        n = len(self.joints)
        if not 0 < self.step < math.inf:
            raise ConfigError(f"step = {smoothing.step} s; give the time between samples.")
        if self.bandwidth.shape != (n,) or not (np.isfinite(self.bandwidth) & (self.bandwidth >= 0)).all():
            raise ConfigError(
                f"bandwidth = {self.bandwidth} s; give a number from 0 for each of {join_names(joints, 6)}."
            )
        self._decay = max(decay(float(width), self.step) for width in self.bandwidth)
        # as many samples before a cut as it takes for its error to fade, and enough for a spline
        self._before = MAX_LAG
        if self._decay < 1:
            self._before = math.ceil(math.log(DEFAULT_ACCURACY) / math.log(self._decay)) + MIN_SPLINE_SAMPLES
        self._lag = self._before if lag is None else round(lag / self.step) if 0 <= lag < math.inf else 0
        self._every = max(MIN_WINDOW, self._lag) if window is None else window
        if (lag is not None and not lag >= 0) or not 2 <= self._every <= MAX_LAG or not self._lag < MAX_LAG:
            raise ConfigError(
                f"a lag of {lag} s, {self._lag} samples, and a bandwidth of {self.bandwidth.max():.3g} s: give a lag "
                f"from 0, and one of at most {MAX_LAG} samples, in windows of 2 to {MAX_LAG} (window = {window})."
            )
        self._lag = max(self._lag, MIN_SPLINE_SAMPLES - 1)
        size = self._before + self._every + self._lag
        # buffers of a fixed size: samples before the window, the window, and the lag
        self._t, self._q, self._tau = np.empty(size), np.empty((size, n)), np.empty((size, n))
        self._filled = self._done = 0  # samples that are held, and those of them whose motion was returned
        self._settings = np.array([self.step, self._lag, self._every, ends, *self.bandwidth])
        self._begin = self._last = math.nan  # the first and the last stamp of this stretch

    def __repr__(self) -> str:
        return (
            f"<FixedLag of {join_names(self.joints, 6)}: {self.lag:.3g} s, bandwidth to {self.bandwidth.max():.3g} s>"
        )

    @property
    def lag(self) -> float:
        """Time (s) after a sample that its motion takes into account."""
        return self._lag * self.step

    @property
    def latest(self) -> float:
        """Time (s) after a sample by which its motion is returned: the lag and a window."""
        return (self._lag + self._every) * self.step

    @property
    def remaining_error(self) -> Array:
        """Share (n) that the lag leaves of the error of the motion at the newest sample."""
        return np.array([decay(float(width), self.step) ** self._lag for width in self.bandwidth])

    def motion_at_rest(self, samples: int) -> Motion:
        """Return a motion at rest, with the joints and the rate of the stream."""
        t = self.step * np.arange(samples, dtype=np.float64)
        zeros, usable = np.zeros((samples, len(self.joints))), np.ones(samples, dtype=bool)
        return Motion(t, zeros, zeros, zeros, zeros, self.joints, usable, SOURCE)

    def push(self, t: ArrayLike, q: ArrayLike, tau: ArrayLike) -> tuple[FinalMotion, ...]:
        """Take samples, t (B) s, q and tau (B, n), and return the motion of those that are final, without overlap.

        Columns are in the order of ``joints``. The motion does not depend on how many samples are given at a
        time. Raises InputError for a shape that does not fit, a value that is not finite, or a time that does
        not increase; none of the samples is taken then.
        """
        time, positions, torques = map(as_numbers, (t, q, tau))
        time = time if time.ndim else time[None]
        if len(time) == 1 and positions.ndim * torques.ndim != 4:
            n = len(self.joints)
            positions, torques = (x[None] if x.shape == (n,) else x for x in (positions, torques))
        if len(time) == 1 and self._append(float(time[0]), positions, torques):
            return ()
        steps = self._check_samples(time, positions, torques)
        motions = list[FinalMotion]()
        gaps = (steps > MAX_GAP_STEPS * self.step).nonzero()[0].tolist()
        # a gap ends a spline: what is before it is finished, what is after it begins anew
        for start, stop in zip([0, *gaps], [*gaps, len(time)], strict=True):
            if start in gaps:
                motions += self.finish()
            motions += self._take(time[start:stop], positions[start:stop], torques[start:stop])
        return tuple(motions)

    def finish(self) -> tuple[FinalMotion, ...]:
        """Return the rest of the motion, with a natural spline's end at the last sample; the next sample begins
        anew.
        """
        motions = self._smooth_window(self._filled, ended=True) if self._filled >= MIN_SPLINE_SAMPLES else ()
        self._filled = self._done = 0
        self._begin = math.nan
        return motions

    @property
    def state(self) -> dict[str, Array]:
        """State as arrays, to be saved; ``restore`` takes them again."""
        filled = slice(0, self._filled)
        counts = np.array([self._done, self._begin, self._last])
        signals = {"t": self._t[filled].copy(), "q": self._q[filled].copy(), "tau": self._tau[filled].copy()}
        return signals | {"counts": counts, "settings": self._settings}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a saved state of the same settings; InputError where it does not fit them."""
        if not np.array_equal(state["settings"], self._settings):
            raise InputError("the saved window is of another step, bandwidth or lag, or of other joints; start anew.")
        count = len(state["t"])
        for buffer, name in ((self._t, "t"), (self._q, "q"), (self._tau, "tau")):
            buffer[:count] = state[name]
        self._filled, self._done = count, int(state["counts"][0])
        self._begin, self._last = (float(stamp) for stamp in state["counts"][1:])

    def _append(self, t: float, q: Array, tau: Array) -> bool:
        """Take a single sample that needs nothing else, in a third of the time; False where it is not one of these."""
        k, step = self._filled, t - self._last
        if not k or k + 1 == self._done + self._every + self._lag or not q.shape == self._q[:1].shape == tau.shape:
            return False
        is_next = MIN_STEP_SHARE * self.step < step <= MAX_GAP_STEPS * self.step
        if is_next := is_next and math.isfinite(np.vdot(q, q) + np.vdot(tau, tau)):
            self._t[k], self._q[k], self._tau[k] = t, q[0], tau[0]
            self._filled, self._last = k + 1, t
        return is_next

    def _check_samples(self, t: Array, q: Array, tau: Array) -> Array:
        """Check samples, and return the steps (B) before each, nan before the first of all."""
        shape = len(t), len(self.joints)
        if not shape == q.shape == tau.shape:
            raise InputError(f"{SOURCE}: q and tau have shapes {q.shape} and {tau.shape}; they must be {shape}.")
        # the sum of squares is not finite where a value is not, and takes a tenth of the time for a single sample
        is_finite = math.isfinite(np.vdot(t, t) + np.vdot(q, q) + np.vdot(tau, tau))
        for name, x in () if is_finite else (("t", t), ("q", q), ("tau", tau)):
            if not np.isfinite(x).all():
                k = int(np.flatnonzero(~np.isfinite(x).reshape(len(t), -1).all(axis=1))[0])
                raise InputError(f"{SOURCE}: {name} of sample {k} is {x[k]}; leave out what is not finite.")
        steps = t.copy()  # less the stamp before each; np.diff would take a sixth of the time of a single sample
        steps[:1] -= self._last
        steps[1:] -= t[:-1]
        if np.count_nonzero(too_close := steps <= MIN_STEP_SHARE * self.step):
            k = int(np.argmax(too_close))
            raise InputError(f"{SOURCE}: the stamp {float(t[k])!r} s does not follow that before it; leave it out.")
        return steps

    def _take(self, t: Array, q: Array, tau: Array) -> list[FinalMotion]:
        """Take samples without a gap between them."""
        motions, start = list[FinalMotion](), 0
        if len(t) and math.isnan(self._begin):
            self._begin = float(t[0])
        while start < len(t):
            # fill the buffer up to one window at a time, so that results do not depend on the size of the batches
            room = self._done + self._every + self._lag - self._filled
            rows, target = slice(start, start + room), slice(self._filled, self._filled + min(room, len(t) - start))
            self._t[target], self._q[target], self._tau[target] = t[rows], q[rows], tau[rows]
            start, self._filled = start + target.stop - target.start, target.stop
            self._last = float(self._t[target.stop - 1])
            if self._filled == self._done + self._every + self._lag:
                motions += self._smooth_window(self._filled - self._lag)
                # drop the samples that no longer matter
                if (excess := self._done - self._before) > 0:
                    for x in (self._t, self._q, self._tau):
                        x[: self._filled - excess] = x[excess : self._filled].copy()
                    self._filled, self._done = self._filled - excess, self._before
        return motions

    def _smooth_window(self, stop: int, *, ended: bool = False) -> tuple[FinalMotion, ...]:
        """Smooth the buffer, and return the motion that was not returned before, up to ``stop``."""
        buffered, delivered = slice(0, self._filled), slice(self._done, stop)
        # the smoothing parameter in units of samples: bandwidth^4 over the step
        rule = Fixed(lam=(self.bandwidth**4 / self.step).tolist())
        names = [f"joint {name!r}" for name in self.joints]
        fit = smooth(self._t[buffered], self._q[buffered], rule, sigma=1.0, names=names)
        t = self._t[delivered].copy()
        margin = self._ends * (float(self.bandwidth.max()) + self.step)
        # near the ends of a stretch derivatives are not reliable
        mask = t >= self._begin + margin
        if ended:
            mask &= t <= self._last - margin
        smoothing = {"method": "natural cubic smoothing spline, fixed lag", "bandwidth": tuple(self.bandwidth.tolist())}
        q, dq, ddq = (fit.derivative(order)[delivered] for order in range(3))
        self._done = stop
        motion = Motion(t, q, dq, ddq, self._tau[delivered].copy(), self.joints, mask, SOURCE, smoothing)
        return (FinalMotion(motion, ended),)
