"""Variance components: how much measured vectors differ beyond their standard errors, by restricted likelihood.

Vectors y_k = X_k c + u_k + e_k have errors e_k ~ N(0, s^2 C_k) of known shape and deviations u_k ~ N(0, V) with V made
of blocks. REML (Patterson and Thompson, 1971) by the iteration of Zhou et al. (2015), "MM algorithms for variance
components models", which keeps each block positive definite. Robots that deviate more than chance are bounded as by
Huber (1964), so that the few in which something has changed do not make all others look uncertain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.regression import GroupKind, ParameterGroup, rank_of_information
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

ParameterBlock = NDArray[np.intp]
MIN_INFORMATION = 1e-10  # of the largest: a direction with less, in scaled parameters, is not shown
MAX_ITERATIONS, CONVERGENCE_TOLERANCE = 80, 0.01  # of the iteration, until no component changes by more
MAX_DEVIATION = 3.0  # standard deviations of a mean square above one at which it is bounded

MAX_LOGS = 400  # logs, taken from robots at random, of which the scatter is estimated
FEW_ROBOTS = 5  # robots, below which one that changes weighs too much


class History(Noun):
    """The base parameters of one robot, from K logs in the order of their dates.

    ``days`` (K) since the first log of the fleet; ``value`` (K, b) by least squares on each log alone; ``information``
    (K, b, b), the inverse of its covariance (with correlated residuals accounted for), zero in directions that the log
    does not show. What the model leaves has a history of its own, with the logarithm of each joint's residual as value.
    """

    robot: str
    logs: tuple[str, ...]
    days: Array
    value: Array
    information: Array


class WhitenedVectors(Noun):
    """K vectors (b) as whitened rows z_k = G_k y_k, with the model of one robot: y_k = design_k c + deviations.

    ``factor`` (K, b, b) holds the G_k, G_k' G_k = C_k^-1, with zero rows for directions that are not shown;
    ``is_shown`` (K, b) marks the others; ``value`` (K, b) are the z_k; ``design`` is (K, b, q).
    """

    factor: Array
    value: Array
    is_shown: NDArray[np.bool_]
    design: Array

    def solve(self, variances: VarianceComponents, weights: Array | None = None) -> GlsSolution:
        """Solve for c by generalised least squares; ``weights`` (K) divide the covariances of the vectors."""
        G, b = self.factor, self.factor.shape[1]
        # N_k^-1, of the covariance N_k = s^2 I + G_k V G_k' of the whitened rows
        inverse = np.linalg.inv(variances.inflation * np.eye(b) + G @ variances.covariance @ G.swapaxes(1, 2))
        if weights is not None:
            inverse = weights[:, None, None] * inverse
        X = G @ self.design
        NX = inverse @ X
        information = np.einsum("kiq,kip->qp", X, NX)
        covariance = rank_of_information(information, tolerance=MIN_INFORMATION).inverse
        c = covariance @ np.einsum("kiq,ki->q", NX, self.value)
        e = self.value - X @ c
        n = np.einsum("kij,kj->ki", inverse, e)
        # the fit of c takes its share of the residuals, so that their expected squares are smaller
        hat = NX @ covariance @ NX.swapaxes(1, 2)
        residual_precision = inverse - hat
        expected_noise = (np.einsum("kii->ki", residual_precision) * self.is_shown).sum(axis=1)
        noise = np.stack([(n**2).sum(axis=1), expected_noise], axis=1)
        expected = G.swapaxes(1, 2) @ residual_precision @ G
        return GlsSolution(c, covariance, np.einsum("kij,ki->kj", G, n), expected, noise, (e * n).sum(axis=1))

    def robust_weights(self, variances: VarianceComponents) -> Array:
        """Return a weight (K) below one for each vector that is farther from the mean than chance."""
        weights = np.ones(len(self.value))
        dof = self.is_shown.sum(axis=1)
        # distances are measured from a mean that depends on the weights, so both are iterated
        for _ in range(10):
            distance = self.solve(variances, weights).distance / weights
            # a chi-square distance has the mean dof and the variance 2 dof
            weights = np.minimum(1.0, (dof + MAX_DEVIATION * np.sqrt(2.0 * dof)) / np.maximum(distance, 1e-300))
        return weights


class VarianceComponents(Noun):
    """The covariance (b, b) of deviations, by ``blocks`` of parameters, and the factor s^2 on the covariances C_k."""

    blocks: tuple[ParameterBlock, ...]
    covariance: Array
    inflation: float = 1.0


class GlsSolution(Noun):
    """Generalised least squares with given components: c (q) with its covariance (q, q), and what REML needs.

    ``score`` (K, b) are G_k' N_k^-1 e_k with the residuals e_k of the rows and N_k their covariance; ``expected``
    (K, b, b) its covariance; ``noise`` (K, 2) the square of N_k^-1 e_k and what is expected of it; ``distance`` (K) the
    Mahalanobis distances e_k' N_k^-1 e_k.
    """

    value: Array
    covariance: Array
    score: Array
    expected: Array
    noise: Array
    distance: Array


def whiten(value: Array, information: Array, design: Array | None = None) -> WhitenedVectors:
    """Whiten values (K, b) by their information (K, b, b); ``design`` (K, b, q) is by default one common mean."""
    # scaled to a unit diagonal, so that the threshold on eigenvalues does not depend on the units
    root_information = np.sqrt(np.einsum("kii->ki", information))
    scale = np.where(root_information > 0, root_information, 1.0)
    roots, vectors = np.linalg.eigh(information / (scale[:, :, None] * scale[:, None, :]))
    is_shown = roots > MIN_INFORMATION * roots[:, -1:].clip(min=0.0)
    size = np.sqrt(np.where(is_shown, roots, 0.0))
    factor = size[:, :, None] * vectors.swapaxes(1, 2) * root_information[:, None, :]
    mean = np.broadcast_to(np.eye(value.shape[1]), information.shape)
    return WhitenedVectors(factor, np.einsum("kij,kj->ki", factor, value), is_shown, mean if design is None else design)


def variance_components(
    sets: Sequence[WhitenedVectors],
    blocks: Sequence[ParameterBlock],
    *,
    inflate: bool = False,
    avoid_zero: bool = False,
    start: VarianceComponents | None = None,
) -> VarianceComponents:
    """Estimate the variance components that several robots' vectors share, or those of one set of vectors.

    With ``inflate`` the factor s^2 >= 1 is estimated, too. With ``avoid_zero`` no variance is zero by chance:
    each is as if one more vector had shown it (Chung et al., 2013). Blocks that nothing shows are zero.
    """
    current: VarianceComponents = start or _initial_components(sets, tuple(blocks))
    for _ in range(MAX_ITERATIONS):
        # one set has no robots to bound, so that its single vectors are weighted instead
        solutions = [
            vectors.solve(current, vectors.robust_weights(current) if len(sets) == 1 else None) for vectors in sets
        ]
        previous, current = current, _update_components(_robot_sums(solutions), current, inflate, avoid_zero)
        if _relative_change(previous, current, solutions) < CONVERGENCE_TOLERANCE:
            break
    return current


class _RobotSums(Noun):
    """The sums over one robot's vectors that the update needs: squared scores, their covariances, the noise."""

    square: Array
    expected: Array
    noise: Array
    count: float


