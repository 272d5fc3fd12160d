"""One recording in eq. (7): its spline trajectory, and the normal equations of position and torque."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from dynident.likelihood.arrow import Arrow, gather
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
    """

    log: Log
    trajectory: Trajectory
    torque_knots: tuple[Array, ...] = ()
    rest: bool = False
    trust: Array | None = None

    @cached_property
    def points(self) -> Array:
        """All times (P), sorted: the samples', and those at which only the equations of motion are demanded."""
        return self._ordered[0]

    @cached_property
    def sample(self) -> NDArray[np.bool_]:
        """Which (P) of the points are samples."""
        return self._ordered[1]

    @cached_property
    def _ordered(self) -> tuple[Array, NDArray[np.bool_]]:
        extra = [self._collocation(knots) for knots in self.torque_knots]
        t = np.concatenate([self.log.t, *extra])
        order = np.argsort(t, kind="stable")
        return t[order], order < len(self.log)

    def _collocation(self, knots: Array) -> Array:
        """Gauss's points of the trajectory's intervals, and the torque knots themselves, without which W could hang."""
        breaks = self.trajectory.breaks
        middle, size = (breaks[:-1] + breaks[1:]) / 2, np.diff(breaks)
        points = np.concatenate([middle - GAUSS * size, middle + GAUSS * size])
        return np.sort(np.concatenate([points[(points > knots[0]) & (points < knots[-1])], knots]))

    @cached_property
    def hats(self) -> Array:
        """Share (P, k) of each torque knot in the torque at each point; zero at samples."""
        t, columns = self.points, []
        for knots in self.torque_knots:
            inside = ~self.sample & (t >= knots[0]) & (t <= knots[-1])
            columns += [np.where(inside, np.interp(t, knots, unit), 0.0) for unit in np.eye(len(knots))]
        return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))

    @cached_property
    def local(self) -> Array:
        """Basis values (3, P, 5) at the points; at rest the first two coefficients are one."""
        found = self.trajectory.local(self.points)
        if self.rest:
            begin = self.trajectory.interval(self.points) == 0
            found[:, begin, 1] += found[:, begin, 0]
            found[:, begin, 0] = 0.0
        return found

    @cached_property
    def interval(self) -> NDArray[np.intp]:
        """The interval (P) of each point."""
        return self.trajectory.interval(self.points)

    @cached_property
    def _groups(self) -> tuple[NDArray[np.intp], NDArray[np.intp], list[int]]:
        """The intervals that have points, where in the points each begins, and where it ends."""
        there, start = np.unique(self.interval, return_index=True)
        return there, start, [*start[1:].tolist(), len(self.interval)]

    @cached_property
    def _gram(self) -> Array:
        """Sum of products (I, 5, 5) of the basis over the samples of each interval."""
        V = self.local[0] * self.sample[:, None]
        return self._products(V, V)

    def _products(self, left: Array, right: Array) -> Array:
        """Return the sums (I, a, b) of left' right over the rows (P, ..., a), (P, ..., b) of each interval."""
        a, b = left.shape[-1], right.shape[-1]
        out = np.zeros((len(self.trajectory.first), a, b))
        for i, lo, hi in zip(*self._groups, strict=True):
            np.matmul(left[lo:hi].reshape(-1, a).T, right[lo:hi].reshape(-1, b), out=out[i])
        return out

    @cached_property
    def _maps(self) -> tuple[csr_array, ...]:
        """The basis at the points as sparse matrices (P, m): positions, velocities, accelerations."""
        P = len(self.points)
        columns = (self.trajectory.first[self.interval][:, None] + np.arange(5)).ravel()
        rows = np.arange(0, 5 * P + 1, 5)
        return tuple(csr_array((V.ravel(), columns, rows), shape=(P, self.trajectory.size)) for V in self.local)

    def motion(self, state: State) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (P, n) at the points."""
        q, dq, ddq = (basis @ state.C for basis in self._maps)
        return q, dq, ddq

    def weights(self, sigma_tau: Array) -> Array:
        """Return one over the standard deviation (P, n) of each row of the torque."""
        out = np.empty((len(self.points), len(sigma_tau)))
        out[:] = 1.0 / sigma_tau
        out[~self.sample] /= TIGHT
        if self.trust is not None:
            out[self.sample] *= self.trust
        return out

    def residuals(self, model: Model, state: State, theta: Array) -> tuple[Array, Array]:
        """Return what is left of the positions (N, n) and of the torques (P, n), in their units."""
        q, dq, ddq = self.motion(state)
        return self.log.q - q[self.sample], self._wanted(state) - model.torque(q, dq, ddq, theta)

    def offset(self, state: State) -> Array:
        """Return what is left of the positions (N, n)."""
        return np.asarray(self.log.q - (self._maps[0] @ state.C)[self.sample])

    def _wanted(self, state: State) -> Array:
        """Return the torque (P, n) that the model should have at the points."""
        wanted = self.hats @ state.W
        wanted[self.sample] = self.log.tau
        return np.asarray(wanted)

    def cost(self, model: Model, state: State, theta: Array, sigma_q: Array, sigma_tau: Array) -> float:
        """Return half the sum of the weighted squares."""
        left_q, left_tau = self.residuals(model, state, theta)
        return 0.5 * float(((left_q / sigma_q) ** 2).sum() + ((left_tau * self.weights(sigma_tau)) ** 2).sum())

    def equations(
        self, model: Model, state: State, theta: Array, sigma_q: Array, sigma_tau: Array, *, bend: bool = True
    ) -> Equations:
        """Return the normal equations about a state."""
        n, p, k = len(sigma_q), len(theta), self.hats.shape[1]
        states = self.motion(state)
        Z, slopes = model.regressor(*states), model.partials(*states, theta)
        weight = self.weights(sigma_tau)
        left = weight * (self._wanted(state) - Z @ theta)
        left_q = np.zeros_like(left)
        left_q[self.sample] = (self.log.q - states[0][self.sample]) / sigma_q**2
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
        pull = self._products(self.local[0], left_q).reshape(-1, w, 1)
        bends = self._bends(model, states, Z, left * weight) if bend else np.zeros((len(blocks), w, p))
        wide = np.concatenate([blocks[:, :w, w:-1], bends, blocks[:, :w, -1:] + pull], axis=2)
        band, side = gather(blocks[:, :w, :w], wide, self.trajectory.first * n, self.trajectory.size * n)
        if self.rest:
            band[0, :n] = 1.0  # the first coefficients are the second ones
        total = blocks[:, w:, w:].sum(axis=0)
        cost = 0.5 * float(total[-1, -1] + (left_q**2 * sigma_q**2).sum())
        return Equations(band, side[:, :b], total[:-1, :-1], side[:, b:-1], side[:, -1], total[:-1, -1], cost)

    def _bends(self, model: Model, states: tuple[Array, Array, Array], Z: Array, pull: Array) -> Array:
        """Return the sums (I, w, p) of -sum_j pull_j d^2 tau_j / dC dtheta, by differences of the regressor."""
        (P, n), p = pull.shape, Z.shape[2]
        slopes = np.empty((P, 3, n, p))
        for d in range(3):
            for j in range(n):
                size = NUDGE * (1.0 + float(np.abs(states[d][:, j]).max()))
                nudged = [*states]
                nudged[d] = states[d].copy()
                nudged[d][:, j] += size
                change = (model.regressor(*nudged) - Z) / size
                slopes[:, d, j] = (pull[:, None] @ change)[:, 0]
        basis = np.moveaxis(self.local, 0, 1)
        return -self._products(basis, slopes.reshape(P, 3, n * p)).reshape(-1, 5 * n, p)

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
        slopes, weight = model.partials(*states, theta), self.weights(sigma_tau) * self.sample[:, None]
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
        measured = np.zeros((len(self.points), n))
        measured[self.sample] = self.log.q
        smooth, along = self._products(self.local[2], self.local[2]), self._products(self.local[0], measured)
        for j in range(n):
            blocks = self._gram / sigma_q[j] ** 2 + smooth / sigma_ddq[j] ** 2
            band, rhs = gather(blocks, along[:, :, j : j + 1] / sigma_q[j] ** 2, self.trajectory.first, size)
            if self.rest:
                band[0, 0] = 1.0
            C[:, j] = Arrow(band, rhs).inner(rhs)[:, 0]
        if self.rest:
            C[0] = C[1]
        W = [np.stack([_near(self.log, knot) for knot in knots]) for knots in self.torque_knots]
        return State(C, np.concatenate(W) if W else np.zeros((0, n)))


def _near(log: Log, t: float) -> Array:
    """Return the mean torque (n) of the five samples from t on."""
    i = min(int(np.searchsorted(log.t, t - 1e-12)), len(log) - 5)
    return np.asarray(log.tau[max(i, 0) : i + 5].mean(axis=0))
