"""Scores of some seconds of a motion for changed parameters: score and information of the base parameters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from functools import cached_property

import numpy as np

from dynident.identification import Identification
from dynident.regression import BaseParameters, EntryBlock, rank_of_information, structural_base_parameters
from dynident.regression.whitening import long_run
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

INFORMATION_TOLERANCE = 1e-9  # of the largest information: what a block does not show
# sums of the same length that are kept, at most: windows are then known to a quarter of their length
MAX_EQUAL_LENGTHS = 4

UNKNOWN_TORQUE_RATIO = 30.0  # of the noise: the torque by which a parameter may be wrong that no motion has shown
MIN_BLOCK_SHARE = 1e-3  # of the usual information: blocks with less do not show how a direction scatters
MIN_PRIOR_SHARE = 1e-4  # of the usual information: what a direction has at least in that
MIN_VARIANCE = 1e-12


class Gram(Noun):
    """Sums over samples for each joint.

    Of the rows Y of the scaled base parameters (``Scorer``) and the residual e of the model as it was
    identified: Y' Y (n, r, r), Y' e (n, r), e' e (n), and the number of rows (n).
    """

    information: Array
    score: Array
    squares: Array
    rows: Array

    def without(self, joint: int) -> Gram:
        """Return the sums without the rows of a joint."""
        weights = np.where(np.arange(len(self.rows)) == joint, 0.0, 1.0)
        information, score = self.information * weights[:, None, None], self.score * weights[:, None]
        return Gram(information, score, self.squares * weights, self.rows * weights)

    def __add__(self, other: Gram) -> Gram:
        """Return the sums over both."""
        return Gram(*(getattr(self, field.name) + getattr(other, field.name) for field in fields(self)))


class Scores(Noun):
    """Scores of a block of motion from ``start`` to ``stop`` (s), of ``samples``, for the base parameters.

    With rows weighted by the joints' noise: ``information`` sum Y' Y (r, r), ``score`` sum Y' e (r).
    ``level`` (n) is the residual level, the logarithm of each joint's mean square that no base parameters
    explain, nan where no row of the joint is in use; ``residual`` (n) the mean square itself, with what they
    would explain (N m, N).
    """

    start: float
    stop: float
    samples: int
    information: Array
    score: Array
    level: Array
    residual: Array


class Scorer(Noun):
    """Reduces torque equations to scores of the base parameters of a result.

    Each base parameter is multiplied by its ``scale`` (r), so that all have effects of about the same size;
    ``sigma`` (n) is the noise of the joints' torques (N m, N) that weights them.
    """

    identification: Identification
    basis: BaseParameters
    sigma: Array

    @classmethod
    def from_identification(cls, identification: Identification) -> Scorer:
        """Return the scorer of a result, with the residual of its fit as noise."""
        sigma = np.asarray(identification.estimate.residual.sigma, dtype=float)
        # a joint without noise would have an infinite weight
        typical = float(np.median(sigma[sigma > 0])) if (sigma > 0).any() else 1.0
        basis = identification.base.structural or structural_base_parameters(identification.model)
        return cls(identification, basis, np.where(sigma > 0, sigma, typical))

    @property
    def scale(self) -> Array:
        """Factors of the base parameters (r)."""
        return self.basis.scale[list(self.basis.independent)]

    @property
    def empty_gram(self) -> Gram:
        """Sums over no samples."""
        n, r = len(self.sigma), len(self.basis.independent)
        return Gram(np.zeros((n, r, r)), np.zeros((n, r)), np.zeros(n), np.zeros(n))

    def gram(self, blocks: Iterable[EntryBlock]) -> Gram:
        """Return the sums over blocks of equations."""
        total = self.empty_gram
        for block in blocks:
            for j, (base, theta) in enumerate(self._maps):
                entries = block.joint_rows(j)
                # the last entry is the torque: subtract that of the result, which leaves the residual
                entries[-1] -= theta @ entries[:-1]
                product = entries @ entries.T
                total.information[j] += base.T @ product[:-1, :-1] @ base
                total.score[j] += base.T @ product[:-1, -1]
                total.squares[j] += product[-1, -1]
                total.rows[j] += np.count_nonzero(block.used[j])
        return total

    def scores(self, gram: Gram, start: float, stop: float, samples: int) -> Scores:
        """Return the scores of a block from its sums."""
        weights = self.sigma**-2
        information, score = np.einsum("j,jkl->kl", weights, gram.information), weights @ gram.score
        # the base parameters that fit the block: what they do not explain is the level of the residual
        step = rank_of_information(information, tolerance=INFORMATION_TOLERANCE).inverse @ score
        squares = gram.squares - 2 * gram.score @ step + np.einsum("k,jkl,l->j", step, gram.information, step)
        has_rows, rows = gram.rows > 0, np.maximum(gram.rows, 1.0)
        min_squares = np.maximum(1e-12 * gram.squares, np.finfo(float).tiny)
        level = np.where(has_rows, np.log(np.maximum(squares, min_squares) / rows), np.nan)
        residual = np.where(has_rows, gram.squares / rows, np.nan)
        return Scores(start, stop, samples, information, score, level, residual)

    @cached_property
    def _maps(self) -> tuple[tuple[Array, Array], ...]:
        """For each joint the maps from its entries to the rows of the scaled base parameters, and to the result's
        torque.
        """
        independent, theta = list(self.basis.independent), self.identification.estimate.value
        maps = self.identification.model.structure.maps
        return tuple((entry_map[:, independent] / self.scale, entry_map @ theta) for entry_map in maps)


class Sums(Noun):
    """Sums over ``count`` blocks from ``start`` to ``stop`` (s), of ``samples``: information (r, r) and score
    (r).

    ``clipped`` (M) are the scores in the groups' directions relative to the reference, those of single
    blocks limited. ``level`` (n) are the standardised residual levels, of ``level_count`` (n) blocks, and
    ``clipped_level`` (n) the same, limited.
    """

    start: float
    stop: float
    count: int
    samples: int
    information: Array
    score: Array
    clipped: Array
    level: Array
    clipped_level: Array
    level_count: Array

    def __add__(self, later: Sums) -> Sums:
        """Return the sums over both."""
        sums = {field.name: getattr(self, field.name) + getattr(later, field.name) for field in fields(self)[2:]}
        return Sums(self.start, later.stop, **sums)


def push_sums(windows: Sequence[Sums], new: Sums) -> tuple[Sums, ...]:
    """Return the windows with the sums of one more block: of more than ``MAX_EQUAL_LENGTHS`` of a length, the
    oldest two merge.
    """
    merged, length = [*windows, new], new.count
    while True:
        equal = [k for k, sums in enumerate(merged) if sums.count == length]
        # merge the oldest two of a length; that may make too many of the doubled length, and so on
        if len(equal) <= MAX_EQUAL_LENGTHS:
            return tuple(merged)
        k = equal[0]
        merged[k : k + 2] = [merged[k] + merged[k + 1]]
        length *= 2


def suffix_sums(windows: Sequence[Sums]) -> tuple[Array, dict[str, Array]]:
    """Return the starts (S) of the windows that end now, the shortest first, and their sums by name (S, ...)."""
    # from the newest back: cumulative sums are those of all windows that end now
    newest_first = list(reversed(windows))
    names = [entry.name for entry in fields(Sums)[2:]]
    sums = {name: np.cumsum([getattr(entry, name) for entry in newest_first], axis=0) for name in names}
    return np.array([entry.start for entry in newest_first]), sums


class Reference(Noun):
    """Scaled base parameters (``Scorer``) of a robot less those of the result, ``value`` (r), with their
    ``covariance``.

    Of the covariance (r, r), ``unknown`` (r, r) is the part that more motion without a change would lessen.
    ``spread`` (M) is the ratio of the variance of the scores in the groups' directions to that of white
    noise, by ``dof`` degrees of freedom. ``level`` (n) and ``level_std`` (n) are mean and spread of a block's
    residual level, the logarithm of the mean square that is left of the torque; ``level_error`` (n) is the
    error of that mean, in such spreads. ``residual`` (n) is the root mean square (N m, N).
    """

    value: Array
    covariance: Array
    unknown: Array
    spread: Array
    dof: float
    level: Array
    level_std: Array
    level_error: Array
    residual: Array

    def with_residual_change(self, joint: int, step: float) -> Reference:
        """Return the reference after a change of a joint's residual level by ``step``, a difference of logarithms."""
        levels = self.level.copy()
        levels[joint] += step
        return replace(self, level=levels)

    def learn(self, block: Scores) -> Reference:
        """Return the reference after a block of motion that is new to it."""
        typical_spread = float(np.median(self.spread))
        step = block.score - block.information @ self.value
        inverses = (np.linalg.inv(_regularise(matrix)) for matrix in (self.covariance, self.unknown))
        sums = (inverse + block.information / typical_spread for inverse in inverses)
        covariance, unknown = (np.asarray(np.linalg.inv(_regularise(matrix))) for matrix in sums)
        value = self.value + covariance @ step / typical_spread
        return replace(self, value=value, covariance=covariance, unknown=unknown)


