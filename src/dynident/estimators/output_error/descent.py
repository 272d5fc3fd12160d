"""Levenberg's and Marquardt's iteration for an output error; the states at the start of each piece are eliminated.

The rows of a piece are [J_theta | J_start] and its residual e: with A = J_start' J_start the start that fits best
follows from theta, and what is left of J_theta is orthogonal to J_start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, Step, brief
from dynident.estimators.estimator import Problem
from dynident.estimators.output_error.first import first_runs
from dynident.estimators.output_error.notes import StartedElsewhere, StillSimulating
from dynident.estimators.output_error.shots import Shots, Simulation
from dynident.regression import Rank
from dynident.regression.long_run import bandwidth, bartlett
from dynident.simulation import Failure

__all__ = ["Descent", "Fitted"]

Array = NDArray[np.float64]
CLOSE = 0.01  # standard errors of a step that ends the iteration
ROUNDING = 1e-10  # relative change of the cost that ends it
DAMPING, LEAST, MOST = 1e-3, 1e-9, 1e6
RIDGE = 1e-12  # of the start: a joint that rests has no sensitivity
ALONE = 1e6  # condition above which a piece alone determines a direction
EXACT = 1e-9  # of the motion: a residual below it is rounding


@dataclass(frozen=True, eq=False)
class Fitted:
    """The ``value`` (p) with its ``information`` (p, p), of so many ``rows``, and what is to be noted."""

    value: Array
    information: Array
    rows: int
    notes: tuple[Note, ...]

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class _Linear:
    """A recording around its simulation: the weighted rows left of theta's (B, K n, r) and of the residuals (B, K n),
    and what the starts (B, 2 n) follow: ``start`` = at theta as it is, ``follow`` (B, 2 n, r) by a step of theta."""

    rows: Array
    rest: Array
    start: Array
    follow: Array

    __repr__ = brief


@dataclass(eq=False)
class Descent:
    """One estimation in progress; ``rank`` has the directions of the parameters that the data determine."""

    problem: Problem
    shots: tuple[Shots, ...]
    rank: Rank
    iterations: int
    notes: list[Note] = field(default_factory=list)

    def fit(self, start: Array) -> Fitted:
        """Return the fit that begins with ``start`` (p)."""
        model, turn = self.problem.model, self.rank.determined / self.rank.values[: self.rank.rank]
        self.problem.progress("simulating")
        theta, runs, other = first_runs(self.problem, start, lambda value: self.simulated(self.shots, value))
        if other is not None:
            self.notes.append(StartedElsewhere(other))
        damping, moved, settled = DAMPING, np.inf, False
        sigma = self.noise(runs)
        for iteration in range(1, self.iterations + 1):
            self.problem.progress(Step("simulating", iteration, self.iterations))
            linear = [
                self.linear(shots, run, *shots.slopes(model, theta, run, turn), sigma)
                for shots, run in zip(self.shots, runs, strict=True)
            ]
            H, g = _normal(linear)
            cost = self.cost(runs, sigma)
            while damping < MOST:
                step = np.linalg.solve(H + damping * np.diag(np.diag(H) + np.finfo(float).tiny), g)
                shots = tuple(
                    one.moved(run.run.rows[:, 0], some.start - some.follow @ step)
                    for one, run, some in zip(self.shots, runs, linear, strict=True)
                )
                there = self.simulated(shots, theta + turn @ step)
                if not isinstance(there, Failure) and self.cost(there, sigma) <= cost * (1 + ROUNDING):
                    break
                damping *= 10.0
            else:
                settled = True  # no step makes it less
                break
            moved = float(np.sqrt(step @ H @ step / max(len(step), 1)))
            fall = 1 - self.cost(there, sigma) / cost if cost > 0 else 0.0
            theta, runs, self.shots, damping = theta + turn @ step, there, shots, max(damping / 10.0, LEAST)
            sigma = self.noise(runs)
            if (moved < CLOSE and damping <= DAMPING) or fall < ROUNDING:
                settled = True
                break
        if not settled:
            self.notes.append(StillSimulating(self.iterations, moved))
        linear = [
            self.linear(shots, run, *shots.slopes(model, theta, run, turn), sigma)
            for shots, run in zip(self.shots, runs, strict=True)
        ]
        return Fitted(theta, self.information(linear), sum(one.e.size for one in runs), tuple(self.notes))

    def simulated(self, shots: Sequence[Shots], theta: Array) -> list[Simulation] | Failure:
        """Return the simulations of all recordings, or the first failure."""
        found = []
        for one in shots:
            run = one.simulated(self.problem.model, theta)
            if isinstance(run, Failure):
                return run
            found.append(run)
        return found

    def noise(self, runs: Sequence[Simulation]) -> Array:
        """Return the rms (n) of the residuals of each joint."""
        rows = np.concatenate([one.e.reshape(-1, one.e.shape[2]) for one in runs])
        size = np.concatenate([one.measured[one.rows] for one in self.shots])
        least = EXACT * (np.ptp(size, axis=0) + np.finfo(float).tiny)
        return np.asarray(np.maximum(np.sqrt(np.mean(np.square(rows), axis=0)), least))

    @staticmethod
    def cost(runs: Sequence[Simulation], sigma: Array) -> float:
        """Return the weighted sum of squares."""
        return float(sum(np.square(one.e / sigma).sum() for one in runs))

    @staticmethod
    def linear(shots: Shots, run: Simulation, by_theta: Array, by_start: Array, sigma: Array) -> _Linear:
        """Return the rows of a recording without the starts of its pieces."""
        pieces = len(by_theta)
        J, S, e = (
            (one / sigma.reshape(-1, *[1] * (one.ndim - 3))).reshape(pieces, -1, *one.shape[3:])
            for one in (by_theta, by_start, run.e)
        )
        size = np.linalg.norm(S, axis=1, keepdims=True)
        S = S / np.where(size > 0, size, 1.0)
        A = S.transpose(0, 2, 1) @ S + RIDGE * np.eye(S.shape[2])
        both = np.linalg.solve(A, S.transpose(0, 2, 1) @ np.concatenate((J, e[..., None]), axis=2))
        left = np.concatenate((J, e[..., None]), axis=2) - S @ both
        scaled = both / np.where(size > 0, size, 1.0).transpose(0, 2, 1)
        return _Linear(left[..., :-1], left[..., -1], scaled[..., -1], scaled[..., :-1])

    def information(self, linear: Sequence[_Linear]) -> Array:
        """Return the inverse covariance (p, p): H S^-1 H on the determined directions, with the covariance S of J' e."""
        H, _ = _normal(linear)
        r = len(H)
        pieces = [one for one in linear if len(one.rows) > 1]
        S = _of_pieces(pieces, H) if len(pieces) == len(linear) else self._of_samples(linear, H)
        back = self.rank.values[:r, None] * self.rank.vectors[:, :r].T * self.rank.scale
        root = np.linalg.solve(_root(S), H @ back)
        return np.asarray(root.T @ root)

    def _of_samples(self, linear: Sequence[_Linear], H: Array) -> Array:
        """Return the long-run covariance (r, r) of J' e, of residuals that are correlated in time."""
        n, r, half = len(self.problem.model.joints), len(H), _root(H)
        total, independent = np.zeros((r, r)), 0.0
        for one in linear:
            scores = (one.rows * one.rest[..., None]).reshape(-1, n, r).sum(axis=1)
            scores = np.linalg.solve(half, scores.T).T
            length = bandwidth(iter([iter([scores])]))
            count, part = bartlett(iter([scores]), length, r)
            total, independent = total + part, independent + count / length
        spread = (independent * total + r * np.diag(np.diag(total))) / (independent + r)
        return np.asarray(half @ spread @ half.T)


