"""The normal equations of positions and torques about a state of one segment."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.maximum_likelihood.arrow import Arrow, gather
from dynident.estimators.maximum_likelihood.segment import Segment, Sigma, State
from dynident.estimators.maximum_likelihood.trajectory import TrajectoryBlock
from dynident.models import Model, Partials

__all__ = ["Equations", "equations", "leverage", "scores"]

Array = NDArray[np.float64]
NUDGE = 1e-6  # of a state, for differences of the regressor


@dataclass(frozen=True, eq=False)
class Equations:
    """Gauss-Newton equations of one segment about a state; border columns: W (k n), theta (p).

    ``band`` (w, m n), ``border`` (m n, k n + p), ``corner`` of the border with itself, ``mixed_hessian`` (m n, p) the
    second derivatives of the cost by trajectory and theta that Gauss-Newton leaves out, (m n, 0) where not asked for;
    minus the gradients by C (m n) and by the border. ``cost`` is half the sum of the weighted squares.
    """

    band: Array
    border: Array
    corner: Array
    mixed_hessian: Array
    by_coefficients: Array
    by_border: Array
    cost: float


@dataclass(frozen=True, eq=False)
class _Part:
    """A block of intervals about a state: ``rows`` (B, n, w + b + 1) are the derivatives of the weighted model by C, W
    and theta, and the weighted residuals.
    """

    block: TrajectoryBlock
    rows: Array
    states: tuple[Array, Array, Array]
    Z: Array
    weight: Array


def _parts(segment: Segment, model: Model, state: State, theta: Array, sigma_tau: Array) -> Iterator[_Part]:
    """Yield the parts of a segment, so that the regressor is never formed whole."""
    motion, weight, wanted = segment.motion(state), segment.weights(sigma_tau), segment.wanted(state)
    for block in segment.blocks:
        states = (motion[0][block.points], motion[1][block.points], motion[2][block.points])
        Z = model.regressor(*states)
        slopes, own = model.partials(*states, theta), weight[block.points]
        rows = _rows(segment, block.points, Z, slopes, wanted[block.points] - Z @ theta)
        rows *= own[:, :, None]
        yield _Part(block, rows, states, Z, own)


def _rows(segment: Segment, points: slice, Z: Array, slopes: Partials, left: Array) -> Array:
    """Return the derivatives (B, n, 5 n + k n + p) of the model by C, W and theta, and last the residual."""
    B, n, p = Z.shape
    w, k = 5 * n, segment.hats.shape[1]
    rows = np.zeros((B, n, w + k * n + p + 1))
    by = np.stack([slopes.q, slopes.dq, slopes.ddq], axis=2)
    rows[:, :, :w] = (np.moveaxis(segment.local[:, points], 0, 2)[:, None] @ by).reshape(B, n, w)
    for j in range(n):
        rows[:, j, w + j : w + k * n : n] = -segment.hats[points]
    rows[:, :, w + k * n : -1] = Z
    rows[:, :, -1] = left
    return rows


def equations(
    segment: Segment, model: Model, state: State, theta: Array, sigma: Sigma, *, mixed_hessian: bool = True
) -> Equations:
    """Return the normal equations about a state."""
    n, p, k = len(sigma.q), len(theta), segment.hats.shape[1]
    w, b, size = 5 * n, k * n + p, segment.trajectory.size * n
    band, side = np.zeros((w, size)), np.zeros((size, b + p * mixed_hessian + 1))
    total = np.zeros((b + 1, b + 1))
    for part in _parts(segment, model, state, theta, sigma.tau):
        blocks = part.block.products(part.rows[:, :, :w], part.rows)
        for j in range(n):
            blocks[:, j:w:n, j:w:n] += segment.gram[part.block.intervals] / sigma.q[j] ** 2
        bends = _mixed_hessian(segment, model, part) if mixed_hessian else np.zeros((len(blocks), w, 0))
        wide = np.concatenate([blocks[:, :, w:-1], bends, blocks[:, :, -1:]], axis=2)
        one, other = gather(blocks[:, :, :w], wide, part.block.adds)
        band += one
        side += other
        flat = part.rows[:, :, w:].reshape(-1, b + 1)
        total += flat.T @ flat
    share, squares = segment.shares(state)
    side[:, -1] += (share / sigma.q**2).ravel()
    if segment.rest:
        band[0, :n] = 1.0  # the first coefficients are the second ones
    cost = segment.given(squares, sigma) + 0.5 * float(total[-1, -1])
    return Equations(band, side[:, :b], total[:-1, :-1], side[:, b:-1], side[:, -1], total[:-1, -1], cost)


def _mixed_hessian(segment: Segment, model: Model, part: _Part) -> Array:
    """Return the sums (I, w, p) of -sum_j pull_j d^2 tau_j / dC dtheta, by differences of the regressor."""
    (P, n, p), states = part.Z.shape, part.states
    nudged = [np.repeat(one[None], 3 * n, axis=0) for one in states]
    size = [NUDGE * (1.0 + float(np.abs(one[:, j]).max(initial=0.0))) for one in states for j in range(n)]
    for at, step in enumerate(size):
        nudged[at // n][at, :, at % n] += step
    there = model.regressor(*(one.reshape(-1, n) for one in nudged)).reshape(3 * n, P, n, p)
    there -= part.Z
    pull, change = part.rows[:, :, -1:] * part.weight[:, :, None], np.zeros((3 * n, P, p))
    for j in range(n):  # quicker than a product of many small matrices
        change += there[:, :, j] * pull[:, j]
    change /= np.reshape(size, (-1, 1, 1))
    slopes = change.reshape(3, n, P, p).transpose(2, 0, 1, 3).reshape(P, 3, n * p)
    return -part.block.products(np.moveaxis(segment.local[:, part.block.points], 0, 1), slopes).reshape(-1, 5 * n, p)


def leverage(segment: Segment, model: Model, state: State, theta: Array, sigma: Sigma) -> Array:
    """Return the degrees of freedom (2, n) that the trajectory takes from the positions and torques of each joint.

    These are the traces of (N^-1 times a joint's share of N), with N the band of the trajectory.
    """
    n, out = len(sigma.q), np.zeros((2, len(sigma.q)))
    found = equations(segment, model, state, theta, sigma, mixed_hessian=False)
    inverse = Arrow(found.band, found.border).inverse
    for part in _parts(segment, model, state, theta, sigma.tau):
        at = segment.trajectory.first[part.block.intervals, None] * n + np.arange(5 * n)
        low, high = np.minimum(at[:, :, None], at[:, None, :]), np.maximum(at[:, :, None], at[:, None, :])
        Z = inverse[high - low, low]
        own = segment.measured[part.block.points]
        for j in range(n):
            out[0, j] += (Z[:, j::n, j::n] * segment.gram[part.block.intervals]).sum() / sigma.q[j] ** 2
            row = part.rows[:, j, : 5 * n] * own[:, None]
            out[1, j] += (Z * part.block.products(row, row)).sum()
    return out


def scores(segment: Segment, model: Model, state: State, theta: Array, sigma: Sigma, follow: Array) -> Array:
    """Return the score (I, p) of theta from each interval's positions and torques, the trajectory profiled out.

    ``follow`` (m n + k n, p) is minus the dependence of C and W on theta.
    """
    n, p, w, out = len(sigma.q), len(theta), 5 * len(sigma.q), []
    edge, V = segment.trajectory.size * n, segment.shown[1]
    shown = segment.by_interval(V[:, :, None] * (segment.offset(state) / sigma.q**2)[:, None, :])
    for part in _parts(segment, model, state, theta, sigma.tau):
        pull = part.block.products(part.rows[:, :, :-1], part.rows[:, :, -1:])[:, :, 0]
        pull[:, :w] += shown[part.block.intervals].reshape(-1, w)
        at = segment.trajectory.first[part.block.intervals, None] * n + np.arange(w)
        own = pull[:, -p:] - (pull[:, None, :w] @ follow[at])[:, 0] - pull[:, w:-p] @ follow[edge:]
        out.append(own)
    return np.concatenate(out)
