"""One recording in eq. (7): its spline trajectory, and the residuals of its positions and torques."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from dynident.errors import brief
from dynident.estimators.maximum_likelihood.arrow import Arrow, add_ahead, band_of, places
from dynident.estimators.maximum_likelihood.torques import Torques, condensed
from dynident.estimators.maximum_likelihood.trajectory import Trajectory, TrajectoryBlock
from dynident.log import Log
from dynident.models import Model

__all__ = ["Segment", "Sigma", "State"]

Array = NDArray[np.float64]
GAUSS = 0.5 / np.sqrt(3.0)  # points of Gauss's rule of two, from the middle of an interval of length one
RIDGE = 1e-9  # of the positions' products, where a coefficient acts on none
TIGHT = 0.05  # standard deviation of the torque's straight line after a step, in units of the torque's noise


@dataclass(frozen=True, eq=False)
class Sigma:
    """Standard deviations of white noise: ``q`` (n) of the positions (rad, m), ``tau`` (n) of the torques (N m, N)."""

    q: Array
    tau: Array


@dataclass(frozen=True, eq=False)
class State:
    """The unknowns of one segment: spline coefficients C (m, n), and torques W (k, n) at the torque knots."""

    C: Array
    W: Array


@dataclass(frozen=True, eq=False)
class Segment:
    """A log with the spline space of its trajectory.

    After each step the torque is piecewise linear on ``torque_knots`` (k per step, s): there the trajectory satisfies
    the equations of motion also between the samples. ``rest``: the motion starts with velocity zero. ``raw`` are the
    torques as measured, ``torques`` the same, or fewer points that replace them. The positions are ``time_offset`` (s)
    late.
    """

    log: Log
    trajectory: Trajectory
    raw: Torques
    torques: Torques
    torque_knots: tuple[Array, ...] = ()
    rest: bool = False
    time_offset: float = 0.0

    __repr__ = brief

    @cached_property
    def points(self) -> Array:
        """Times (P) of the equations of motion, sorted: of the torques, and between them after steps."""
        return self._ordered[0]

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Which (P) of the points have a measured torque."""
        return self._ordered[1]

    @cached_property
    def _ordered(self) -> tuple[Array, NDArray[np.bool_]]:
        extra = [self._collocation(knots) for knots in self.torque_knots]
        t = np.concatenate([self.torques.t, *extra])
        order = np.argsort(t, kind="stable")
        return t[order], order < len(self.torques.t)

    def _collocation(self, knots: Array) -> Array:
        """Gauss's points of the trajectory's intervals, and the torque knots, which make W determined."""
        breaks = self.trajectory.breaks
        middle, size = (breaks[:-1] + breaks[1:]) / 2, np.diff(breaks)
        points = np.concatenate([middle - GAUSS * size, middle + GAUSS * size])
        return np.sort(np.concatenate([points[(points > knots[0]) & (points < knots[-1])], knots]))

    def condensed(self, model: Model, state: State, theta: Array, sigma_tau: Array) -> Segment:
        """Return the segment with the torques replaced by fewer points, where the model's torque is smooth enough."""
        torque = self._modelled(model, state, theta)
        interval = self.trajectory.interval(self.raw.t)
        return replace(self, torques=condensed(self.raw, interval, torque, sigma_tau))

    def trusting(self, weight: Array) -> Segment:
        """Return the segment with all its torques, multiplied by weights (K, n)."""
        return replace(self, torques=replace(self.raw, weight=self.raw.weight * weight))

    @cached_property
    def hats(self) -> Array:
        """Share (P, k) of each torque knot in the torque at each point; zero where it is measured."""
        t, columns = self.points, []
        for knots in self.torque_knots:
            inside = ~self.measured & (t >= knots[0]) & (t <= knots[-1])
            columns += [np.where(inside, np.interp(t, knots, unit), 0.0) for unit in np.eye(len(knots))]
        return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))

    @cached_property
    def seen(self) -> Array:
        """Times (N) of the motion that the positions show."""
        return self.log.t - self.time_offset

    @cached_property
    def blocks(self) -> tuple[TrajectoryBlock, ...]:
        """Blocks of intervals and their points."""
        return tuple(self.trajectory.blocks(self.points, self.log.q.shape[1]))

    @cached_property
    def local(self) -> Array:
        """Basis values (3, P, 5) at the points; at rest the first two coefficients are one."""
        return self.basis(self.points)

    def basis(self, t: Array) -> Array:
        """Return basis values (3, P, 5) at times (P)."""
        found = self.trajectory.local(t)
        if self.rest:
            begin = self.trajectory.interval(t) == 0
            found[:, begin, 1] += found[:, begin, 0]
            found[:, begin, 0] = 0.0
        return found

    @cached_property
    def shown(self) -> tuple[NDArray[np.intp], Array]:
        """The interval (N) of each position, and the basis values (N, 5) there."""
        return self.trajectory.interval(self.seen), self.basis(self.seen)[0]

    @cached_property
    def positions(self) -> csr_array:
        """The basis at the positions (N, m)."""
        return self._sparse(*self.shown)

    def _band(self, blocks: Array) -> Array:
        """Return the band (5, m) of one joint's coefficients from blocks (I, 5, 5) by interval."""
        total = np.zeros((self.trajectory.size, 1, 5))
        add_ahead(total, blocks[:, :, None], places(self.trajectory.first, 5))
        return band_of(total)

    @cached_property
    def gram_band(self) -> Array:
        """The band (5, m) of the products of the basis over all positions."""
        return self._band(self.gram)

    @cached_property
    def _summed(self) -> tuple[csr_array, Array, Array, Array]:
        """What the positions say, however many: products of the basis (m, m), coefficients C (m, n) near the positions,
        and of what these leave the basis's share (m, n) and the squares (n).
        """
        turned = self.positions.T
        band = self.gram_band.copy()
        band[0] += RIDGE * band[0].max()
        middle = self.log.q.mean(axis=0)  # positions may be far from zero
        C = middle + Arrow(band, np.zeros((self.trajectory.size, 0))).inner(turned @ (self.log.q - middle))
        left = self.log.q - self.positions @ C
        return turned @ self.positions, C, turned @ left, (left**2).sum(axis=0)

    def shares(self, state: State) -> tuple[Array, Array]:
        """Return the basis's share (m, n) in what is left of the positions, and the sum of its squares (n).

        Both are changes from those near the positions, so that nothing is lost to rounding.
        """
        products, C, share, squares = self._summed
        change = state.C - C
        found = share - products @ change
        return found, squares - (change * (share + found)).sum(axis=0)

    @cached_property
    def _points(self) -> csr_array:
        """Positions, velocities and accelerations (3 P, m) at the points."""
        return self._sparse(np.tile(self.trajectory.interval(self.points), 3), self.local.reshape(-1, 5))

    @cached_property
    def _torques(self) -> csr_array:
        """The same (3 K, m) at the torques as measured."""
        return self._sparse(np.tile(self.trajectory.interval(self.raw.t), 3), self.basis(self.raw.t).reshape(-1, 5))

    def _sparse(self, interval: NDArray[np.intp], V: Array) -> csr_array:
        columns = (self.trajectory.first[interval][:, None] + np.arange(5)).ravel()
        rows = np.arange(0, 5 * len(V) + 1, 5)
        return csr_array((V.ravel(), columns, rows), shape=(len(V), self.trajectory.size))

    def by_interval(self, x: Array) -> Array:
        """Return the sums (I, ...) over each interval of what is given by position (N, ...)."""
        start = np.flatnonzero(np.diff(self.shown[0], prepend=-1))
        out = np.zeros((len(self.trajectory.first), *x.shape[1:]))
        out[self.shown[0][start]] = np.add.reduceat(x, start)
        return out

    @cached_property
    def gram(self) -> Array:
        """Sum of products (I, 5, 5) of the basis over the positions of each interval."""
        V = self.shown[1]
        return self.by_interval(V[:, :, None] * V[:, None, :])

    @cached_property
    def _bends(self) -> Array:
        """The band (5, m) of the squared acceleration, summed over as many times as there are positions."""
        breaks = self.trajectory.breaks
        bend = self.basis((breaks[:-1] + breaks[1:]) / 2)[2]
        share = np.diff(breaks) * len(self.log) / (breaks[-1] - breaks[0])
        return self._band(share[:, None, None] * bend[:, :, None] * bend[:, None, :])

    def motion(self, state: State) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (P, n) at the points."""
        q, dq, ddq = (self._points @ state.C).reshape(3, -1, state.C.shape[1])
        return q, dq, ddq

    def weights(self, sigma_tau: Array) -> Array:
        """Return one over the standard deviation (P, n) of each row of the torque."""
        out = np.empty((len(self.points), len(sigma_tau)))
        out[~self.measured] = 1.0 / (TIGHT * sigma_tau)
        out[self.measured] = np.sqrt(self.torques.weight) / sigma_tau
        return out

    def residuals(self, model: Model, state: State, theta: Array) -> tuple[Array, Array]:
        """Return what is left of the positions (N, n) and torques (K, n) as measured, in their units."""
        return self.offset(state), self.raw.tau - self._modelled(model, state, theta)

    def _modelled(self, model: Model, state: State, theta: Array) -> Array:
        q, dq, ddq = (self._torques @ state.C).reshape(3, -1, state.C.shape[1])
        return model.torque(q, dq, ddq, theta)

    def offset(self, state: State) -> Array:
        """Return what is left of the positions (N, n)."""
        return np.asarray(self.log.q - self.positions @ state.C)

    def wanted(self, state: State) -> Array:
        """Return the torque (P, n) that the model should have at the points."""
        wanted = self.hats @ state.W
        wanted[self.measured] = self.torques.tau
        return np.asarray(wanted)

    def given(self, squares: Array, sigma: Sigma) -> float:
        """Return half the weighted ``squares`` (n) of positions, and of what no model can explain of the torques."""
        return 0.5 * float((squares / sigma.q**2 + self.torques.scatter / sigma.tau**2).sum())

    def cost(self, model: Model, state: State, theta: Array, sigma: Sigma) -> float:
        """Return half the sum of the weighted squares."""
        left = (self.wanted(state) - model.torque(*self.motion(state), theta)) * self.weights(sigma.tau)
        return self.given(self.shares(state)[1], sigma) + 0.5 * float((left**2).sum())

    def moved(self, state: State, dC: Array, dW: Array) -> State:
        """Return the state after a step, given flat."""
        n = state.C.shape[1]
        C = state.C + dC.reshape(-1, n)
        if self.rest:
            C[0] = C[1]
        return replace(state, C=C, W=state.W + dW.reshape(-1, n))

    def smooth(self, sigma_q: float, sigma_ddq: float) -> Arrow:
        """Return the normal equations of one joint's positions, with accelerations of about ``sigma_ddq`` kept down."""
        size, band = self.trajectory.size, self.gram_band / sigma_q**2 + self._bends / sigma_ddq**2
        if self.rest:
            band[0, 0] = 1.0  # the first coefficient is the second one
        return Arrow(band, np.zeros((size, 0)))

    def start(self, sigma_q: Array, sigma_ddq: Array) -> State:
        """Return the smooth start: positions fitted with accelerations of about ``sigma_ddq`` (n) kept down."""
        along = (self.positions.T @ self.log.q) / sigma_q**2
        pairs = zip(sigma_q, sigma_ddq, along.T, strict=True)
        C = np.concatenate([self.smooth(a, b).inner(rhs[:, None]) for a, b, rhs in pairs], axis=1)
        if self.rest:
            C[0] = C[1]
        W = [np.stack([_near(self.log, knot) for knot in knots]) for knots in self.torque_knots]
        return State(C, np.concatenate(W) if W else np.zeros((0, len(sigma_q))))

    def resolution(self, sigma_q: Array, sigma_ddq: Array) -> Array:
        """Return the usual standard deviation (n) of the velocities in the smooth start."""
        interval, slope = self.shown[0], self.basis(self.seen)[1]
        at = self.trajectory.first[interval][:, None] + np.arange(5)
        low, high = np.minimum(at[:, :, None], at[:, None, :]), np.maximum(at[:, :, None], at[:, None, :])
        out = []
        for a, b in zip(sigma_q, sigma_ddq, strict=True):
            inverse = self.smooth(a, b).inverse[high - low, low]
            out.append(np.sqrt(np.median(np.einsum("na,nab,nb->n", slope, inverse, slope))))
        return np.array(out)


def _near(log: Log, t: float) -> Array:
    """Return the mean torque (n) of the five samples from t on."""
    i = min(int(np.searchsorted(log.t, t - 1e-12)), len(log) - 5)
    return np.asarray(log.tau[max(i, 0) : i + 5].mean(axis=0))