def build_reference(blocks: Sequence[Scores], directions: Array) -> Reference:
    """Build the reference from blocks without a change, for the ``directions`` (r, M) of the groups."""
    A, s = sum(entry.information for entry in blocks), sum(entry.score for entry in blocks)
    # mean square torque, in units of the noise
    mean_squares = np.diag(np.asarray(A)) / sum(entry.samples for entry in blocks)
    # a parameter that no motion has shown may be wrong by a torque of UNKNOWN_TORQUE_RATIO times the noise
    usual = np.maximum(mean_squares, MIN_PRIOR_SHARE * float(np.median(mean_squares)))
    prior = np.diag(usual / UNKNOWN_TORQUE_RATIO**2)
    value = np.linalg.solve(_regularise(A + prior), np.asarray(s))
    M = np.stack([np.diag(directions.T @ entry.information @ directions) for entry in blocks])
    u = np.stack([(entry.score - entry.information @ value) @ directions for entry in blocks])
    # by how much the scores scatter more than white noise would, direction by direction
    spread = np.array([_score_spread(u[:, m], M[:, m]) for m in range(u.shape[1])])
    covariance = np.asarray(np.linalg.inv(_regularise(A / float(np.median(spread)) + prior)), dtype=float)
    levels = np.stack([entry.level for entry in blocks])
    mean, std = (np.array([entry(x) for x in levels.T]) for entry in (_finite_mean, _long_run_std))
    count = np.isfinite(levels).sum(axis=0)
    residual = np.sqrt(np.array([_finite_mean(x) for x in np.stack([entry.residual for entry in blocks]).T]))
    error, dof = 1 / np.sqrt(np.maximum(count, 1)), max(len(blocks) / 2.0, 4.0)
    return Reference(value, covariance, covariance, spread, dof, mean, std, error, residual)


