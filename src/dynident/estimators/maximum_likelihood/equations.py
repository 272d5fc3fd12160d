"""The normal equations of positions and torques of one segment, linearised at a state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.barrier import Barrier
from dynident.estimators.maximum_likelihood.segment import Segment, Sigma, State
from dynident.estimators.maximum_likelihood.trajectory import Arrow, TrajectoryBlock, add_ahead, add_rows, band_of
from dynident.models import Model, Partials
from dynident.models.structure import select_independent
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

Moves = Sequence[tuple[Array, Array]]  # of C and W, by segment
DIFFERENCE_STEP = 1e-6  # of a state, for differences of the regressor
MIN_EFFECT = 1e-6  # fall of the cost for a change by its own size, or by 1, below which a parameter has no effect
RANDOM_STATES = 120  # random ones, for n rows each; an even number, so that either half has all joints


class Hypothesis(Noun):
    """A model with its parameters ``theta`` (p), and the noise ``sigma`` of positions and torques."""

    model: Model
    theta: Array
    sigma: Sigma


class RegressorColumns(Noun):
    """The columns ``indices`` (r) of the regressor, from which all p follow: Y = Y[indices] ``combination`` (r, p)."""

    indices: NDArray[np.intp]
    combination: Array

    @classmethod
    def all(cls, p: int) -> RegressorColumns:
        """Return all columns of p parameters."""
        return cls(np.arange(p), np.eye(p))

    @classmethod
    def none(cls, p: int) -> RegressorColumns:
        """Return no columns, for steps of the trajectory alone."""
        return cls(np.arange(0), np.zeros((0, p)))

    @classmethod
    def independent(cls, model: Model) -> RegressorColumns:
        """Return the columns of a model without those of its bodies that depend on others.

        The columns of rigid bodies are analytic in the states: a linear relation that holds at enough random states
        always holds.
        """
        p = len(model.parameters)
        bodies = np.flatnonzero([bool(parameter.body) for parameter in model.parameters])
        if not len(bodies):
            return cls.all(p)
        Y = model.regressor(**model.random_states(np.random.default_rng(0), RANDOM_STATES))[:, :, bodies]
        # unit columns, so that the rank does not depend on the units of the parameters
        scale = np.sqrt((Y**2).mean(axis=(0, 1)))
        scale[scale == 0] = 1.0
        lead, shares = select_independent(Y.swapaxes(0, 1).reshape(-1, len(bodies)) / scale)
        combination = np.eye(p)
        combination[np.ix_(bodies[lead], bodies)] = shares * scale / scale[lead, None]
        indices = np.setdiff1d(np.arange(p), np.delete(bodies, lead))
        return cls(indices, combination[indices])

    def select(self, Y: Array) -> Array:
        """Select the columns of a regressor (N, n, p)."""
        return Y if len(self.indices) == Y.shape[2] else Y[:, :, self.indices]


class Equations(Noun):
    """Gauss-Newton equations of one segment at a state; border columns: W (k n), then r of the regressor.

    ``band`` (w, m n); ``corner`` (b, b) of the border with itself; ``by_border`` (b): minus the gradient by it.
    ``side`` (m n, b + 1 + r): the border, minus the gradient by C, and, where requested, the second derivatives
    of the cost by trajectory and parameters that Gauss-Newton leaves out. ``cost``: half the sum of the weighted
    squares.
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
        """Second derivatives (m n, r) by C and the parameters, (m n, 0) where not requested."""
        return self.side[:, len(self.corner) + 1 :]


class _EquationBlock(Noun):
    """A block of intervals at a state.

    ``rows`` (B, n, w + b + 1) are the derivatives of the weighted model by C, W and the parameters of ``Z`` (B,
    n, r), and the weighted residuals; ``memory`` (B, m) is the memory of the model.
    """

    block: TrajectoryBlock
    rows: Array
    states: tuple[Array, Array, Array]
    Z: Array
    weight: Array
    memory: Array | None


