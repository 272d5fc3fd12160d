"""One recording in eq. (7): its spline trajectory, and the normal equations of position and torque."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from dynident.likelihood.arrow import Arrow, gather
from dynident.likelihood.torques import Torques, condensed
from dynident.likelihood.trajectory import Trajectory
from dynident.log import Log
from dynident.model import Model

__all__ = ["Equations", "Segment", "State"]

Array = NDArray[np.float64]
NUDGE = 1e-6  # of a state, for differences of the regressor
GAUSS = 0.5 / np.sqrt(3.0)  # points of Gauss's rule of two, from the middle of an interval of length one
TIGHT = 0.05  # standard deviation of the torque's straight line after a step, in units of the torque's noise


@dataclass(frozen=True, eq=False)
class State:
    """The unknowns of one segment: spline coefficients C (m, n), and torques W (k, n) at the torque knots."""

    C: Array
    W: Array


@dataclass(frozen=True, eq=False)
class Equations:
    """Gauss-Newton equations of one segment about a state; border columns: W (k n), theta (p).

    ``band`` (w, m n), ``border`` (m n, k n + p), ``corner`` of the border with itself, ``bend`` (m n, p) the second
    derivatives of the cost by trajectory and theta that Gauss-Newton leaves out; minus the gradients by C (m n) and by
    the border. ``cost`` is half the sum of the weighted squares.
    """

    band: Array
    border: Array
    corner: Array
    bend: Array
    by_coefficients: Array
    by_border: Array
    cost: float


@dataclass(frozen=True, eq=False)
class Segment:
    """A log with the space its motion is sought in.

    After each of the ``steps`` (s) the torque is piecewise linear on ``torque_knots`` (k per step, s): there the
    trajectory obeys the equations of motion between the samples, too. ``rest``: the motion starts with velocity zero.
    ``torques`` are the measured ones, or points that stand for them.
    """

    log: Log
    trajectory: Trajectory
    torques: Torques
    torque_knots: tuple[Array, ...] = ()
    rest: bool = False

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

    def condensed(self, model: Model, state: State, theta: Array, sigma_tau: Array) -> Segment:
        """Return the segment with few points for many torques, where the model's torque about a state allows it."""
        torque = model.torque(*self.sampled(state), theta)
        return replace(self, torques=condensed(self.log, self._interval, torque, sigma_tau))

    def trusting(self, weight: Array) -> Segment:
        """Return the segment with all samples of the torque, each of a weight (N, n)."""
        return replace(self, torques=replace(Torques.of(self.log), weight=weight))

    def _collocation(self, knots: Array) -> Array:
        """Gauss's points of the trajectory's intervals, and the torque knots themselves, without which W could hang."""
        breaks = self.trajectory.breaks
        middle, size = (breaks[:-1] + breaks[1:]) / 2, np.diff(breaks)
        points = np.concatenate([middle - GAUSS * size, middle + GAUSS * size])
        return np.sort(np.concatenate([points[(points > knots[0]) & (points < knots[-1])], knots]))

    @cached_property
    def hats(self) -> Array:
        """Share (P, k) of each torque knot in the torque at each point; zero where it is measured."""
        t, columns = self.points, []
        for knots in self.torque_knots:
            inside = ~self.measured & (t >= knots[0]) & (t <= knots[-1])
            columns += [np.where(inside, np.interp(t, knots, unit), 0.0) for unit in np.eye(len(knots))]
        return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))

    @cached_property
    def local(self) -> Array:
        """Basis values (3, P, 5) at the points; at rest the first two coefficients are one."""
        return self._local(self.points)

    def _local(self, t: Array) -> Array:
        found = self.trajectory.local(t)
        if self.rest:
            begin = self.trajectory.interval(t) == 0
            found[:, begin, 1] += found[:, begin, 0]
            found[:, begin, 0] = 0.0
        return found

    @cached_property
    def _interval(self) -> NDArray[np.intp]:
        """The interval (N) of each sample."""
        return self.trajectory.interval(self.log.t)

    @cached_property
    def _samples(self) -> tuple[csr_array, ...]:
        return self._maps(self.log.t)

    @cached_property
    def _points(self) -> tuple[csr_array, ...]:
        return self._maps(self.points)

    def _maps(self, t: Array) -> tuple[csr_array, ...]:
        """Return the basis at times (P) as sparse matrices (P, m): positions, velocities, accelerations."""
        columns = (self.trajectory.first[self.trajectory.interval(t)][:, None] + np.arange(5)).ravel()
        rows, shape = np.arange(0, 5 * len(t) + 1, 5), (len(t), self.trajectory.size)
        return tuple(csr_array((V.ravel(), columns, rows), shape=shape) for V in self._local(t))

    @cached_property
    def _groups(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Intervals (K) with the same number c of points, and where these are (K, c), for each c."""
        there, start, count = np.unique(self.trajectory.interval(self.points), return_index=True, return_counts=True)
        groups = [(c, count == c) for c in np.unique(count)]
        return [(there[same], start[same][:, None] + np.arange(c)) for c, same in groups]

    def _products(self, left: Array, right: Array) -> Array:
        """Return the sums (I, a, b) of left' right over the rows (P, ..., a), (P, ..., b) of each interval."""
        a, b = left.shape[-1], right.shape[-1]
        out = np.zeros((len(self.trajectory.first), a, b))
        for there, at in self._groups:
            one = left[at].reshape(len(at), -1, a)
            other = one if right is left else right[at].reshape(len(at), -1, b)
            out[there] = np.swapaxes(one, 1, 2) @ other
        return out

    @cached_property
    def _gram(self) -> Array:
        """Sum of products (I, 5, 5) of the basis over the samples of each interval."""
        V, interval = self._local(self.log.t)[0], self._interval
        start = np.flatnonzero(np.diff(interval, prepend=-1))
        out = np.zeros((len(self.trajectory.first), 5, 5))
        out[interval[start]] = np.add.reduceat(V[:, :, None] * V[:, None, :], start)
        return out

    def motion(self, state: State) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (P, n) at the points."""
        q, dq, ddq = (basis @ state.C for basis in self._points)
        return q, dq, ddq

    def sampled(self, state: State) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (N, n) at the samples."""
        q, dq, ddq = (basis @ state.C for basis in self._samples)
        return q, dq, ddq

    def weights(self, sigma_tau: Array) -> Array:
        """Return one over the standard deviation (P, n) of each row of the torque."""
        out = np.empty((len(self.points), len(sigma_tau)))
        out[~self.measured] = 1.0 / (TIGHT * sigma_tau)
        out[self.measured] = np.sqrt(self.torques.weight) / sigma_tau
        return out

    def residuals(self, model: Model, state: State, theta: Array) -> tuple[Array, Array]:
        """Return what is left of the samples' positions and torques (N, n), in their units."""
        q, dq, ddq = self.sampled(state)
        return self.log.q - q, self.log.tau - model.torque(q, dq, ddq, theta)

    def offset(self, state: State) -> Array:
        """Return what is left of the positions (N, n)."""
        return np.asarray(self.log.q - self._samples[0] @ state.C)

    def _wanted(self, state: State) -> Array:
        """Return the torque (P, n) that the model should have at the points."""
        wanted = self.hats @ state.W
        wanted[self.measured] = self.torques.tau
        return np.asarray(wanted)

    def _positions(self, state: State, sigma_q: Array, sigma_tau: Array) -> float:
        """Return half the weighted squares of the positions, and of what no model can explain of the torques."""
        scatter = float((self.torques.scatter / sigma_tau**2).sum())
        return 0.5 * (float(((self.offset(state) / sigma_q) ** 2).sum()) + scatter)

    def cost(self, model: Model, state: State, theta: Array, sigma_q: Array, sigma_tau: Array) -> float:
        """Return half the sum of the weighted squares."""
        left = (self._wanted(state) - model.torque(*self.motion(state), theta)) * self.weights(sigma_tau)
        return self._positions(state, sigma_q, sigma_tau) + 0.5 * float((left**2).sum())

    def equations(
        self, model: Model, state: State, theta: Array, sigma_q: Array, sigma_tau: Array, *, bend: bool = True
    ) -> Equations:
        """Return the normal equations about a state."""
        n, p, k = len(sigma_q), len(theta), self.hats.shape[1]
        states = self.motion(state)
        Z, slopes = model.regressor(*states), model.partials(*states, theta)
        weight = self.weights(sigma_tau)
        left = weight * (self._wanted(state) - Z @ theta)
        P, w, b = len(left), 5 * n, k * n + p
        rows = np.zeros((P, n, w + b + 1))  # minus the derivatives of the residuals by C, W and theta; residuals
        for V, by in zip(self.local, (slopes.q, slopes.dq, slopes.ddq), strict=True):
            rows[:, :, :w] += (V[:, None, :, None] * by[:, :, None, :]).reshape(P, n, w)
        for j in range(n):
            rows[:, j, w + j : w + k * n : n] = -self.hats
        rows[:, :, w + k * n : -1] = Z
        rows[:, :, :-1] *= weight[:, :, None]
        rows[:, :, -1] = left
        blocks = self._products(rows, rows)
        for j in range(n):
            blocks[:, j:w:n, j:w:n] += self._gram / sigma_q[j] ** 2
        bends = self._bends(model, states, Z, left * weight) if bend else np.zeros((len(blocks), w, p))
        wide = np.concatenate([blocks[:, :w, w:-1], bends, blocks[:, :w, -1:]], axis=2)
        band, side = gather(blocks[:, :w, :w], wide, self.trajectory.first * n, self.trajectory.size * n)
        side[:, -1] += (self._samples[0].T @ (self.offset(state) / sigma_q**2)).ravel()
        if self.rest:
            band[0, :n] = 1.0  # the first coefficients are the second ones
        total = blocks[:, w:, w:].sum(axis=0)
        cost = self._positions(state, sigma_q, sigma_tau) + 0.5 * float(total[-1, -1])
        return Equations(band, side[:, :b], total[:-1, :-1], side[:, b:-1], side[:, -1], total[:-1, -1], cost)

    def _bends(self, model: Model, states: tuple[Array, Array, Array], Z: Array, pull: Array) -> Array:
        """Return the sums (I, w, p) of -sum_j pull_j d^2 tau_j / dC dtheta, by differences of the regressor."""
        (P, n), p = pull.shape, Z.shape[2]
        nudged = [np.repeat(one[None], 3 * n, axis=0) for one in states]
        size = [NUDGE * (1.0 + float(np.abs(one[:, j]).max())) for one in states for j in range(n)]
        for at, step in enumerate(size):
            nudged[at // n][at, :, at % n] += step
        there = model.regressor(*(one.reshape(-1, n) for one in nudged)).reshape(3 * n, P, n, p)
        change = (pull[:, None] @ (there - Z)).reshape(3, n, P, p) / np.reshape(size, (3, n, 1, 1))
        slopes = change.transpose(2, 0, 1, 3).reshape(P, 3, n * p)
        return -self._products(np.moveaxis(self.local, 0, 1), slopes).reshape(-1, 5 * n, p)

    def leverage(self, model: Model, state: State, theta: Array, sigma_q: Array, sigma_tau: Array) -> Array:
        """Return how many degrees of freedom (2, n) the trajectory takes from the positions and torques of each joint.

        These are the traces of (N^-1 times a joint's share of N), with N the band of the trajectory.
        """
        n = len(sigma_q)
        found = self.equations(model, state, theta, sigma_q, sigma_tau, bend=False)
        inverse = Arrow(found.band, found.border).inverse
        at = self.trajectory.first[:, None] * n + np.arange(5 * n)
        low, high = np.minimum(at[:, :, None], at[:, None, :]), np.maximum(at[:, :, None], at[:, None, :])
        Z = inverse[high - low, low]
        states = self.motion(state)
        slopes, weight = model.partials(*states, theta), self.weights(sigma_tau) * self.measured[:, None]
        out = np.empty((2, n))
        for j in range(n):
            out[0, j] = (Z[:, j::n, j::n] * self._gram).sum() / sigma_q[j] ** 2
            row = sum(
                V[:, :, None] * by[:, j, None, :]
                for V, by in zip(self.local, (slopes.q, slopes.dq, slopes.ddq), strict=True)
            )
            row = np.reshape(row, (len(weight), 5 * n)) * weight[:, j, None]
            out[1, j] = (Z * self._products(row, row)).sum()
        return out

    def moved(self, state: State, dC: Array, dW: Array) -> State:
        """Return the state after a step, given flat."""
        n = state.C.shape[1]
        C = state.C + dC.reshape(-1, n)
        if self.rest:
            C[0] = C[1]
        return replace(state, C=C, W=state.W + dW.reshape(-1, n))

    def start(self, sigma_q: Array, sigma_ddq: Array) -> State:
        """Return the smooth start: positions fitted with accelerations of about ``sigma_ddq`` (n) kept down."""
        n, size = len(sigma_q), self.trajectory.size
        C = np.empty((size, n))
        smooth, along = self._products(self.local[2], self.local[2]), self._samples[0].T @ self.log.q
        for j in range(n):
            blocks = self._gram / sigma_q[j] ** 2 + smooth / sigma_ddq[j] ** 2
            band, _ = gather(blocks, np.zeros((len(blocks), 5, 1)), self.trajectory.first, size)
            if self.rest:
                band[0, 0] = 1.0
            C[:, j] = Arrow(band, along[:, j : j + 1]).inner(along[:, j : j + 1] / sigma_q[j] ** 2)[:, 0]
        if self.rest:
            C[0] = C[1]
        W = [np.stack([_near(self.log, knot) for knot in knots]) for knots in self.torque_knots]
        return State(C, np.concatenate(W) if W else np.zeros((0, n)))


def _near(log: Log, t: float) -> Array:
    """Return the mean torque (n) of the five samples from t on."""
    i = min(int(np.searchsorted(log.t, t - 1e-12)), len(log) - 5)
    return np.asarray(log.tau[max(i, 0) : i + 5].mean(axis=0))
