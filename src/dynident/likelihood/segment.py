"""One recording in eq. (7): its spline trajectory, and the normal equations of position and torque."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.likelihood.arrow import gather
from dynident.likelihood.trajectory import Trajectory
from dynident.log import Log
from dynident.model import Model

__all__ = ["Equations", "Segment", "State"]

Array = NDArray[np.float64]
GAUSS = 0.5 / np.sqrt(3.0)  # points of Gauss's rule of two, from the middle of an interval of length one
TIGHT = 0.02  # standard deviation of the torque's straight line after a step, in units of the torque's noise


@dataclass(frozen=True, eq=False)
class State:
    """The unknowns of one segment: spline coefficients C (m, n), and torques W (k, n) at the torque knots."""

    C: Array
    W: Array


@dataclass(frozen=True, eq=False)
class Equations:
    """Gauss-Newton equations of one segment about a state; border columns: W (k n), theta (p).

    ``band`` (w, m n), ``border`` (m n, k n + p), ``corner`` of the border with itself, ``bend`` (m n, p) the second
    derivatives of the cost by trajectory and theta that Gauss-Newton leaves out; gradients ``by_C`` (m n) and
    ``by_border``. ``cost`` is half the sum of the weighted squares.
    """

    band: Array
    border: Array
    corner: Array
    bend: Array
    by_C: Array
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
    used: NDArray[np.bool_] | None = None

    @cached_property
    def points(self) -> Array:
        """The samples' times, and after them those at which only the equations of motion are demanded."""
        extra = [self._collocation(knots) for knots in self.torque_knots]
        return np.concatenate([self.log.t, *extra])

    def _collocation(self, knots: Array) -> Array:
        """Gauss's points of the trajectory's intervals, and the torque knots themselves, without which W could hang."""
        breaks = self.trajectory.breaks
        middle, size = (breaks[:-1] + breaks[1:]) / 2, np.diff(breaks)
        points = np.concatenate([middle - GAUSS * size, middle + GAUSS * size])
        return np.sort(np.concatenate([points[(points > knots[0]) & (points < knots[-1])], knots]))

    @cached_property
    def hats(self) -> Array:
        """Share (P, k) of each torque knot in the torque at each point; zero at samples."""
        N = len(self.log)
        out = np.zeros((len(self.points), sum(map(len, self.torque_knots))))
        at = 0
        for knots in self.torque_knots:
            t = self.points[N:]
            inside = (t >= knots[0]) & (t <= knots[-1])
            for unit in np.eye(len(knots)):
                out[N:, at] = np.where(inside, np.interp(t, knots, unit), 0.0)
                at += 1
        return out

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
    def _sorted(self) -> tuple[NDArray[np.intp], list[tuple[int, int, int]]]:
        """The points in order of their intervals, and (interval, start, stop) of the intervals that have any."""
        order = np.argsort(self.interval, kind="stable")
        there, start = np.unique(self.interval[order], return_index=True)
        stop = [*start[1:].tolist(), len(order)]
        return order, list(zip(there.tolist(), start.tolist(), stop, strict=True))

    @cached_property
    def _gram(self) -> Array:
        """Sum of products (I, 5, 5) of the basis over the samples of each interval."""
        N = len(self.log)
        out = np.zeros((len(self.trajectory.first), 5, 5))
        V = self.local[0].copy()
        V[N:] = 0.0
        order, groups = self._sorted
        V = V[order]
        for i, lo, hi in groups:
            out[i] = V[lo:hi].T @ V[lo:hi]
        return out

    def motion(self, state: State) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (P, n) at the points."""
        columns = self.trajectory.first[self.interval][:, None] + np.arange(5)
        C = state.C[columns]
        q, dq, ddq = (np.einsum("pa,paj->pj", V, C) for V in self.local)
        return q, dq, ddq

    def weights(self, sigma_tau: Array) -> Array:
        """Return one over the standard deviation (P, n) of each row of the torque."""
        out = np.empty((len(self.points), len(sigma_tau)))
        out[:] = 1.0 / sigma_tau
        out[len(self.log) :] /= TIGHT
        return out

    def residuals(self, model: Model, state: State, theta: Array) -> tuple[Array, Array]:
        """Return what is left of the positions (N, n) and of the torques (P, n), in their units."""
        N = len(self.log)
        q, dq, ddq = self.motion(state)
        wanted = self.hats @ state.W
        wanted[:N] = self.log.tau
        return self.log.q - q[:N], wanted - model.torque(q, dq, ddq, theta)

    def cost(self, model: Model, state: State, theta: Array, sigma_q: Array, sigma_tau: Array) -> float:
        """Return half the sum of the weighted squares."""
        left_q, left_tau = self.residuals(model, state, theta)
        return 0.5 * float(((left_q / sigma_q) ** 2).sum() + ((left_tau * self.weights(sigma_tau)) ** 2).sum())

    def equations(
        self, model: Model, state: State, theta: Array, sigma_q: Array, sigma_tau: Array, *, bend: bool = True
    ) -> Equations:
        """Return the normal equations about a state."""
        N, n, p = len(self.log), len(sigma_q), len(theta)
        k = self.hats.shape[1]
        q, dq, ddq = self.motion(state)
        Z, slopes = model.regressor(q, dq, ddq), model.partials(q, dq, ddq, theta)
        by = np.stack([slopes.q, slopes.dq, slopes.ddq])
        weight = self.weights(sigma_tau)
        wanted = self.hats @ state.W
        wanted[:N] = self.log.tau
        left = weight * (wanted - Z @ theta)
        w, b = 5 * n, k * n + p
        P = len(q)
        rows = np.empty((P, n, w + b + 1))
        # rows of -residual: d tau by C, minus the hats, d tau by theta
        rows[:, :, :w] = np.einsum("dpa,dpjk->pjak", self.local, by, optimize=True).reshape(P, n, w)
        rows[:, :, w : w + k * n] = 0.0
        for j in range(n):
            rows[:, j, w + j : w + k * n : n] = -self.hats
        rows[:, :, w + k * n : -1] = Z
        rows[:, :, :-1] *= weight[:, :, None]
        rows[:, :, -1] = left
        order, groups = self._sorted
        rows = rows[order]
        I = len(self.trajectory.first)  # noqa: E741
        blocks = np.zeros((I, w + b + 1, w + b + 1))
        for i, lo, hi in groups:
            part = rows[lo:hi].reshape(-1, w + b + 1)
            blocks[i] = part.T @ part
        left_q = np.zeros((P, n))
        left_q[:N] = (self.log.q - q[:N]) / sigma_q**2
        along = np.zeros((I, w, 1))
        bends = np.zeros((I, w, p))
        pull = np.einsum("pa,pj->paj", self.local[0], left_q).reshape(P, w, 1)
        self._sum(along, pull)
        if bend:
            self._sum(bends, self._bends(model, (q, dq, ddq), left * weight, p))
        for j in range(n):
            blocks[:, j:w:n, j:w:n] += self._gram / sigma_q[j] ** 2
        wide = np.concatenate([blocks[:, :w, w:-1], bends, blocks[:, :w, -1:] + along], axis=2)
        band, side = gather(blocks[:, :w, :w], wide, self.trajectory.first * n, self.trajectory.size * n)
        if self.rest:
            band[0, :n] = 1.0  # the first coefficients are the second ones
        total = blocks[:, w:, w:].sum(axis=0)
        cost = 0.5 * float(total[-1, -1] + ((self.log.q - q[:N]) ** 2 / sigma_q**2).sum())
        return Equations(band, side[:, :b], total[:-1, :-1], side[:, b:-1], side[:, -1], total[:-1, -1], cost)

    def _sum(self, out: Array, rows: Array) -> None:
        """Add up rows (P, ...) by interval."""
        order, groups = self._sorted
        starts = [lo for _, lo, _ in groups]
        out[[i for i, _, _ in groups]] = np.add.reduceat(rows[order], starts, axis=0)

    def _bends(self, model: Model, states: tuple[Array, Array, Array], pull: Array, p: int) -> Array:
        """Return the rows (P, w, p) of -sum_j pull_j d^2 tau_j / dC dtheta."""
        P, n = pull.shape
        out = np.empty((P, 5, n, p))
        for k, unit in enumerate(np.eye(p)):
            by = model.partials(*states, unit)
            E = np.stack([np.einsum("pj,pjk->pk", pull, part) for part in (by.q, by.dq, by.ddq)])
            np.einsum("dpa,dpk->pak", self.local, E, out=out[..., k])
        return -out.reshape(P, 5 * n, p)

    def moved(self, state: State, dC: Array, dW: Array) -> State:
        """Return the state after a step, given flat."""
        n = state.C.shape[1]
        C = state.C + dC.reshape(-1, n)
        if self.rest:
            C[0] = C[1]
        return replace(state, C=C, W=state.W + dW.reshape(-1, n))

    def start(self, sigma_q: Array, sigma_ddq: Array, sigma_tau: Array) -> State:
        """Return the smooth start: positions fitted with accelerations of about ``sigma_ddq`` (n) kept down."""
        from dynident.likelihood.arrow import Arrow

        N, n = len(self.log), len(sigma_q)
        size = self.trajectory.size
        C = np.empty((size, n))
        bend = np.einsum("pa,pb->pab", self.local[2], self.local[2])
        smooth, along = np.zeros_like(self._gram), np.zeros((len(self._gram), 5, n))
        self._sum(smooth, bend)
        pull = np.zeros((len(self.points), 5, n))
        pull[:N] = self.local[0][:N, :, None] * self.log.q[:, None, :]
        self._sum(along, pull)
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
