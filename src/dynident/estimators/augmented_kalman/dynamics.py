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
    """A ``model`` with parameters theta = ``theta`` (p) + ``directions`` (p, r) a. A state (L = 2 n + r) is what q and dq
    differ from the smoothed ones by, and a. ``within`` is the noise of the torque's first moment over a step, in step^2
    times that of its mean: it moves q, not dq."""

    model: Model
    theta: Array
    directions: Array
    within: float

    __repr__ = brief

    @property
    def joints(self) -> int:
        """The number n of joints."""
        return len(self.model.joints)

    def linear(self, step: Array, motion: Array, tau: Array) -> tuple[Array, Array, Array]:
        """Return F (B, L, L), G (B, L, 2 n) and c (B, L): a state x is F x + c after a ``step`` (B) in s at the mean
        ``motion`` (3, B, n) under the mean torque (B, n), of which G has the derivatives, by its moment, too.

        At the motion that the noisy torque makes, a regressor with noise would seem to tell more than it does.
        """
        n, r = self.joints, self.directions.shape[1]
        mass, by = self.model.mass_matrix(motion[0], self.theta), self.model.partials(*motion, self.theta)
        by_a = self.model.regressor(*motion) @ self.directions
        left = (tau - self.model.torque(*motion, self.theta))[..., None]
        sides = np.concatenate([-by.q, -by.dq, -by_a, np.broadcast_to(np.eye(n), mass.shape), left], axis=2)
        solved: Array = np.asarray(np.linalg.solve(mass, sides), dtype=np.float64)
        whole, inner = _exponential(step, solved[:, :, : 2 * n])
        pushed = inner[:, :, n:] @ solved[:, :, 2 * n :]
        F = np.tile(np.eye(2 * n + r), (len(mass), 1, 1))
        F[:, : 2 * n, : 2 * n], F[:, : 2 * n, 2 * n :] = whole, pushed[:, :, :r]
        rest = np.concatenate([pushed[:, :, r:], np.zeros((len(mass), r, n + 1))], axis=1)
        moment = np.zeros((len(mass), 2 * n + r, n))
        moment[:, :n] = self.within * np.square(step)[:, None, None] * solved[:, :, 2 * n + r : -1]
        return F, np.concatenate([rest[:, :, :n], moment], axis=2), rest[:, :, n]

    def moved(self, step: Array, motion: Array, tau: Array, x: Array) -> Array:
        """Return states (B, C, L) after the step, by the model at each of them: the exponential Euler method."""
        n, (size, count, _) = self.joints, x.shape
        flat = x.reshape(size * count, -1)
        q, dq, ddq, push = (np.repeat(one, count, axis=0) for one in (*motion, tau))
        mass, bias = self.model.mass_and_bias(
            q + flat[:, :n], dq + flat[:, n : 2 * n], self.theta + flat[:, 2 * n :] @ self.directions.T
        )
        rate = np.linalg.solve(mass, (push - bias)[..., None])[..., 0] - ddq
        by = self.model.partials(*motion, self.theta)
        at = np.linalg.solve(
            self.model.mass_matrix(motion[0], self.theta), -np.concatenate([by.q, by.dq], axis=2)
        )
        _, inner = _exponential(step, np.asarray(at, dtype=np.float64))
        change = np.concatenate([flat[:, n : 2 * n], rate], axis=1).reshape(size, count, 2 * n)
        out = x.copy()
        out[:, :, : 2 * n] += change @ np.swapaxes(inner, 1, 2)
        return out


def _exponential(step: Array, rates: Array) -> tuple[Array, Array]:
    """Return exp(A h) and the integral of exp(A s) over h, (B, 2 n, 2 n), for d dq / dt = ``rates`` (B, n, 2 n) (q, dq)."""
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
