"""One recording in eq. (7): its spline trajectory, and the residuals of its positions and torques."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.maximum_likelihood.trajectory import Arrow, Basis, SplineTrajectory, TrajectoryBlock, basis
from dynident.models import Model
from dynident.motion.log import Log, Motion
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

GAUSS_POINTS = 8  # of Gauss's rule, for the samples of one interval
CACHED_RULES, MAX_CACHED_SAMPLES = 8, 10_000  # rules kept for other recordings, and samples of one that is too large
MAX_POLYNOMIAL_RESIDUAL = 0.03  # standard deviations of a sample: torques this close to a polynomial count as one


class Torques(Noun):
    """Torques tau (K, n) at times t (K), each standing for ``weight`` (K, n) samples.

    The squared distances of all samples from a smooth f sum to those of weight (tau - f(t))^2, plus ``scatter`` (n).
    """

    t: Array
    tau: Array
    weight: Array
    scatter: Array

    @classmethod
    def of(cls, log: Log, time_offset: float = 0.0, used_torques: NDArray[np.bool_] | None = None) -> Torques:
        """Return the samples of a log at which the positions, ``time_offset`` (s) late, show the motion.

        Samples outside ``used_torques`` (N, n) have weight zero.
        """
        t = log.t
        keep = (t >= t[0] - time_offset) & (t <= t[-1] - time_offset)
        weight = np.ones_like(log.tau) if used_torques is None else used_torques.astype(float)
        return cls(t[keep], log.tau[keep], weight[keep], np.zeros(log.tau.shape[1]))


def condense_torques(raw: Torques, interval: NDArray[np.intp], torque: Array, sigma_tau: Array) -> Torques:
    """Return torques with those of each interval replaced by a few points, where that is exact.

    ``interval`` (K) is the interval of each torque, in order; ``torque`` (K, n) is about what the model will
    give. It has to be a polynomial of degree 7 in the interval and in its neighbours, but for a small part of
    ``sigma_tau`` (n). The points are the zeros of the polynomial of degree 8 that is orthogonal over the samples,
    with Gauss and Christoffel's weights: squares of polynomials of degree 7 are summed exactly (Golub and Welsch,
    1969).
    """
    # only intervals with more samples than points gain, and only where all their samples count alike
    first_samples, count = np.unique(interval, return_index=True, return_counts=True)[1:]
    is_chosen = (count > GAUSS_POINTS + 1) & np.logical_and.reduceat((raw.weight == 1).all(axis=1), first_samples)
    if not is_chosen.any():
        return raw
    # intervals in which the model's torque is not nearly a polynomial of that degree keep their samples
    rough = _rule_of_samples(raw.t, first_samples, count, is_chosen).residual(torque / sigma_tau)
    is_smooth = np.ones(len(count), dtype=bool)
    np.logical_and.at(
        is_smooth,
        np.repeat(np.flatnonzero(is_chosen), count[is_chosen]),
        (np.abs(rough) < MAX_POLYNOMIAL_RESIDUAL).all(axis=1),
    )
    is_smooth[1:-1] &= is_smooth[2:] & is_smooth[:-2]  # a reversal of the motion may still move
    is_chosen &= is_smooth
    if not is_chosen.any():
        return raw
    rule = _rule_of_samples(raw.t, first_samples, count, is_chosen)
    t, tau, weight = rule.points(raw.tau)
    is_single = ~rule.member
    order = np.argsort(np.concatenate([raw.t[is_single], t]), kind="stable")
    return Torques(
        np.concatenate([raw.t[is_single], t])[order],
        np.concatenate([raw.tau[is_single], tau])[order],
        np.concatenate([raw.weight[is_single], np.repeat(weight[:, None], tau.shape[1], axis=1)])[order],
        (rule.residual(raw.tau) ** 2).sum(axis=0),
    )


def _rule_of_samples(
    t: Array, first_samples: NDArray[np.intp], count: NDArray[np.intp], is_chosen: NDArray[np.bool_]
) -> _GaussRule:
    """Return the rule of these samples, which is computed once for all recordings with these times."""
    if len(t) > MAX_CACHED_SAMPLES:
        return _GaussRule.from_samples(t, first_samples, count, is_chosen)
    return _cached_rule(t.tobytes(), first_samples.tobytes(), count.tobytes(), is_chosen.tobytes())


@lru_cache(maxsize=CACHED_RULES)
def _cached_rule(t: bytes, first_samples: bytes, count: bytes, is_chosen: bytes) -> _GaussRule:
    starts, sizes = np.frombuffer(first_samples, dtype=np.intp), np.frombuffer(count, dtype=np.intp)
    return _GaussRule.from_samples(np.frombuffer(t), starts, sizes, np.frombuffer(is_chosen, dtype=bool))


class _GaussRule(Noun):
    """Polynomials (GAUSS_POINTS, M), orthonormal over the M samples of the chosen intervals.

    The intervals begin at ``start`` (I). ``diagonal``, ``off_diagonal`` (GAUSS_POINTS, I) are the coefficients of
    the recursion in x = (t - middle) / half.
    """

    member: NDArray[np.bool_]
    start: NDArray[np.intp]
    count: NDArray[np.intp]
    middle: Array
    half: Array
    polynomials: Array
    diagonal: Array
    off_diagonal: Array

    @classmethod
    def from_samples(
        cls, t: Array, first_samples: NDArray[np.intp], count: NDArray[np.intp], is_chosen: NDArray[np.bool_]
    ) -> _GaussRule:
        """Return the rule for the chosen stretches of samples, which have these first samples and counts."""
        member, size = np.repeat(is_chosen, count), count[is_chosen]
        start = np.concatenate([[0], np.cumsum(size)[:-1]])
        low, high = t[first_samples[is_chosen]], t[first_samples[is_chosen] + size - 1]
        middle, half = (low + high) / 2, (high - low) / 2
        x = (t[member] - np.repeat(middle, size)) / np.repeat(half, size)
        rows = np.empty((GAUSS_POINTS, len(x)))
        diagonal, off_diagonal = np.empty((2, GAUSS_POINTS, len(size)))
        rows[0] = np.repeat(1 / np.sqrt(size), size)
        # Lanczos' three-term recursion for polynomials that are orthonormal over the samples
        for k in range(GAUSS_POINTS):
            diagonal[k] = np.add.reduceat(x * rows[k] ** 2, start)
            next_polynomial = (x - np.repeat(diagonal[k], size)) * rows[k]
            if k:
                next_polynomial -= np.repeat(off_diagonal[k - 1], size) * rows[k - 1]
            off_diagonal[k] = np.sqrt(np.add.reduceat(next_polynomial**2, start))
            if k + 1 < GAUSS_POINTS:
                rows[k + 1] = next_polynomial / np.repeat(off_diagonal[k], size)
        return cls(member, start, size, middle, half, rows, diagonal, off_diagonal)

    def coefficients(self, x: Array) -> Array:
        """Return the coefficients (GAUSS_POINTS, I, n) of the polynomials nearest to x (N, n)."""
        return np.stack([np.add.reduceat(row[:, None] * x[self.member], self.start) for row in self.polynomials])

    def residual(self, x: Array) -> Array:
        """Return the distance (M, n) of x (N, n) from the nearest polynomials."""
        nearest = np.repeat(self.coefficients(x), self.count, axis=1)
        return np.asarray(x[self.member] - np.einsum("km,kmj->mj", self.polynomials, nearest))

    @cached_property
    def _nodes(self) -> tuple[Array, Array, Array]:
        """Times (J), weights (J), J = I GAUSS_POINTS, and the polynomials there (I, GAUSS_POINTS, GAUSS_POINTS)."""
        order = np.arange(GAUSS_POINTS)
        # nodes and weights are eigenvalues and first components of the eigenvectors of the Jacobi matrix
        jacobi = np.zeros((len(self.count), GAUSS_POINTS, GAUSS_POINTS))
        jacobi[:, order, order] = self.diagonal.T
        jacobi[:, order[1:], order[:-1]] = self.off_diagonal[:-1].T
        zeros, vectors = np.linalg.eigh(jacobi)
        weight = self.count[:, None] * vectors[:, 0] ** 2
        values = np.swapaxes(vectors * np.sign(vectors[:, :1]), 1, 2) / np.sqrt(weight)[:, :, None]
        return (self.middle[:, None] + self.half[:, None] * zeros).ravel(), weight.ravel(), values

    def points(self, x: Array) -> tuple[Array, Array, Array]:
        """Return times (J), values of the nearest polynomials of x (J, n), and weights (J), J = I GAUSS_POINTS."""
        t, weight, values = self._nodes
        return t, (values @ np.swapaxes(self.coefficients(x), 0, 1)).reshape(-1, x.shape[1]), weight


GAUSS_OFFSET = 0.5 / np.sqrt(3.0)  # points of Gauss's rule of two, from the middle of an interval of length one
LINE_STD = 0.05  # standard deviation of the torque's straight line after a step, in units of the torque's noise


class Sigma(Noun):
    """Standard deviations of white noise: ``q`` (n) of the positions (rad, m), ``tau`` (n) of the torques (N m, N)."""

    q: Array
    tau: Array


class State(Noun):
    """The unknowns of one segment: spline coefficients C (m, n), and torques W (k, n) at the torque knots."""

    C: Array
    W: Array


class Segment(Noun):
    """A log with the spline space of its trajectory.

    After each step the torque is piecewise linear on ``torque_knots`` (k per step, s): there the trajectory
    satisfies the equations of motion also between the samples. ``from_rest``: the motion starts with velocity
    zero. ``raw`` are the torques as measured, ``torques`` the same, or fewer points that replace them. The
    positions are stamped ``time_offset`` (s) late. The memory of the model is taken from the motion
    ``remembered`` and does not follow the trajectory.
    """

    log: Log
    trajectory: SplineTrajectory
    raw: Torques
    torques: Torques
    torque_knots: tuple[Array, ...] = ()
    from_rest: bool = False
    time_offset: float = 0.0
    remembered: Motion | None = None

    @cached_property
    def points(self) -> Array:
        """Times (P) at which the equations of motion hold, sorted: those of the torques, and between them after
        steps."""
        return self._point_order[0]

    @cached_property
    def is_measured(self) -> NDArray[np.bool_]:
        """Which (P) of the points have a measured torque."""
        return self._point_order[1]

    @cached_property
    def _point_order(self) -> tuple[Array, NDArray[np.bool_]]:
        extra = [self._collocation(knots) for knots in self.torque_knots]
        t = np.concatenate([self.torques.t, *extra])
        order = np.argsort(t, kind="stable")
        return t[order], order < len(self.torques.t)

    @cached_property
    def memory(self) -> Array | None:
        """The memory (P, m) of the model at the points, None where it has none."""
        return self._memory(self.points)

    def _memory(self, t: Array) -> Array | None:
        motion = self.remembered
        if motion is None or motion.memory is None:
            return None
        return np.stack([np.interp(t, motion.t, column) for column in motion.memory.T], axis=1)

    def _collocation(self, knots: Array) -> Array:
        """Return Gauss's points of the trajectory's intervals, and the torque knots, which make W determined."""
        breaks = self.trajectory.breaks
        middle, size = (breaks[:-1] + breaks[1:]) / 2, np.diff(breaks)
        # two Gauss points per interval keep the trajectory on the equations of motion between the samples
        points = np.concatenate([middle - GAUSS_OFFSET * size, middle + GAUSS_OFFSET * size])
        return np.sort(np.concatenate([points[(points > knots[0]) & (points < knots[-1])], knots]))

    def condense(self, model: Model, state: State, theta: Array, sigma_tau: Array) -> Segment:
        """Return the segment with the torques replaced by fewer points, where the model's torque is smooth enough."""
        torque = self._model_torque(model, state, theta)
        interval = self.trajectory.interval(self.raw.t)
        return replace(self, torques=condense_torques(self.raw, interval, torque, sigma_tau))

    def weight_torques(self, weight: Array) -> Segment:
        """Return the segment with all its torques, multiplied by weights (K, n)."""
        return replace(self, torques=replace(self.raw, weight=self.raw.weight * weight))

    @cached_property
    def hats(self) -> Array:
        """Share (P, k) of each torque knot in the torque at each point; zero where it is measured."""
        t, columns = self.points, []
        for knots in self.torque_knots:
            inside = ~self.is_measured & (t >= knots[0]) & (t <= knots[-1])
            columns += [np.where(inside, np.interp(t, knots, unit), 0.0) for unit in np.eye(len(knots))]
        return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))

    @cached_property
    def position_times(self) -> Array:
        """Times (N) of the motion that the positions show."""
        return self.log.t - self.time_offset

    @cached_property
    def blocks(self) -> tuple[TrajectoryBlock, ...]:
        """Blocks of intervals and their points."""
        return tuple(self.trajectory.blocks(self.points, self.log.q.shape[1]))

    @cached_property
    def basis(self) -> Basis:
        """The splines at the points."""
        return basis(self.trajectory, self.points, from_rest=self.from_rest)

    @cached_property
    def position_basis(self) -> Basis:
        """The splines at the times of the positions."""
        return basis(self.trajectory, self.position_times, from_rest=self.from_rest)

    @cached_property
    def _position_sums(self) -> tuple[Array, Array, Array]:
        """Sums over all positions: coefficients C (m, n) near them, and for their residuals the projections and
        squares.

        The projections on the basis are (m, n), the sums of squares (n).
        """
        middle = self.log.q.mean(axis=0)  # positions may be far from zero
        # sums about the mean, with the misfit kept apart: no digits are lost where positions are far from zero
        C = middle + self.position_basis.normal_equations.solve_band(
            self.position_basis.transposed_values @ (self.log.q - middle)
        )
        residual = self.log.q - self.position_basis.values @ C
        return C, self.position_basis.transposed_values @ residual, (residual**2).sum(axis=0)

    def shares(self, state: State) -> tuple[Array, Array]:
        """Return the projection (m, n) of the position residuals on the basis, and the sum of their squares (n).

        Both are computed as changes from those of the coefficients near the positions, so that nothing is lost to
        rounding.
        """
        C, share, squares = self._position_sums
        change = state.C - C
        new_share = share - self.position_basis.products @ change
        return new_share, squares - (change * (share + new_share)).sum(axis=0)

    def motion(self, state: State) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (P, n) at the points."""
        return self.basis.motion(state.C)

    def weights(self, sigma_tau: Array) -> Array:
        """Return one over the standard deviation (P, n) of each row of the torque."""
        out = np.empty((len(self.points), len(sigma_tau)))
        # after a step, the straight line between torque knots holds nearly exactly
        out[~self.is_measured] = 1.0 / (LINE_STD * sigma_tau)
        out[self.is_measured] = np.sqrt(self.torques.weight) / sigma_tau
        return out

    def residuals(self, model: Model, state: State, theta: Array) -> tuple[Array, Array]:
        """Return the residuals of positions (N, n) and torques (K, n) as measured, in their units."""
        return self.offset(state), self.raw.tau - self._model_torque(model, state, theta)

    def _model_torque(self, model: Model, state: State, theta: Array) -> Array:
        motion = basis(self.trajectory, self.raw.t, from_rest=self.from_rest).motion(state.C)
        return model.torque(*motion, theta, self._memory(self.raw.t))

    def offset(self, state: State) -> Array:
        """Return the residuals of the positions (N, n)."""
        return np.asarray(self.log.q - self.position_basis.values @ state.C)

    def target_torque(self, state: State) -> Array:
        """Return the torque (P, n) that the model should have at the points."""
        target = self.hats @ state.W
        target[self.is_measured] = self.torques.tau
        return np.asarray(target)

    def fixed_cost(self, squares: Array, sigma: Sigma) -> float:
        """Return half the weighted ``squares`` (n) of positions, and of the scatter of the torques.

        The scatter is what no model can explain.
        """
        return 0.5 * float((squares / sigma.q**2 + self.torques.scatter / sigma.tau**2).sum())

    def cost(self, model: Model, state: State, theta: Array, sigma: Sigma) -> float:
        """Return half the sum of the weighted squares."""
        residual = (self.target_torque(state) - model.torque(*self.motion(state), theta, self.memory)) * self.weights(
            sigma.tau
        )
        return self.fixed_cost(self.shares(state)[1], sigma) + 0.5 * float((residual**2).sum())

    def move(self, state: State, dC: Array, dW: Array) -> State:
        """Return the state after a step, given as flat arrays."""
        n = state.C.shape[1]
        C = state.C + dC.reshape(-1, n)
        if self.from_rest:
            C[0] = C[1]
        return replace(state, C=C, W=state.W + dW.reshape(-1, n))

    def smoothing_equations(self, sigma_q: float, sigma_ddq: float) -> Arrow:
        """Return the normal equations of one joint's positions, with accelerations of about ``sigma_ddq`` penalised."""
        size, band = (
            self.trajectory.size,
            self.position_basis.gram_band / sigma_q**2 + self.position_basis.acceleration_band / sigma_ddq**2,
        )
        if self.from_rest:
            band[0, 0] = 1.0  # the first coefficient is the second one
        return Arrow(band, np.zeros((size, 0)))

    def initial_state(self, sigma_q: Array, sigma_ddq: Array) -> State:
        """Return the smooth start: positions fitted with accelerations of about ``sigma_ddq`` (n) penalised."""
        right_side = (self.position_basis.transposed_values @ self.log.q) / sigma_q**2
        pairs = zip(sigma_q, sigma_ddq, right_side.T, strict=True)
        C = np.concatenate([self.smoothing_equations(a, b).solve_band(rhs[:, None]) for a, b, rhs in pairs], axis=1)
        if self.from_rest:
            C[0] = C[1]
        t, tau = self.log.t, self.log.tau
        first = [np.minimum(np.searchsorted(t, knots - 1e-12), len(t) - 5) for knots in self.torque_knots]
        # the mean torque of the five samples from each knot on
        W = [np.stack([tau[max(i, 0) : i + 5].mean(axis=0) for i in rows]) for rows in first]
        return State(C, np.concatenate(W) if W else np.zeros((0, len(sigma_q))))

    def resolution(self, sigma_q: Array, sigma_ddq: Array) -> Array:
        """Return the typical standard deviation (n) of the velocities in the smooth start."""
        interval, slope = self.position_basis.interval, self.position_basis.local[1]
        at = self.trajectory.first_coefficient[interval][:, None] + np.arange(5)
        low, high = np.minimum(at[:, :, None], at[:, None, :]), np.maximum(at[:, :, None], at[:, None, :])
        out = []
        # variance of a velocity from the band of the inverse: only splines that act at the same time matter
        for a, b in zip(sigma_q, sigma_ddq, strict=True):
            inverse = self.smoothing_equations(a, b).inverse[high - low, low]
            out.append(np.sqrt(np.median(np.einsum("na,nab,nb->n", slope, inverse, slope))))
        return np.array(out)