def _of_pieces(linear: Sequence[_Linear], H: Array) -> Array:
    """Return the covariance (r, r) of J' e from pieces, each of which is correlated as it will: what each changes when
    it is left out (the jackknife; Bell and McCaffrey, 2002)."""
    J, e = (np.concatenate(some) for some in ([one.rows for one in linear], [one.rest for one in linear]))
    scores = np.einsum("bkr,bk->br", J, e)
    rest = np.eye(len(H)) - (J.transpose(0, 2, 1) @ J) @ np.linalg.inv(H)
    known = np.linalg.cond(rest) < ALONE
    scores[known] = np.linalg.solve(rest[known], scores[known][..., None])[..., 0]
    return np.asarray(scores.T @ scores + np.diag(ROUNDING**2 * np.diag(H)))


def _normal(linear: Sequence[_Linear]) -> tuple[Array, Array]:
    """Return J' J (r, r) and J' e (r) of all recordings."""
    r = linear[0].rows.shape[2]
    J, e = (np.concatenate([one.reshape(-1, *shape) for one in some]) for some, shape in (
        ([one.rows for one in linear], (r,)), ([one.rest for one in linear], ()))
    )  # fmt: skip
    return J.T @ J, J.T @ e


def _root(matrix: Array) -> Array:
    """Return the Cholesky factor (r, r), of a singular matrix that of one near to it."""
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    some = matrix / np.outer(scale, scale)
    return np.asarray(scale[:, None] * np.linalg.cholesky(some + 1e-13 * len(some) * np.eye(len(some))))
