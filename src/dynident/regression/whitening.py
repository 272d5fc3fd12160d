"""Whitening: rows whose noise is coloured in time and correlated between joints, made independent and of unit variance.

The noise of joint j is an autoregression e_t = a_1 e_(t-1) + ... + a_m e_(t-m) + u_t, and the innovations u_t of all
joints have a covariance S. Rows, torque and regressor alike, go through the same filter and the same mixing U^-1 with
S = U U', U upper triangular: row j is then the innovation of joint j less what those of the joints after it tell of it,
so that it has few columns more than before (Aitken's generalised least squares).

Every uninterrupted stretch of rows of a joint starts anew, exactly: its first m rows have the best predictors from the
rows that there are (Durbin and Levinson), and are scaled to the variance of an innovation. Of innovations of several
joints at such a row the covariance S is kept, which is exact where their coefficients are the same. Where rows of some
joints are missing, those that are there are mixed by their part of S.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.models import Structure
from dynident.models.structure import select_independent
from dynident.motion.filters import butterworth, slowest_pole, zero_phase
from dynident.motion.log import Motion, mark_read_only
from dynident.motion.smoothers import cutoff_complaint
from dynident.motion.splines import stretches
from dynident.regression.triangular import EntryBlock
from dynident.runtime import Axes, ConfigError, Noun, check_settings
from dynident.runtime.arrays import Array


def bandwidth(series: Iterator[Iterator[Array]]) -> int:
    """Return Andrews' (1991, eqs. 5.3 and 6.4) L in samples for Bartlett's kernel, each column fitted as AR(1).

    ``series`` holds for each uninterrupted stretch its blocks (B, r). All columns count alike; L is at most a tenth of
    the samples.
    """
    squares: Array | float = 0.0
    products: Array | float = 0.0
    rows = 0
    for blocks in series:
        last_row = None
        for u in blocks:
            joined = u if last_row is None else np.concatenate((last_row, u))
            squares, products = squares + np.square(u).sum(axis=0), products + (joined[1:] * joined[:-1]).sum(axis=0)
            last_row, rows = u[-1:], rows + len(u)
    # AR(1) coefficient of each column; the limits keep the moments below finite
    rho = np.clip(products / np.where(np.asarray(squares) > 0, squares, 1.0), -0.9999, 0.9999)
    innovation = (1 - rho**2) ** 2  # squared innovation variance of a series of unit variance
    alpha = np.sum(4 * rho**2 * innovation / ((1 - rho) ** 6 * (1 + rho) ** 2)) / np.sum(innovation / (1 - rho) ** 4)
    return int(np.clip(np.ceil(1.1447 * (alpha * rows) ** (1 / 3)), 1, max(rows // 10, 1)))


def long_run(series: Sequence[Array]) -> Array:
    """Return S = sum_ts max(0, 1 - |t - s| / L) u_t u_s' (r, r) of scores u (N, r), a series for each stretch."""
    length = bandwidth(iter([u]) for u in series)
    return np.asarray(sum(bartlett(iter([u]), length, u.shape[1])[1] for u in series))


def bartlett(blocks: Iterator[Array], length: int, width: int) -> tuple[int, Array]:
    """Return the number of rows and (1/L) sum b_t b_t', the running sums b reaching past both ends."""
    pending, rows, total = np.zeros((length - 1, width)), 0, np.zeros((width, width))

    def add(u: Array) -> None:
        """Add the next rows to the sums that are still running, and those that end to the total."""
        nonlocal pending, total
        # running sums over L rows, as differences of cumulative sums
        sums = np.cumsum(np.concatenate((np.zeros((1, width)), pending, u)), axis=0)
        b = sums[length:] - sums[:-length]
        total = total + b.T @ b
        pending = np.concatenate((pending, u))[len(u) :]

    for u in blocks:
        add(u)
        rows += len(u)
    # zeros flush the sums that reach past the end
    add(np.zeros((length - 1, width)))
    return rows, total / length


HIGHEST_ORDER = 12  # order of a digital filter: poles of higher ones are lost in rounding