def _equation_blocks(
    segment: Segment, hypothesis: Hypothesis, state: State, columns: RegressorColumns
) -> Iterator[_EquationBlock]:
    """Yield the blocks of a segment, so that the regressor is never formed as a whole."""
    model, theta, sigma_tau = hypothesis.model, hypothesis.theta, hypothesis.sigma.tau
    motion, weight, wanted = segment.motion(state), segment.weights(sigma_tau), segment.target_torque(state)
    n, longest = len(sigma_tau), max(block.points.stop - block.points.start for block in segment.blocks)
    # one for all blocks: memory that is new has to be cleared by the system
    work = np.zeros((longest, n, 5 * n + segment.hats.shape[1] * n + len(columns.indices) + 1))
    for block in segment.blocks:
        states = (motion[0][block.points], motion[1][block.points], motion[2][block.points])
        memory = None if segment.memory is None else segment.memory[block.points]
        # without parameters only the trajectory moves: the torque is cheaper than the regressor
        if columns.indices.size:
            Z = columns.select(model.regressor(*states, memory))
            torque = Z @ (columns.combination @ theta)
        else:
            torque = model.torque(*states, theta, memory)
            Z = np.zeros((*torque.shape, 0))
        block_weight, rows = weight[block.points], work[: len(torque)]
        _write_rows(rows, segment, block.points, model.partials(*states, theta, memory), block_weight)
        np.multiply(Z, block_weight[:, :, None], out=rows[:, :, rows.shape[2] - 1 - Z.shape[2] : -1])
        np.multiply(wanted[block.points] - torque, block_weight, out=rows[:, :, -1])
        yield _EquationBlock(block, rows, states, Z, block_weight, memory)


def _write_rows(rows: Array, segment: Segment, points: slice, slopes: Partials, weight: Array) -> None:
    """Write the derivatives (B, n, 5 n + k n) of the weighted model by C and W into the first columns of ``rows``.

    Derivatives by W are zero where no torque knot acts.
    """
    B, n = weight.shape
    w, k = 5 * n, segment.hats.shape[1]
    weighted_slopes = np.empty((B, n, 3, n))
    for d, slope in enumerate((slopes.q, slopes.dq, slopes.ddq)):
        np.multiply(slope, weight[:, :, None], out=weighted_slopes[:, :, d])
    basis_values = np.moveaxis(segment.basis.local[:, points], 0, 2)[:, None]  # (B, 1, 5, 3)
    np.matmul(basis_values, weighted_slopes, out=rows[:, :, :w].reshape(B, n, 5, n))
    # after a step the torque is not measured: the unknown torques at the knots take its place
    for j in range(n if k else 0):
        rows[:, j, w + j : w + k * n : n] = -segment.hats[points] * weight[:, j : j + 1]


def equations(
    segment: Segment,
    hypothesis: Hypothesis,
    state: State,
    *,
    mixed_hessian: bool = True,
    columns: RegressorColumns | None = None,
) -> Equations:
    """Return the normal equations at a state, with all columns of the regressor, or those of ``columns``."""
    sigma = hypothesis.sigma
    columns = RegressorColumns.all(len(hypothesis.theta)) if columns is None else columns
    n, r, k = len(sigma.q), len(columns.indices), segment.hats.shape[1]
    w, b, m = 5 * n, k * n + r, segment.trajectory.size
    band_blocks, side = np.zeros((m, n, w)), np.zeros((m, n, b + 1 + r * mixed_hessian))
    total = np.zeros((b + 1, b + 1))
    work = np.empty((max(block.intervals.stop - block.intervals.start for block in segment.blocks), w, w + b + 1))
    for part in _equation_blocks(segment, hypothesis, state, columns):
        block = part.block
        blocks = block.products(part.rows[:, :, :w], part.rows, work).reshape(-1, 5, n, w + b + 1)
        add_ahead(band_blocks, blocks[..., :w], block.at)
        add_rows(side[..., : b + 1], blocks[..., w:], block.at)
        if mixed_hessian:
            add_rows(
                side[..., b + 1 :],
                _mixed_hessian(segment, hypothesis.model, part, columns).reshape(-1, 5, n, r),
                block.at,
            )
        flat = part.rows.reshape(-1, w + b + 1)[:, w:]
        total += flat.T @ flat
    # the positions enter by sums over all of them, computed once for all states
    share, squares = segment.shares(state)
    side[:, :, b] += share / sigma.q**2
    band = band_of(band_blocks)
    band.T.reshape(m, n, w)[:, :, ::n] += np.multiply.outer(segment.position_basis.gram_band.T, sigma.q**-2.0).swapaxes(
        1, 2
    )
    if segment.from_rest:
        band[0, :n] = 1.0  # the first coefficients are the second ones
    cost = segment.fixed_cost(squares, sigma) + 0.5 * float(total[-1, -1])
    return Equations(band, side.reshape(m * n, -1), total[:-1, :-1], total[:-1, -1], cost)


