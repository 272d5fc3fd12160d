"""The motion of an arm over one step, as the torque drives it, with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models import Model

__all__ = ["Dynamics"]

Array = NDArray[np.float64]
ORDER = 4  # of the exponential's series, within a part of a step


@dataclass(frozen=True, eq=False)
class Dynamics:
    """A ``model`` with parameters theta = ``theta`` (p) + ``directions`` (p, r) a, in steps each in so many
    ``parts``. A state (2 n + r) is q, dq and a, the ``step`` (B) of each in s. ``within`` is the noise of the
    torque's first moment over a step, in step^2 times that of its mean: it moves q, not dq."""

    model: Model
    theta: Array
    directions: Array
    parts: int
    within: float

    __repr__ = brief

    @property
    def joints(self) -> int:
        """The number n of joints."""
        return len(self.model.joints)

    def parameters(self, x: Array) -> Array:
        """Return theta (B, p) of states (B, 2 n + r)."""
        return np.asarray(self.theta + x[:, 2 * self.joints :] @ self.directions.T)

    def moved(self, step: Array, x: Array, mean: Array, slope: Array) -> Array:
        """Return the states (B, 2 n + r) after a step under the torque mean + slope (t - step / 2), (B, n), by the
        classical Runge-Kutta method."""
        n, h, theta = self.joints, step[:, None] / self.parts, self.parameters(x)
        q, dq = x[:, :n], x[:, n : 2 * n]
        for k in range(self.parts):
            tau = [mean + slope * (h * (k + share) - step[:, None] / 2) for share in (0.0, 0.5, 1.0)]
            a = self._rate(q, dq, tau[0], theta)
            b = self._rate(q + h / 2 * dq, dq + h / 2 * a, tau[1], theta)
            c = self._rate(q + h / 2 * (dq + h / 2 * a), dq + h / 2 * b, tau[1], theta)
            d = self._rate(q + h * (dq + h / 2 * b), dq + h * c, tau[2], theta)
            q, dq = q + h * dq + h * h / 6 * (a + b + c), dq + h / 6 * (a + 2 * b + 2 * c + d)
        return np.concatenate([q, dq, x[:, 2 * n :]], axis=1)

    def slopes(self, step: Array, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array]:
        """Return the derivatives of the state after a step by that before, (B, L, L), and by mean and moment of the
        torque, (B, L, 2 n), with the model linearised at a motion (B, n) and ``theta``.

        At the motion that the noisy torque makes, a regressor with noise would seem to tell more than it does.
        """
        n, r, h = self.joints, self.directions.shape[1], step[:, None, None] / self.parts
        mass = self.model.mass_matrix(q, self.theta)
        by = self.model.partials(q, dq, ddq, self.theta)
        by_a = self.model.regressor(q, dq, ddq) @ self.directions
        sides = np.concatenate([-by.q, -by.dq, -by_a, np.broadcast_to(np.eye(n), mass.shape)], axis=2)
        solved: Array = np.asarray(np.linalg.solve(mass, sides), dtype=np.float64)
        A = np.zeros((len(q), 2 * n, 2 * n))
        A[:, :n, n:], A[:, n:] = np.eye(n), solved[:, :, : 2 * n]
        B = np.zeros((len(q), 2 * n, r + n))
        B[:, n:] = solved[:, :, 2 * n :]
        F, G = _discrete(A, B, h)
        whole, pushed = F, G
        for _ in range(self.parts - 1):
            whole, pushed = F @ whole, F @ pushed + G
        out = np.tile(np.eye(2 * n + r), (len(q), 1, 1))
        out[:, : 2 * n, : 2 * n], out[:, : 2 * n, 2 * n :] = whole, pushed[:, :, :r]
        push = np.concatenate([pushed[:, :, r:], np.zeros((len(q), r, n))], axis=1)
        return out, np.concatenate([push, self._moment(step, solved[:, :, 2 * n + r :], 2 * n + r)], axis=2)

    def push(self, step: Array, x: Array) -> Array:
        """Return what mean and moment of the torque do to the state in a step, (B, L, 2 n), by the mass alone."""
        n, h = self.joints, step[:, None, None]
        inverse: Array = np.asarray(
            np.linalg.inv(self.model.mass_and_bias(x[:, :n], x[:, n : 2 * n], self.parameters(x))[0]), dtype=np.float64
        )
        still = np.zeros((len(x), x.shape[1] - 2 * n, n))
        push = np.concatenate([h * h / 2 * inverse, h * inverse, still], axis=1)
        return np.concatenate([push, self._moment(step, inverse, x.shape[1])], axis=2)

    def _moment(self, step: Array, inverse: Array, size: int) -> Array:
        out = np.zeros((len(inverse), size, self.joints))
        out[:, : self.joints] = self.within * np.square(step)[:, None, None] * inverse
        return out

    def _rate(self, q: Array, dq: Array, tau: Array, theta: Array) -> Array:
        mass, bias = self.model.mass_and_bias(q, dq, theta)
        return np.asarray(np.linalg.solve(mass, (tau - bias)[..., None])[..., 0])


def _discrete(A: Array, B: Array, h: Array) -> tuple[Array, Array]:
    """Return exp(A h) and the integral of exp(A s) B over h."""
    F = np.tile(np.eye(A.shape[1]), (len(A), 1, 1))
    inner, power = F.copy(), F.copy()
    for k in range(1, ORDER + 1):
        power = power @ A * (h / k)
        F = F + power
        inner = inner + power / (k + 1)
    return F, inner @ B * h
