"""Controllers of joints, each with the references that were recorded: what drives a model in a closed loop.

All hold their references constant from one of their times to the next, and limit their input, such as a current, before
its gain.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import InputError, ModelError, brief
from dynident.log import Controller
from dynident.simulation.one_joint import Law
from dynident.simulation.slopes import Seen, Slopes, diagonal
from dynident.simulation.trace import gaps_of, instants

__all__ = ["PD", "PID", "Around", "CascadePD", "Function", "HasTimes"]

Array = NDArray[np.float64]


@runtime_checkable
class HasTimes(Controller, Protocol):
    """A controller with references that were recorded at times."""

    @property
    def t(self) -> Array:
        """The times (N), s."""

    def timed(self, t: Array, /) -> HasTimes:
        """Return the controller with other times (N) of its references."""

    def every(self, period: float, /) -> HasTimes:
        """Return the controller as it works every ``period`` s."""


class _Loop:
    """What the loops have in common: tau = gain clip(wanted), each joint by itself, of references that are held."""

    joints: tuple[str, ...]
    t: Array
    reference: Array
    gain: Array
    saturation: Array
    feedforward: Array

    def check(self, rate: Array | None = None, **gains: Array) -> None:
        """Raise InputError where a shape does not fit."""
        n, rows = len(self.joints), len(self.t)
        signals = {"reference": self.reference, "feedforward": self.feedforward}
        if rate is not None:
            signals["velocity_reference"] = rate
        for name, array in {**signals, **gains, "gain": self.gain, "saturation": self.saturation}.items():
            shape = (rows, n) if name in signals else (n,)
            if np.shape(array) != shape:
                raise InputError(f"controller: {name} has shape {np.shape(array)}, expected {shape}.")

    def timed(self, t: Array) -> Self:
        """Return the controller with other times (N) of its references."""
        return replace(self, t=t)  # type: ignore[type-var]

    def every(self, period: float) -> Self:
        """Return the controller as it works every ``period`` s: references are interpolated linearly between samples.

        Raises InputError where no whole number of periods fits between these.
        """
        t, found = instants(self.t, period), {}
        for name in ("reference", "feedforward", "velocity_reference"):
            if (signal := getattr(self, name, None)) is not None:
                found[name] = np.column_stack([np.interp(t, self.t, one) for one in signal.T])
        return replace(self, t=t, **found)  # type: ignore[type-var]

    def row(self, t: Any) -> Any:
        """Return the row of the references that is held at time t."""
        return np.maximum(np.searchsorted(self.t, t + 1e-9) - 1, 0)

    def limited(self, wanted: Array) -> Array:
        """Return the torque of an input."""
        return np.asarray(self.gain * np.minimum(np.maximum(wanted, -self.saturation), self.saturation))

    def free(self, wanted: Array) -> Array:
        """Return the gain where the input is not limited, else zero."""
        return np.where(np.abs(wanted) < self.saturation, self.gain, 0.0)


class _Linear(_Loop, ABC):
    """A loop whose input is linear in the state."""

    @property
    @abstractmethod
    def gains(self) -> tuple[Array, Array]:
        """By what (n) the input falls with q and with dq."""

    @abstractmethod
    def wanted(self, k: Any, q: Array, dq: Array) -> Array:
        """Return the input before its limit, for the references of row k."""

    def __call__(self, t: float, q: Array, dq: Array) -> Array:
        """Return the torque (n) for the state at time t."""
        return self.limited(self.wanted(self.row(t), q, dq))

    def numbers(self, t: Array) -> tuple[list[float], tuple[float, ...]]:
        """Return the input of a single joint at t (N) at rest in zero; gains, that of the torque, and the limit."""
        rest: list[float] = self.wanted(self.row(t), np.zeros(1), np.zeros(1))[:, 0].tolist()
        return rest, tuple(float(one[0]) for one in (*self.gains, self.gain, self.saturation))

    def of_numbers(self, t: Array) -> Law:
        """Return the torque of a single joint as a function of the number of an instant of t (N), of q and of dq."""
        rest, (kp, kd, gain, limit) = self.numbers(t)

        def torque(k: int, q: float, dq: float, state: Any) -> tuple[float, Any]:
            return gain * min(max(rest[k] - kp * q - kd * dq, -limit), limit), state

        return torque

    def slopes(self, seen: Seen) -> Slopes:
        """Return the derivatives, zero at saturation."""
        free = self.free(self.wanted(self.row(seen.t), seen.q, seen.dq))
        (rows, n), (kp, kd), none = seen.q.shape, self.gains, np.zeros((len(seen.t), 0, 0))
        nothing = np.zeros((rows, 0, n))
        by = diagonal(-free * kp), diagonal(-free * kd), np.zeros((rows, n, 0))
        return Slopes(by, (nothing, nothing, none))


@dataclass(frozen=True, eq=False)
class CascadePD(_Linear):
    """A drive with a position loop around a velocity loop: tau = gain clip(kv (kp (reference - q) - dq) + feedforward).

    ``t`` (N) s; ``reference`` (N, n) rad or m; ``kp`` (n) 1/s; ``kv`` (n) input per rad/s or m/s; ``gain`` (n) N m or N
    per input; ``saturation`` (n) of the input, infinite where there is none; ``feedforward`` (N, n) of the input.
    References are held constant between samples. Raises InputError where a shape does not fit.
    """

    joints: tuple[str, ...]
    t: Array
    reference: Array
    kp: Array
    kv: Array
    gain: Array
    saturation: Array
    feedforward: Array

    __repr__ = brief

    def __post_init__(self) -> None:
        self.check(kp=self.kp, kv=self.kv)

    def wanted(self, k: Any, q: Array, dq: Array) -> Array:
        """Return the input before its limit, for the references of row k."""
        return np.asarray(self.kv * (self.kp * (self.reference[k] - q) - dq) + self.feedforward[k])

    @property
    def gains(self) -> tuple[Array, Array]:
        """By what (n) the input falls with q and with dq."""
        return self.kv * self.kp, self.kv


@dataclass(frozen=True, eq=False)
class PD(_Linear):
    """tau = gain clip(kp (reference - q) + kd (velocity_reference - dq) + feedforward), in plain words a spring and a
    damper.

    As ``CascadePD``, with ``kp`` (n) input per rad or m, ``kd`` (n) input per rad/s or m/s. Without
    ``velocity_reference`` (N, n), rad/s or m/s, the damper acts on the velocity itself.
    """

    joints: tuple[str, ...]
    t: Array
    reference: Array
    kp: Array
    kd: Array
    gain: Array
    saturation: Array
    feedforward: Array
    velocity_reference: Array | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        self.check(self.velocity_reference, kp=self.kp, kd=self.kd)

    def wanted(self, k: Any, q: Array, dq: Array) -> Array:
        """Return the input before its limit, for the references of row k."""
        rate = 0.0 if self.velocity_reference is None else self.velocity_reference[k]
        return np.asarray(self.kp * (self.reference[k] - q) + self.kd * (rate - dq) + self.feedforward[k])

    @property
    def gains(self) -> tuple[Array, Array]:
        """By what (n) the input falls with q and with dq."""
        return self.kp, self.kd


class Around:
    """What a controller that remembers has from its ``loop``."""

    loop: HasTimes

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints."""
        return self.loop.joints

    @property
    def t(self) -> Array:
        """The times (N) of the references, s."""
        return self.loop.t

    def timed(self, t: Array) -> Self:
        """Return the controller with other times (N) of its references."""
        return replace(self, loop=self.loop.timed(t))  # type: ignore[type-var]

    def every(self, period: float) -> Self:
        """Return the controller as it works every ``period`` s."""
        return replace(self, loop=self.loop.every(period))  # type: ignore[type-var]

    def __call__(self, t: float, q: Array, dq: Array) -> Array:
        """Return the torque (n) for the state at time t, of the loop alone."""
        return self.loop(t, q, dq)


