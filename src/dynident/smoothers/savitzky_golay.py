"""Savitzky and Golay's smoother: a polynomial through the samples around each sample, by least squares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, choices
from dynident.log import Log, Motion
from dynident.smoothers.local_polynomials import differences, fitted, spans
from dynident.smoothers.rest import at_rest, with_rest
from dynident.smoothers.smoother import BY_JOINT

__all__ = ["SavitzkyGolay", "SavitzkyGolaySettings"]

Array = NDArray[np.float64]
FACTORS = (0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.4, 1.7, 2.0, 2.4, 2.8)  # times the window, of which "torque" chooses
STEP = 1.1  # from one window that is tried to the next
LOWER = 0.7  # times the squares, which a window twice as wide divides by 32 where they are noise
WORSE = 10.0  # times the least difference: windows that are wider still need not be tried
LONGEST = 1 / 3  # of a log
SAMPLES, OFTEN = 1000, 10  # at which a window is tried: at most so many, or so many of each window
STRETCHED = 1.5  # times the usual time of a window, from which on there is a gap in it
Order = Annotated[int, Ge(2), Le(10)]
Window = Annotated[float, Gt(0)]
Factor = Annotated[float, Gt(0)]


@dataclass(frozen=True)
class SavitzkyGolaySettings:
    """The settings of a ``SavitzkyGolay``; with the rule "torque" several to choose from, of increasing windows."""

    window: Annotated[Window | Mapping[str, Window] | None, BY_JOINT] = None
    order: Order = 4
    factor: Factor = 1.0
    rule: Literal["acceleration", "torque"] = "acceleration"

    def __post_init__(self) -> None:
        if self.rule == "torque" and self.window is not None:
            raise ConfigError("`window` is only used by `rule: acceleration`, not by `rule: torque`, which chooses it")

    @classmethod
    def of(cls, part: SavitzkyGolay) -> SavitzkyGolaySettings:
        """Return the settings that build ``part``."""
        return cls(**{one.name: getattr(part, one.name) for one in fields(part)})

    def build(self) -> SavitzkyGolay | tuple[SavitzkyGolay, ...]:
        """Return the smoother, or those that ``rule`` "torque" chooses from."""
        if self.rule == "torque":
            return tuple(SavitzkyGolay(None, self.order, self.factor * one) for one in FACTORS)
        return SavitzkyGolay(self.window, self.order, self.factor)


@dataclass(frozen=True)
class SavitzkyGolay:
    """Fit a polynomial to the samples around each sample, and take q, dq and ddq from it; Savitzky and Golay (1964).

    ``window`` (s) is the time of an odd number of samples, one number or a mapping by joint name. None takes, for each
    joint, ``factor`` times the window that is best for ddq: about that at which polynomials of ``order`` and of
    ``order`` + 2 differ least, which is the error of the first by what it cannot follow, and by noise. A window of inf
    is that of a joint at rest. Times are taken as they are; masked out are samples whose window has a gap, so that it
    takes more than 1.5 times as long, and those within half a window of the ends.

    Calling it returns a ``Motion``. Raises ConfigError for bad settings or unknown joints, and InputError where the log
    is too short, or the window for its samples.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(1001) * 0.01
    >>> q = np.sin(t) + 1e-3 * np.random.default_rng(0).standard_normal(1001)
    >>> log = dy.Log(t, q[:, None], tau=np.cos(t)[:, None], joints=("hinge",))
    >>> motion = dy.SavitzkyGolay()(log)
    >>> print(f"window {motion.smoothing['window'][0]:.2f} s, {motion.mask.sum()} samples usable")
    window 2.02 s, 799 samples usable
    >>> print(f"error of the velocity {np.abs(motion.dq[:, 0] - np.cos(t))[motion.mask].max():.4f} rad/s")
    error of the velocity 0.0024 rad/s
    """

    window: float | Mapping[str, float] | None = None
    order: int = 4
    factor: float = 1.0
    Settings: ClassVar[type[SavitzkyGolaySettings]] = SavitzkyGolaySettings

    def __post_init__(self) -> None:
        for one in self.window.values() if isinstance(self.window, Mapping) else (self.window,):
            if one is not None and not one > 0:
                raise ConfigError(f"window is {one}: give a positive time in s.")
        whole: Any = self.order
        if not (isinstance(whole, int) and 2 <= whole <= 10):
            raise ConfigError(f"order is {whole}: give a whole number from 2 to 10.")
        if not 0 < self.factor < np.inf:
            raise ConfigError(f"factor is {self.factor}: give a positive multiple of the window.")

    @property
    def method(self) -> str:
        """The method in words."""
        times = "" if self.factor == 1.0 or self.window is not None else f", {self.factor:.3g} times the window"
        return f"Savitzky-Golay, polynomials of order {self.order}{times}"

    def __call__(self, log: Log) -> Motion:
        """Fit; ``smoothing`` holds per joint the window (s) and the noise (rad, m)."""
        halves = self._halves(log)
        motion, noise, still = self._fitted(log, halves)
        step = float(np.median(np.diff(log.t)))
        windows = [np.inf if rests else 2 * half * step for half, rests in zip(halves, still, strict=True)]
        how = {"method": self.method, "window": tuple(windows), "noise": tuple(noise.tolist())}
        mask = self._mask(log, max((half for half, rests in zip(halves, still, strict=True) if not rests), default=1))
        for x in motion:
            x.flags.writeable = False  # no copy is made then
        return Motion(log.t, *motion, log.tau, log.joints, mask, log.source, how)

    def as_used(self, motion: Motion) -> SavitzkyGolay:
        """Return the smoother with the window, for each joint, that it has used for a motion."""
        return SavitzkyGolay(dict(zip(motion.joints, motion.smoothing["window"], strict=True)), self.order)

    def _fitted(self, log: Log, halves: list[int]) -> tuple[tuple[Array, Array, Array], Array, NDArray[np.bool_]]:
        """Return q, dq, ddq (N, n), the noise (n), and which joints rest, those of a window without end among them."""
        out, noise = np.empty((3, *log.q.shape)), np.zeros(len(halves))
        for half in set(halves) - {0}:
            joints = np.flatnonzero(np.array(halves) == half)
            *found, kept = fitted(log.t, log.q[:, joints], half, self.order)
            out[:, :, joints] = found
            whole = _whole(log.t, half)
            left = np.square(log.q[:, joints] - found[0])[whole if whole.any() else slice(None)].mean(axis=0)
            noise[joints] = np.sqrt(left / max(1.0 - kept / len(log), 1e-3))
        resting = np.array(halves) == 0
        out[0][:, resting], noise[resting] = 0.0, np.std(log.q[:, resting], axis=0)
        still = at_rest(log.q, out[0], noise) | resting
        return with_rest(still, log.q, (out[0], out[1], out[2])), noise, still

    def _halves(self, log: Log) -> list[int]:
        """Return how many samples (n) a window has on either side; none where it is without end."""
        least = (self.order + 2) // 2
        if len(log) < 2 * least + 1:
            raise InputError(
                f"{log.source}: {len(log)} samples are too few for polynomials of order {self.order}, which need "
                f"{2 * least + 1}."
            )
        given = self._given(log)
        if all(one is not None for one in given):
            return [self._half(log, float(one or 0.0), least) for one in given]
        found = self._chosen(log, least)
        return [half if one is None else self._half(log, one, least) for half, one in zip(found, given, strict=True)]

    def _given(self, log: Log) -> list[float | None]:
        if not isinstance(self.window, Mapping):
            return [self.window] * len(log.joints)
        for name in self.window:
            if name not in log.joints:
                raise ConfigError(f"window names the joint {name!r}; the log has others; {choices(name, log.joints)}")
        return [self.window.get(name) for name in log.joints]

    def _half(self, log: Log, window: float, least: int) -> int:
        step = float(np.median(np.diff(log.t)))
        if window == np.inf:
            return 0
        half = round(min(window / step / 2, float(len(log))))
        if half < least:
            raise InputError(
                f"{log.source}: a window of {window:.3g} s holds {2 * half + 1} samples; polynomials of order "
                f"{self.order} need at least {2 * least + 1}, {2 * least * step:.3g} s, or leave the window out."
            )
        if 2 * half + 1 > len(log):
            raise InputError(
                f"{log.source}: {len(log)} samples, {log.t[-1] - log.t[0]:.3g} s, are too short for a window of "
                f"{window:.3g} s; give a smaller one, or leave it out."
            )
        return half

    def _chosen(self, log: Log, least: int) -> list[int]:
        """Return the half window (n) that is best for ddq, times the factor.

        The squared difference of two orders is a W^(2 s) + k b W^-5 over the window W, with the even order s <= order,
        k times the variance of the lower one. It is least k^(1 / (2 s + 5)) above the window of the least error. Where
        both orders miss a motion they agree on it: what counts is the first window that a wider one does not better.
        """
        longest = max(least, (int(LONGEST * len(log)) - 1) // 2)
        tried, half = [], least + 1
        while half <= longest:
            inside = np.flatnonzero(_whole(log.t, half))
            if not len(inside):
                break
            rows = inside[np.linspace(0, len(inside) - 1, _count(len(inside), half)).astype(np.intp)]
            squares, gain = differences(log.t, log.q, half, (self.order, self.order + 2), rows)
            tried.append((half * gain ** (-1 / (2 * (self.order // 2 * 2) + 5)), squares))
            if (squares > WORSE * np.min([one for _, one in tried], axis=0)).all():
                break
            half = max(half + 1, int(STEP * half))
        if not tried:
            return [least] * log.q.shape[1]
        widths, squares = (np.array(one) for one in zip(*tried, strict=True))
        best = (widths[_first_minimum(widths, column)] for column in squares.T)
        return [max(round(min(self.factor * float(width), float(longest))), least) for width in best]

    def _mask(self, log: Log, half: int) -> NDArray[np.bool_]:
        """Return the samples that may be used."""
        mask = _whole(log.t, half)
        if not mask.any():
            raise InputError(f"{log.source}: every window of {2 * half + 1} samples has a gap in it; smooth less.")
        return mask


def _first_minimum(widths: Array, squares: Array) -> int:
    """Return the first of the windows (K) whose squares no wider one, up to twice as wide, lowers much."""
    for i, width in enumerate(widths):
        later = squares[i + 1 :][widths[i + 1 :] <= 2.0 * width]
        if not len(later) or later.min() > LOWER * squares[i]:
            return i + int(np.argmin(squares[i:][widths[i:] <= np.sqrt(2.0) * width]))
    return len(widths) - 1


def _whole(t: Array, half: int) -> NDArray[np.bool_]:
    """Return which samples (N) have half a window on either side, and no gap in it."""
    inside = np.zeros(len(t), dtype=bool)
    inside[half : len(t) - half] = True
    return np.asarray(inside & (spans(t, half) <= STRETCHED * 2 * half * float(np.median(np.diff(t)))))


def _count(samples: int, half: int) -> int:
    """Return at how many of so many samples a window is tried."""
    return int(min(SAMPLES, max(100, OFTEN * samples / (2 * half + 1)), samples))