@dataclass(frozen=True)
class ParallelFilter:
    """Parallel filtering: the same zero-phase low-pass and decimation for the torque and every regressor column.

    The relation tau = Y theta holds exactly after a linear filter. ``decimate`` keeps every k-th sample; ``cutoff``
    (Hz) is that of the Butterworth filter of ``order``, applied forward and backward; None takes 0.8 of the Nyquist
    frequency after decimation. Reference: Gautier and Poignet (2000), cited by the article.

    >>> import dynident as dy
    >>> dy.ParallelFilter(decimate=10, cutoff=20.0)
    ParallelFilter(decimate=10, cutoff=20.0, order=4)
    """

    decimate: Annotated[int, Ge(1)] = 1
    cutoff: Annotated[float, Gt(0)] | None = None
    order: Annotated[int, Ge(1), Le(HIGHEST_ORDER)] = 4

    def __post_init__(self) -> None:
        check_settings(self)
        if self.decimate == 1 and self.cutoff is None:
            raise ConfigError("parallel filter: give decimate > 1, a cutoff in Hz, or both.")

    def sections(self, motion: Motion) -> Array:
        """Return the filter's second-order sections for the mean rate of a motion."""
        cutoff, reason = self.cutoff_at(motion), "" if self.cutoff else f" for decimate = {self.decimate},"
        if complaint := cutoff_complaint(f"the parallel filter's cut-off{reason}", cutoff, motion.t):
            raise ConfigError(f"{motion.source}: {complaint}")
        return butterworth(self.order, cutoff, _rate(motion))

    def cutoff_at(self, motion: Motion) -> float:
        """Return the cut-off (Hz) for a motion."""
        return self.cutoff or 0.4 * _rate(motion) / self.decimate

    def filter_motion(self, motion: Motion, channels: Sequence[str] = ("q", "dq", "ddq", "tau")) -> Motion:
        """Return a motion with its ``channels`` filtered in each stretch of usable samples, and not decimated."""
        sections = self.sections(motion)
        series: dict[str, Any] = {name: getattr(motion, name).copy() for name in channels}
        for part in stretches(motion.mask):
            for x in series.values():
                x[part] = self.apply(sections, x[part])
        for x in series.values():
            mark_read_only(x)
        return replace(motion, **series)

    def pad_samples(self, sections: Array) -> int:
        """Return the number of samples in which the filter's response decays to about 1e-12."""
        slowest = max(slowest_pole(sections), 0.1)  # a pole at zero has no logarithm
        return int(np.ceil(np.log(1e-12) / np.log(slowest)))

    def apply(self, sections: Array, x: Array, axis: int = 0) -> Array:
        """Return x filtered at all N samples of an axis, the first, not yet decimated; fastest along the last one."""
        return zero_phase(sections, x, min(3 * self.order, x.shape[axis] - 1), axis)

    def __str__(self) -> str:
        cutoff = "0.8 of half the decimated rate" if self.cutoff is None else f"{self.cutoff:g} Hz"
        decimation = f", one of {self.decimate} samples kept" if self.decimate > 1 else ""
        return f"low-pass of order {self.order} at {cutoff}{decimation}"


def _rate(motion: Motion) -> float:
    return 1.0 / float(np.diff(motion.t).mean())


PlacedBlock = tuple[int, slice, EntryBlock]  # rows, with the place of their motion and their samples in it
SPARE_ROWS = 30  # random rows beyond the number of columns that they are to tell apart


