"""The interior of the limits: motions on a grid of times, and a barrier that grows as they near a limit.

A limit holds on the grid with a reserve for what lies between its points.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from dynident.apps.excitation.criterion import InformationCriterion
from dynident.apps.excitation.family import Family, LimitConstraints
from dynident.apps.excitation.limits import DISTANCE_RESERVE, TORQUE_RESERVE, Feasibility, MotionLimits
from dynident.models import Model
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

REFINEMENT = 8  # points between two of the grid
RESERVE_FACTOR = 1.5  # times what the limits were exceeded by is kept free
SHRINK_STEPS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5)
BARRIER_DISTANCE = 0.1  # m: beyond such a distance the barrier fades


class GridReserve(Noun):
    """Reserve kept free on the grid for what lies between its points.

    ``torque`` (n) are shares of the torque limits, ``distance`` (P) is in m.
    """

    torque: Array
    distance: Array

    @classmethod
    def minimum(cls, feasible: Feasibility) -> GridReserve:
        """Return the smallest reserve that is kept free."""
        joints, pairs = len(feasible.limits.joints), len(feasible.space.pairs)
        return cls(np.full(joints, TORQUE_RESERVE), np.full(pairs, DISTANCE_RESERVE))


class BarrierPoint(Noun):
    """The ``criterion`` at coefficients ``x`` (n, K), the ``value`` with the barrier, and its ``gradient`` (n, K)."""

    x: Array
    criterion: float
    value: float
    gradient: Array


class Interior(Noun):
    """Barrier problem for motions of a ``family`` on a ``grid`` (N), with coefficients x (n, K).

    ``information`` gives the criterion to minimise, and its derivatives (3, N, n) by q, dq and ddq (N, n); ``unit`` is
    the amount of it that weighs as much as the barrier with a weight of one. ``spare`` is kept free on the grid.
    """

    feasible: Feasibility
    family: Family
    grid: Array
    information: InformationCriterion
    spare: GridReserve
    unit: float = 1.0

    def with_reserve(self, reserve: GridReserve) -> Interior:
        """Return the problem with at least this reserve."""
        torque = np.maximum(self.spare.torque, reserve.torque)
        return replace(self, spare=GridReserve(torque, np.maximum(self.spare.distance, reserve.distance)))

    @property
    def limits(self) -> MotionLimits:
        """The limits of the joints."""
        return self.feasible.limits

    @cached_property
    def functions(self) -> Array:
        """Functions of the family and their derivatives on the grid, (4, N, K)."""
        return self.family.values(self.grid)

    @cached_property
    def guard(self) -> LimitConstraints:
        """Constraints that keep q, dq, ddq and the jerk within their limits at all times."""
        return self.family.guard(len(self.grid))

    def states(self, x: Array) -> Array:
        """Return q, dq, ddq and the jerk, (4, N, n)."""
        return np.asarray(self.functions @ x.T)

    def range_slack(self, x: Array) -> Array:
        """Return the slack of the ranges of q, dq, ddq and jerk on either side, as shares (2, R, n) of half a range.

        The R rows are those of the constraints, one derivative below the other.
        """
        offset = self.constraint_values(x) - self._row_middles
        return np.array([self.guard.share - offset, self.guard.share + offset])

    def constraint_values(self, x: Array) -> Array:
        """Return the rows of the constraints (R, n) as shares of half of the ranges."""
        return np.asarray((self._rows @ x.T) / self._row_sizes)

    def is_inside(self, x: Array) -> bool:
        """Return whether a motion keeps to all limits on the grid, with the reserve."""
        if not (self.range_slack(x) > 0).all():
            return False
        states = self.states(x)
        push, distances = self.torque_slack(states), self.gaps(states[0])
        return bool((push > 0).all() and (distances > 0).all())

    def torque_slack(self, states: Array) -> Array:
        """Return the slack of the torque on either side, as shares (2, N, n)."""
        tau = self.feasible.model.torque(states[0], states[1], states[2], self.feasible.theta) / self.limits.torque
        limit = 1.0 - self.spare.torque
        return np.array([limit - tau, limit + tau])

    def torque_partials(self, states: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives of the torque by q, dq and ddq, each (N, n, n)."""
        partials = self.feasible.model.partials(states[0], states[1], states[2], self.feasible.theta)
        return partials.q, partials.dq, partials.ddq

    @cached_property
    def guard_shares(self) -> Array:
        """Rows of the constraints as shares of half of each joint's ranges, (n, R, K)."""
        return np.asarray(self._rows / self._row_sizes.T[:, :, None])

    def gaps(self, q: Array) -> Array:
        """Return the distances (N, P) in m beyond the clearance and the reserve."""
        return self.feasible.space.distances(q) - self.feasible.clearance - self.spare.distance

    def at(self, x: Array, weight: float) -> BarrierPoint | None:
        """Evaluate the criterion and a barrier of this ``weight`` at coefficients x; None where a limit is not kept."""
        room = self.range_slack(x)
        # check the limits from the cheapest to the most expensive: most trial points fail early
        if not (room > 0).all():
            return None
        states = self.states(x)
        push = self.torque_slack(states)
        if not (push > 0).all():
            return None
        distances, distance_gradients = self.feasible.space.gradients(states[0])
        gaps = distances - self.feasible.clearance - self.spare.distance
        if not (gaps > 0).all():
            return None
        criterion, criterion_gradients = self.information.value_and_gradients(*states[:3])
        if not np.isfinite(criterion):
            return None
        share = weight * self.unit / len(self.grid)
        # log(1 + d0 / gap) behaves like -log(gap) near contact, and fades where bodies are far apart
        barrier = share * float(np.log1p(BARRIER_DISTANCE / gaps).sum() - np.log(room).sum() - np.log(push).sum())
        state_gradients = np.zeros_like(states)
        state_gradients[:3] = criterion_gradients
        # sum of the torque times weights: one pass of derivatives for all torque limits
        torque_weights = share * (1.0 / push[0] - 1.0 / push[1]) / self.limits.torque
        if torque_weights.any():
            for k, partial in enumerate(self.torque_partials(states)):
                state_gradients[k] += np.einsum("ij,ijk->ik", torque_weights, partial)
        if gaps.size:
            state_gradients[0] -= share * np.einsum(
                "ip,ipj->ij", BARRIER_DISTANCE / (gaps * (gaps + BARRIER_DISTANCE)), distance_gradients
            )
        gradient = np.einsum("din,dik->nk", state_gradients, self.functions)
        gradient += share * ((1.0 / room[0] - 1.0 / room[1]) / self._row_sizes).T @ self._rows
        return BarrierPoint(x, criterion, criterion + barrier, gradient)

    def barrier_curvature(self, x: Array, weight: float, centre_weight: float) -> Array:
        """Return the curvature (n, K, K) of the barrier of q, dq, ddq and jerk, joint by joint.

        The curvature in the middle of the limits is added with the weight ``centre_weight``.
        """
        # a floor of the slack bounds the curvature next to a limit
        room = np.maximum(self.range_slack(x), 0.1 * weight)
        weights = (
            self.unit * (weight * np.square(1.0 / room).sum(axis=0) + 2 * centre_weight) / np.square(self._row_sizes)
        )
        B = self._rows
        return np.asarray(np.einsum("rk,rn,rl->nkl", B, weights, B, optimize=True) / len(self.grid))

    def between(self, x: Array, model: Model) -> GridReserve | None:
        """Return the reserve that keeps the torque of ``model`` and the distances also between the points of the grid.

        They are computed on a grid that is ``REFINEMENT`` times as fine. None where the limits are kept there.
        """
        times = np.linspace(0.0, self.family.duration, REFINEMENT * len(self.grid) + 1)
        # what the grid misses shows on a grid eight times as fine
        tau, gaps = self._extremes(np.asarray(self.family.values(times) @ x.T), model)
        torque_excess = np.maximum(tau - 1.0 + TORQUE_RESERVE / 2, 0.0)
        missing_distance = np.maximum(DISTANCE_RESERVE / 2 - gaps, 0.0)
        if not (torque_excess.any() or missing_distance.any()):
            return None
        grid_torque, grid_gaps = self._extremes(self.states(x), model)
        # keep free what was exceeded, or what the finer grid found beyond the coarse one, with some more
        more_torque = self.spare.torque + RESERVE_FACTOR * torque_excess
        torque = np.maximum(more_torque, RESERVE_FACTOR * (tau - grid_torque) + TORQUE_RESERVE)
        more_distance = self.spare.distance + RESERVE_FACTOR * missing_distance
        distance = np.maximum(more_distance, RESERVE_FACTOR * (grid_gaps - gaps) + DISTANCE_RESERVE)
        return GridReserve(torque * (torque_excess > 0), distance * (missing_distance > 0))

    def _extremes(self, states: Array, model: Model) -> tuple[Array, Array]:
        """Return the largest torques (n) as shares of the limits, and the least distances (P) beyond the clearance."""
        tau = np.abs(model.torque(states[0], states[1], states[2], self.feasible.theta) / self.limits.torque)
        distances = self.feasible.space.distances(states[0]).min(axis=0, initial=np.inf)
        return tau.max(axis=0), distances - self.feasible.clearance

    def shrink(self, x: Array) -> Array | None:
        """Shrink a motion as little as keeps the limits; None where even half of it does not."""
        pose = self.mean_pose(x)
        # shrink towards the mean pose: velocities, accelerations and torques of motion fall with the size
        candidates = (x + share * (pose - x) for share in SHRINK_STEPS)
        return next((motion for motion in candidates if self.is_inside(motion)), None)

    def mean_pose(self, x: Array) -> Array:
        """Return the coefficients (n, K) of the mean pose of a motion."""
        pose = np.zeros_like(x)
        pose[:, 0] = (self.functions[0] @ x.T).mean(axis=0)
        return pose

    @cached_property
    def _rows(self) -> Array:
        return np.concatenate(self.guard.rows)

    @cached_property
    def _row_sizes(self) -> Array:
        """Half of the range of each row (R, n)."""
        return np.repeat(self.limits.sizes, [len(rows) for rows in self.guard.rows], axis=0)

    @cached_property
    def _row_middles(self) -> Array:
        """Middle of the range of each row (R, n), as a share of half of it."""
        return np.asarray(
            (np.arange(len(self._rows)) < len(self.guard.rows[0]))[:, None] * self.limits.middle / self._row_sizes
        )
