"""Variance components: how much measured vectors differ beyond their standard errors, by restricted likelihood.

Vectors y_k = X_k c + u_k + e_k have errors e_k ~ N(0, s^2 C_k) of known shape and deviations u_k ~ N(0, V) with V made
of blocks. REML (Patterson and Thompson, 1971) by the iteration of Zhou et al. (2015), "MM algorithms for variance
components models", which keeps each block positive definite. Robots that deviate more than chance are bounded as by
Huber (1964), so that the few in which something has changed do not make all others look uncertain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Components", "Measured", "Solved", "components", "measured", "pseudo_inverse", "solved"]

Array = NDArray[np.float64]
Block = NDArray[np.intp]
SHOWN = 1e-10  # a direction with less of the largest information, in scaled parameters, is not shown
ROUNDS, CLOSE = 80, 0.01  # of the iteration, until no component changes by more
CAP = 3.0  # standard deviations of a mean square above one at which it is bounded


@dataclass(frozen=True, eq=False)
class Measured:
    """K vectors (b) as whitened rows z_k = G_k y_k, and what of them is one robot's: y_k = design_k c + deviations.

    ``factor`` (K, b, b) holds the G_k, G_k' G_k = C_k^-1, with zero rows for directions not shown, ``shown`` (K, b) the
    others; ``value`` (K, b) the z_k; ``design`` (K, b, q).
    """

    factor: Array
    value: Array
    shown: NDArray[np.bool_]
    design: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Components:
    """The covariance (b, b) of deviations, by ``blocks`` of parameters, and the factor s^2 on the covariances C_k."""

    blocks: tuple[Block, ...]
    covariance: Array
    inflation: float = 1.0

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Solved:
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

    __repr__ = brief


def measured(value: Array, information: Array, design: Array | None = None) -> Measured:
    """Return values (K, b) with information (K, b, b) as whitened rows; ``design`` (K, b, q) is one mean by default."""
    precision = np.sqrt(np.einsum("kii->ki", information))
    scale = np.where(precision > 0, precision, 1.0)
    roots, vectors = np.linalg.eigh(information / (scale[:, :, None] * scale[:, None, :]))
    shown = roots > SHOWN * roots[:, -1:].clip(min=0.0)
    size = np.sqrt(np.where(shown, roots, 0.0))
    factor = size[:, :, None] * vectors.swapaxes(1, 2) * precision[:, None, :]
    mean = np.broadcast_to(np.eye(value.shape[1]), information.shape)
    return Measured(factor, np.einsum("kij,kj->ki", factor, value), shown, mean if design is None else design)


def pseudo_inverse(matrix: Array) -> Array:
    """Return the inverse of an information matrix (q, q) on the directions that it shows, zero on the others."""
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0, scale, 1.0)
    roots, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    shown = roots > SHOWN * max(roots[-1], 0.0)
    half = vectors[:, shown] / np.sqrt(roots[shown]) / scale[:, None]
    return np.asarray(half @ half.T)


def solved(one: Measured, parts: Components, weights: Array | None = None) -> Solved:
    """Return c by generalised least squares; ``weights`` (K) divide the covariances of the vectors."""
    G, b = one.factor, one.factor.shape[1]
    inverse = np.linalg.inv(parts.inflation * np.eye(b) + G @ parts.covariance @ G.swapaxes(1, 2))
    if weights is not None:
        inverse = weights[:, None, None] * inverse
    X = G @ one.design
    NX = inverse @ X
    covariance = pseudo_inverse(np.einsum("kiq,kip->qp", X, NX))
    c = covariance @ np.einsum("kiq,ki->q", NX, one.value)
    e = one.value - X @ c
    n = np.einsum("kij,kj->ki", inverse, e)
    hat = NX @ covariance @ NX.swapaxes(1, 2)
    left = inverse - hat
    noise = np.stack([(n**2).sum(axis=1), (np.einsum("kii->ki", left) * one.shown).sum(axis=1)], axis=1)
    expected = G.swapaxes(1, 2) @ left @ G
    return Solved(c, covariance, np.einsum("kij,ki->kj", G, n), expected, noise, (e * n).sum(axis=1))


def components(
    sets: Sequence[Measured],
    blocks: Sequence[Block],
    *,
    inflate: bool = False,
    few: bool = False,
    start: Components | None = None,
) -> Components:
    """Return the variance components that several robots' vectors share, or those of one set of vectors.

    With ``inflate`` the factor s^2 >= 1 is sought, too. With ``few`` no variance is zero by chance: each is as if one
    more vector had shown it (Chung et al., 2013). Blocks that nothing shows are zero.
    """
    now = start or _start(sets, tuple(blocks))
    for _ in range(ROUNDS):
        runs = [solved(one, now, weights_of(one, now) if len(sets) == 1 else None) for one in sets]
        before, now = now, _next(_owners(runs), now, inflate, few)
        if _moved(before, now, runs) < CLOSE:
            break
    return now


def weights_of(one: Measured, parts: Components) -> Array:
    """Return a weight (K) below one for each vector that is farther from the mean than chance."""
    weights = np.ones(len(one.value))
    dof = one.shown.sum(axis=1)
    for _ in range(10):
        distance = solved(one, parts, weights).distance / weights
        weights = np.minimum(1.0, (dof + CAP * np.sqrt(2.0 * dof)) / np.maximum(distance, 1e-300))
    return weights


@dataclass(frozen=True, eq=False)
class _Owner:
    """What one robot says of the components: sums over its vectors of squared scores, their covariances, the noise."""

    square: Array
    expected: Array
    noise: Array
    count: float

    __repr__ = brief


def _owners(runs: Sequence[Solved]) -> list[_Owner]:
    """Return the sums by robot; of one set, by its vectors."""
    if len(runs) == 1:
        (run,) = runs
        rows = zip(run.score, run.expected, run.noise, strict=True)
        return [_Owner(np.outer(g, g), expected, noise, 1.0) for g, expected, noise in rows]
    return [
        _Owner(run.score.T @ run.score, run.expected.sum(axis=0), run.noise.sum(axis=0), max(len(run.score) - 1.0, 1.0))
        for run in runs
    ]


def _bound(dof: Array) -> tuple[Array, Array]:
    """Return how large a mean square, one on average, may be by chance, and its average where it is bounded there."""
    from scipy.special import gammainc, gammaincc

    half = 0.5 * np.maximum(dof, 1.0)
    most = 1 + CAP / np.sqrt(half)
    return most, gammainc(half + 1, half * most) + most * gammaincc(half, half * most)


def _next(owners: Sequence[_Owner], now: Components, inflate: bool, few: bool) -> Components:
    covariance = np.zeros_like(now.covariance)
    for block in now.blocks:
        place = np.ix_(block, block)
        covariance[place] = _block(owners, block, now.covariance[place], few)
    if not inflate:
        return Components(now.blocks, covariance, now.inflation)
    square, expected = np.array([one.noise for one in owners]).T
    most, mean = _bound(expected * now.inflation)
    ratio = np.minimum(square, most * expected).sum() / max((mean * expected).sum(), 1e-300)
    return Components(now.blocks, covariance, max(1.0, float(now.inflation * np.sqrt(ratio))))


def _block(owners: Sequence[_Owner], block: Block, V: Array, few: bool) -> Array:
    """Return W (m, m), the next V: the matrix with W M W = V R V, of squares R and their expectation M."""
    place = np.ix_(block, block)
    squares, expected = (
        np.array(one) for one in zip(*((x.square[place], x.expected[place]) for x in owners), strict=True)
    )
    most, mean = _bound(len(block) * np.array([one.count for one in owners]))
    found, wanted = (np.einsum("kij,ji->k", x, V) for x in (squares, expected))
    share = np.minimum(1.0, most * wanted / np.maximum(found, 1e-300))
    R, M = np.einsum("k,kij->ij", share, squares), np.einsum("k,kij->ij", mean, expected)
    scale = np.sqrt(np.diag(V))
    if not (scale > 0).all() or not (np.diag(M) > 0).all():
        return np.zeros_like(V)
    V, R, M = V / np.outer(scale, scale), R * np.outer(scale, scale), M * np.outer(scale, scale)
    if few:
        R = R + np.linalg.inv(V)
    L = np.linalg.cholesky(M + 1e-9 * np.diag(np.diag(M)))
    roots, vectors = np.linalg.eigh(L.T @ V @ R @ V @ L)
    half = np.linalg.solve(L.T, vectors * np.maximum(roots, 1e-30 * roots[-1]) ** 0.25)
    return np.asarray(half @ half.T * np.outer(scale, scale))


def _moved(before: Components, now: Components, runs: Sequence[Solved]) -> float:
    """Return the largest relative change of a standard deviation, as far as the data tell it from zero."""
    old, new = np.diag(before.covariance), np.diag(now.covariance)
    seen = np.sum([np.einsum("kii->i", run.expected) for run in runs], axis=0) / sum(len(run.score) for run in runs)
    change = np.abs(np.log(np.maximum(new, 1e-300) / np.maximum(old, 1e-300))) * np.minimum(old * seen, 1.0)
    return float(0.5 * max(change.max(initial=0.0), abs(np.log(now.inflation / before.inflation))))


def _start(sets: Sequence[Measured], blocks: tuple[Block, ...]) -> Components:
    """Return the variances of the values about their robot's mean and of their errors, from which all fall."""
    total, weight = 0.0, 0.0
    for one in sets:
        precision = np.einsum("kij,kij->kj", one.factor, one.factor)  # how much each vector shows of a parameter
        y = np.array([pseudo_inverse(G.T @ G) @ G.T @ z for G, z in zip(one.factor, one.value, strict=True)])
        mean = (precision * y).sum(axis=0) / np.maximum(precision.sum(axis=0), 1e-300)
        total = total + (precision * (y - mean) ** 2 + (precision > 0)).sum(axis=0)
        weight = weight + precision.sum(axis=0) * (1 - 1 / max(len(y), 2))
    variance = np.asarray(total) / np.maximum(np.asarray(weight), 1e-300)
    return Components(blocks, np.diag(variance))
