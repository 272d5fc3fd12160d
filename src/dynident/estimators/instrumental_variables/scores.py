"""The covariance of a solution, from the long-run covariance of its scores W_t' D^2 e_t (Newey and West, 1987).

Where two passes of a motion are instruments of each other, the scores of both hold the product of both errors: those of
paired samples are added before they count as a series.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.instrumental_variables.instruments import Instruments
from dynident.estimators.instrumental_variables.moments import Moments, blocks_of, cholesky
from dynident.regression import Rank, Regression
from dynident.regression.long_run import bandwidth, bartlett

__all__ = ["information_of"]

Array = NDArray[np.float64]
SHARE = 0.02  # of a recording: errors of accelerations cancel only over times that are longer than they correlate
ROUNDING = 1e-6  # of the covariance for white residuals: what is below is no estimate
Series = tuple[NDArray[np.intp], Array]  # samples, and the scores there


def information_of(
    found: Moments, rows: Regression, others: Regression, instruments: Sequence[Instruments], rank: Rank
) -> tuple[Array, float]:
    """Return the inverse covariance (p, p) of the solution, and the number of samples that are independent.

    The covariance is A^-1 S A^-T with A = W' D^2 X and the long-run covariance S of the scores of each recording. In
    units of S for white residuals, what is estimated of correlations between directions counts as far as there are more
    independent samples than directions.
    """
    r, beta = found.turn.shape[1], found.to_turn(found.value)
    root = cholesky(found.white(beta))
    total, independent, few = np.zeros((r, r)), 0.0, 0.0
    for series in _recordings(found, beta, root, (rows, others), instruments):
        rows_of = sum(map(len, series()))
        if not rows_of:
            continue
        short = bandwidth(iter([series()]))
        long = max(short, int(SHARE * rows_of))
        total = total + bartlett(series(), long, r)[1]
        independent, few = independent + rows_of / short, few + rows_of / long
    rest = np.diag(np.diag(total))
    spread = root @ ((few * total + r * rest) / (few + r) + ROUNDING * np.eye(r)) @ root.T
    half = np.linalg.solve(cholesky(spread), found.total(found.crossed))  # its square is that of beta
    n = max(found.rows.max(), 1)
    back = rank.values[: rank.rank, None] * rank.vectors[:, : rank.rank].T * rank.scale
    return max(n - r / len(found.weights), 1.0) / n * (half @ back).T @ (half @ back), independent


def _recordings(
    found: Moments, beta: Array, root: Array, both: tuple[Regression, Regression], instruments: Sequence[Instruments]
) -> Iterator[Callable[[], Iterator[Array]]]:
    """Yield for each recording a function that gives its scores, in blocks (B, r)."""
    each = [partial(_scores, found, beta, root, *(_only(one, k) for one in both)) for k in range(len(instruments))]
    whole = {k: _joined(each[k](), beta) for k, one in enumerate(instruments) if one.other is not None}
    for k in whole:
        m = instruments[k].other
        if m in whole and m >= k:
            _fold(whole[k], whole[m], instruments[k], instruments[m])
    for k, scores in enumerate(each):
        yield partial(_last, [whole[k]] if k in whole else scores)


def _last(series: Iterable[Series] | Callable[[], Iterator[Series]]) -> Iterator[Array]:
    return (u for _, u in (series() if callable(series) else series))


def _scores(found: Moments, beta: Array, root: Array, rows: Regression, others: Regression) -> Iterator[Series]:
    """Yield samples and their scores (B, r), in units of ``root``."""
    for block in blocks_of(rows, others, found.turn):
        error = (block.y - block.X @ beta) * found.weights**2
        yield (
            np.arange(len(rows.motions[0]))[block.rows],
            np.linalg.solve(root, np.einsum("bj,bjr->rb", error, block.W)).T,
        )


def _joined(series: Iterator[Series], beta: Array) -> Series:
    parts = [(np.zeros(0, dtype=np.intp), np.zeros((0, len(beta)))), *series]
    at, scores = zip(*parts, strict=True)
    return np.concatenate(at), np.concatenate(scores)


def _fold(one: Series, other: Series, here: Instruments, there: Instruments) -> None:
    """Add the scores of the other pass to those of the samples that have it as instrument, and are its instrument."""
    (at, u), (places, v) = one, other
    if not len(at) or not len(places) or here.partner is None or there.partner is None:
        return
    wanted, step = here.partner[at], int(np.median(np.diff(at))) if len(at) > 1 else 1
    j = np.clip(np.searchsorted(places, wanted), 1, max(len(places) - 1, 1)) - 1
    j = np.minimum(j + (wanted - places[j] > step // 2), len(places) - 1)  # the nearest that is left after decimation
    back = there.partner[places[j]]
    both = (wanted >= 0) & (back >= 0) & (np.abs(places[j] - wanted) <= step) & (np.abs(back - at) <= step)
    if u is v:
        both &= at < places[j]
    u[both] += v[j[both]]
    v[j[both]] = 0.0


def _only(regression: Regression, k: int) -> Regression:
    return replace(regression, motions=regression.motions[k : k + 1], weights=regression.weights[k : k + 1])
