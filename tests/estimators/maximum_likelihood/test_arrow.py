"""A matrix with a band and a border: solved, inverted, gathered."""

import numpy as np
import pytest

from dynident.errors import ModelError
from dynident.estimators.maximum_likelihood.arrow import Arrow, gather, overlap


class TestArrow:
    def matrix(self, rng: np.random.Generator, size: int = 14, w: int = 4) -> tuple[np.ndarray, np.ndarray]:
        L = np.tril(rng.standard_normal((size, size))) * (np.abs(np.subtract.outer(range(size), range(size))) < w)
        A = (L + 3 * np.eye(size)) @ (L + 3 * np.eye(size)).T
        band = np.zeros((w, size))
        for d in range(w):
            band[d, : size - d] = np.diag(A, -d)
        return A, band

    def test_solves_and_inverts(self, rng: np.random.Generator) -> None:
        A, band = self.matrix(rng)
        B = rng.standard_normal((14, 3))
        arrow, inverse = Arrow(band, B), np.linalg.inv(A)
        np.testing.assert_allclose(arrow.border_solution, inverse @ B, rtol=1e-10)
        np.testing.assert_allclose(arrow.log_det, np.linalg.slogdet(A)[1], rtol=1e-12)
        for d in range(4):
            np.testing.assert_allclose(arrow.inverse[d, : 14 - d], np.diag(inverse, -d), rtol=1e-9, atol=1e-14)

    def test_gathers_overlapping_blocks(self, rng: np.random.Generator) -> None:
        first = np.array([0, 2, 3])
        half = rng.standard_normal((3, 4, 4))
        blocks, rows = half @ half.swapaxes(1, 2), rng.standard_normal((3, 4, 2))
        full, side = np.zeros((7, 7)), np.zeros((7, 2))
        for at, block, row in zip(first, blocks, rows, strict=True):
            full[at : at + 4, at : at + 4] += block
            side[at : at + 4] += row
        band, border = gather(blocks, rows, overlap(first, 4, 7))
        for d in range(4):
            np.testing.assert_allclose(band[d, : 7 - d], np.diag(full, -d))
        np.testing.assert_allclose(border, side)

    def test_refuses_what_is_not_determined(self) -> None:
        with pytest.raises(ModelError, match="not determined"):
            Arrow(np.zeros((2, 5)), np.zeros((5, 1))).inner(np.ones((5, 1)))