def _robot_sums(solutions: Sequence[GlsSolution]) -> list[_RobotSums]:
    """Return the sums by robot; of one set, by its vectors."""
    # in one set each vector counts as a robot of its own
    if len(solutions) == 1:
        (solution,) = solutions
        rows = zip(solution.score, solution.expected, solution.noise, strict=True)
        return [_RobotSums(np.outer(g, g), expected, noise, 1.0) for g, expected, noise in rows]
    return [
        _RobotSums(x.score.T @ x.score, x.expected.sum(axis=0), x.noise.sum(axis=0), max(len(x.score) - 1.0, 1.0))
        for x in solutions
    ]


def _mean_square_bound(dof: Array) -> tuple[Array, Array]:
    """Return how large a mean square, one on average, may be by chance, and its average where it is bounded there."""
    from scipy.special import gammainc, gammaincc

    half = 0.5 * np.maximum(dof, 1.0)
    upper = 1 + MAX_DEVIATION / np.sqrt(half)
    # the mean of a chi-square that is cut off at the bound, by incomplete gamma functions
    return upper, gammainc(half + 1, half * upper) + upper * gammaincc(half, half * upper)


def _update_components(
    robot_sums: Sequence[_RobotSums], current: VarianceComponents, inflate: bool, avoid_zero: bool
) -> VarianceComponents:
    covariance = np.zeros_like(current.covariance)
    for block in current.blocks:
        place = np.ix_(block, block)
        covariance[place] = _update_block(robot_sums, block, current.covariance[place], avoid_zero)
    if not inflate:
        return VarianceComponents(current.blocks, covariance, current.inflation)
    square, expected = np.array([robot.noise for robot in robot_sums]).T
    # bound what one robot adds, and never make standard errors smaller than stated
    upper, mean = _mean_square_bound(expected * current.inflation)
    ratio = np.minimum(square, upper * expected).sum() / max((mean * expected).sum(), 1e-300)
    return VarianceComponents(current.blocks, covariance, max(1.0, float(current.inflation * np.sqrt(ratio))))