class Whitening(Noun):
    """A noise model: ``coefficients`` a (m_j) of the autoregression of each joint, and ``covariance`` S (n, n) of the
    innovations, (N m)^2 or N^2.

    Raises ConfigError where an autoregression is not stable, or the covariance not positive definite.
    """

    coefficients: tuple[Annotated[Array, Axes("m")], ...]
    covariance: Annotated[Array, Axes("n", "n")]

    def __post_init__(self) -> None:
        n = len(self.coefficients)
        if self.covariance.shape != (n, n) or not np.allclose(self.covariance, self.covariance.T, rtol=1e-9):
            raise ConfigError(f"covariance of the noise is no symmetric matrix of the {n} joints.")
        if not (np.isfinite(self.covariance).all() and np.linalg.eigvalsh(self._correlation)[0] > 0):
            raise ConfigError("covariance of the noise: is not positive definite.")
        for j, coefficients in enumerate(self.coefficients):
            if not is_stable(coefficients):
                raise ConfigError(f"coefficients of the noise of joint {j + 1}: the autoregression is not stable.")

    @property
    def _correlation(self) -> Array:
        deviation = np.sqrt(np.diag(self.covariance))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.nan_to_num(self.covariance / np.outer(deviation, deviation)))

    @property
    def orders(self) -> tuple[int, ...]:
        """The order of the autoregression of each joint."""
        return tuple(map(len, self.coefficients))

    @property
    def span(self) -> int:
        """The number of rows before a row that count in it."""
        return max(self.orders, default=0)

    @cached_property
    def mixes(self) -> bool:
        """Whether innovations of the joints are correlated."""
        return bool((self.covariance[~np.eye(len(self.covariance), dtype=bool)] != 0).any())

    @cached_property
    def predictors(self) -> tuple[tuple[tuple[Array, float], ...], ...]:
        """For each joint, the best predictors from k = 0 ... m rows, with their scales.

        A predictor is its coefficients (k) and what its error is multiplied by to have the variance of an innovation
        (zero where the autoregression is not stable).
        """
        return tuple(map(_levinson_predictors, self.coefficients))

    def structure(self, plain: Structure) -> Structure:
        """Return the structure of whitened rows from the ``plain`` structure of the rows."""
        if not self.mixes:
            return plain
        columns_and_maps = [_spanning_columns(np.concatenate(plain.maps[j:])) for j in range(len(plain.maps))]
        return Structure(tuple(columns for columns, _ in columns_and_maps), tuple(maps for _, maps in columns_and_maps))

    def innovations(self, block: EntryBlock, lead: int = 0) -> list[Array]:
        """Return for each joint the innovations (b_j + 1, B) of [Y_j | tau_j]', zero where rows are not to be used.

        The first ``lead`` rows of the block only serve as predecessors.
        """
        return [self._prewhiten(j, block, lead) for j in range(len(self.coefficients))]

    def rows(self, block: EntryBlock, mixed: Structure, lead: int = 0) -> EntryBlock:
        """Return the whitened rows of a block, which have the structure ``mixed``."""
        series = self.innovations(block, lead)
        keep = None if block.keep is None else block.keep[:, lead:]
        if not self.mixes:
            series = [x / s for x, s in zip(series, np.sqrt(np.diag(self.covariance)), strict=True)]
            entries, tau = np.concatenate([x[:-1] for x in series]), np.stack([x[-1] for x in series])
            return EntryBlock(mixed, entries, tau, keep)
        w, plain = self._mixing_weights(keep), block.structure
        entries, tau = np.zeros((len(mixed.joint), series[0].shape[1])), np.zeros((len(series), series[0].shape[1]))
        # row j takes its own innovation and those of the joints after it, in the columns of the mixed structure
        for j, (part, columns) in enumerate(zip(mixed.parts, mixed.columns, strict=True)):
            for k in range(j, len(series)):
                contribution = w[j, k] * series[k]
                entries[part] += plain.maps[k][:, columns].T @ contribution[:-1]
                tau[j] += contribution[-1]
        return EntryBlock(mixed, entries, tau, keep)

    def _prewhiten(self, j: int, block: EntryBlock, lead: int) -> Array:
        x, a = block.joint_rows(j), self.coefficients[j]
        if not len(a):
            return x[:, lead:]
        kernel, present = np.append(1.0, -a), block.used[j]
        # rows with all predecessors go through the filter; the first ones of a stretch follow below
        y: Array = np.stack([np.convolve(row, kernel)[lead : len(row)] for row in x]) * present[lead:]
        age = preceding_counts(present)
        starting = lead + np.flatnonzero(present[lead:] & (age[lead:] < len(a)))
        # a row with k < m predecessors takes the best predictor from these, scaled to the innovation's variance
        for k in np.unique(age[starting]):
            at, (predictor, scale) = starting[age[starting] == k], self.predictors[j][k]
            past = at - 1 - np.arange(k)[:, None]
            y[:, at - lead] = scale * (x[:, at] - np.einsum("k,rkt->rt", predictor, x[:, past]))
        return y

    def _mixing_weights(self, keep: NDArray[np.bool_] | None) -> Array:
        """Return the weight of each joint's innovation in each row: (n, n, B), or (n, n, 1) for all rows alike."""
        if keep is None or keep.all():
            return _inverse_mixing(self.covariance)[:, :, None]
        # the mixing of each pattern of missing joints is computed once
        patterns, pattern_index = np.unique(keep, axis=1, return_inverse=True)
        weights = np.zeros((*self.covariance.shape, patterns.shape[1]))
        for i, present in enumerate(patterns.T):
            joints = np.flatnonzero(present)
            weights[joints[:, None], joints, i] = _inverse_mixing(self.covariance[np.ix_(joints, joints)])
        return weights[:, :, pattern_index.ravel()]