def _mixed_hessian(segment: Segment, model: Model, part: _EquationBlock, columns: RegressorColumns) -> Array:
    """Return the sums (I, w, r) of -sum_j e_j d^2 tau_j / dC dtheta, by differences of the regressor.

    e are the residuals, weighted twice.
    """
    (P, n, p), states = part.Z.shape, part.states
    shifted_states = [np.repeat(quantity[None], 3 * n, axis=0) for quantity in states]
    steps = [
        DIFFERENCE_STEP * (1.0 + float(np.abs(quantity[:, j]).max(initial=0.0)))
        for quantity in states
        for j in range(n)
    ]
    # all nudged states in one call of the model: 3 n copies, each with one entry shifted
    for at, step in enumerate(steps):
        shifted_states[at // n][at, :, at % n] += step
    q, dq, ddq = (quantity.reshape(-1, n) for quantity in shifted_states)
    memory = None if part.memory is None else np.tile(part.memory, (3 * n, 1))
    regressor_change = columns.select(model.regressor(q, dq, ddq, memory)).reshape(3 * n, P, n, p)
    regressor_change -= part.Z
    pull, change = part.rows[:, :, -1:] * part.weight[:, :, None], np.zeros((3 * n, P, p))
    for j in range(n):  # quicker than a product of many small matrices
        change += regressor_change[:, :, j] * pull[:, j]
    change /= np.reshape(steps, (-1, 1, 1))
    slopes = change.reshape(3, n, P, p).transpose(2, 0, 1, 3).reshape(P, 3, n * p)
    basis_values = np.moveaxis(segment.basis.local[:, part.block.points], 0, 1)
    return -part.block.products(basis_values, slopes).reshape(-1, 5 * n, p)


def leverage(segment: Segment, hypothesis: Hypothesis, state: State, arrow: Arrow | None = None) -> Array:
    """Return the degrees of freedom (2, n) that the trajectory takes from the positions and torques of each joint.

    These are the traces of (N^-1 times a joint's share of N), with N the band of the trajectory, taken from
    ``arrow`` where it is given.
    """
    sigma, no_columns = hypothesis.sigma, RegressorColumns.none(len(hypothesis.theta))
    n, out = len(sigma.q), np.zeros((2, len(sigma.q)))
    if arrow is None:
        normal_equations = equations(segment, hypothesis, state, mixed_hessian=False, columns=no_columns)
        arrow = Arrow(normal_equations.band, normal_equations.border)
    inverse = arrow.inverse
    for part in _equation_blocks(segment, hypothesis, state, no_columns):
        at = segment.trajectory.first_coefficient[part.block.intervals, None] * n + np.arange(5 * n)
        # look up the block of each interval in the symmetric band of the inverse
        low, high = np.minimum(at[:, :, None], at[:, None, :]), np.maximum(at[:, :, None], at[:, None, :])
        inverse_blocks = inverse[high - low, low]
        is_measured = segment.is_measured[part.block.points]
        for j in range(n):
            out[0, j] += (
                inverse_blocks[:, j::n, j::n] * segment.position_basis.gram[part.block.intervals]
            ).sum() / sigma.q[j] ** 2
            row = part.rows[:, j, : 5 * n] * is_measured[:, None]
            out[1, j] += (inverse_blocks * part.block.products(row, row)).sum()
    return out


def scores(segment: Segment, hypothesis: Hypothesis, state: State, sensitivity: Array) -> Array:
    """Return the score (I, p) of theta from each interval's positions and torques, the trajectory profiled out.

    ``sensitivity`` (m n + k n, p) is minus the derivative of C and W by theta.
    """
    sigma, p = hypothesis.sigma, len(hypothesis.theta)
    n, w, out = len(sigma.q), 5 * len(sigma.q), []
    coefficients, V = segment.trajectory.size * n, segment.position_basis.local[0]
    position_scores = segment.position_basis.by_interval(
        V[:, :, None] * (segment.offset(state) / sigma.q**2)[:, None, :]
    )
    for part in _equation_blocks(segment, hypothesis, state, RegressorColumns.all(p)):
        gradient = part.block.products(part.rows[:, :, :-1], part.rows[:, :, -1:])[:, :, 0]
        gradient[:, :w] += position_scores[part.block.intervals].reshape(-1, w)
        at = segment.trajectory.first_coefficient[part.block.intervals, None] * n + np.arange(w)
        # the score with C and W following theta, so that the trajectory is profiled out
        score = (
            gradient[:, -p:]
            - (gradient[:, None, :w] @ sensitivity[at])[:, 0]
            - gradient[:, w:-p] @ sensitivity[coefficients:]
        )
        out.append(score)
    return np.concatenate(out)


class SearchPoint(Noun):
    """A point of the search, with its cost."""

    states: tuple[State, ...]
    theta: Array
    cost: float


class Likelihood(Noun):
    """The likelihood to maximise: a model on the segments of its logs, with their noise, and a barrier.

    theta moves along the orthonormal ``directions`` (p, v) only: what neither data nor prior determine stays as
    it is.
    """

    model: Model
    segments: tuple[Segment, ...]
    sigma: Sigma
    barrier: Barrier
    directions: Array
    columns: RegressorColumns

    def open_directions(self, information: Array, theta: Array, fixed: int | None) -> Array:
        """Return the directions (p, w) that the information (p, p) or a prior determines, without the fixed
        parameter."""
        directions = self.directions
        # predicted change of the cost when a direction moves by its own size, or by one
        effect = (directions * (information @ directions)).sum(axis=0) * np.maximum((theta @ directions) ** 2, 1.0)
        moves = (effect > MIN_EFFECT) | (self.barrier.centred_components & (directions != 0).T).any(axis=1)
        return np.asarray(directions[:, moves if fixed is None else moves & (directions[fixed] == 0)])

    def cost(self, states: Sequence[State], theta: Array) -> float:
        """Return half the weighted squares plus the barrier; infinite outside the feasible set."""
        barrier = self.barrier.value(theta)
        if np.isinf(barrier):
            return barrier
        pairs = zip(self.segments, states, strict=True)
        return barrier + sum(segment.cost(self.model, state, theta, self.sigma) for segment, state in pairs)

    def equations(self, states: Sequence[State], theta: Array, *, mixed_hessian: bool) -> list[Equations]:
        """Return the normal equations of each segment."""
        hypothesis, pairs = Hypothesis(self.model, theta, self.sigma), zip(self.segments, states, strict=True)
        return [
            equations(segment, hypothesis, state, mixed_hessian=mixed_hessian, columns=self.columns)
            for segment, state in pairs
        ]

    def linearise(
        self, states: Sequence[State], theta: Array, previous: Sequence[Equations], *, mixed_hessian: bool
    ) -> list[Equations]:
        """Return the equations at states and theta, with the second derivatives of ``previous`` ones where given."""
        normal_equations = self.equations(states, theta, mixed_hessian=mixed_hessian and not previous)
        if not previous:
            return normal_equations
        return [
            replace(new, side=np.concatenate([new.side, old.mixed_hessian], axis=1))
            for new, old in zip(normal_equations, previous, strict=True)
        ]

    def trajectory_equations(self, states: Sequence[State], theta: Array) -> list[Equations]:
        """Return the normal equations of each segment for its trajectory alone, which need no regressor."""
        hypothesis, no_columns = Hypothesis(self.model, theta, self.sigma), RegressorColumns.none(len(theta))
        return [
            equations(segment, hypothesis, state, mixed_hessian=False, columns=no_columns)
            for segment, state in zip(self.segments, states, strict=True)
        ]

    def point(self, states: tuple[State, ...], theta: Array) -> SearchPoint | None:
        """Return a point with its cost; None outside the feasible set."""
        cost = self.cost(states, theta)
        return SearchPoint(states, theta, cost) if np.isfinite(cost) else None


def move_states(
    segments: Sequence[Segment], states: Sequence[State], moves: Moves, size: float = 1.0
) -> tuple[State, ...]:
    """Return the states moved by ``size`` times their steps."""
    triples = zip(segments, states, moves, strict=True)
    return tuple(segment.move(state, size * dC, size * dW) for segment, state, (dC, dW) in triples)