def _score_spread(u: Array, M: Array) -> float:
    """Return the variance of scores u (K) relative to M (K), or that of their sum if it is larger; at least
    1e-6.

    It is one where fewer than four blocks show the direction.
    """
    is_shown = MIN_BLOCK_SHARE * max(float(M.max()), MIN_VARIANCE) < M
    if is_shown.sum() < 4:
        return 1.0
    # scores of blocks with much and little motion are comparable once standardised
    z = u[is_shown] / np.sqrt(M[is_shown])
    k = len(z)
    # what lasts over several blocks adds to the variance of their sum
    long_run_variance = float(long_run([z[:, None] - z.mean()])[0, 0]) / (k - 1)
    return max(float(z.var(ddof=1)), long_run_variance, 1e-6)


def _finite_mean(x: Array) -> float:
    finite = x[np.isfinite(x)]
    return float(finite.mean()) if len(finite) else float("nan")


def _long_run_std(x: Array) -> float:
    """Return the standard deviation of a block by its long-run variance; nan for fewer than 4 blocks."""
    finite = x[np.isfinite(x)]
    if len(finite) < 4:
        return float("nan")
    centred = finite - finite.mean()
    return float(np.sqrt(max(long_run([centred[:, None]])[0, 0] / (len(finite) - 1), finite.var(ddof=1), MIN_VARIANCE)))


def _regularise(matrix: Array) -> Array:
    """Return a symmetric matrix with a tiny share of its diagonal added, so that rounding leaves it invertible."""
    A = np.asarray(matrix)
    return np.asarray((A + A.T) / 2 + 1e-12 * np.diag(np.maximum(np.diag(A), MIN_VARIANCE)))
