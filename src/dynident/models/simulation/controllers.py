"""Controllers of joints, each with the references that were recorded: what drives a model in a closed loop.

All hold their references constant from one of their times to the next, and limit their input before its gain.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from dynident.models.simulation.steps import ScalarLaw
from dynident.models.simulation.trace import ControllerInput, ControllerSlopes, diagonal, drive_times, sample_gaps
from dynident.motion.log import Controller, HasState
from dynident.runtime import ConfigError, InputError, ModelError, Noun
from dynident.runtime.arrays import Array


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


SIGNALS, GAINS = ("reference", "feedforward", "velocity_reference"), ("kp", "kv", "kd", "gain", "saturation")


class _ReferenceLoop:
    """Base of the loops: tau = gain clip(input), joint by joint, with references that are held."""

    joints: tuple[str, ...]
    t: Array
    reference: Array
    gain: Array
    saturation: Array
    feedforward: Array

    def __post_init__(self) -> None:
        n, rows = len(self.joints), len(self.t)
        for name, shape in {**dict.fromkeys(SIGNALS, (rows, n)), **dict.fromkeys(GAINS, (n,))}.items():
            array = getattr(self, name, None)
            if array is not None and np.shape(array) != shape:
                raise InputError(f"controller: {name} has shape {np.shape(array)}, expected {shape}.")

    def timed(self, t: Array) -> Self:
        """Return the controller with other times (N) of its references."""
        return replace(self, t=t)  # type: ignore[type-var]

    def every(self, period: float) -> Self:
        """Return the controller as it works every ``period`` s: references are interpolated linearly between samples.

        Raises InputError where no whole number of periods fits between these.
        """
        t, resampled = drive_times(self.t, period), {}
        for name in SIGNALS:
            if (signal := getattr(self, name, None)) is not None:
                resampled[name] = np.column_stack([np.interp(t, self.t, column) for column in signal.T])
        return replace(self, t=t, **resampled)  # type: ignore[type-var]

    def row(self, t: Any) -> Any:
        """Return the row of the references that is held at time t; times that differ by rounding are a sample's."""
        return np.maximum(np.searchsorted(self.t, t + 1e-9) - 1, 0)

    def saturate(self, unlimited: Array) -> Array:
        """Return the torque of an input before its limit."""
        return np.asarray(self.gain * np.minimum(np.maximum(unlimited, -self.saturation), self.saturation))

    def free_gain(self, unlimited: Array) -> Array:
        """Return the gain where the input is not limited, else zero."""
        return np.where(np.abs(unlimited) < self.saturation, self.gain, 0.0)


class _Linear(_ReferenceLoop, ABC):
    """A loop whose input is linear in the state."""

    velocity_reference: Array | None = None

    @property
    @abstractmethod
    def gains(self) -> tuple[Array, Array]:
        """The factors (n) by which the input falls with q and with dq."""

    def unlimited_input(self, k: Any, q: Array, dq: Array) -> Array:
        """Return the input before its limit, for the references of row k."""
        (kp, kd), rate = self.gains, 0.0 if self.velocity_reference is None else self.velocity_reference[k]
        return np.asarray(kp * (self.reference[k] - q) + kd * (rate - dq) + self.feedforward[k])

    def __call__(self, t: float, q: Array, dq: Array) -> Array:
        """Return the torque (n) for the state at time t."""
        return self.saturate(self.unlimited_input(self.row(t), q, dq))

    def scalar_coefficients(self, t: Array) -> tuple[list[float], tuple[float, ...]]:
        """Return what makes the torque of a single joint.

        These are the input at times t (N) for q = dq = 0; and the gains of q and of dq, the gain of the torque, and
        the limit of the input.
        """
        input_at_rest: list[float] = self.unlimited_input(self.row(t), np.zeros(1), np.zeros(1))[:, 0].tolist()
        return input_at_rest, tuple(float(array[0]) for array in (*self.gains, self.gain, self.saturation))

    def scalar_law(self, t: Array) -> ScalarLaw:
        """Return the torque of a single joint as a function of the number of an instant of t (N), of q and of dq."""
        input_at_rest, (kp, kd, gain, limit) = self.scalar_coefficients(t)

        def torque(k: int, q: float, dq: float, state: Any) -> tuple[float, Any]:
            return gain * min(max(input_at_rest[k] - kp * q - kd * dq, -limit), limit), state

        return torque

    def slopes(self, inputs: ControllerInput) -> ControllerSlopes:
        """Return the derivatives, zero at saturation."""
        # the input has no slope beyond its limit
        gain = self.free_gain(self.unlimited_input(self.row(inputs.t), inputs.q, inputs.dq))
        (rows, n), (kp, kd), none = inputs.q.shape, self.gains, np.zeros((len(inputs.t), 0, 0))
        nothing = np.zeros((rows, 0, n))
        by_state = diagonal(-gain * kp), diagonal(-gain * kd), np.zeros((rows, n, 0))
        return ControllerSlopes(by_state, (nothing, nothing, none))