def whiten_blocks(
    blocks: Iterable[PlacedBlock], whitening: Whitening, mixed: Structure, first_sample: int = 0
) -> Iterator[PlacedBlock]:
    """Yield the whitened rows of consecutive blocks, without those of samples before ``first_sample``.

    Of a block only its last rows are held, as many as the next one needs.
    """
    before: tuple[int, slice, EntryBlock] | None = None
    for k, rows, block in blocks:
        # the rows held from the block before complete the predecessors of this one
        is_continued = before is not None and before[:2] == (k, rows.start)
        joined_block = join_blocks([before[2], block]) if before is not None and is_continued else block
        lead = joined_block.tau.shape[1] - block.tau.shape[1]
        dropped = len(range(rows.start, min(first_sample, rows.stop), rows.step or 1))
        if dropped < block.tau.shape[1]:
            start = rows.start + dropped * (rows.step or 1)
            yield k, slice(start, rows.stop, rows.step), whitening.rows(joined_block, mixed, lead + dropped)
        last_rows = slice(max(joined_block.tau.shape[1] - whitening.span, 0), None)
        keep = None if joined_block.keep is None else joined_block.keep[:, last_rows]
        last_block = replace(
            joined_block, entries=joined_block.entries[:, last_rows], tau=joined_block.tau[:, last_rows], keep=keep
        )
        before = k, rows.stop, last_block


def join_blocks(blocks: list[EntryBlock]) -> EntryBlock:
    """Return consecutive blocks of one structure as one block."""
    if len(blocks) == 1:
        return blocks[0]
    has_keep, keep = any(block.keep is not None for block in blocks), [block.used for block in blocks]
    entries, tau = (np.concatenate([getattr(block, x) for block in blocks], axis=1) for x in ("entries", "tau"))
    return EntryBlock(blocks[0].structure, entries, tau, np.concatenate(keep, axis=1) if has_keep else None)


def preceding_counts(present: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Return the number of rows (B) directly before each that are present."""
    index = np.arange(len(present))
    # the last gap before each row, by a running maximum
    gap = np.maximum.accumulate(np.where(present, -1, index))
    return np.asarray(index - 1 - np.concatenate([[-1], gap[:-1]])) if len(index) else index


def is_stable(a: Array) -> bool:
    """Return whether an autoregression with the coefficients a (m) is stable, to working precision."""
    return all(np.isfinite(scale) and scale > 0 for _, scale in _levinson_predictors(a))


def _levinson_predictors(a: Array) -> tuple[tuple[Array, float], ...]:
    """Return the predictors from 0 ... m rows with their scales, by Levinson's recursion backwards."""
    predictors, scale = [(np.asarray(a, dtype=float), 1.0)], 1.0
    while len(coefficients := predictors[-1][0]):
        # the last coefficient is the reflection coefficient, which gives the predictor of one order less
        reflection, shorter = coefficients[-1], coefficients[:-1]
        scale *= np.sqrt(max(1.0 - reflection**2, 0.0))
        predictors.append(
            (
                np.zeros_like(shorter)
                if scale == 0
                else (shorter + reflection * shorter[::-1]) / (1.0 - reflection**2),
                float(scale),
            )
        )
    return tuple(reversed(predictors))


def _inverse_mixing(S: Array) -> Array:
    """Return the inverse of the upper triangular U with U U' = S (n, n)."""
    if not len(S):
        return S
    # the Cholesky factor of the reversed matrix is upper triangular in the original order
    lower = np.linalg.inv(np.linalg.cholesky(S[::-1, ::-1]))
    return np.asarray(np.tril(lower)[::-1, ::-1])


def _spanning_columns(maps: Array) -> tuple[NDArray[np.intp], Array]:
    """Return independent columns (b) of the rows ``maps`` (m, p), and the matrix that makes all of them (b, p)."""
    nonzero = np.flatnonzero(maps.any(axis=0))
    if not len(nonzero):
        return nonzero, np.zeros((0, maps.shape[1]))
    # random combinations of the rows have the same independent columns as the rows themselves
    random = np.random.default_rng(0).standard_normal((2 * len(nonzero) + SPARE_ROWS, len(maps)))
    X = random @ maps[:, nonzero]
    scale = np.sqrt(np.square(X).mean(axis=0))
    chosen_columns, K = select_independent(X / scale)
    all_columns = np.zeros((len(chosen_columns), maps.shape[1]))
    all_columns[:, nonzero] = K * scale / scale[chosen_columns, None]
    return nonzero[chosen_columns], all_columns
