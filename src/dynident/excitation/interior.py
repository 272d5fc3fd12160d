"""The criterion of a motion with its limits as a logarithmic barrier, on a grid: what the search minimises.

Every motion of finite value keeps to all limits on the grid, with what lies between its points to spare: so do all that
the search keeps, whenever it is stopped (Boyd and Vandenberghe 2004, "Convex optimization", ch. 11).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.excitation.criterion import InformationCriterion
from dynident.excitation.spaces.space import Space
from dynident.excitation.trajectories.family import Family, Guard
from dynident.excitation.trajectories.feasibility import RESERVE, SPARE, Feasibility
from dynident.excitation.trajectories.limits import MotionLimits

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["Interior", "Point", "Spare"]

Array = NDArray[np.float64]
FINER = 8  # points between two of the grid
MORE = 1.5  # times what the limits were exceeded by is kept free
SHRUNK = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5)
NEAR = 0.1  # m: beyond such a distance the barrier fades


@dataclass(frozen=True, eq=False)
class Spare:
    """What is kept free on the grid for what lies between its points: as shares (n) of the torque limits, and
    of distances (P), m."""

    torque: Array
    distance: Array

    __repr__ = brief

    @classmethod
    def least(cls, feasible: Feasibility, space: Space) -> Spare:
        """Return what is kept free at least."""
        return cls(np.full(len(feasible.limits.joints), RESERVE), np.full(len(space.pairs), SPARE))

    def wider(self, other: Spare) -> Spare:
        """Return the larger of two, entry by entry."""
        return Spare(np.maximum(self.torque, other.torque), np.maximum(self.distance, other.distance))


@dataclass(frozen=True, eq=False)
class Point:
    """The ``criterion`` of coefficients, the whole ``value`` with the barrier, and its ``gradient`` (n, K)."""

    criterion: float
    value: float
    gradient: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Interior:
    """Motions of a ``family`` on a ``grid`` (N), as coefficients x (n, K), that are ``feasible``.

    ``information`` gives the criterion that is to be small, and its slopes (3, N, n) by q, dq and ddq (N, n);
    ``unit`` is how much of it weighs as much as the barrier with a weight of one. ``spare`` is kept free on the grid.
    """

    feasible: Feasibility
    space: Space
    family: Family
    grid: Array
    information: InformationCriterion
    spare: Spare
    unit: float = 1.0

    __repr__ = brief

    def wider(self, spare: Spare) -> Interior:
        """Return it with at least so much to spare."""
        return replace(self, spare=self.spare.wider(spare))

    @property
    def limits(self) -> MotionLimits:
        """The limits of the joints."""
        return self.feasible.limits

    @cached_property
    def functions(self) -> Array:
        """The functions of the family and their derivatives on the grid, (4, N, K)."""
        return self.family.values(self.grid)

    @cached_property
    def guard(self) -> Guard:
        """What keeps q, dq, ddq and the jerk within their limits at all times."""
        return self.family.guard(len(self.grid))

    def states(self, x: Array) -> Array:
        """Return q, dq, ddq and the jerk, (4, N, n)."""
        return np.asarray(self.functions @ x.T)

    def room(self, x: Array) -> Array:
        """Return what is left of the ranges of q, dq, ddq and the jerk on either side, as shares (2, R, n) of half of
        them, at the rows of the guard one below the other."""
        out = self.moved(x) - self._middle
        return np.array([self.guard.share - out, self.guard.share + out])

    def moved(self, x: Array) -> Array:
        """Return the rows of the guard (R, n) as shares of half of the ranges."""
        return np.asarray((self._rows @ x.T) / self._sizes)

    def keeps(self, x: Array) -> bool:
        """Whether a motion keeps to all limits on the grid, with what is to spare."""
        if not (self.room(x) > 0).all():
            return False
        states = self.states(x)
        push, gap = self.torque_room(states), self.gaps(states[0])
        return bool((push > 0).all() and (gap > 0).all())

    def torque_room(self, states: Array) -> Array:
        """Return what of the torque is left on either side, as shares (2, N, n)."""
        tau = self._torque(states) / self.limits.torque
        free = 1.0 - self.spare.torque
        return np.array([free - tau, free + tau])

    def torque_partials(self, states: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives of the torque by q, dq and ddq, each (N, n, n)."""
        found = self.feasible.model.partials(states[0], states[1], states[2], self.feasible.theta)
        return found.q, found.dq, found.ddq

    @cached_property
    def guard_shares(self) -> Array:
        """The rows of the guard as shares of half of each joint's ranges (n, R, K)."""
        return np.asarray(self._rows / self._sizes.T[:, :, None])

    def gaps(self, q: Array) -> Array:
        """Return the distances (N, P) in m beyond what must be kept."""
        return self.space.distances(q) - self.feasible.clearance - self.spare.distance

    def at(self, x: Array, weight: float) -> Point | None:
        """Return the value at coefficients x with a ``weight`` of the barrier; None where a limit is not kept."""
        room = self.room(x)
        if not (room > 0).all():
            return None
        states = self.states(x)
        push = self.torque_room(states)
        if not (push > 0).all():
            return None
        distances, turned = self.space.gradients(states[0])
        gap = distances - self.feasible.clearance - self.spare.distance
        if not (gap > 0).all():
            return None
        criterion, slopes = self.information.value_and_slopes(*states[:3])
        if not np.isfinite(criterion):
            return None
        share = weight * self.unit / len(self.grid)
        barrier = share * float(np.log1p(NEAR / gap).sum() - np.log(room).sum() - np.log(push).sum())
        all_slopes = np.zeros_like(states)
        all_slopes[:3] = slopes
        self._add_torque(all_slopes, states, share * (1.0 / push[0] - 1.0 / push[1]) / self.limits.torque)
        if gap.size:
            all_slopes[0] -= share * np.einsum("ip,ipj->ij", NEAR / (gap * (gap + NEAR)), turned)
        gradient = np.einsum("din,dik->nk", all_slopes, self.functions)
        gradient += share * ((1.0 / room[0] - 1.0 / room[1]) / self._sizes).T @ self._rows
        return Point(criterion, criterion + barrier, gradient)

    def metric(self, x: Array, weight: float, least: float) -> Array:
        """Return the curvature (n, K, K) of the barrier of q, dq, ddq and jerk, joint by joint; at its middle with a
        weight ``least`` more."""
        room = np.maximum(self.room(x), 0.1 * weight)
        bent = self.unit * (weight * np.square(1.0 / room).sum(axis=0) + 2 * least) / np.square(self._sizes)
        B = self._rows
        return np.asarray(np.einsum("rk,rn,rl->nkl", B, bent, B, optimize=True) / len(self.grid))

    def between(self, x: Array, model: Model) -> Spare | None:
        """Return what must be kept free so that the torque of ``model`` and the distances are kept on a grid that is
        ``FINER``, too; None where they are."""
        times = np.linspace(0.0, self.family.duration, FINER * len(self.grid) + 1)
        tau, near = self._extremes(np.asarray(self.family.values(times) @ x.T), model)
        over, under = np.maximum(tau - 1.0 + RESERVE / 2, 0.0), np.maximum(SPARE / 2 - near, 0.0)
        if not (over.any() or under.any()):
            return None
        on_grid, off = self._extremes(self.states(x), model)
        torque = np.where(over > 0, np.maximum(self.spare.torque + MORE * over, MORE * (tau - on_grid) + RESERVE), 0.0)
        distance = np.where(under > 0, np.maximum(self.spare.distance + MORE * under, MORE * (off - near) + SPARE), 0.0)
        return self.spare.wider(Spare(torque, distance))

    def _extremes(self, states: Array, model: Model) -> tuple[Array, Array]:
        """Return the largest torques (n) as shares of the limits, and the least distances (P) beyond the clearance."""
        tau = np.abs(model.torque(states[0], states[1], states[2], self.feasible.theta) / self.limits.torque)
        near = self.space.distances(states[0]).min(axis=0, initial=np.inf)
        return tau.max(axis=0), near - self.feasible.clearance

    def smaller(self, x: Array) -> Array | None:
        """Return a motion that is smaller by as little as keeps the limits; None where only half of it would."""
        pose = self.middle_of(x)
        tried = (x + share * (pose - x) for share in SHRUNK)
        return next((one for one in tried if self.keeps(one)), None)

    def middle_of(self, x: Array) -> Array:
        """Return the coefficients (n, K) of the mean pose of a motion."""
        pose = np.zeros_like(x)
        pose[:, 0] = (self.functions[0] @ x.T).mean(axis=0)
        return pose

    def _add_torque(self, slopes: Array, states: Array, forces: Array) -> None:
        """Add the slopes of the sum of ``forces`` (N, n) times the torque."""
        if not forces.any():
            return
        for k, one in enumerate(self.torque_partials(states)):
            slopes[k] += np.einsum("ij,ijk->ik", forces, one)

    def _torque(self, states: Array) -> Array:
        return self.feasible.model.torque(states[0], states[1], states[2], self.feasible.theta)

    @cached_property
    def _rows(self) -> Array:
        return np.concatenate(self.guard.rows)

    @cached_property
    def _sizes(self) -> Array:
        """Half of the range of each row (R, n)."""
        return np.repeat(self.limits.sizes, [len(rows) for rows in self.guard.rows], axis=0)

    @cached_property
    def _middle(self) -> Array:
        """The middle of the range of each row (R, n), as a share of half of it."""
        return np.asarray(
            (np.arange(len(self._rows)) < len(self.guard.rows[0]))[:, None] * self.limits.middle / self._sizes
        )