def _update_block(robot_sums: Sequence[_RobotSums], block: ParameterBlock, V: Array, avoid_zero: bool) -> Array:
    """Return W (m, m), the next V: the matrix with W M W = V R V, of squares R and their expectation M."""
    place = np.ix_(block, block)
    squares, expected = (np.array([getattr(x, name)[place] for x in robot_sums]) for name in ("square", "expected"))
    # Huber's bound on what one robot adds, with the expectation corrected for it
    upper, mean = _mean_square_bound(len(block) * np.array([entry.count for entry in robot_sums]))
    observed_square, expected_square = (np.einsum("kij,ji->k", x, V) for x in (squares, expected))
    share = np.minimum(1.0, upper * expected_square / np.maximum(observed_square, 1e-300))
    R, M = np.einsum("k,kij->ij", share, squares), np.einsum("k,kij->ij", mean, expected)
    # in units of the present deviations, for conditioning; a block at zero stays there
    scale = np.sqrt(np.diag(V))
    if not (scale > 0).all() or not (np.diag(M) > 0).all():
        return np.zeros_like(V)
    V, R, M = V / np.outer(scale, scale), R * np.outer(scale, scale), M * np.outer(scale, scale)
    # one more vector with just the present deviations keeps the variance above zero
    if avoid_zero:
        R = R + np.linalg.inv(V)
    # with M = L L', the solution is W = L'^-1 (L' V R V L)^1/2 L^-1
    L = np.linalg.cholesky(M + 1e-9 * np.diag(np.diag(M)))
    roots, vectors = np.linalg.eigh(L.T @ V @ R @ V @ L)
    half = np.linalg.solve(L.T, vectors * np.maximum(roots, 1e-30 * roots[-1]) ** 0.25)
    return np.asarray(half @ half.T * np.outer(scale, scale))


def _relative_change(
    previous: VarianceComponents, current: VarianceComponents, solutions: Sequence[GlsSolution]
) -> float:
    """Return the largest relative change of a standard deviation, as far as the data tell it from zero."""
    old, new = np.diag(previous.covariance), np.diag(current.covariance)
    # components too small for the data to tell from zero do not delay convergence
    vectors = sum(len(run.score) for run in solutions)
    information = np.sum([np.einsum("kii->i", run.expected) for run in solutions], axis=0) / vectors
    change = np.abs(np.log(np.maximum(new, 1e-300) / np.maximum(old, 1e-300))) * np.minimum(old * information, 1.0)
    return float(0.5 * max(change.max(initial=0.0), abs(np.log(current.inflation / previous.inflation))))