class CascadePD(Noun, _Linear):
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

    @property
    def gains(self) -> tuple[Array, Array]:
        """The factors (n) by which the input falls with q and with dq."""
        return self.kv * self.kp, self.kv


class PD(Noun, _Linear):
    """tau = gain clip(kp (reference - q) + kd (velocity_reference - dq) + feedforward): a spring and a damper.

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

    @property
    def gains(self) -> tuple[Array, Array]:
        """The factors (n) by which the input falls with q and with dq."""
        return self.kp, self.kd


class LoopWrapper:
    """Base of controllers that remember something around a ``loop``."""

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


class PID(Noun, LoopWrapper):
    """A PD controller with an integral: its input has ki z more, z the sum of h (reference - q) over the samples.

    ``loop`` has everything else; ``ki`` (n) input per rad s or m s. The integral stands still at a sample where the
    input is beyond its limit and it would drive it further (clamping). It begins where the torque is the measured one.
    """

    loop: PD
    ki: Array

    def __post_init__(self) -> None:
        if np.shape(self.ki) != (shape := (len(self.joints),)):
            raise InputError(f"controller: ki has shape {np.shape(self.ki)}, expected {shape}.")

    def begin(self, t: float, h: float, q: Array, dq: Array, tau: Array) -> Array:
        """Return the integral (n), rad s or m s, before the first sample, where the torque tau (n) was measured."""
        loop, k = self.loop, self.loop.row(t)
        # the measured torque, within what the loop can give
        measured_input = np.minimum(np.maximum(tau / loop.gain, -loop.saturation), loop.saturation)
        # solve the input for the integral after the sample, then take the sample's share away
        integral = (measured_input - loop.unlimited_input(k, q, dq)) / np.where(self.ki, self.ki, np.inf)
        return np.asarray(integral - np.where(self.ki, h * (loop.reference[k] - q), 0.0))

    def advance(self, t: float, h: float, q: Array, dq: Array, state: Array) -> tuple[Array, Array]:
        """Return the torque (n) and the next integral (n)."""
        k = self.loop.row(t)
        unlimited, _, after = self._integrate(k, h, q, dq, state)
        return self.loop.saturate(unlimited), after

    def _integrate(self, k: Any, h: Any, q: Array, dq: Array, state: Array) -> tuple[Array, Array, Array]:
        """Return the input before its limit, where the integral stands still, and the next one."""
        error = self.loop.reference[k] - q
        unlimited = self.loop.unlimited_input(k, q, dq) + self.ki * (state + h * error)
        # clamping: at its limit the input must not be driven further by the integral
        stands = (np.abs(unlimited) >= self.loop.saturation) & (unlimited * self.ki * error > 0)
        return unlimited, stands, np.where(stands, state, state + h * error)

    def scalar_law(self, t: Array) -> ScalarLaw:
        """Return torque and next integral of a single joint, as the other loops do."""
        input_at_rest, (kp, kd, gain, limit) = self.loop.scalar_coefficients(t)
        references: list[float] = self.loop.reference[self.loop.row(t), 0].tolist()
        gaps, ki = sample_gaps(t).tolist(), float(self.ki[0])

        def torque(k: int, q: float, dq: float, state: float) -> tuple[float, float]:
            error = references[k] - q
            grown = state + gaps[k] * error
            unlimited = input_at_rest[k] - kp * q - kd * dq + ki * grown
            stands = abs(unlimited) >= limit and unlimited * ki * error > 0
            return gain * min(max(unlimited, -limit), limit), state if stands else grown

        return torque

    def slopes(self, inputs: ControllerInput) -> ControllerSlopes:
        """Return the derivatives.

        Those of the torque are zero at saturation; where the integral stands still, it depends on itself alone.
        """
        h, ones, loop = inputs.h[:, None], np.ones_like(inputs.q), self.loop
        unlimited, stands, _ = self._integrate(loop.row(inputs.t), h, inputs.q, inputs.dq, inputs.state)
        free = loop.free_gain(unlimited)
        torque_slopes = (-free * (loop.kp + self.ki * h), -free * loop.kd, free * self.ki)
        integral_slopes = (np.where(stands, 0.0, -h * ones), 0 * ones, ones)
        (a, b, c), (d, e, f) = (map(diagonal, triple) for triple in (torque_slopes, integral_slopes))
        return ControllerSlopes((a, b, c), (d, e, f))


class Function(Noun, _ReferenceLoop):
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

    def __call__(self, t: float, q: Array, dq: Array) -> Array:
        """Return the torque (n) for the state at time t."""
        k = self.row(t)
        name = getattr(self.law, "__name__", type(self.law).__name__)
        try:
            output = np.asarray(self.law(t, q.copy(), dq.copy(), self.reference[k].copy()), dtype=float)
        except (Exception, SystemExit) as error:
            raise ModelError(f"controller: {name} failed at t = {t:.6g} s: {type(error).__name__}: {error}") from error
        if output.shape != q.shape or not np.isfinite(output).all():
            raise ModelError(
                f"controller: {name} returned {output.tolist()} at t = {t:.6g} s; return {len(q)} finite numbers, one "
                f"for each of {', '.join(self.joints)}."
            )
        return self.saturate(output + self.feedforward[k])


MAX_STEPS = 100


class DifferencingLoop(Noun, LoopWrapper):
    """A ``loop`` whose velocity is the difference of positions ``steps`` of its steps apart, over their time.

    That is the mean of the last differences over one step, which it remembers; steps are of equal length. Before
    the first sample the velocity has been that of the start. Raises ConfigError where steps is not from 1 to 100.
    """

    loop: HasTimes
    steps: int

    def __post_init__(self) -> None:
        if not 1 <= self.steps <= MAX_STEPS:
            raise ConfigError(f"steps = {self.steps}; give a whole number from 1 to {MAX_STEPS}.")

    def begin(self, t: float, h: float, q: Array, dq: Array, tau: Array) -> Array:
        """Return the last differences and the state of the loop before the first sample."""
        inner = self.loop.begin(t, h, q, dq, tau) if isinstance(self.loop, HasState) else np.zeros(0)
        return np.concatenate((np.tile(dq, self.steps - 1), inner))

    def advance(self, t: float, h: float, q: Array, dq: Array, state: Array) -> tuple[Array, Array]:
        """Return the torque (n) and the next state."""
        history, inner = np.split(state, [(self.steps - 1) * len(q)])
        # dq is the difference over the last step: the mean of it and those remembered
        rate = (dq + history.reshape(-1, len(q)).sum(axis=0)) / self.steps
        if isinstance(self.loop, HasState):
            tau, inner = self.loop.advance(t, h, q, rate, inner)
        else:
            tau = self.loop(t, q, rate)
        return tau, np.concatenate((np.concatenate((dq, history))[: len(history)], inner))

    def slopes(self, inputs: ControllerInput) -> ControllerSlopes:
        """Return the derivatives; those of the loop by its velocity are shared equally by the differences."""
        rows, n = inputs.q.shape
        count = (self.steps - 1) * n
        history, inner = np.split(inputs.state, [count], axis=1)
        rate = (inputs.dq + history.reshape(rows, -1, n).sum(axis=1)) / self.steps
        loop_slopes = replace(inputs, dq=rate, state=inner).slopes_of(self.loop)
        # dq and each remembered difference have an equal share of the velocity
        shared_slopes = ((by_q, by_dq / self.steps, by_z) for by_q, by_dq, by_z in (loop_slopes.tau, loop_slopes.state))
        tau, inner_state = (
            (by_q, share, np.concatenate((np.tile(share, (1, 1, self.steps - 1)), by_z), axis=2))
            for by_q, share, by_z in shared_slopes
        )
        # the differences move on by one step: dq comes first, and the oldest is forgotten
        width = n + count + inner.shape[1]
        shift = np.broadcast_to(np.eye(count, width), (rows, count, width))
        history_slopes = np.zeros((rows, count, n)), shift[..., :n], shift[..., n:]
        by_q, by_dq, by_z = (np.concatenate(pair, axis=1) for pair in zip(history_slopes, inner_state, strict=True))
        return ControllerSlopes(tau, (by_q, by_dq, by_z))