@dataclass(frozen=True, eq=False)
class PID(Around):
    """A PD controller with an integral: its input has ki z more, z the sum of h (reference - q) over the samples.

    ``loop`` has everything else; ``ki`` (n) input per rad s or m s. The integral stands still at a sample where the
    input is beyond its limit and it would drive it further (clamping). It begins where the torque is the measured one.
    """

    loop: PD
    ki: Array

    __repr__ = brief

    def __post_init__(self) -> None:
        if np.shape(self.ki) != (shape := (len(self.joints),)):
            raise InputError(f"controller: ki has shape {np.shape(self.ki)}, expected {shape}.")

    def begin(self, t: float, h: float, q: Array, dq: Array, tau: Array) -> Array:
        """Return the integral (n), rad s or m s, before the first sample, where the torque tau (n) was measured."""
        loop, k = self.loop, self.loop.row(t)
        asked = np.minimum(np.maximum(tau / loop.gain, -loop.saturation), loop.saturation)
        rest = (asked - loop.wanted(k, q, dq)) / np.where(self.ki, self.ki, np.inf)
        return np.asarray(rest - np.where(self.ki, h * (loop.reference[k] - q), 0.0))

    def advance(self, t: float, h: float, q: Array, dq: Array, state: Array) -> tuple[Array, Array]:
        """Return the torque (n) and the next integral (n)."""
        k = self.loop.row(t)
        wanted, _, after = self._grown(k, h, q, dq, state)
        return self.loop.limited(wanted), after

    def _grown(self, k: Any, h: Any, q: Array, dq: Array, state: Array) -> tuple[Array, Array, Array]:
        """Return the input before its limit, where the integral stands still, and the next one."""
        error = self.loop.reference[k] - q
        wanted = self.loop.wanted(k, q, dq) + self.ki * (state + h * error)
        stands = (np.abs(wanted) >= self.loop.saturation) & (wanted * self.ki * error > 0)
        return wanted, stands, np.where(stands, state, state + h * error)

    def of_numbers(self, t: Array) -> Law:
        """Return torque and next integral of a single joint, as the other loops do."""
        rest, (kp, kd, gain, limit) = self.loop.numbers(t)
        references: list[float] = self.loop.reference[self.loop.row(t), 0].tolist()
        gaps, ki = gaps_of(t).tolist(), float(self.ki[0])

        def torque(k: int, q: float, dq: float, state: float) -> tuple[float, float]:
            error = references[k] - q
            grown = state + gaps[k] * error
            wanted = rest[k] - kp * q - kd * dq + ki * grown
            stands = abs(wanted) >= limit and wanted * ki * error > 0
            return gain * min(max(wanted, -limit), limit), state if stands else grown

        return torque

    def slopes(self, seen: Seen) -> Slopes:
        """Return the derivatives, of the torque zero at saturation, of the integral 1 by itself where it stands."""
        h, one, loop = seen.h[:, None], np.ones_like(seen.q), self.loop
        wanted, stands, _ = self._grown(loop.row(seen.t), h, seen.q, seen.dq, seen.state)
        free = loop.free(wanted)
        by = (-free * (loop.kp + self.ki * h), -free * loop.kd, free * self.ki)
        then = (np.where(stands, 0.0, -h * one), 0 * one, one)
        (a, b, c), (d, e, f) = (map(diagonal, three) for three in (by, then))
        return Slopes((a, b, c), (d, e, f))


