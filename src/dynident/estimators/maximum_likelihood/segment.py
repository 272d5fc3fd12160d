"""One recording in eq. (7): its spline trajectory, and the residuals of its positions and torques."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.estimators.maximum_likelihood.arrow import Arrow
from dynident.estimators.maximum_likelihood.basis import Basis, basis
from dynident.estimators.maximum_likelihood.torques import Torques, condensed
from dynident.estimators.maximum_likelihood.trajectory import Trajectory, TrajectoryBlock
from dynident.log import Log, Motion
from dynident.models import Model

__all__ = ["Segment", "Sigma", "State"]

Array = NDArray[np.float64]
GAUSS = 0.5 / np.sqrt(3.0)  # points of Gauss's rule of two, from the middle of an interval of length one
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
    late. What a model remembers is taken from the motion ``remembered`` and does not follow the trajectory.
    """

    log: Log
    trajectory: Trajectory
    raw: Torques
    torques: Torques
    torque_knots: tuple[Array, ...] = ()
    rest: bool = False
    time_offset: float = 0.0
    remembered: Motion | None = None

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

    @cached_property
    def memory(self) -> Array | None:
        """What the model remembers (P, m) at the points, None where it does not."""
        return self._memory(self.points)

    def _memory(self, t: Array) -> Array | None:
        known = self.remembered
        if known is None or known.memory is None:
            return None
        return np.stack([np.interp(t, known.t, one) for one in known.memory.T], axis=1)

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
    def basis(self) -> Basis:
        """The splines at the points."""
        return basis(self.trajectory, self.points, rest=self.rest)

    @cached_property
    def shown(self) -> Basis:
        """The splines at the positions."""
        return basis(self.trajectory, self.seen, rest=self.rest)

    @cached_property
    def _summed(self) -> tuple[Array, Array, Array]:
        """What the positions say, however many: coefficients C (m, n) near them, and of what these leave the basis's
        share (m, n) and the squares (n).
        """
        middle = self.log.q.mean(axis=0)  # positions may be far from zero
        C = middle + self.shown.normal.inner(self.shown.transposed @ (self.log.q - middle))
        left = self.log.q - self.shown.values @ C
        return C, self.shown.transposed @ left, (left**2).sum(axis=0)

    def shares(self, state: State) -> tuple[Array, Array]:
        """Return the basis's share (m, n) in what is left of the positions, and the sum of its squares (n).

        Both are changes from those near the positions, so that nothing is lost to rounding.
        """
        C, share, squares = self._summed
        change = state.C - C
        found = share - self.shown.products @ change
        return found, squares - (change * (share + found)).sum(axis=0)

    def motion(self, state: State) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (P, n) at the points."""
        return self.basis.motion(state.C)

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
        motion = basis(self.trajectory, self.raw.t, rest=self.rest).motion(state.C)
        return model.torque(*motion, theta, self._memory(self.raw.t))

    def offset(self, state: State) -> Array:
        """Return what is left of the positions (N, n)."""
        return np.asarray(self.log.q - self.shown.values @ state.C)

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
        left = (self.wanted(state) - model.torque(*self.motion(state), theta, self.memory)) * self.weights(sigma.tau)
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
        size, band = self.trajectory.size, self.shown.gram_band / sigma_q**2 + self.shown.bends / sigma_ddq**2
        if self.rest:
            band[0, 0] = 1.0  # the first coefficient is the second one
        return Arrow(band, np.zeros((size, 0)))

    def start(self, sigma_q: Array, sigma_ddq: Array) -> State:
        """Return the smooth start: positions fitted with accelerations of about ``sigma_ddq`` (n) kept down."""
        along = (self.shown.transposed @ self.log.q) / sigma_q**2
        pairs = zip(sigma_q, sigma_ddq, along.T, strict=True)
        C = np.concatenate([self.smooth(a, b).inner(rhs[:, None]) for a, b, rhs in pairs], axis=1)
        if self.rest:
            C[0] = C[1]
        W = [np.stack([_near(self.log, knot) for knot in knots]) for knots in self.torque_knots]
        return State(C, np.concatenate(W) if W else np.zeros((0, len(sigma_q))))

    def resolution(self, sigma_q: Array, sigma_ddq: Array) -> Array:
        """Return the usual standard deviation (n) of the velocities in the smooth start."""
        interval, slope = self.shown.interval, self.shown.local[1]
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
