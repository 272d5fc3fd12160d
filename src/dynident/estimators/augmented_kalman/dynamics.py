"""How an arm departs from its smoothed motion over one step, as the torque drives it.

The measured motion is where friction and mass are evaluated, so that neither a joint that sticks nor stiff friction can
make a prediction run away; what is stiff passes through the exact exponential.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models import Model

__all__ = ["Dynamics"]

Array = NDArray[np.float64]
ORDER = 6  # of the exponential's series
SMALL, MOST = 0.25, 40  # size of what is put into the series; doublings at most


@dataclass(frozen=True, eq=False)
class Dynamics:
    """A ``model`` with parameters theta = ``theta`` (p) + ``directions`` (p, r) a.

    A state (L = 2 n + r) is what q and dq differ from the smoothed ones by, and a. ``within`` is the noise of the
    torque's first moment over a step, in step^2 times that of its mean: it moves q, not dq.
    """

    model: Model
    theta: Array
    directions: Array
    within: float

    __repr__ = brief

    @property
    def joints(self) -> int:
        """The number n of joints."""
        return len(self.model.joints)

    def linear(self, step: Array, motion: Array, left: Array) -> tuple[Array, Array, Array]:
        """Return F (B, L, L), G (B, L, 2 n) and c (B, L): a state x is F x + c after a ``step`` (B) in s at the mean
        ``motion`` (3, B, n), where theta leaves so much torque on average, (B, n). G are the derivatives by the mean
        torque and by its moment.

        At the motion that the noisy torque makes, a regressor with noise would seem to tell more than it does.
        """
        n, r = self.joints, self.directions.shape[1]
        mass, by = (
            self.model.mass_matrix(motion[0], self.theta),
            self.model.partials(motion[0], motion[1], motion[2], self.theta),
        )
        by_a = self.model.regressor(*motion) @ self.directions
        unit = np.broadcast_to(np.eye(n), mass.shape)
        sides = np.concatenate([-by.q, -by.dq, -by_a, unit, left[..., None]], axis=2)
        solved: Array = np.asarray(np.linalg.solve(mass, sides), dtype=np.float64)
        whole, inner = _exponential(step, solved[:, :, : 2 * n])
        pushed = inner[:, :, n:] @ solved[:, :, 2 * n :]
        F = np.tile(np.eye(2 * n + r), (len(mass), 1, 1))
        F[:, : 2 * n, : 2 * n], F[:, : 2 * n, 2 * n :] = whole, pushed[:, :, :r]
        rest = np.concatenate([pushed[:, :, r:], np.zeros((len(mass), r, n + 1))], axis=1)
        moment = np.zeros((len(mass), 2 * n + r, n))
        moment[:, :n] = self.within * np.square(step)[:, None, None] * solved[:, :, 2 * n + r : -1]
        return F, np.concatenate([rest[:, :, :n], moment], axis=2), rest[:, :, n]

    def moved(self, step: Array, motion: Array, left: Array, x: Array) -> Array:
        """Return states (B, C, L) after the step, by the model at each of them: the exponential Euler method."""
        n, (size, count, _) = self.joints, x.shape
        flat = x.reshape(size * count, -1)
        q, dq, ddq, push = (
            np.repeat(one, count, axis=0)
            for one in (*motion, left + self.model.torque(motion[0], motion[1], motion[2], self.theta))
        )
        mass, bias = self.model.mass_and_bias(
            q + flat[:, :n], dq + flat[:, n : 2 * n], self.theta + flat[:, 2 * n :] @ self.directions.T
        )
        rate = np.linalg.solve(mass, (push - bias)[..., None])[..., 0] - ddq
        by = self.model.partials(motion[0], motion[1], motion[2], self.theta)
        at = np.linalg.solve(self.model.mass_matrix(motion[0], self.theta), -np.concatenate([by.q, by.dq], axis=2))
        _, inner = _exponential(step, np.asarray(at, dtype=np.float64))
        change = np.concatenate([flat[:, n : 2 * n], rate], axis=1).reshape(size, count, 2 * n)
        out = x.copy()
        out[:, :, : 2 * n] += change @ np.swapaxes(inner, 1, 2)
        return out


def _exponential(step: Array, rates: Array) -> tuple[Array, Array]:
    """Return exp(A h) and the integral of exp(A s) over h, (B, 2 n, 2 n); ``rates`` (B, n, 2 n) are the last rows of
    A."""
    n = rates.shape[1]
    A = np.zeros((len(rates), 2 * n, 2 * n))
    A[:, :n, n:], A[:, n:] = np.eye(n), rates
    size = float((np.abs(A).sum(axis=2).max(axis=1) * step).max(initial=0.0))
    doublings = int(np.clip(np.ceil(np.log2(max(size, SMALL) / SMALL)), 0, MOST)) if np.isfinite(size) else 0
    h = (step / 2.0**doublings)[:, None, None]
    F = np.tile(np.eye(2 * n), (len(A), 1, 1))
    inner, power = F.copy(), F.copy()
    for k in range(1, ORDER + 1):
        power = power @ A * (h / k)
        F, inner = F + power, inner + power / (k + 1)
    inner = inner * h
    for _ in range(doublings):
        F, inner = F @ F, inner + F @ inner
    return F, inner