def _initial_components(sets: Sequence[WhitenedVectors], blocks: tuple[ParameterBlock, ...]) -> VarianceComponents:
    """Return the variances of the values about their robot's mean and of their errors, from which all fall."""
    # start above the solution: the iteration shrinks variances easily, but cannot leave zero
    total, weight = 0.0, 0.0
    for vectors in sets:
        # how much each vector shows of a parameter
        precision = np.einsum("kij,kij->kj", vectors.factor, vectors.factor)
        ranks = [rank_of_information(G.T @ G, tolerance=MIN_INFORMATION) for G in vectors.factor]
        y = np.array([rank.inverse @ G.T @ z for rank, G, z in zip(ranks, vectors.factor, vectors.value, strict=True)])
        mean = (precision * y).sum(axis=0) / np.maximum(precision.sum(axis=0), 1e-300)
        total = total + (precision * (y - mean) ** 2 + (precision > 0)).sum(axis=0)
        weight = weight + precision.sum(axis=0) * (1 - 1 / max(len(y), 2))
    variance = np.asarray(total) / np.maximum(np.asarray(weight), 1e-300)
    return VarianceComponents(blocks, np.diag(variance))


class Scatter(VarianceComponents):
    """The scatter from log to log, with the factor s^2 by which the covariances of the estimates are too small.

    ``dof`` says how many logs it rests on, less what was estimated from them.
    """

    dof: float = 0.0

    def with_scatter(self, information: Array) -> Array:
        """Return what a log says of the robot (b, b), not of the day: the inverse of its covariance and the scatter."""
        G = whiten(np.zeros((1, len(information))), information[None]).factor[0]
        covariance = self.inflation * np.eye(len(G)) + G @ self.covariance @ G.T
        return np.asarray(G.T @ np.linalg.solve(covariance, G))


def blocks_of(groups: Sequence[ParameterGroup], b: int) -> tuple[NDArray[np.intp], ...]:
    """Return the base parameters that scatter together: friction of a joint, a ripple; each other one by itself."""
    label = np.arange(b)
    # groups that share a parameter are joined into one block
    for group in groups:
        if group.kind is not GroupKind.PAYLOAD:
            touched = np.isin(label, label[group.directions.any(axis=1)])
            label[touched] = label[touched].min(initial=b)
    return tuple(np.flatnonzero(label == number) for number in np.unique(label))


def scatter_of(
    histories: Sequence[History],
    groups: Sequence[ParameterGroup],
    rng: np.random.Generator,
    designs: Sequence[Array] | None = None,
    start: Scatter | None = None,
) -> Scatter:
    """Return the scatter of robots of one type, robust against few that change.

    ``designs`` (K, b, q each) say what is known to have changed, by default nothing: then each of few robots is taken
    in runs of three logs with a mean of their own, because one that changes would hide it in its own scatter. ``rng``
    draws robots where there are more than 400 logs. Raises InputError where the robots do not have the same base
    parameters.
    """
    sizes = {history.value.shape[1] for history in histories}
    if len(sizes) > 1:
        raise InputError(f"the robots have {sorted(sizes)} base parameters; give robots of one type, with one recipe.")
    b = sizes.pop() if sizes else 0
    known_designs = designs or [np.broadcast_to(np.eye(b), history.information.shape) for history in histories]
    sets, dof = list[WhitenedVectors](), 0.0
    # robots in random order, until there are enough logs
    for k in rng.permutation(len(histories)):
        if dof < MAX_LOGS:
            for run in _runs_with_one_mean(len(known_designs[k]), len(histories) < FEW_ROBOTS and designs is None):
                sets.append(whiten(histories[k].value[run], histories[k].information[run], known_designs[k][run]))
                dof += max(len(known_designs[k][run]) - known_designs[k].shape[2] / b, 0.0)
    blocks = blocks_of(groups, b) if b else ()
    # a single vector tells nothing of the scatter about its mean
    sets = [vectors for vectors in sets if len(vectors.value) > 1]
    if not sets:
        return Scatter(blocks, np.zeros((b, b)))
    return Scatter(**vars(variance_components(sets, blocks, inflate=True, start=start)), dof=dof)


def _runs_with_one_mean(logs: int, in_runs: bool) -> list[slice]:
    """Return which logs share a mean: all of a robot, or runs of three, the last one of up to five."""
    starts = range(0, max(logs - 2, 1), 3) if in_runs else range(1)
    ends = [*starts[1:], logs]
    return [slice(start, end) for start, end in zip(starts, ends, strict=True)]