@dataclass(frozen=True, eq=False)
class Function(_Loop):
    """A controller that is a Python function: tau = gain clip(law(t, q, dq, reference) + feedforward).

    ``law`` is called once a sample with t (s), q, dq and the reference that is held there (n), in SI units, and returns
    the input (n). It must not remember anything. Everything else is as of ``CascadePD``. It raises ModelError where
    the function fails, or returns something else than n finite numbers.
    """

    joints: tuple[str, ...]
    t: Array
    reference: Array
    law: Callable[[float, Array, Array, Array], ArrayLike]
    gain: Array
    saturation: Array
    feedforward: Array

    __repr__ = brief

    def __post_init__(self) -> None:
        self.check()

    def __call__(self, t: float, q: Array, dq: Array) -> Array:
        """Return the torque (n) for the state at time t."""
        k = self.row(t)
        name = getattr(self.law, "__name__", type(self.law).__name__)
        try:
            found = np.asarray(self.law(t, q.copy(), dq.copy(), self.reference[k].copy()), dtype=float)
        except (Exception, SystemExit) as error:
            raise ModelError(f"controller: {name} failed at t = {t:.6g} s: {type(error).__name__}: {error}") from error
        if found.shape != q.shape or not np.isfinite(found).all():
            raise ModelError(
                f"controller: {name} returned {found.tolist()} at t = {t:.6g} s; return {len(q)} finite numbers, one "
                f"for each of {', '.join(self.joints)}."
            )
        return self.limited(found + self.feedforward[k])
