"""The normal equations of positions and torques about a state of one segment."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.maximum_likelihood.arrow import Arrow, add_ahead, add_rows, band_of
from dynident.estimators.maximum_likelihood.columns import Columns
from dynident.estimators.maximum_likelihood.segment import Segment, Sigma, State
from dynident.estimators.maximum_likelihood.trajectory import TrajectoryBlock
from dynident.models import Model, Partials

__all__ = ["Equations", "equations", "leverage", "scores"]

Array = NDArray[np.float64]
NUDGE = 1e-6  # of a state, for differences of the regressor


@dataclass(frozen=True, eq=False)
class Equations:
    """Gauss-Newton equations of one segment about a state; border columns: W (k n), then r of the regressor.

    ``band`` (w, m n), ``corner`` (b, b) of the border with itself, ``by_border`` (b) minus the gradient by it. ``side``
    (m n, b + 1 + r) is the border, minus the gradient by C, and, where asked for, the second derivatives of the cost by
    trajectory and parameters that Gauss-Newton leaves out. ``cost`` is half the sum of the weighted squares.
    """

    band: Array
    side: Array
    corner: Array
    by_border: Array
    cost: float

    @property
    def border(self) -> Array:
        """The border (m n, b) of the band."""
        return self.side[:, : len(self.corner)]

    @property
    def by_coefficients(self) -> Array:
        """Minus the gradient (m n) by C."""
        return np.asarray(self.side[:, len(self.corner)])

    @property
    def mixed_hessian(self) -> Array:
        """Second derivatives (m n, r) by C and the parameters, (m n, 0) where not asked for."""
        return self.side[:, len(self.corner) + 1 :]

    def with_mixed_hessian(self, known: Array) -> Equations:
        """Return the equations, which have none, with second derivatives (m n, r) that are known."""
        return replace(self, side=np.concatenate([self.side, known], axis=1))


@dataclass(frozen=True, eq=False)
class _Part:
    """A block of intervals about a state: ``rows`` (B, n, w + b + 1) are the derivatives of the weighted model by C, W
    and the parameters of ``Z`` (B, n, r), and the weighted residuals; ``memory`` (B, m) is what the model remembers.
    """

    block: TrajectoryBlock
    rows: Array
    states: tuple[Array, Array, Array]
    Z: Array
    weight: Array
    memory: Array | None


def _parts(
    segment: Segment, model: Model, state: State, theta: Array, sigma_tau: Array, columns: Columns
) -> Iterator[_Part]:
    """Yield the parts of a segment, so that the regressor is never formed whole."""
    motion, weight, wanted = segment.motion(state), segment.weights(sigma_tau), segment.wanted(state)
    n, most = len(sigma_tau), max(block.points.stop - block.points.start for block in segment.blocks)
    # one for all blocks: memory that is new has to be cleared by the system
    work = np.zeros((most, n, 5 * n + segment.hats.shape[1] * n + len(columns.kept) + 1))
    for block in segment.blocks:
        states = (motion[0][block.points], motion[1][block.points], motion[2][block.points])
        memory = None if segment.memory is None else segment.memory[block.points]
        if columns.kept.size:
            Z = columns.of(model.regressor(*states, memory))
            torque = Z @ (columns.combination @ theta)
        else:
            torque = model.torque(*states, theta, memory)
            Z = np.zeros((*torque.shape, 0))
        own, rows = weight[block.points], work[: len(torque)]
        _write_rows(rows, segment, block.points, Z, model.partials(*states, theta, memory), own)
        np.multiply(wanted[block.points] - torque, own, out=rows[:, :, -1])
        yield _Part(block, rows, states, Z, own, memory)


def _write_rows(rows: Array, segment: Segment, points: slice, Z: Array, slopes: Partials, weight: Array) -> None:
    """Write the derivatives (B, n, 5 n + k n + r) of the weighted model by C, W and parameters to all but the last of
    ``rows``, which are zero where no torque knot acts.
    """
    B, n, _ = Z.shape
    w, k = 5 * n, segment.hats.shape[1]
    by = np.empty((B, n, 3, n))
    for d, one in enumerate((slopes.q, slopes.dq, slopes.ddq)):
        np.multiply(one, weight[:, :, None], out=by[:, :, d])
    along = np.moveaxis(segment.basis.local[:, points], 0, 2)[:, None]  # (B, 1, 5, 3)
    np.matmul(along, by, out=rows[:, :, :w].reshape(B, n, 5, n))
    for j in range(n if k else 0):
        rows[:, j, w + j : w + k * n : n] = -segment.hats[points] * weight[:, j : j + 1]
    np.multiply(Z, weight[:, :, None], out=rows[:, :, w + k * n : -1])


def equations(
    segment: Segment,
    model: Model,
    state: State,
    theta: Array,
    sigma: Sigma,
    *,
    mixed_hessian: bool = True,
    columns: Columns | None = None,
) -> Equations:
    """Return the normal equations about a state, with all ``columns`` of the regressor, or those given."""
    columns = Columns.all(len(theta)) if columns is None else columns
    n, r, k = len(sigma.q), len(columns.kept), segment.hats.shape[1]
    w, b, m = 5 * n, k * n + r, segment.trajectory.size
    ahead, side, total = np.zeros((m, n, w)), np.zeros((m, n, b + 1 + r * mixed_hessian)), np.zeros((b + 1, b + 1))
    work = np.empty((max(one.intervals.stop - one.intervals.start for one in segment.blocks), w, w + b + 1))
    for part in _parts(segment, model, state, theta, sigma.tau, columns):
        block = part.block
        blocks = block.products(part.rows[:, :, :w], part.rows, work).reshape(-1, 5, n, w + b + 1)
        add_ahead(ahead, blocks[..., :w], block.at)
        add_rows(side[..., : b + 1], blocks[..., w:], block.at)
        if mixed_hessian:
            add_rows(side[..., b + 1 :], _mixed_hessian(segment, model, part, columns).reshape(-1, 5, n, r), block.at)
        flat = part.rows.reshape(-1, w + b + 1)[:, w:]
        total += flat.T @ flat
    share, squares = segment.shares(state)
    side[:, :, b] += share / sigma.q**2
    band = band_of(ahead)
    band.T.reshape(m, n, w)[:, :, ::n] += np.multiply.outer(segment.shown.gram_band.T, sigma.q**-2.0).swapaxes(1, 2)
    if segment.rest:
        band[0, :n] = 1.0  # the first coefficients are the second ones
    cost = segment.given(squares, sigma) + 0.5 * float(total[-1, -1])
    return Equations(band, side.reshape(m * n, -1), total[:-1, :-1], total[:-1, -1], cost)


def _mixed_hessian(segment: Segment, model: Model, part: _Part, columns: Columns) -> Array:
    """Return the sums (I, w, r) of -sum_j pull_j d^2 tau_j / dC dtheta, by differences of the regressor."""
    (P, n, p), states = part.Z.shape, part.states
    nudged = [np.repeat(one[None], 3 * n, axis=0) for one in states]
    size = [NUDGE * (1.0 + float(np.abs(one[:, j]).max(initial=0.0))) for one in states for j in range(n)]
    for at, step in enumerate(size):
        nudged[at // n][at, :, at % n] += step
    q, dq, ddq = (one.reshape(-1, n) for one in nudged)
    memory = None if part.memory is None else np.tile(part.memory, (3 * n, 1))
    there = columns.of(model.regressor(q, dq, ddq, memory)).reshape(3 * n, P, n, p)
    there -= part.Z
    pull, change = part.rows[:, :, -1:] * part.weight[:, :, None], np.zeros((3 * n, P, p))
    for j in range(n):  # quicker than a product of many small matrices
        change += there[:, :, j] * pull[:, j]
    change /= np.reshape(size, (-1, 1, 1))
    slopes = change.reshape(3, n, P, p).transpose(2, 0, 1, 3).reshape(P, 3, n * p)
    along = np.moveaxis(segment.basis.local[:, part.block.points], 0, 1)
    return -part.block.products(along, slopes).reshape(-1, 5 * n, p)


def leverage(
    segment: Segment, model: Model, state: State, theta: Array, sigma: Sigma, known: Arrow | None = None
) -> Array:
    """Return the degrees of freedom (2, n) that the trajectory takes from the positions and torques of each joint.

    These are the traces of (N^-1 times a joint's share of N), with N the band of the trajectory, of ``known``.
    """
    n, out = len(sigma.q), np.zeros((2, len(sigma.q)))
    none = Columns.none(len(theta))
    if known is None:
        found = equations(segment, model, state, theta, sigma, mixed_hessian=False, columns=none)
        known = Arrow(found.band, found.border)
    inverse = known.inverse
    for part in _parts(segment, model, state, theta, sigma.tau, none):
        at = segment.trajectory.first[part.block.intervals, None] * n + np.arange(5 * n)
        low, high = np.minimum(at[:, :, None], at[:, None, :]), np.maximum(at[:, :, None], at[:, None, :])
        Z = inverse[high - low, low]
        own = segment.measured[part.block.points]
        for j in range(n):
            out[0, j] += (Z[:, j::n, j::n] * segment.shown.gram[part.block.intervals]).sum() / sigma.q[j] ** 2
            row = part.rows[:, j, : 5 * n] * own[:, None]
            out[1, j] += (Z * part.block.products(row, row)).sum()
    return out


def scores(segment: Segment, model: Model, state: State, theta: Array, sigma: Sigma, follow: Array) -> Array:
    """Return the score (I, p) of theta from each interval's positions and torques, the trajectory profiled out.

    ``follow`` (m n + k n, p) is minus the dependence of C and W on theta.
    """
    n, p, w, out = len(sigma.q), len(theta), 5 * len(sigma.q), []
    edge, V = segment.trajectory.size * n, segment.shown.local[0]
    shown = segment.shown.by_interval(V[:, :, None] * (segment.offset(state) / sigma.q**2)[:, None, :])
    for part in _parts(segment, model, state, theta, sigma.tau, Columns.all(p)):
        pull = part.block.products(part.rows[:, :, :-1], part.rows[:, :, -1:])[:, :, 0]
        pull[:, :w] += shown[part.block.intervals].reshape(-1, w)
        at = segment.trajectory.first[part.block.intervals, None] * n + np.arange(w)
        own = pull[:, -p:] - (pull[:, None, :w] @ follow[at])[:, 0] - pull[:, w:-p] @ follow[edge:]
        out.append(own)
    return np.concatenate(out)
