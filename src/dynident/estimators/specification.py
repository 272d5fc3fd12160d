"""Whether chance explains how far a fit to whitened rows is from least squares, or the model lacks something.

Where the residual is noise, both fits are unbiased, and apart by chance alone: the more, the slower the noise, as least
squares takes more of that for motion. What the model lacks pulls them further apart (Hausman, 1978). How far apart they
are by chance is simulated, with noise as it was found (a parametric bootstrap): both are linear in the torque.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Step, brief
from dynident.regression import Rank, Regression, Whitening

__all__ = ["DRAWS", "Apart"]

Array = NDArray[np.float64]
DRAWS = 99  # of which none is as far apart in one of a hundred fits, where the residual is noise
AT_ONCE = 1 << 23  # numbers of noise that are drawn together


@dataclass(frozen=True, eq=False)
class Apart:
    """Least squares of ``plain`` rows with ``weights`` (n): their triangular ``factor`` (p + 1, p + 1), its ``rank``.

    How far other parameters are from it is the weighted sum of squares of the torque between them, |X (a - b)|^2.
    """

    plain: Regression
    weights: Array
    factor: Array
    rank: Rank

    __repr__ = brief

    def distance(self, by: Array) -> Array:
        """Return how far apart parameters are that differ by (p, k)."""
        return np.asarray(np.square(self.factor[:-1, :-1] @ by).sum(axis=0))

    def chance(self, by: Array, noise: Whitening, rank: Rank, progress: Callable[[str], None]) -> bool:
        """Tell whether a fit to rows whitened by ``noise``, of this ``rank``, may differ by (p) by chance: whether it
        does so as much in one of 99 simulations."""
        white, limit = replace(self.plain, whitening=noise), self.distance(by[:, None])[0]
        done, rng = 0, np.random.default_rng(0)  # a fit is the same whenever it is made
        size = sum(motion.q.size for motion in self.plain.motions)
        while done < DRAWS:
            progress(Step("simulating the noise", done, DRAWS))
            some = min(max(AT_ONCE // size, 1), DRAWS - done)
            drawn = self._drawn(noise, some, rng)
            usual = self.rank.inverse @ self.plain.pulls(drawn, self.weights, filtered=True)
            other = rank.inverse @ white.pulls(drawn, filtered=True)
            if (self.distance(other - usual) >= limit).any():
                return True
            done += some
        return False

    def _drawn(self, noise: Whitening, count: int, rng: np.random.Generator) -> list[Array]:
        """Return noise (N, n, k) for each motion, where it has rows."""
        found = [np.zeros((*motion.q.shape, count)) for motion in self.plain.motions]
        series = self._series(noise, count, rng)
        at = 0
        for k, rows, length in self._rows:
            found[k][rows] = series[at : at + length]
            at += length
        return found

    def _series(self, noise: Whitening, count: int, rng: np.random.Generator) -> Array:
        """Return noise (N, n, k) of as many consecutive rows as there are, after as many more that are left out."""
        from scipy.signal import lfilter  # seldom needed

        total = sum(length for _, _, length in self._rows)
        root = np.linalg.cholesky(noise.covariance)
        out = np.einsum("ij,tjk->tik", root, rng.standard_normal((2 * total, len(root), count)))
        for j, one in enumerate(noise.coefficients):
            out[:, j] = lfilter([1.0], np.append(1.0, -one), out[:, j], axis=0)
        return np.asarray(out[total:])

    @cached_property
    def _rows(self) -> list[tuple[int, slice, int]]:
        """The place of the motion, the samples, and the number of the rows of each block."""
        return list(self._blocks())

    def _blocks(self) -> Iterator[tuple[int, slice, int]]:
        for k, rows, block in self.plain.placed(self.plain.model.structure_with(())):
            yield k, rows, block.tau.shape[1]
